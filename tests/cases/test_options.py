"""Every option of a case, in every command that takes a case: it reaches cloud, model, sweep or search, or is refused in one line."""

import dataclasses
import functools
import json
import types

import numpy as np
import pytest

from jaxgel._validation import entry_of
from jaxgel.bifurcation import imperfections
from jaxgel.cases import OutputOptions, load_case, load_map, load_study, map_runs
from jaxgel.cli import command_line as cli
from jaxgel.continuation import SweepOptions
from jaxgel.discretisation import DiscretisationOptions
from jaxgel.discretisation import options as discretisation_options
from jaxgel.io import Recorder
from jaxgel.mechanics import Loads

SECTIONS = {"discretisation": DiscretisationOptions, "sweep": SweepOptions, "loads": Loads}
VALUES = {
    "spacing": 1.1,
    "nodes_per_hole": 9,
    "across": 3,
    "basis": "linear",
    "dmax": 2.7,
    "solver": "direct",
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
    "branch": "symmetric",
    "imperfection": 0.05,
    "contact": "off",
    "symmetry": "off",
    "body_force": [0.0, 1e-5],
    "traction": {"top": [0.0, 1e-4]},
}  # a value of each option that is not its default
DRIVEN = {"control": "chi", "from": 0.1, "to": 0.2}  # beside an option of another control than mu
OF_CONTROL = {
    "control": DRIVEN,
    "from": DRIVEN,
    "to": DRIVEN,
    "at_mu": DRIVEN,
    "values": {"control": "chi"},
    "direction": {"control": "stretch", "from": 1.0, "to": 1.1},
}
FIELDS = [(section, entry_of(field)) for section, kind in SECTIONS.items() for field in dataclasses.fields(kind)]
COMMANDS = ("run", "resume", "map", "critical", "check-grad", "design", "verify")
REFUSED = {
    ("critical", "imperfection"): "removes the bifurcations",
    ("critical", "contact"): "searched with contact 'on'",
    ("design", "imperfection"): "has no derivative",
    ("verify", "imperfection"): "has no derivative",
    ("design", "back"): "must increase",
    ("verify", "back"): "must increase",
}
REPLACED = {
    ("critical", "steps"): "the search chooses its own steps",
    ("critical", "back"): "the way back is the same branch",
    ("check-grad", "back"): "--states says how many",
    ("critical", "branch"): "critical points are those of the branch that continues the dry state",
    ("critical", "symmetry"): "the search takes the symmetries that there are",
    ("check-grad", "steps"): "--states says how many",
    ("verify", "spacing"): "[verification] has its own",
    ("verify", "nodes_per_hole"): "nodes on outlines change with the spacing",
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
MAP = '[[parameters]]\nof = "Nv"\nvalues = [1e-3]\n'


class Reached(Exception):
    """What a command wanted of its sweep or search was recorded; nothing is computed."""


@functools.cache
def tiny():
    """Cloud and model that stand in for those of every command, which only says what it wants."""
    case = load_case("square", {"discretisation": {"spacing": 0.5, "basis": "linear"}})
    return case.cloud(), case.model()


@pytest.fixture
def asked(monkeypatch):
    """Name of each stage -> keywords with which a command asked for it last."""
    found, (cloud, model) = {}, tiny()

    def recorder(stage, answer):
        def record(*args, **keywords):
            found[stage] = keywords
            found[f"{stage}: arguments"] = args
            return answer()

        return record

    def ends():
        raise Reached

    bifurcation = types.SimpleNamespace(kind="bifurcation")
    monkeypatch.setattr(discretisation_options, "make_cloud", recorder("cloud", lambda: _Still(cloud)))
    monkeypatch.setattr(discretisation_options, "discretise", recorder("model", lambda: model))

    def searched(*args, most, **keywords):
        found["mode" if most == 1 else "critical"] = keywords
        return [bifurcation] if most == 1 else ends()

    monkeypatch.setattr(imperfections, "critical_points", searched)
    monkeypatch.setattr(imperfections, "imperfection", recorder("imperfection", lambda: np.full((model.n_nodes, 2), 1e-3)))
    monkeypatch.setattr(imperfections, "sweep", recorder("sweep", ends))
    return found


class _Still:
    """A cloud that stays where it is, whatever the plate."""

    def __init__(self, cloud):
        self.plate, self.nodes, self.spacing, self.topology, self.vertices = (
            *(cloud.plate, cloud.nodes, cloud.spacing),
            *(cloud.topology, cloud.vertices),
        )

    def at(self, _):
        return self


def written(value):
    """A value in TOML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {written(item)}" for key, item in value.items()) + "}"
    return json.dumps(value) if isinstance(value, str | bool) else repr(value)


def perform(command, section, name, folder):
    """Run a command on a case in which one option is not its default; its exit code."""
    base = {"discretisation": {"spacing": 1.3}, "sweep": {} if name in ("mu", "values") else {"steps": 2}, "loads": {}}
    base[section] |= OF_CONTROL.get(name, {}) | {name: VALUES[name]}
    text = PLATE + "".join(
        f"[{section}]\n" + "".join(f"{key} = {written(v)}\n" for key, v in entries.items()) for section, entries in base.items()
    )
    fields = {entry_of(f): f.name for f in dataclasses.fields(SweepOptions)}
    at = SweepOptions(**{fields[key]: tuple(v) if isinstance(v, list) else v for key, v in base["sweep"].items()}).values[-1]
    file = folder / "case.toml"
    file.write_text(text + {"design": STUDY.format(at=at), "verify": STUDY.format(at=at), "map": MAP}.get(command, ""))
    if command == "verify":
        study = load_study(file)
        return study.verify(study.problem.start)
    if command == "map":  # one point in this process
        study = load_map(file)
        map_runs._prepared.cache_clear()
        row = map_runs.run_point(map_runs.json.dumps({"name": "x", "study": study.table}), study.points[0], str(folder / "0"))
        assert row["status"] == "failed" and row["reason"] == "Reached"
        raise Reached
    if command == "resume":
        case = load_case(str(file))
        Recorder(folder / "out", case, case.problem(case.model())).begin()
        return cli.main(["resume", str(folder / "out"), "--quiet"])
    return cli.main([command, str(file), "--quiet", "--out", str(folder / "out")])


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(("section", "name"), FIELDS)
def test_an_option_reaches_its_stage_or_is_refused(command, section, name, asked, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("jaxgel.design.search.cell_sizes", lambda _: (1.0, 1.0))
    monkeypatch.setattr("jaxgel.cases.case.check_room", lambda _: None)
    if (command, name) in REFUSED:
        if command == "verify":
            with pytest.raises(ValueError, match=REFUSED[command, name]):
                perform(command, section, name, tmp_path)
            return
        assert perform(command, section, name, tmp_path) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and ("back" in name or f"{section}.{name}" in error) and REFUSED[command, name] in error
        return
    with pytest.raises(Reached):
        perform(command, section, name, tmp_path)
    if (command, name) in REPLACED:
        return
    follows = asked["critical" if command == "critical" else "sweep"]
    kind, value = SECTIONS[section], VALUES[name]
    stage = next(f for f in dataclasses.fields(kind) if entry_of(f) == name).metadata.get("stage", "loads")
    if section == "loads":
        assert np.abs(np.asarray(follows["loads"])).sum() > 0
    elif name == "imperfection":
        assert asked["imperfection: arguments"][-1] == value
        np.testing.assert_array_equal(follows["loads"], 1e-3)
    elif name in ("control", "at_mu", "direction"):
        assert getattr(follows["control"], {"control": "name", "at_mu": "mu"}.get(name, name)) == value
    elif stage == "values":
        wanted = [value] if np.ndim(value) == 0 else value
        if name in ("steps", "back"):
            wanted = SweepOptions(**{"steps": 2, name: value}).values
        elif command == "critical" and name in ("mu", "values"):
            wanted = [value[0], value[-1] if name == "mu" else value[1]]
        taken = np.asarray(follows["values" if name in OF_CONTROL else "mu"], dtype=float)
        assert all(np.min(np.abs(taken - one)) < 1e-12 for one in wanted) and (name != "back" or len(taken) == 3)
    else:
        assert {"cloud": asked["cloud"], "model": asked["model"], "sweep": follows}[stage][name] == value


def test_every_option_has_a_stage_that_takes_it():
    assert {f.metadata["stage"] for f in dataclasses.fields(DiscretisationOptions)} == {"cloud", "model"}
    assert {f.metadata["stage"] for f in dataclasses.fields(SweepOptions)} == {"values", "loads", "sweep"}


def test_options_that_are_not_of_a_case_stay_what_they_were(asked):
    """None leaves the default of the plate or the discretisation to `make_cloud` and `discretise`."""
    options = DiscretisationOptions()
    options.model(options.cloud(load_case("square").plate))
    assert asked["cloud"] == dict(spacing=None, nodes_per_hole=None, across=None)
    assert asked["model"] == dict(basis="quadratic", dmax=None, solver="auto")


@pytest.mark.parametrize("entry", [{"mu_end": -1.0}, {"mu_start": -4.0}, {"steps": 5}])
def test_ends_and_steps_are_refused_where_a_case_lists_its_mu(entry, tmp_path):
    (tmp_path / "case.toml").write_text(PLATE + "[sweep]\nmu = [-3.0, -2.0]\n")
    with pytest.raises(ValueError, match=rf"^sweep\.{next(iter(entry))}: .* has no effect, as the case lists its values of mu"):
        load_case(str(tmp_path / "case.toml"), {"sweep": entry})
    assert load_case(str(tmp_path / "case.toml"), {"sweep": {"mu": [-2.5]}}).sweep.values == [-2.5]


def test_output_options_are_those_of_files_that_a_command_draws():
    assert {f.name for f in dataclasses.fields(OutputOptions)} == {"figures", "animation", "paraview"}
