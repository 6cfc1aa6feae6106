"""Cases that swell in time: sections time and bath, refusals, and built-in cases."""

import re
import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from studies import TINY, changed

import jaxgel
from jaxgel.cases import (
    case_names,
    case_schema,
    case_text,
    example,
    explicit,
    from_table,
    load_case,
    sample_names,
)

TABLE = tomllib.loads(
    TINY + "[gel]\nchi = 0.1\n[sweep]\nmu_start = -4.0\n[time]\nend = 2.0\n[bath]\nmu = -1.5\n"
)
SLOT = {"kind": "circle", "centre": [-1.5, 1.5], "radius": 0.2}


def with_entries(**sections):
    """The table of the tiny plate in a bath with other sections.

    An entry that is None is left out, and so is such a section.
    """
    table = TABLE | {
        section: TABLE.get(section, {}) | own if isinstance(own, dict) and section in TABLE else own
        for section, own in sections.items()
    }
    table = {
        section: {key: v for key, v in own.items() if v is not None}
        if isinstance(own, dict)
        else own
        for section, own in table.items()
    }
    return {section: own for section, own in table.items() if own is not None}


def holes(**entries):
    """The hole of the tiny plate with other entries."""
    return [TABLE["holes"][0] | entries]


def case(**sections):
    return from_table(with_entries(**sections), "tiny")


ACCEPTED = {
    "bath": ({}, {0: jaxgel.Bath(-1.5), "top": jaxgel.Bath(-1.5)}),
    "ramp": (
        {"bath": {"ramp": 0.1}},
        {part: jaxgel.Bath([-4.0, -1.5], times=[0.0, 0.1]) for part in (0, "top")},
    ),
    "table": (
        {"bath": {"mu": [-3.0, -1.0], "times": [0.0, 2.0]}},
        {part: jaxgel.Bath([-3.0, -1.0], times=[0.0, 2.0]) for part in (0, "top")},
    ),
    "sealed edge": ({"plate": {"wet": {"top": False}}}, {0: jaxgel.Bath(-1.5)}),
    "sealed hole": ({"holes": holes(wet=False)}, {"top": jaxgel.Bath(-1.5)}),
    "two baths": (
        {"holes": holes(bath={"mu": -1.0}), "plate": {"bath": {"top": {"mu": -2.0, "ramp": 0.5}}}},
        {0: jaxgel.Bath(-1.0), "top": jaxgel.Bath([-4.0, -2.0], times=[0.0, 0.5])},
    ),
    "wet is true": (
        {"holes": holes(wet=True), "plate": {"wet": {"top": True}}},
        {0: jaxgel.Bath(-1.5), "top": jaxgel.Bath(-1.5)},
    ),
    "start of a sweep": ({"sweep": None}, {0: jaxgel.Bath(-1.5), "top": jaxgel.Bath(-1.5)}),
    "start at the end of a sweep": (
        {"sweep": {"mu_start": -0.9178}},
        {0: jaxgel.Bath(-1.5), "top": jaxgel.Bath(-1.5)},
    ),
    "contact off": (
        {"sweep": {"contact": "off"}},
        {0: jaxgel.Bath(-1.5), "top": jaxgel.Bath(-1.5)},
    ),
}


@pytest.mark.parametrize("name", ACCEPTED)
def test_every_part_of_the_boundary_has_its_bath(name):
    """Also of the case read back from its table and from its text."""
    sections, expected = ACCEPTED[name]
    made = case(**sections)
    for again in (
        made,
        from_table(made.table(), "again"),
        from_table(tomllib.loads(case_text(explicit(made))), "text"),
    ):
        assert again.baths() == expected
        assert again.sweep.mu_start == {
            "start of a sweep": -4.9678,
            "start at the end of a sweep": -0.9178,
        }.get(name, -4.0)
        assert again.sweep.contact == "off" and again.time == made.time
    jsonschema.Draft202012Validator(case_schema()).validate(made.table())


def test_times_are_steps_or_a_list():
    """Ten to a decade by default; of a list those that are given."""
    steps, listed = (
        case(),
        case(time={"end": None, "times": [0.1, 0.5, 2.0], "unit": "h", "D": 2.0}),
    )
    assert (
        steps.time.values == jaxgel.TimeSteps(2.0, per_decade=10)
        and steps.time.last == listed.time.last == 2.0
    )
    assert case(time={"first": 1e-3, "steps_per_decade": 4}).time.values == jaxgel.TimeSteps(
        2.0, 1e-3, 4
    )
    problem = listed.problem(listed.model())
    assert listed.times(problem) == [0.1, 0.5, 2.0]
    assert (problem.control.name, problem.control.unit, problem.has_contact) == ("t", "h", False)
    assert listed.resolved_time(problem) == pytest.approx(case().resolved_time(problem) / 2)


def test_a_cloud_resolves_the_layer_from_the_square_of_its_spacing_over_the_diffusivity_on():
    """Free swelling at the start gives the diffusivity of a layer; nan if nothing swells freely."""
    made = case()
    problem, gel = made.problem(made.model()), jaxgel.Gel(1e-3, 0.1)
    stretch = jaxgel.free_swelling(-4.0, gel)
    D = jaxgel.materials.layer_diffusivity(stretch, stretch, gel, None, 1.0)
    assert made.resolved_time(problem) == pytest.approx((2 / 3) ** 2 / float(D))
    assert np.isnan(jaxgel.transient.resolved_time(problem, [0], 0.5))


REFUSED = [
    ({"bath": None}, r"case file: bath is missing; give a table, written \[bath\]"),
    ({"time": None}, r"case file: time is missing; give a table, written \[time\]"),
    ({"time": {"end": None}}, "time.end: is missing; give end, or times = "),
    ({"time": {"end": 0.0}}, "time.end: 0.0 is not a finite number above 0"),
    ({"time": {"ende": 1.0}}, "time: unknown entry 'ende'; did you mean 'end'"),
    ({"time": {"D": -1.0}}, "time.D: -1.0 is not a finite number above 0"),
    ({"time": {"unit": 3}}, "time.unit: 3 is not a text"),
    ({"time": {"first": 2.0}}, "time.first: 2 is not below time.end = 2"),
    (
        {"time": {"steps_per_decade": 0}},
        "time.steps_per_decade: 0 is not a whole number of at least 1",
    ),
    ({"time": {"times": [1.0]}}, "time.end: 2.0 does not go with a list of times"),
    (
        {"time": {"end": None, "times": [1.0, 2.0], "first": 0.1}},
        "time.first: 0.1 does not go with a list of times",
    ),
    (
        {"time": {"end": None, "times": [2.0, 1.0]}},
        "time.times: 2 is followed by 1, the values must increase",
    ),
    (
        {"time": {"end": None, "times": [0.0, 1.0]}},
        "time.times.0.: 0.0 is not a finite number above 0",
    ),
    ({"bath": {"mu": None}}, "bath: mu is missing"),
    (
        {"bath": {"mu": "high"}},
        "bath.mu: 'high' is neither a finite number nor a list of 1 or more finite numbers",
    ),
    ({"bath": {"mu": [-3.0, -1.0]}}, r"bath.mu: .* is a list, which goes with bath.times"),
    ({"bath": {"times": [0.0, 3.0]}}, "bath.mu: -1.5 is a number, bath.times goes with a list"),
    (
        {"bath": {"mu": [-3.0, -1.0], "times": [0.0, 1.0, 2.0]}},
        "bath.mu: has 2 values, bath.times has 3",
    ),
    (
        {"bath": {"mu": [-3.0, -1.0], "times": [2.0, 1.0]}},
        "bath.times: 2 is followed by 1, the values must increase",
    ),
    (
        {"bath": {"mu": [-3.0, -1.0], "times": [-1.0, 2.0]}},
        "bath.times.0.: -1.0 is not a finite number of at least 0",
    ),
    (
        {"bath": {"mu": [-3.0, -1.0], "times": [0.0, 1.0]}},
        "bath.times: 1 is before the last time of the run, 2; give",
    ),
    (
        {"bath": {"mu": [-3.0, -1.0], "times": [0.0, 2.0], "ramp": 1.0}},
        "bath: give one of times and ramp, not both",
    ),
    ({"bath": {"ramp": 0.0}}, "bath.ramp: 0.0 is not a finite number above 0"),
    ({"bath": {"mu": 0.5}}, "bath.mu: 0.5 is not accepted, it must be at most 0 kT"),
    (
        {"bath": {"mu": [-3.0, 0.1], "times": [0.0, 2.0]}},
        "bath.mu: 0.1 is not accepted, it must be at most 0 kT",
    ),
    (
        {"holes": holes(bath={"mu": 1.0, "ramp": 0.5})},
        "holes.0..bath.mu: 1 is not accepted, it must be at most 0 kT",
    ),
    (
        {"sweep": {"mu_end": -1.0}},
        (
            r"sweep.mu_end: -1.0 does not go with \[time\], in which the bath drives; it takes "
            r"mu_start"
        ),
    ),
    ({"sweep": {"mu": [-3.0, -1.0]}}, "sweep.mu: "),
    (
        {"sweep": {"control": "chi", "from": 0.1, "to": 0.2}},
        "sweep.control: 'chi' does not go with",
    ),
    ({"sweep": {"back": True}}, "sweep.back: True does not go with"),
    ({"sweep": {"imperfection": 0.1}}, "sweep.imperfection: 0.1 does not go with"),
    ({"sweep": {"eigenvalues": True}}, "sweep.eigenvalues: True does not go with"),
    (
        {"sweep": {"contact": "on"}},
        "sweep.contact: 'on' does not go with .* it takes contact = 'off'",
    ),
    ({"holes": holes(wet="no")}, "holes.0..wet: 'no' is neither true nor false"),
    ({"holes": holes(wett=False)}, "holes.0.: unknown entry 'wett'; did you mean 'wet'"),
    ({"holes": holes(bath={"mue": -1.0})}, "holes.0..bath: unknown entry 'mue'; did you mean 'mu'"),
    (
        {"holes": holes(bath={"mu": [-1.0], "times": [1.0]})},
        "holes.0..bath.times: 1 is before the last time",
    ),
    (
        {"holes": holes(wet=False, bath={"mu": -1.0})},
        "holes.0.: give one of wet = false and bath, not both",
    ),
    (
        {"holes": [*holes(), SLOT | {"bath": {"mu": [-1.0, -2.0]}}]},
        "holes.1..bath.mu: .* is a list",
    ),
    ({"plate": {"wet": {"topp": False}}}, "plate.wet: unknown entry 'topp'; did you mean 'top'"),
    (
        {"plate": {"wet": {"left": True}}},
        "plate.wet.left: the edge is roller, only a free edge is wetted",
    ),
    (
        {"plate": {"bath": {"left": {"mu": -1.0}}}},
        "plate.bath.left: the edge is roller, only a free edge is wetted",
    ),
    ({"plate": {"wet": {"top": False}}, "holes": holes(wet=False)}, "bath: nothing is wetted"),
    (
        {"time": None, "bath": None, "holes": holes(wet=False)},
        r"holes.0.: goes with swelling in time; add \[time\] and \[bath\]",
    ),
    (
        {"time": None, "bath": None, "plate": {"bath": {"top": {"mu": -1.0}}}},
        "plate.top: goes with swelling in time",
    ),
]


def test_wrong_entries_are_refused_in_one_line(refused):
    """Each names its field, what came and what is accepted."""
    refused(lambda sections: case(**sections), REFUSED, start=True)


UNCOVERED = [
    ({"plate": {"kinematics": "plane stress"}}, "kinematics: a film drinks through its faces"),
    ({"gel": {"chi": 0.9}}, "gel: can separate into phases"),
    ({"plate": {"edges": "periodic"}}, "edges: periodic edges are not covered"),
    (
        {"bath": {"mu": -60.0}},
        "bath.mu: -60 is too low, J - 1 would be lost in round-off; give at least -23.4 kT",
    ),
    (
        {"regions": [SLOT | {"elastomer": {"Nv": 0.1, "bulk": 10.0}}]},
        "gel: a plate with elastomers is not covered",
    ),
]


@pytest.mark.slow
def test_what_time_does_not_cover_is_refused_with_the_problem(refused):
    """Before anything is written."""

    def problem(sections):
        made = case(**sections)
        return made.problem(made.model())

    refused(problem, UNCOVERED, start=True)


def test_built_in_cases_are_plates_and_cases_in_time():
    """A name without a sample is a case, and its own file is the same case."""
    assert case_names() == [*sample_names(), "sample-1-bath", "two-sizes"]
    for name in case_names()[-2:]:
        made = load_case(name)
        again = from_table(tomllib.loads(case_text(explicit(made))), name)
        assert made.time is not None and (again.time, again.bath, again.baths()) == (
            made.time,
            made.bath,
            made.baths(),
        )
        assert again.discretisation == made.discretisation and made.baths() == {
            i: jaxgel.Bath(made.bath.mu) for i in range(len(made.plate.holes))
        }
    assert (
        load_case("sample-1-bath").plate.name == "sample-1" and load_case("sample-1").time is None
    )
    with pytest.raises(
        ValueError, match=r"^case: unknown name 'two-size'; did you mean 'two-sizes'\?"
    ):
        load_case("two-size")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sample-1-bath", "two-sizes"])
def test_built_in_cases_end_near_equilibrium(name):
    """Within 1e-3 of the largest displacement."""
    made = load_case(name)
    model = made.model()
    path = made.path(model)
    end = jaxgel.sweep(
        jaxgel.Problem(model, made.gel, contact=False), [made.sweep.mu_start, made.bath.mu]
    )
    assert path.stop.ok and len(path) < 100
    assert np.abs(path.x[-1] - end.x[-1]).max() < 1e-3 * np.abs(path.x[-1] - path.x[0]).max()


def test_the_example_in_time_says_what_can_be_wetted():
    """With regions of elastomer there is none."""
    text = case_text(example(in_time=True))
    assert (
        from_table(tomllib.loads(text), "again").baths() == example(in_time=True).baths()
        and len(example(in_time=True).baths()) == 4
    )
    assert text.count("# wet =") == 4 and "mu_end" not in text and "# ramp =" in text
    with pytest.raises(
        ValueError, match=r"^regions: an elastomer is not covered by swelling in time"
    ):
        example(regions=True, in_time=True)


def test_a_picture_of_holes_gives_each_of_them_its_bath(tmp_path):
    """As an outline from a file does."""
    (tmp_path / "bore.csv").write_text(
        "\n".join(f"{np.cos(a):.6f}, {np.sin(a):.6f}" for a in np.linspace(0, 6.2, 40))
    )
    text = changed(
        TINY,
        (
            'kind = "circle"\ncentre = [0.1, -0.2]\nradius = 1.1\n',
            'kind = "outline"\nfile = "bore.csv"\nbath = { mu = -1.0 }\n',
        ),
    )
    (tmp_path / "bore.toml").write_text(text + "[time]\nend = 1.0\n[bath]\nmu = -2.0\n")
    assert load_case(tmp_path / "bore.toml").baths() == {
        0: jaxgel.Bath(-1.0),
        "top": jaxgel.Bath(-2.0),
    }


def test_the_case_of_the_documentation_is_one():
    """Its holes have baths of their own, and the top edge is sealed."""
    text = (Path(__file__).parents[2] / "docs" / "howto" / "time.md").read_text(encoding="utf-8")
    made = from_table(tomllib.loads(re.search(r"```toml\n(.*?)```", text, re.DOTALL)[1]), "page")
    assert (
        made.baths() == {0: jaxgel.Bath(-1.5), 1: jaxgel.Bath([-4.0, -1.2], times=[0.0, 2.0])}
        and made.time.unit == "h"
    )
