"""Extreme numbers from a user end in a result or in one line, with bounded memory.

Tiny, huge, negative or not finite; no traceback.
"""

import copy
import functools
import itertools
import json
import math
import re
import resource

import pytest

from jaxgel.cases import Case, case_schema
from jaxgel.cli import command_line as cli
from jaxgel.cli import options, parser
from jaxgel.continuation import SweepFailed
from jaxgel.discretisation import DiscretisationOptions

NUMBERS = [1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e12, math.nan, math.inf, -math.inf, -1.0, 0.0, 10**30]
GIBIBYTE = 2**30
PLATE = {"width": 4.0, "height": 4.0, "spacing": 0.8, "nodes_per_hole": 12}
HOLES = [
    {"kind": "circle", "centre": [0.1, -0.2], "radius": 1.1},
    {"kind": "ellipse", "centre": [0.1, 0.0], "semi_axes": [1.2, 0.9], "angle": 0.3},
    {"kind": "rectangle", "centre": [0.1, 0.0], "sides": [1.8, 1.5], "angle": 0.3},
    {
        "kind": "superellipse",
        "centre": [0.1, 0.0],
        "semi_axes": [1.2, 0.9],
        "angle": 0.3,
        "exponent": 3.0,
    },
    {"kind": "fourier", "centre": [0.1, 0.0], "radius": 1.0, "cos": [0.1], "sin": [0.0]},
    {"kind": "polygon", "vertices": [[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]]},
]
WHOLE_PLATE = PLATE | {
    "edges": {"top": "fixed"},
    "deformation": [[1.1, 0.0], [0.0, 1.0]],
    "displacement": {"top": [0.0, 0.1]},
    "core": [0.5, 0.5],
}
CASES = {f"hole {hole['kind']}": {"plate": PLATE, "holes": [hole]} for hole in HOLES} | {
    "plate": {"plate": WHOLE_PLATE, "discretisation": {"spacing": 0.8}},
    "options": {
        "plate": PLATE,
        "holes": HOLES[:1],
        "gel": {"Nv": 1e-3, "chi": 0.1},
        "sweep": {"mu_start": -4.9, "mu_end": -4.8, "steps": 2, "imperfection": 0.1},
        "discretisation": {"spacing": 0.8, "nodes_per_hole": 12, "across": 2, "dmax": 2.95},
    },
    "loads": {
        "plate": PLATE,
        "holes": HOLES[:1],
        "loads": {"body_force": [0.0, 1e-4], "traction": {"top": [0.0, 1e-4]}},
    },
    "picture": {
        "plate": PLATE,
        "gel": {"Nv": {"pixels": [[0, 255], [9, 99]], "low": 1e-3, "high": 2e-3}},
    },
    "values": {"plate": PLATE, "gel": {"Nv": {"values": [[1e-3, 2e-3], [1e-3, 1e-3]]}}},
    "region": {"plate": PLATE, "regions": [HOLES[0] | {"elastomer": {"Nv": 0.1, "bulk": 10.0}}]},
    "layer": {"plate": PLATE, "regions": [HOLES[2] | {"gel": {"Nv": 2e-3, "chi": 0.2}}]},
    "axial stretch": {
        "plate": PLATE | {"kinematics": "generalised plane strain", "axial_stretch": 1.05}
    },
    "given mu": {"plate": PLATE, "sweep": {"mu": [-4.9, -4.8]}},
    "disc": {
        "plate": PLATE,
        "obstacles": [{"kind": "disc", "centre": [0.0, 9.0], "radius": 1.0}],
        "sweep": {"contact_range": 0.05},
    },
    "half-plane": {
        "plate": PLATE,
        "obstacles": [{"kind": "half-plane", "point": [0.0, 9.0], "normal": [0.0, -1.0]}],
    },
    "punch": {
        "plate": PLATE,
        "obstacles": [{"kind": "half-plane", "point": [0.0, 9.0], "normal": [0.0, -1.0]}],
        "sweep": {
            "control": "punch",
            "values": [0.0, 0.1],
            "obstacle": 0,
            "displacement": [0.0, -1.0],
        },
    },
    "polyline": {
        "plate": PLATE,
        "obstacles": [{"kind": "polyline", "points": [[0.0, 9.0], [1.0, 9.0]]}],
    },
    "pnipam": {"plate": PLATE, "gel": {"kind": "pnipam", "Nv": 0.01, "temperature": 30.0}},
    "polyelectrolyte": {
        "plate": PLATE,
        "gel": {
            "kind": "polyelectrolyte",
            "pH": 5.0,
            "salt": 0.01,
            "acid_fraction": 0.05,
            "pKa": 4.3,
            "solvent_volume": 0.1,
        },
    },
    "driven": {
        "plate": PLATE,
        "sweep": {
            "control": "chi",
            "from": 0.1,
            "to": 0.2,
            "steps": 3,
            "back": True,
            "at_mu": -1.0,
        },
    },
    "in time": {
        "plate": PLATE,
        "holes": [HOLES[0] | {"bath": {"mu": -1.0, "ramp": 0.1}}],
        "gel": {"chi": 0.1},
        "sweep": {"mu_start": -4.0},
        "time": {"end": 2.0, "steps_per_decade": 5, "first": 1e-3, "D": 1.0},
        "bath": {"mu": -1.5, "ramp": 0.2},
    },
    "given times": {
        "plate": PLATE,
        "holes": HOLES[:1],
        "gel": {"chi": 0.1},
        "time": {"times": [0.5, 1.0]},
        "bath": {"mu": [-2.0, -1.5], "times": [0.0, 1.0]},
    },
    "given values": {"plate": PLATE, "sweep": {"control": "stretch", "values": [1.1, 1.0]}},
}


def leaves(tree, path=()):
    """Paths to the numbers of a table, of each list only to its first entry."""
    if isinstance(tree, dict):
        return [leaf for key, value in tree.items() for leaf in leaves(value, (*path, key))]
    if isinstance(tree, list):
        return leaves(tree[0], (*path, 0))
    return [path] if isinstance(tree, int | float) else []


ENTRIES = [
    (name, path)
    for name, table in CASES.items()
    for path in leaves(table)
    if not (name.startswith("hole") and path[0] == "plate")
    and (name != "loads" or path[0] == "loads")
]
QUICK = [
    name for name in CASES if not name.startswith("hole") or name in ("hole circle", "hole ellipse")
]
COMMANDS = dict.fromkeys(
    ("run", "critical", "loop", "check-grad", "outline", "accuracy"), "square"
) | {
    "serve": "no.toml",
    "uncertainty": "uncertain.toml",
    "waves": "cell.toml",
    "design": "no.toml",
    "map": "no.toml",
    "resume": "no",
}
BESIDE = {  # an option that goes with others only
    "--from": ["--control=chi", "--to=0.3"],
    "--to": ["--control=chi", "--from=0.3"],
    "--values": ["--control=stretch"],
    "--at-mu": ["--control=chi", "--values=0.1,0.3"],
}
CELL = """
plate = { width = 4.0, height = 4.0, spacing = 0.8, nodes_per_hole = 12, edges = "periodic" }
holes = [{ kind = "circle", centre = [0.0, 0.0], radius = 1.1 }]
"""
UNCERTAIN = "plate = { sample = 'square' }\nuncertainty = { Nv = '5 %' }\n"
# each of their numbers makes programs of its own
OF_CLOUDS = {"plate", "holes", "regions", "spacing", "nodes_per_hole", "across"}
NUMERIC = {options.real, options.reals, options.whole_number, options.steps}


def options(command):
    """Every option of a command that takes a number."""
    return [
        action.option_strings[0]
        for action in parser.parser()[1][command]._actions
        if action.type in NUMERIC
    ]


def toml(table):
    """The TOML text of a case's table."""

    def value(v):
        if isinstance(v, dict):
            return "{ " + ", ".join(f"{key} = {value(item)}" for key, item in v.items()) + " }"
        return (
            f"[{', '.join(map(value, v))}]"
            if isinstance(v, list)
            else json.dumps(v)
            if isinstance(v, str)
            else repr(v)
        )

    return "\n".join(f"{section} = {value(entries)}" for section, entries in table.items())


def changed(table, path, number):
    table = copy.deepcopy(table)
    functools.reduce(lambda part, key: part[key], path[:-1], table)[path[-1]] = number
    return table


@pytest.fixture
def fault(monkeypatch, capsys, tmp_path):
    """Function that runs a command up to its sweep: unexpected ends, and its output."""

    def stop(*_, **__):
        raise SweepFailed("sweep: reached")

    for name in ("critical_points", "loop", "swell"):
        monkeypatch.setattr(f"jaxgel.cases.case.Case.{name}", stop)
    monkeypatch.setattr("jaxgel.cloud.checks.MAX_NODES", 2000)  # so that what is accepted is quick
    monkeypatch.setattr("jaxgel.bifurcation.imperfections.critical_points", stop)
    monkeypatch.setattr("jaxgel.bifurcation.imperfections.sweep", stop)
    monkeypatch.setattr("jaxgel.cli.taylor_test.check_gradient", stop)
    monkeypatch.setattr("jaxgel.cli.wave_runs.lattice_onset", stop)
    monkeypatch.setattr("jaxgel.cases.response.Response.path", stop)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cell.toml").write_text(CELL)
    (tmp_path / "uncertain.toml").write_text(UNCERTAIN)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    make, models = Case.model, []

    def kept(case):
        models.extend([] if models else [make(case)])
        return models[0]

    def run(arguments, without_model=False, same_model=False):
        with monkeypatch.context() as patch:
            if without_model:
                patch.setattr(DiscretisationOptions, "model", stop)
            if same_model:
                patch.setattr(Case, "model", kept)
            code = cli.main(arguments)
        error = re.sub(
            r"jaxgel: warning: (spacing|nodes_per_hole): [^\n]*\n", "", capsys.readouterr().err
        )  # of a coarse cloud, beside the line
        wrong = (
            code not in (0, 2, 3)
            or not re.fullmatch(r"(jaxgel: [^\n]*\n)?", error)
            or (code == 0) != (error == "")
        )
        return (f"exit code {code} and {error!r}" if wrong else ""), code, error

    yield run
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 < GIBIBYTE


@pytest.mark.parametrize("command", COMMANDS)
def test_a_numeric_option_ends_in_a_result_or_one_line(command, fault):
    faults = []
    for option, number in itertools.product(options(command), NUMBERS):
        word = (
            repr(number)
            if isinstance(number, float) and not number.is_integer()
            else f"{number:.0f}"
        )
        moves = option.strip("-").replace("-", "_") in OF_CLOUDS
        words = [command, COMMANDS[command], f"{option}={word}", *BESIDE.get(option, ())]
        text, code, error = fault(
            words, without_model=moves, same_model=not moves and option != "--dmax"
        )
        if code == 2 and command not in ("design", "map", "resume", "serve"):
            named = option.strip("-").replace("-", "_") in error.replace("-", "_")
            text = text or (
                ""
                if named or "mu" in option or "dmax" in option or option in BESIDE
                else f"{option} is not in {error!r}"
            )
        faults += [f"{option}={word}: {text}"] * bool(text)
    assert not faults, "\n".join(faults)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "whole"),
    [(name, False) for name in QUICK]
    + [pytest.param(name, True, marks=pytest.mark.slow) for name in CASES],
)
def test_a_number_of_a_case_ends_in_a_result_or_one_line(name, whole, fault, tmp_path):
    """Up to its cloud, or if no node moves to its model.

    The slow tests go up to the model of every cloud.
    """
    faults = []
    for path, number in itertools.product(
        [path for case, path in ENTRIES if case == name], NUMBERS
    ):
        own = functools.reduce(lambda part, key: part[key], path, CASES[name])
        given = (
            int(number)
            if isinstance(own, int) and math.isfinite(number) and number == int(number)
            else number
        )
        (tmp_path / "case.toml").write_text(toml(changed(CASES[name], path, given)))
        text, *_ = fault(
            ["run", "case.toml", "--no-plots", "--quiet"],
            without_model=not whole and bool(OF_CLOUDS & {*path}) and "bath" not in path,
            same_model=path[0] in ("gel", "loads", "sweep", "time", "bath") or "bath" in path,
        )
        faults += [f"{'.'.join(map(str, path))} = {given}: {text}"] * bool(text)
    assert not faults, "\n".join(faults)


def test_every_number_of_the_schema_is_walked():
    def numeric(rule, name=""):
        kinds = rule.get("type")
        if kinds in ("number", "integer") or (kinds == "array" and numeric(rule["items"], name)):
            return {name}
        parts = [(part, key) for key, part in rule.get("properties", {}).items()]
        parts += [(rule[key], name) for key in ("then", "else", "items") if key in rule]
        parts += [(part, name) for key in ("allOf", "anyOf") for part in rule.get(key, ())]
        return set().union(*(numeric(part, key) for part, key in parts))

    walked = {key for _, path in ENTRIES for key in path if isinstance(key, str)}
    drawings = {"number", "tolerance", "scale", "centre"}  # of a hole from a file
    assert numeric(case_schema()) - drawings - {"left", "right", "bottom"} <= walked


def test_every_command_with_numbers_is_walked():
    assert {name for name in parser.parser()[1] if options(name)} == set(COMMANDS)
