"""The control of a sweep in a case file: its values, and what is refused."""

import math
import re

import pytest

from jaxgel._validation import with_changes
from jaxgel.cases import case_text, from_table, load_case, load_map, load_study, study_from_table
from jaxgel.continuation import Adaptive, SweepOptions
from jaxgel.controls import ChemicalPotential, DrivenParameter, Load, Punch, Stretch
from jaxgel.materials import Pnipam, Polyelectrolyte

PLATE = {"plate": {"width": 4.0, "height": 4.0, "spacing": 0.8, "edges": {"top": "free"}}}


@pytest.mark.parametrize(
    ("entries", "values", "ends"),
    [
        ({"control": "chi", "values": [0.3, 0.4, 0.2]}, [0.3, 0.4, 0.2], (0.3, 0.4)),
        ({"control": "chi", "from": 0.5, "to": 0.25, "steps": 3}, [0.5, 0.375, 0.25], (0.5, 0.25)),
        (
            {"control": "chi", "from": 0.5, "to": 0.25, "steps": 2, "back": True},
            [0.5, 0.25, 0.5],
            (0.5, 0.25),
        ),
        (
            {"control": "chi", "from": 0.5, "to": 0.25, "steps": "auto", "back": True},
            Adaptive(0.5, 0.25, 0.5),
            (0.5, 0.25),
        ),
        (
            {"mu_start": -3.0, "mu_end": -2.0, "steps": 2, "back": True},
            [-3.0, -2.0, -3.0],
            (-3.0, -2.0),
        ),
        ({"mu": [-3.0, -2.0, -2.5]}, [-3.0, -2.0, -2.5], (-3.0, -2.0)),
    ],
)
def test_values_of_a_control(entries, values, ends, tmp_path):
    case = from_table(PLATE | {"sweep": entries}, "driven")
    assert case.sweep.values == values and case.sweep.ends == ends
    (tmp_path / "again.toml").write_text(case_text(case))
    assert (
        load_case(tmp_path / "again.toml").sweep
        == case.sweep
        == from_table(case.table(), "driven").sweep
    )


def test_the_control_that_the_names_stand_for():
    ends = {"start": 1.0, "end": 1.1, "at_mu": -0.5}
    stretch = SweepOptions(control="stretch", direction="x", **ends).driver(None)
    assert isinstance(stretch, Stretch) and (stretch.direction, stretch.mu) == ("x", -0.5)
    pH = SweepOptions(control="pH", **ends).driver(None)
    assert isinstance(pH, DrivenParameter) and (pH.name, pH.mu) == ("pH", -0.5)
    assert isinstance(SweepOptions(control="load", **ends).driver([[0.0, 1.0]]), Load)
    assert isinstance(SweepOptions().driver(None), ChemicalPotential)


def test_kinds_of_gels_and_what_drives_them(tmp_path):
    pnipam = {"kind": "pnipam", "Nv": 0.01, "temperature": 30.0}
    case = from_table(
        PLATE | {"gel": pnipam, "sweep": {"control": "temperature", "values": [45, 40, 45]}},
        "driven",
    )
    assert case.gel == Pnipam(Nv=0.01, temperature=30.0) and case.sweep.values == [45, 40, 45]
    acid = {"kind": "polyelectrolyte", "Nv": 1e-3, "salt": 0.1}
    other = from_table(
        PLATE | {"gel": acid, "sweep": {"control": "pH", "from": 3.0, "to": 8.0}}, "driven"
    )
    assert other.gel == Polyelectrolyte(Nv=1e-3, salt=0.1)
    for written in (case, other):
        (tmp_path / "again.toml").write_text(case_text(written))
        assert load_case(tmp_path / "again.toml").gel == written.gel


def test_a_gel_that_cannot_be_is_refused_in_one_line(refused):
    refused(
        lambda gel, sweep: from_table(PLATE | {"gel": gel, "sweep": sweep}, "driven"),
        [
            (
                {"kind": "pnipm"},
                {},
                (
                    "gel.kind: 'pnipm' is unknown; did you mean 'pnipam'? accepted: gel, pnipam, "
                    "polyelectrolyte"
                ),
            ),
            (
                {"kind": "pnipam", "chi": 0.1},
                {},
                "gel: unknown entry 'chi'; accepted: kind, Nv, temperature",
            ),
            (
                {"kind": "pnipam", "temperature": 101.0},
                {},
                "gel.temperature: 101.0 is not a finite number of at least 0 and of at most 100",
            ),
            ({"temperature": 30.0}, {}, "gel: unknown entry 'temperature'"),
            (
                {"kind": "pnipam"},
                {"control": "temperature", "from": 25, "to": 120},
                "it must be a number in [0, 100], degrees Celsius",
            ),
            (
                {"kind": "pnipam"},
                {"control": "chi", "from": 0.1, "to": 0.2},
                "sweep.control: 'chi' is no parameter of Pnipam",
            ),
        ],
        literal=True,
    )


WALL = {"kind": "half-plane", "point": [0.0, 3.0], "normal": [0.0, -1.0]}
PUNCH = {"control": "punch", "from": 0.0, "to": 0.5, "displacement": [0.0, -1.0]}
CHI, STRETCH = (
    {"control": "chi", "from": 0.1, "to": 0.2},
    {"control": "stretch", "from": 1.0, "to": 1.1},
)
REFUSED = [
    (
        {"control": "ph"},
        (
            "control: 'ph' is unknown; did you mean 'pH'? accepted: mu, temperature, chi, pH, "
            "salt, stretch, load, punch"
        ),
    ),
    (
        {"control": "temperature", "from": 25, "to": 40},
        "sweep.control: 'temperature' is no parameter of Gel, it has Nv, chi",
    ),
    (CHI | {"to": 0.1}, "chi: 0.1 is followed by 0.1, the values must differ from one to the next"),
    (
        {"control": "chi", "values": [0.1, 0.1]},
        "chi: 0.1 is followed by 0.1, the values must differ from one to the next",
    ),
    (
        {"control": "chi", "from": 0.1},
        (
            "sweep.to: is missing; control = 'chi' takes from, to, steps and back, or values; and "
            "at_mu"
        ),
    ),
    (CHI | {"values": [0.1, 0.2]}, "sweep.from: 0.1 does not go with a list of values"),
    (
        {"control": "chi", "values": [0.1, 0.2], "back": True},
        "sweep.back: True does not go with a list of values",
    ),
    (
        CHI | {"mu_end": -2.0},
        "sweep.mu_end: -2.0 does not go with control = 'chi', which takes from, to",
    ),
    (CHI | {"direction": "x"}, "sweep.direction: 'x' does not go with control = 'chi'"),
    (CHI | {"to": 2.5}, "it must be a finite number < 2"),
    (
        {"from": 0.1},
        (
            "sweep.from: 0.1 does not go with control = 'mu', which takes mu_start, mu_end, steps "
            "and back, or mu"
        ),
    ),
    ({"at_mu": 0.1}, "sweep.at_mu: 0.1 does not go with control = 'mu'"),
    (
        {"control": "load", "from": 0, "to": 1},
        "sweep.control: 'load' multiplies the loads of a case, and there are none",
    ),
    (STRETCH | {"from": 0}, "stretch: 0 is not accepted, it must be above 0"),
    (STRETCH | {"direction": "z"}, "sweep.direction: 'z' is unknown; accepted: x, y, both"),
    (CHI | {"obstacle": 0}, "sweep.obstacle: 0 does not go with control = 'chi'"),
    (
        STRETCH | {"displacement": [0.0, 1.0]},
        "sweep.displacement: (0.0, 1.0) does not go with control = 'stretch'",
    ),
    (PUNCH | {"direction": "y"}, "sweep.direction: 'y' does not go with control = 'punch'"),
    (
        PUNCH | {"displacement": [0.0, 0.0]},
        "sweep.displacement: [0, 0] is at rest; give two numbers in mm, as [0.0, -1.0]",
    ),
    (
        {"control": "punch", "values": [0.1]},
        "sweep.displacement: is missing; give two numbers in mm, as [0.0, -1.0]",
    ),
    (PUNCH, "sweep.obstacle: 0 is not an obstacle, the plate has none; give [[obstacles]]"),
]


def test_what_does_not_go_together_is_refused_in_one_line(refused):
    refused(lambda entries: from_table(PLATE | {"sweep": entries}, "driven"), REFUSED, literal=True)


def test_a_punch_moves_an_obstacle_of_the_case(tmp_path):
    case = from_table(
        PLATE | {"obstacles": [WALL, WALL], "sweep": PUNCH | {"obstacle": 1, "at_mu": -0.5}},
        "punched",
    )
    punch = case.sweep.driver(None)
    assert isinstance(punch, Punch) and (punch.obstacle, punch.direction, punch.mu, punch.unit) == (
        1,
        (0.0, -1.0),
        -0.5,
        "mm",
    )
    (tmp_path / "again.toml").write_text(case_text(case))
    assert load_case(tmp_path / "again.toml").sweep == case.sweep
    assert load_case(tmp_path / "again.toml", {"sweep": CHI}).sweep.displacement is None
    with pytest.raises(
        ValueError,
        match=r"^sweep.obstacle: 2 is not an obstacle, the plate has 2, numbered from 0$",
    ):
        from_table(PLATE | {"obstacles": [WALL, WALL], "sweep": PUNCH | {"obstacle": 2}}, "punched")


def test_edges_that_are_all_free_cannot_be_stretched():
    with pytest.raises(
        ValueError,
        match=r"^sweep.control: 'stretch' moves edges that are fixed, roller or periodic",
    ):
        from_table({"plate": PLATE["plate"] | {"edges": "free"}, "sweep": STRETCH}, "driven")


def test_another_control_takes_the_place_of_the_values_of_the_former(tmp_path):
    (tmp_path / "case.toml").write_text(
        '[plate]\nwidth = 4.0\nheight = 4.0\n[sweep]\nmu = [-3.0, -2.0]\nbranch = "symmetric"\n'
    )
    sweep = load_case(tmp_path / "case.toml", {"sweep": CHI | {"steps": 2}}).sweep
    assert (sweep.control, sweep.values, sweep.branch, sweep.at_mu) == (
        "chi",
        [0.1, 0.2],
        "symmetric",
        0.0,
    )
    (tmp_path / "case.toml").write_text(
        '[plate]\nwidth = 4.0\nheight = 4.0\n[sweep]\ncontrol = "chi"\nvalues = [0.1, 0.2]\n'
    )
    with pytest.raises(
        ValueError,
        match=(
            r"^sweep\.to: 0\.3 has no effect, as the case lists its values of chi; change that "
            r"list"
        ),
    ):
        load_case(tmp_path / "case.toml", {"sweep": {"to": 0.3}})


@pytest.mark.parametrize(
    ("own", "changes", "values"),
    [
        (CHI | {"back": True, "steps": 2}, {"values": [0.1, 0.3]}, [0.1, 0.3]),
        ({"mu_start": -3.0, "mu_end": -2.0, "back": True}, {"mu": [-2.5, -1.5]}, [-2.5, -1.5]),
        (
            {"control": "chi", "values": [0.1, 0.3]},
            {"from": 0.2, "to": 0.4, "steps": 2, "back": True},
            [0.2, 0.4, 0.2],
        ),
        ({"mu": [-3.0, -2.0]}, {"mu_start": -4.0, "mu_end": -1.0, "steps": 2}, [-4.0, -1.0]),
    ],
)
def test_a_list_takes_the_place_of_ends_and_ends_that_of_a_list(own, changes, values):
    assert (
        from_table(with_changes(PLATE | {"sweep": own}, {"sweep": changes}), "driven").sweep.values
        == values
    )


STUDY = """
[plate]
width = 8.0
height = 8.0
[[holes]]
kind = "circle"
centre = [0.0, -0.2]
radius = 2.0
[sweep]
control = "chi"
values = {values}
at_mu = -2.0
[[parameters]]
of = "radius"
lower = 1.9
upper = 2.1
[[objective]]
of = "area_reduction"
goal = "maximise"
at = {at}
"""


def test_a_study_counts_at_values_of_its_control(tmp_path):
    file = tmp_path / "study.toml"
    file.write_text(STUDY.format(values=[0.5, 0.3], at=0.3))
    study = load_study(file)
    assert study.problem.mu == [0.5, 0.3] and study.problem.sweep.values == [0.5, 0.3]
    assert study_from_table(study.table, "again").problem.sweep == study.problem.sweep
    for values, at, message in (
        ([0.5, 0.3], 0.4, r"objective[0].at: 0.4 is not one of the sweep's values (0.5, 0.3)"),
        ([0.5, 0.3, 0.5], 0.3, "chi: 0.5 is there twice, the values of a design must differ"),
    ):
        file.write_text(STUDY.format(values=values, at=at))
        with pytest.raises(ValueError, match=re.escape(message)):
            load_study(file)


@pytest.mark.parametrize(
    ("aim", "expected"),
    [
        ("curve = [1.0, 2.0, 3.0]", [1.0, 2.0, 3.0]),
        ("line = { slope = 10.0, mu0 = 0.1 }", [4.0, 5.0, 2.0]),
        ("curve = [1.0, 2.0, 3.0]\nfrom = 0.5\nto = 0.2", [1.0, math.nan, 3.0]),
    ],
)
def test_a_curve_counts_whichever_way_the_control_goes(aim, expected, tmp_path):
    text = STUDY.format(values=[0.5, 0.6, 0.3], at=0.3).replace('goal = "maximise"\nat = 0.3', "{}")
    (tmp_path / "study.toml").write_text(text.format(aim))
    assert load_study(tmp_path / "study.toml").aim["values"] == pytest.approx(expected, nan_ok=True)
    (tmp_path / "study.toml").write_text(
        text.format("curve = [1.0, 2.0, 3.0]\nfrom = 0.9\nto = 0.8")
    )
    with pytest.raises(
        ValueError,
        match=r"^objective\[0\]\.from, to: no chi of the sweep lies in 0\.8 \.\.\. 0\.9$",
    ):
        load_study(tmp_path / "study.toml")


def test_a_map_varies_the_parameters_of_a_gel_that_are_not_driven(tmp_path):
    base = (
        '[plate]\nwidth = 4.0\nheight = 4.0\n[gel]\nkind = "pnipam"\n[sweep]\ncontrol = "{}"\n'
        "values = [1.0, 1.1]\n"
    )
    file = tmp_path / "map.toml"
    file.write_text(
        base.format("stretch") + '[[parameters]]\nof = "temperature"\nvalues = [40.0, 45.0]\n'
    )
    study = load_map(file)
    assert [study.at(point).gel.temperature for point in study.points] == [40.0, 45.0]
    file.write_text(
        base.format("temperature") + '[[parameters]]\nof = "temperature"\nvalues = [40.0, 45.0]\n'
    )
    with pytest.raises(
        ValueError, match=r"^parameters\[0\]\.of: 'temperature' is unknown; accepted: Nv"
    ):
        load_map(file)
