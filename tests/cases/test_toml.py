"""Case files that jaxgel writes, its schema, and user-defined gels in a case file."""

import dataclasses
import json
import re
import tomllib

import jax
import jsonschema
import numpy as np
import pytest

import jaxgel
from jaxgel.cases import case as cases
from jaxgel.cases import case_schema, case_text, example, explicit
from jaxgel.cli import command_line as cli

PLATE = {"width": 20.0, "height": 10.0}
CIRCLE = {"kind": "circle", "centre": [1.0, 0.5], "radius": 2.0}


@pytest.fixture(scope="module")
def validator():
    """Of the schema, which is itself valid."""
    schema = case_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("name", jaxgel.sample_names())
def test_an_exported_sample_is_the_same_case(name, validator):
    case, table = cases.load_case(name), tomllib.loads(case_text(explicit(cases.load_case(name))))
    validator.validate(table)
    again = cases.from_table(table, name)
    for field in dataclasses.fields(case.plate):
        if field.name not in ("holes", "gel"):
            assert getattr(again.plate, field.name) == getattr(case.plate, field.name)
    for hole, original in zip(again.plate.holes, case.plate.holes, strict=True):
        assert type(hole) is type(original)
        jax.tree.map(np.testing.assert_array_equal, hole.theta, original.theta)
    assert (again.gel, again.sweep, again.discretisation, again.output) == (
        case.gel,
        case.sweep,
        case.discretisation,
        case.output,
    )


@pytest.mark.slow
def test_an_exported_sample_runs_to_the_same_numbers(tmp_path):
    assert cli.main(["init", "--from", "square", str(tmp_path / "square")]) == 0
    for case, folder in (("square", "name"), (str(tmp_path / "square.toml"), "file")):
        assert (
            cli.main(
                [
                    "run",
                    case,
                    "--steps",
                    "3",
                    "--no-plots",
                    "--quiet",
                    "--out",
                    str(tmp_path / folder),
                ]
            )
            == 0
        )
    assert (tmp_path / "name" / "states.npz").read_bytes() == (
        tmp_path / "file" / "states.npz"
    ).read_bytes()


def test_init_writes_a_commented_case_once(tmp_path, monkeypatch, capsys, validator):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["init"]) == 0
    text = (tmp_path / "case.toml").read_text()
    validator.validate(tomllib.loads(text))
    assert cases.load_case("case.toml").table() == example().table()
    entries = [
        line for line in text.splitlines() if " = " in line and not line.startswith(("kind", "#"))
    ]
    assert all(re.search(r" # \S", line) for line in entries)
    assert "jaxgel run case.toml" in capsys.readouterr().out
    assert cli.main(["init", "case.toml"]) == 2
    assert re.fullmatch(
        r"jaxgel: error: name: 'case\.toml' is there already; [^\n]*\n", capsys.readouterr().err
    )
    assert (tmp_path / "case.toml").read_text() == text


@pytest.mark.parametrize(
    ("angle", "text"),
    [(np.pi / 2, "angle_deg = 90.0"), (0.4, "angle = 0.4"), (0.0, "angle_deg = 0.0")],
)
def test_angles_are_written_in_degrees_where_these_are_short_and_exact(angle, text):
    hole = {"kind": "ellipse", "centre": [1.0, 0.5], "semi_axes": [3.0, 2.0], "angle": angle}
    written = case_text(explicit(cases.from_table({"plate": PLATE, "holes": [hole]}, "mine")))
    assert re.search(
        rf"^{re.escape(text)} +# .* to the x axis, (degrees|rad)\.$", written, re.MULTILINE
    )
    assert cases.from_table(tomllib.loads(written), "again").plate.holes[0].angle == angle


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--from", "sampel-1"], "did you mean 'sample-1'"), (["no/such/folder/x"], "cannot write")],
)
def test_init_refuses_in_one_line(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["init", *arguments]) == 2
    assert re.fullmatch(rf"jaxgel: error: [^\n]*{message}[^\n]*\n", capsys.readouterr().err)


def test_the_schema_knows_every_section_and_is_printed(validator, capsys):
    assert cli.main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == validator.schema
    assert set(validator.schema["properties"]) == set(cases.SECTIONS)


def test_schema_and_cases_accept_the_same(validator):
    for change in (
        {"plate": PLATE | {"edges": "free"}},
        {
            "plate": PLATE
            | {
                "edges": {"top": "free", "left": "fixed"},
                "core": [1.0, 0.0],
                "unit": "um",
                "spacing": 0.5,
            }
        },
        {"plate": {"sample": "sample-1"}, "holes": []},
        {"holes": [CIRCLE, {"kind": "polygon", "vertices": [[0, 0], [1, 0], [0, 1]]}]},
        {"holes": [{"kind": "fourier", "centre": [0, 0], "radius": 1, "cos": [0.1], "sin": [0.0]}]},
        {"holes": [{"kind": "rectangle", "centre": [0, 0], "sides": [2, 1], "angle_deg": 30}]},
        {"gel": {"Nv": 1e-2, "chi": 1.9}},
        {"sweep": {"mu": [-3, -2.5]}},
        {
            "sweep": {
                "steps": "auto",
                "branch": "symmetric",
                "contact": "stop",
                "imperfection": -0.1,
            }
        },
        {
            "discretisation": {
                "spacing": 0.5,
                "nodes_per_hole": 3,
                "across": 2,
                "basis": "linear",
                "dmax": 2,
            }
        },
        {"output": {"figures": False}},
    ):
        cases.from_table({"plate": PLATE} | change, "mine")
        validator.validate({"plate": PLATE} | change)


def test_the_schema_knows_holes_from_drawings(validator):
    outline = {
        "kind": "outline",
        "file": "a.dxf",
        "number": 1,
        "fit": "polygon",
        "tolerance": 0.1,
        "scale": 2,
        "centre": [0.0, 1.0],
    }
    validator.validate({"plate": PLATE, "holes": [outline, {"kind": "outline", "file": "b.csv"}]})
    validator.validate(
        {
            "plate": PLATE,
            "holes": [
                {
                    "kind": "image",
                    "file": "a.png",
                    "shade": "light",
                    "fit": "polygon",
                    "tolerance": 0.1,
                }
            ],
        }
    )


# --- a gel of one's own ---------------------------------------------------------------------------

MODULE = """
import jaxgel
def gent(Nv, chi, Jm):
    return jaxgel.Gel(Nv, chi, network=jaxgel.Gent(Jm))
def broken(Nv, chi):
    raise RuntimeError("two\\nlines")
def empty(Nv, chi):
    return None
def singular(Nv, chi):
    return jaxgel.Gel(Nv, chi, network=lambda F, gel: F[0, 0] * float("nan"))
number = 3
"""


@pytest.fixture
def with_energy(tmp_path):
    """Function that writes a case file with a gel section beside ``mine.py``; its path."""
    (tmp_path / "mine.py").write_text(MODULE)

    def write(section):
        (tmp_path / "case.toml").write_text(
            f"[plate]\nsample = 'square'\n[sweep]\nmu = [-3.0, -2.0]\n[gel]\n{section}\n"
        )
        return str(tmp_path / "case.toml")

    return write


def test_an_energy_of_ones_own_is_used(with_energy, tmp_path):
    case = cases.load_case(with_energy('energy = "mine:gent"\nJm = 20.0\nchi = 0.3'))
    assert case.gel == jaxgel.Gel(1e-3, 0.3, network=jaxgel.Gent(20.0))
    assert case.table()["gel"] == {"energy": "mine:gent", "Jm": 20.0, "Nv": 1e-3, "chi": 0.3}
    again = cases.from_table(tomllib.loads(case_text(case)), "again", tmp_path)
    assert (
        again.gel
        == case.gel
        == cases.load_case(
            with_energy('kind = "gel"\nenergy = "mine:gent"\nJm = 20.0\nchi = 0.3')
        ).gel
    )


def test_the_functions_of_a_module_stay_the_same_objects(with_energy):
    from jaxgel.cases.user_energy import _from_file

    file = with_energy('energy = "mine:gent"\nJm = 20.0')
    cases.load_case(file)
    before = _from_file.cache_info().misses
    cases.load_case(file)
    assert _from_file.cache_info().misses == before


def test_an_energy_that_cannot_be_used_is_one_line(with_energy, refused):
    refused(
        lambda section: cases.load_case(with_energy(section)),
        [
            ('energy = "mine"', "is not a text of the form module:function"),
            ("energy = 3", "3 is not a text of the form module:function"),
            ('energy = "../mine:gent"', "is not a text of the form module:function"),
            ('energy = "mine:gint"', "module 'mine' has no function 'gint'"),
            ('energy = "mine:number"', "has no function 'number'"),
            (
                'energy = "nomodule_of_this_name:f"',
                "cannot import 'nomodule_of_this_name' from .*ModuleNotFoundError",
            ),
            ('energy = "mine:gent"', "makes no gel of Nv, chi: TypeError: .*Jm"),
            ('energy = "mine:broken"', "RuntimeError: two lines"),
            ('energy = "mine:empty"', "makes no gel"),
            ('energy = "mine:singular"', "must return a gel"),
            ('energy = "mine:gent"\nJm = "a"', r"gel\.Jm: 'a' is not a finite number"),
            ('energy = "mine:gent"\n"J\\nm" = "a"', r"gel\['J\\nm'\]: 'a' is not a finite number"),
            (
                'energy = "mine:gent"\nJm = 20.0\nNv = -1.0',
                r"gel\.Nv: -1\.0 is not a finite number above 0",
            ),
        ],
    )
