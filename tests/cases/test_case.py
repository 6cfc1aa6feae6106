"""Case files: what is read is what was written, and every wrong entry is named in one line."""

import json
import tomllib

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxgel.cases import case as cases
from jaxgel.cases import case_schema, sample
from jaxgel.discretisation import options

PLATE = "[plate]\nwidth = 20.0\nheight = 10.0\n"
HOLE = '[[holes]]\nkind = "ellipse"\ncentre = [1.0, 0.5]\nsemi_axes = [3.0, 2.0]\n'


@pytest.fixture
def load(tmp_path):
    """A function that loads the text of a case file."""

    def load(text):
        (tmp_path / "mine.toml").write_text(text)
        return cases.load_case(str(tmp_path / "mine.toml"))

    return load


def test_a_case_file_makes_its_plate_gel_and_options(load):
    case = load(
        PLATE
        + 'edges = { top = "free" }\n'
        + HOLE
        + "[gel]\nchi = 0.3\n[sweep]\nmu = [-3.0, -2.0]\n[discretisation]\nspacing = 0.5\n"
    )
    assert case.name == "mine"
    assert (case.plate.width, case.plate.height) == (20.0, 10.0)
    assert dict(case.plate.edges) == {
        "left": "roller",
        "right": "roller",
        "bottom": "roller",
        "top": "free",
    }
    np.testing.assert_array_equal(case.plate.holes[0].semi_axes, [3.0, 2.0])
    assert (case.gel.Nv, case.gel.chi) == (1e-3, 0.3)
    assert case.sweep.values == [-3.0, -2.0]
    assert case.sweep.ends == (-3.0, -2.0)
    assert case.discretisation.spacing == 0.5


def test_a_built_in_name_is_the_sample_with_its_gel():
    case = cases.load_case("lattice")
    assert case.plate.name == "lattice"
    assert case.gel.chi == sample("lattice").gel.chi == 1e-5
    assert (case.sweep.values[0], case.sweep.values[-1], len(case.sweep.values)) == (
        -4.9678,
        -0.9178,
        40,
    )


@pytest.mark.parametrize(
    "hole",
    [
        'kind = "ellipse"\ncentre = [1.0, 0.5]\nsemi_axes = [3.0, 2.0]\n',
        'kind = "superellipse"\ncentre = [1.0, 0.5]\nsemi_axes = [3.0, 2.0]\nexponent = 3.0\n',
        'kind = "rectangle"\ncentre = [1.0, 0.5]\nsides = [3.0, 2.0]\n',
    ],
)
def test_an_angle_may_be_given_in_degrees(load, hole):
    text = PLATE + "[[holes]]\n" + hole
    case, radians = load(text + "angle_deg = 90\n"), load(text + f"angle = {np.pi / 2!r}\n")
    assert case.plate.holes[0].angle == radians.plate.holes[0].angle == np.pi / 2
    again = cases.from_table(json.loads(json.dumps(case.table())), "again")
    assert again.plate.holes[0].angle == np.pi / 2
    moved = cases.from_table(case.table() | {"moved": [{"angle_deg": 60.0}]}, "moved")
    assert moved.plate.holes[0].angle == np.deg2rad(60.0)


def test_every_kind_of_hole_with_an_angle_takes_it_in_degrees():
    rules = {
        rule["if"]["properties"]["kind"]["const"]: rule["then"]["properties"]
        for rule in case_schema()["properties"]["holes"]["items"]["allOf"]
    }
    assert {kind for kind, properties in rules.items() if "angle_deg" in properties} == {
        "ellipse",
        "superellipse",
        "rectangle",
    }
    assert all(
        ("angle" in properties) == ("angle_deg" in properties) for properties in rules.values()
    )


def test_a_number_of_steps_includes_both_ends():
    values = cases.load_case(
        "sample-1", {"sweep": {"steps": 4, "mu_start": -4.0, "mu_end": -1.0}}
    ).sweep.values
    np.testing.assert_allclose(values, [-4.0, -3.0, -2.0, -1.0])


@pytest.mark.parametrize("name", ["sample-7", "file"])
def test_the_table_of_a_case_makes_the_same_case_again(load, name):
    case = (
        load(PLATE + HOLE + "[sweep]\nmu = [-3.0, -2.0]\n")
        if name == "file"
        else cases.load_case(name)
    )
    again = cases.from_table(json.loads(json.dumps(case.table())), case.name)
    assert again.table() == case.table()
    assert again.sweep == case.sweep
    assert len(again.plate.holes) == len(case.plate.holes)


WRONG = [
    ("[plate", "is not TOML"),
    ("[plates]\nwidth = 1.0\n", r"case file: unknown entry 'plates'; did you mean 'plate'\?"),
    ("[plate]\nwidth = 20.0\n", "plate: height is missing"),
    (
        "[plate]\nwidht = 20.0\nheight = 1.0\n",
        r"plate: unknown entry 'widht'; did you mean 'width'\?",
    ),
    (
        "[plate]\nwidth = -2.0\nheight = 1.0\n",
        r"plate\.width: -2\.0 is not a finite number above 0",
    ),
    ("[plate]\nwidth = true\nheight = 1.0\n", r"plate\.width: True is not a finite number"),
    (
        PLATE + 'edges = { top = "fre" }\n',
        r"plate\.edges\.top: 'fre' is unknown; did you mean 'free'\?",
    ),
    (PLATE + "edges = 3\n", r"plate\.edges: 3 is neither"),
    (
        '[plate]\nsample = "sample-0"\n',
        r"plate\.sample: 'sample-0' is unknown; did you mean 'sample-9'\?",
    ),
    ("[plate]\nsample = 3\n", r"plate\.sample: 3 is unknown; accepted: sample-1, "),
    ('[plate]\nsample = "sample-1"\n' + HOLE, "holes: .* has its own"),
    (
        PLATE + '[[holes]]\nkind = "elipse"\n',
        r"holes\[0\]\.kind: 'elipse' is unknown; did you mean 'ellipse'\?",
    ),
    (
        PLATE + '[[holes]]\nkind = "circle"\ncentre = [0, 0]\n',
        r"holes\[0\]: radius is missing; give a finite number above 0",
    ),
    (
        PLATE + '[[holes]]\nkind = "circle"\ncentre = [0, 0]\nradios = 1\n',
        r"unknown entry 'radios'; did you mean 'radius'\?",
    ),
    (
        PLATE + '[[holes]]\nkind = "circle"\ncentre = [0, "a"]\nradius = 1\n',
        r"holes\[0\]\.centre\[1\]: 'a' is not a finite number",
    ),
    ("holes = 3\n" + PLATE, r"holes: 3 is not a list of tables, written \[\[holes\]\]"),
    (PLATE + "[gel]\nNv = 0.0\n", "Nv"),
    (PLATE + "[gel]\nchi = 2.5\n", "chi"),
    (PLATE + "[gel]\nNv = nan\n", r"gel\.Nv: nan is neither a finite number nor a table"),
    (PLATE + "[sweep]\nmu = [-3.0, -3.0]\n", "must differ"),
    (PLATE + "[sweep]\nmu = [-3.0, inf]\n", r"sweep\.mu\[1\]: inf is not a finite number"),
    (PLATE + "[sweep]\nmu = []\n", "mu"),
    (PLATE + "[sweep]\nmu = -3.0\n", r"sweep\.mu: -3\.0 is not a list of 1 or more finite numbers"),
    (PLATE + "[sweep]\nmu_start = -1.0\nmu_end = -1.0\n", "must differ"),
    (PLATE + "[sweep]\nsteps = 1\n", r"sweep\.steps: 1 is neither 'auto' nor"),
    (
        PLATE + '[sweep]\nbranch = "stabel"\n',
        r"sweep\.branch: 'stabel' is unknown; did you mean 'stable'\?",
    ),
    (
        PLATE + "[discretisation]\nacross = 1\n",
        r"discretisation\.across: 1 is not a whole number of at least 2",
    ),
    (
        PLATE + "[discretisation]\nspacing = 0\n",
        r"discretisation\.spacing: 0 is not a finite number above 0",
    ),
    (PLATE + '[discretisation]\nbasis = "cubic"\n', r"discretisation\.basis: 'cubic' is unknown"),
    (
        PLATE + "[discretisation]\nnodes_per_hole = 2.5\n",
        r"discretisation\.nodes_per_hole: 2\.5 is not a whole number",
    ),
    ("plate = 3\n", r"plate: 3 is not a table, written \[plate\]"),
    ("", r"case file: plate is missing; give a table, written \[plate\]"),
    (
        PLATE + "[[holes]]\nradius = 1.0\n",
        r"holes\[0\]: kind is missing; give one of circle, .*, outline",
    ),
    (PLATE + "edges = { top = 3 }\n", r"plate\.edges\.top: 3 is unknown; accepted: roller"),
    (PLATE + "core = [1.0]\n", r"plate\.core: \[1\.0\] is not a list of 2 finite numbers"),
    (
        PLATE + "deformation = [[1.0], [0.0, 1.0]]\n",
        r"plate\.deformation\[0\]: \[1\.0\] is not a list of 2 finite numbers",
    ),
    (
        PLATE + "[discretisation]\nspacing = 1" + 400 * "0" + "\n",
        r"spacing: 10+ is not a finite number above 0",
    ),
    (PLATE + "[gel]\nchi = 2.0\n", r"gel\.chi: 2\.0 is not a finite number below 2"),
    (PLATE + "[output]\nfigures = 1\n", r"output\.figures: 1 is neither true nor false"),
    (PLATE + "unit = 3\n", r"plate\.unit: 3 is not a text"),
    (
        PLATE + HOLE + "angle = 0.1\nangle_deg = 5.0\n",
        r"^holes\[0\]: give one of angle and angle_deg, not both$",
    ),
    (PLATE + HOLE + 'angle_deg = "45"\n', r"holes\[0\]\.angle_deg: '45' is not a finite number"),
    (PLATE + HOLE.replace("ellipse", "polygon") + "angle_deg = 5.0\n", "unknown entry"),
    (
        PLATE + 'edges = { topp = "free" }\n',
        r"^plate\.edges: unknown entry 'topp'; did you mean 'top'\?",
    ),
    (
        PLATE + "nodes_per_hole = 2\n",
        r"^plate\.nodes_per_hole: 2 is not a whole number of at least 3",
    ),
    (PLATE + HOLE.replace("ellipse", "circle"), r"^holes\[0\]: unknown entry 'semi_axes'"),
    (PLATE + '[[holes]]\nkind = "outline"\n', r"^holes\[0\]: file is missing"),
    (PLATE + '[[holes]]\nkind = "image"\n', r"^holes\[0\]: file is missing"),
    (
        PLATE + '[[holes]]\nkind = "outline"\nfile = "a.csv"\nfit = "spline"\n',
        r"^holes\[0\]\.fit: 'spline' is unknown",
    ),
    (
        PLATE + HOLE.replace("[1.0, 0.5]", "[0.0]"),
        r"^holes\[0\]\.centre: \[0\.0\] is not a list of 2 finite numbers",
    ),
    (
        PLATE + "[[moved]]\nangle = 0.1\nangle_deg = 30\n",
        r"^moved\[0\]: give one of angle and angle_deg, not both$",
    ),
    (PLATE + "[gel]\nJm = 30.0\n", r"^gel: unknown entry 'Jm'"),
    (
        PLATE + '[gel]\nenergy = "nocolon"\n',
        r"^gel\.energy: 'nocolon' is not a text of the form module:function",
    ),
    (PLATE + "[sweep]\nsteps = 2.5\n", r"^sweep\.steps: 2\.5 is neither 'auto' nor"),
    (PLATE + '[sweep]\nmu = ["a"]\n', r"^sweep\.mu\[0\]: 'a' is not a finite number"),
    (
        PLATE + "[discretisation]\ndmax = -1.0\n",
        r"^discretisation\.dmax: -1\.0 is not a finite number above 0",
    ),
    (PLATE + "[output]\ngif = true\n", r"^output: unknown entry 'gif'"),
    ('[plate]\nsample = "sample-1"\nwidth = 1.0\n', r"^plate: unknown entry 'width'"),
]


def test_a_wrong_entry_is_named_in_one_line_and_refused_by_the_schema(load, refused):
    refused(load, WRONG)
    validator = jsonschema.Draft202012Validator(case_schema())
    passed = [
        message
        for text, message in WRONG
        if message != "is not TOML" and validator.is_valid(tomllib.loads(text))
    ]
    # what no schema says: of numbers that are not finite, and of pairs of entries
    beyond = ["has its own", "nan is", "must differ", "inf is", "must differ", "10+ is"]
    assert len(passed) == len(beyond) and all(
        part in message for part, message in zip(beyond, passed, strict=True)
    ), passed


@pytest.mark.parametrize("options", [{}, {"steps": 3}])
def test_a_section_that_is_none_is_refused_whatever_is_changed_in_it(options, tmp_path):
    (tmp_path / "mine.toml").write_text("sweep = 3\n" + PLATE)
    with pytest.raises(ValueError, match=r"sweep: 3 is not a table, written \[sweep\]"):
        cases.load_case(str(tmp_path / "mine.toml"), {"sweep": options})


def test_options_are_checked_where_they_are_made():
    with pytest.raises(
        ValueError,
        match=r"^discretisation\.basis: 'cubic' is unknown; accepted: linear, quadratic$",
    ):
        options.DiscretisationOptions(basis="cubic")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"case: cannot read .*No such file"):
        cases.load_case(str(tmp_path / "missing.toml"))


WORDS = st.sampled_from(
    ["roller", "stable", "quadratic", "auto", "sample-1", "circle", "ellipse", "", "x"]
)
VALUES = st.recursive(
    WORDS | st.floats() | st.integers(-3, 30) | st.booleans(),
    lambda v: st.lists(v, max_size=3),
    max_leaves=4,
)
KEYS = [
    "width", "height", "edges", "sample", "kind", "centre", "radius", "semi_axes", "Nv", "chi",
    "mu", "mu_start", "steps", "branch", "dmax", "z",
]  # fmt: skip
SECTION = st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=5)
SIZED = SECTION.map(lambda section: {"width": 20.0, "height": 10.0} | section)


@settings(deadline=None, max_examples=300)
@given(
    st.fixed_dictionaries(
        {"plate": SIZED | SECTION | VALUES},
        optional={
            "holes": st.lists(SECTION, max_size=2) | VALUES,
            "gel": SECTION,
            "sweep": SECTION | VALUES,
            "discretisation": SECTION,
        },
    )
)
def test_any_table_is_a_case_or_a_value_error(table):
    try:
        case = cases.from_table(table, "fuzzed")
    except ValueError:
        return
    assert cases.from_table(case.table(), "fuzzed").table() == case.table()
