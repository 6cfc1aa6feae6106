"""Every option of a case in every command: it reaches its place, or is refused in one line.

Places are cloud, model, sweep and search.
"""

import dataclasses
import json
import types

import numpy as np
import pytest

from jaxgel._validation import entry_of
from jaxgel.bifurcation import imperfections
from jaxgel.cases import OutputOptions, load_case
from jaxgel.cli import command_line as cli
from jaxgel.continuation import SweepOptions
from jaxgel.discretisation import DiscretisationOptions
from jaxgel.discretisation import options as discretisation_options
from jaxgel.mechanics import Loads, Problem

SECTIONS = {"discretisation": DiscretisationOptions, "sweep": SweepOptions, "loads": Loads}
VALUES = {
    "spacing": 1.1,
    "nodes_per_hole": 9,
    "across": 3,
    "basis": "linear",
    "dmax": 2.7,
    "mu_start": -3.5,
    "mu_end": -1.2,
    "steps": 3,
    "mu": [-3.0, -2.5, -2.0],
    "control": "chi",
    "from": 0.15,
    "to": 0.25,
    "values": [0.1, 0.3, 0.2],
    "back": True,
    "at_mu": -1.5,
    "direction": "x",
    "obstacle": 1,
    "displacement": [0.1, -1.0],
    "branch": "symmetric",
    "imperfection": 0.05,
    "contact": "off",
    "contact_range": 0.07,
    "symmetry": "off",
    "eigenvalues": True,
    "body_force": [0.0, 1e-5],
    "traction": {"top": [0.0, 1e-4]},
}  # a value of each option that is not its default
DRIVEN = {"control": "chi", "from": 0.1, "to": 0.2}  # beside an option of another control than mu
PUNCHED = {"control": "punch", "from": 0.0, "to": 0.1, "displacement": [0.0, -1.0]}
PINS = "".join(
    f"[[obstacles]]\nkind = 'disc'\ncentre = [0.0, {y}]\nradius = 1.0\n" for y in (9.0, 12.0)
)
OF_CONTROL = {
    "control": DRIVEN,
    "from": DRIVEN,
    "to": DRIVEN,
    "at_mu": DRIVEN,
    "values": {"control": "chi"},
    "direction": {"control": "stretch", "from": 1.0, "to": 1.1},
    "obstacle": PUNCHED,
    "displacement": PUNCHED,
}
FIELDS = [
    (section, entry_of(field))
    for section, kind in SECTIONS.items()
    for field in dataclasses.fields(kind)
]
# a map and a resumed run sweep as a run does
COMMANDS = ("run", "critical", "check-grad", "design")
REFUSED = {
    ("critical", "imperfection"): "removes the bifurcations",
    ("design", "imperfection"): "has no derivative",
    ("design", "back"): "must increase",
}
REPLACED = {
    ("critical", "steps"): "the search chooses its own steps",
    ("critical", "back"): "the way back is the same branch",
    ("check-grad", "back"): "--states says how many",
    ("critical", "branch"): "critical points are those of the branch that continues the dry state",
    ("critical", "symmetry"): "the search takes the symmetries that there are",
    ("critical", "eigenvalues"): "a search computes those that it needs",
    ("check-grad", "steps"): "--states says how many",
}
PLATE = """
[plate]
width = 8.0
height = 8.0
edges = { top = "free" }
[[holes]]
kind = "circle"
centre = [0.0, -0.2]
radius = 2.0
"""
STUDY = """
[[parameters]]
of = "radius"
lower = 1.9
upper = 2.1
[[objective]]
of = "area_reduction"
goal = "maximise"
at = {at}
[verification]
spacing = 0.9
"""


class Reached(Exception):
    """What a command wanted of its sweep or search was recorded; nothing is computed."""


@pytest.fixture(scope="module")
def square():
    """Cloud and model that stand in for those of every command, which only says what it wants."""
    case = load_case("square", {"discretisation": {"spacing": 0.5, "basis": "linear"}})
    return case.cloud(), case.model()


@pytest.fixture
def asked(square, monkeypatch):
    """Name of each stage -> arguments and keywords with which a command asked for it last."""
    found, (cloud, model) = {}, square
    still = types.SimpleNamespace(
        **{
            name: getattr(cloud, name)
            for name in ("plate", "nodes", "spacing", "topology", "vertices")
        }
    )
    still.at = lambda _: still

    def recorder(stage, answer=None):
        def record(*args, **keywords):
            found[stage] = args, keywords
            if answer is None:
                raise Reached
            return answer(*args, **keywords) if answer is Problem else answer

        return record

    monkeypatch.setattr(discretisation_options, "make_cloud", recorder("cloud", still))
    monkeypatch.setattr(discretisation_options, "discretise", recorder("model", model))
    monkeypatch.setattr(
        imperfections,
        "critical_points",
        recorder("mode", [types.SimpleNamespace(kind="bifurcation")]),
    )
    monkeypatch.setattr(
        imperfections, "imperfection", recorder("imperfection", np.full((model.n_nodes, 2), 1e-3))
    )
    monkeypatch.setattr(imperfections, "Problem", recorder("problem", Problem))
    monkeypatch.setattr(imperfections, "sweep", recorder("follow"))
    monkeypatch.setattr("jaxgel.cases.case.critical_points", recorder("follow"))
    monkeypatch.setattr("jaxgel.design.search.cell_sizes", lambda _: (1.0, 1.0))
    monkeypatch.setattr("jaxgel.cases.case.check_room", lambda _: None)
    return found


def written(value):
    """A value in TOML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {written(item)}" for key, item in value.items()) + "}"
    return json.dumps(value) if isinstance(value, str | bool) else repr(value)


def perform(command, section, name, folder):
    """Run a command on a case in which one option is not its default; its exit code."""
    base = {
        "discretisation": {"spacing": 1.3},
        "sweep": {} if name in ("mu", "values") else {"steps": 2},
        "loads": {},
    }
    base[section] |= OF_CONTROL.get(name, {}) | {name: VALUES[name]}
    lines = [
        (f"[{section}]", *(f"{key} = {written(v)}" for key, v in entries.items()))
        for section, entries in base.items()
    ]
    fields = {entry_of(f): f.name for f in dataclasses.fields(SweepOptions)}
    at = SweepOptions(
        **{fields[key]: tuple(v) if isinstance(v, list) else v for key, v in base["sweep"].items()}
    ).numbers[-1]
    pins = PINS if base["sweep"].get("control") == "punch" else ""
    file, text = (
        folder / "case.toml",
        PLATE + pins + "\n".join(line for entries in lines for line in entries) + "\n",
    )
    file.write_text(text + (STUDY.format(at=at) if command == "design" else ""))
    return cli.main([command, str(file), "--quiet", "--out", str(folder / "out")])


def reaches(command, section, name, asked):
    """Whether an option is in what a command asked of its stage."""
    (problem, values, *_), keywords = asked["follow"]
    kind, value = SECTIONS[section], VALUES[name]
    stage = next(f for f in dataclasses.fields(kind) if entry_of(f) == name).metadata.get(
        "stage", "loads"
    )
    if name == "imperfection":
        return asked["imperfection"][0][-1] == value and np.all(np.asarray(problem.loads) == 1e-3)
    if stage == "loads":
        return np.abs(np.asarray(problem.loads)).sum() > 0
    if name == "contact_range":
        return asked["problem"][1][name] == value
    if stage == "problem":
        return asked["problem"][1]["contact"] == (value == "on")
    if name in ("control", "at_mu", "direction"):
        return getattr(problem.control, {"control": "name", "at_mu": "mu"}.get(name, name)) == value
    if name in ("obstacle", "displacement"):
        return np.all(
            problem.control.obstacle == value
            if name == "obstacle"
            else np.asarray(problem.control.direction) == value
        )
    if stage == "values":
        wanted = [value] if np.ndim(value) == 0 else value
        if name in ("steps", "back"):
            wanted = SweepOptions(**{"steps": 2, name: value}).values
        elif command == "critical" and name in ("mu", "values"):
            wanted = [value[0], value[-1] if name == "mu" else value[1]]
        taken = np.asarray(values, dtype=float)
        return all(np.min(np.abs(taken - one)) < 1e-12 for one in wanted) and (
            name != "back" or len(taken) == 3
        )
    return {"cloud": asked["cloud"][1], "model": asked["model"][1], "sweep": keywords}[stage][
        name
    ] == value


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_reaches_its_stage_or_is_refused(command, asked, tmp_path, capsys):
    faults = []
    for section, name in FIELDS:
        folder, where = tmp_path / name, f"{section}.{name}"
        folder.mkdir()
        try:
            code, error = perform(command, section, name, folder), capsys.readouterr().err
        except Reached:
            reached = (command, name) in REPLACED or reaches(command, section, name, asked)
            if (command, name) in REFUSED or not reached:
                faults.append(f"{where}: not in {asked['follow']}")
            continue
        message = REFUSED.get((command, name))
        if (
            code != 2
            or message is None
            or error.count("\n") != 1
            or message not in error
            or not ("back" in name or where in error)
        ):
            faults.append(f"{where}: exit code {code} and {error!r}")
    assert not faults, "\n".join(faults)


def test_every_option_has_a_stage_that_takes_it_and_none_of_it_is_a_default_of_another(asked):
    """None leaves the plate's or discretisation's default to `make_cloud` and `discretise`."""
    assert {f.metadata["stage"] for f in dataclasses.fields(DiscretisationOptions)} == {
        "cloud",
        "model",
    }
    assert {f.metadata["stage"] for f in dataclasses.fields(SweepOptions)} == {
        "values",
        "loads",
        "problem",
        "sweep",
    }
    options = DiscretisationOptions()
    options.model(options.cloud(load_case("square").plate))
    assert asked["cloud"][1] == dict(spacing=None, nodes_per_hole=None, across=None)
    assert asked["model"][1] == dict(basis="quadratic", dmax=None)
    assert {f.name for f in dataclasses.fields(OutputOptions)} == {
        "figures",
        "animation",
        "paraview",
    }


def test_ends_and_steps_are_refused_where_a_case_lists_its_mu(tmp_path):
    (tmp_path / "case.toml").write_text(PLATE + "[sweep]\nmu = [-3.0, -2.0]\n")
    for name, value in {"mu_end": -1.0, "mu_start": -4.0, "steps": 5}.items():
        with pytest.raises(
            ValueError,
            match=rf"^sweep\.{name}: .* has no effect, as the case lists its values of mu",
        ):
            load_case(str(tmp_path / "case.toml"), {"sweep": {name: value}})
    assert load_case(str(tmp_path / "case.toml"), {"sweep": {"mu": [-2.5]}}).sweep.values == [-2.5]
