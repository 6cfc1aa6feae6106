"""The Taylor test of a user's case: it passes for true gradients, fails for broken ones.

It writes its table.
"""

import csv
import dataclasses
import tomllib

import jax
import numpy as np
import pytest
from studies import TINY

import jaxgel
from jaxgel.cases import case_text, from_table
from jaxgel.cli import command_line as cli
from jaxgel.cli import taylor_test as module
from jaxgel.cli.taylor_test import OBJECTIVES, RATE, STATES, check_gradient, differentiable

HOLE = dict(kind="ellipse", centre=[0.3, -0.2], semi_axes=[2.4, 1.6], angle=0.4)
TABLE = dict(
    plate=dict(width=8.0, height=8.0, edges={"top": "free"}),
    holes=[HOLE],
    # stiff enough for Nv to turn this plate: at 1e-3 the angle's change is lost in round-off
    gel=dict(Nv=1e-2, chi=0.1),
    sweep=dict(mu_start=-3.0, mu_end=-1.8, steps=2),
    discretisation=dict(spacing=1.2, nodes_per_hole=8),
)


@pytest.fixture(scope="module")
def case():
    """A case whose cloud is made once, for which programs are compiled once."""
    case = from_table(TABLE, "small")
    kind, made = type(case.discretisation), case.discretisation.cloud(case.plate)
    make = kind.cloud
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            kind, "cloud", lambda self, plate: made if plate is case.plate else make(self, plate)
        )
        yield case


@pytest.fixture(scope="module")
def checked(case):
    """All rows, and those of one more objective: the area with a derivative off by 1 %."""
    true = OBJECTIVES["area reduction"]
    wrong = {"wrong": lambda path: 0.99 * true(path) + 0.01 * jax.lax.stop_gradient(true(path))}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "OBJECTIVES", OBJECTIVES | wrong)
        return check_gradient(case, states=2)


@pytest.fixture(scope="module")
def rows(checked):
    return [row for row in checked if row.objective != "wrong"]


@pytest.mark.slow
def test_the_remainders_fall_quadratically(rows):
    assert all(row.ok for row in rows)
    assert len({(row.objective, row.family) for row in rows}) == len(rows) == 3 * 6
    assert {row.family for row in rows} == {"centre", "semi_axes", "angle", "Nv", "chi", "mu"}
    smooth = [row.rate for row in rows if row.family in ("chi", "mu")]  # no kinks if no node moves
    assert min(smooth) > RATE and np.median(smooth) == pytest.approx(2.0, abs=0.005)
    np.testing.assert_allclose(
        [row.difference for row in rows], [row.slope for row in rows], rtol=1e-4
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sweep", "families"),
    [
        ({"control": "chi", "from": 0.4, "to": 0.1, "at_mu": -2.0}, {"Nv", "chi", "mu"}),
        (
            {"control": "stretch", "from": 1.0, "to": 1.05, "at_mu": -2.0},
            {"Nv", "chi", "stretch", "mu"},
        ),
        ({"control": "load", "from": 0.5, "to": 1.0, "at_mu": -2.0}, {"Nv", "chi", "load", "mu"}),
    ],
    ids=lambda entry: entry.get("control") if isinstance(entry, dict) else "",
)
def test_the_values_and_the_parameters_of_a_control_are_families(sweep, families):
    """Values go by the control's name; a driven parameter of the gel has no effect."""
    table = TABLE | {"sweep": sweep, "loads": {"traction": {"top": [0.0, 1e-3]}}}
    rows = check_gradient(from_table(table, "driven"), states=2)
    assert all(row.ok for row in rows)
    assert {row.family for row in rows} == {"centre", "semi_axes", "angle"} | families
    assert min(row.rate for row in rows if row.family in families) > RATE


@pytest.mark.slow
def test_gradients_of_swelling_in_time_have_families_of_their_own():
    """D, the start, and mu and times of the baths, of which one ramps from the start.

    A bath at rest has no times.
    """
    ramp = {"bath": {"mu": -1.0, "ramp": 0.15}}
    table = tomllib.loads(TINY) | {
        "gel": {"Nv": 1e-2, "chi": 0.1},
        "sweep": {"mu_start": -4.0},
        "bath": {"mu": -1.5},
    }
    table |= {
        "holes": [hole | ramp for hole in table["holes"]],
        "time": {"times": [0.01, 0.15, 0.3]},
    }
    rows = check_gradient(from_table(table, "bath"))
    smooth = {"Nv", "chi", "D", "mu_start", "bath mu", "bath times"}  # no kinks if no node moves
    assert all(row.ok for row in rows) and {row.family for row in rows} == smooth | {
        "centre",
        "radius",
    }
    assert min(row.rate for row in rows if row.family in smooth) > RATE
    np.testing.assert_allclose(
        [row.difference for row in rows], [row.slope for row in rows], rtol=1e-3
    )


def test_the_states_of_a_check_are_among_the_times_of_the_case():
    """The last one is the case's last; a bath at rest has no kinks."""
    table = tomllib.loads(TINY) | {
        "gel": {"chi": 0.1},
        "sweep": {"mu_start": -4.0},
        "bath": {"mu": -1.5},
    }
    case = from_table(table | {"time": {"end": 10.0}}, "bath")
    model = case.model()
    drive, times = module._Swelling(case, model, None), case.times(case.problem(model))
    assert len(drive.times) == STATES and {*drive.times} < {*times} and drive.times[-1] == 10.0
    assert module._Swelling(case, model, 1000).times == times
    assert module._Swelling(case, model, 1).times == [10.0]
    assert not drive.kinks and drive.mu == [-1.5]


@pytest.mark.slow
def test_a_ramp_moves_with_its_start_and_a_time_with_its_kink():
    """Of the plate in time, whose bath ramps from mu_start; the other time stays."""
    table = tomllib.loads(TINY) | {
        "gel": {"chi": 0.1},
        "sweep": {"mu_start": -4.0},
        "bath": {"mu": -1.5, "ramp": 0.1},
    }
    case = from_table(table | {"time": {"times": [0.1, 0.2]}}, "bath")
    model = case.model()
    drive, problem = module._Swelling(case, model, None), case.problem(model)
    assert (drive.mu, drive.kinks) == ([-1.5], [0.1])
    np.testing.assert_allclose(drive.sizes["bath times"], 1e-3)
    path = drive.beside(
        None, problem, drive.numbers | {"mu_start": -3.0, "bath times": np.array([0.11])}
    )
    assert path.t.tolist() == [0.0, 0.11, 0.2] and path.mu.tolist() == [-3.0, -1.5, -1.5]
    assert np.isfinite(path.x).all()


@pytest.mark.slow
def test_an_objective_without_a_value_is_left_out(rows):
    """The core of this plate lies in the hole.

    Its nan must not reach the derivatives of the others.
    """
    assert {row.objective for row in rows} == set(OBJECTIVES) - {"core rotation"}


@pytest.mark.slow
def test_the_rotation_of_a_level_midline_is_left_out(square_model, path):
    """Round-off chooses the highest point of a level line: its angle is 0 and has no derivative."""
    level = jaxgel.sweep(jaxgel.Problem(square_model, jaxgel.sample("square").gel), [-2.0])
    assert abs(jaxgel.rotation_angle(level)[0]) < 1e-9
    assert differentiable(level) == ("core rotation",)  # a plate without holes has no area to lose
    assert differentiable(path) == tuple(OBJECTIVES)


@pytest.mark.slow
def test_a_wrong_gradient_is_found(checked):
    """Its remainders fall as h."""
    rows = [row for row in checked if row.objective == "wrong"]
    assert {row.family for row in rows} == {"centre", "semi_axes", "angle", "Nv", "chi", "mu"}
    assert not any(row.ok for row in rows)
    # a term in h^2 is left
    assert np.median([row.rate for row in rows]) == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_a_remainder_of_nan_is_a_failure_and_round_off_is_none(rows):
    assert not dataclasses.replace(rows[0], difference=np.nan, remainders=(np.nan,) * 2).ok
    assert dataclasses.replace(rows[0], difference=1e-12, slope=0.0, remainders=(1e-13,) * 2).ok


@pytest.mark.slow
def test_the_command_prints_and_writes_the_table(case, tmp_path, capsys, monkeypatch, rows):
    monkeypatch.setattr(module, "check_gradient", lambda *_, **__: rows)
    (tmp_path / "small.toml").write_text(case_text(case))
    assert (
        cli.main(
            [
                "check-grad",
                str(tmp_path / "small.toml"),
                "--states",
                "2",
                "--out",
                str(tmp_path / "out"),
            ]
        )
        == 0
    )
    printed = capsys.readouterr().out.splitlines()
    written = list(csv.DictReader((tmp_path / "out" / "check-grad.csv").read_text().splitlines()))
    assert len(written) == len(rows) == len(printed) - 2
    assert (
        printed[-1] == "left out, without a value or a derivative at the last state: core rotation"
    )
    assert float(written[0]["remainder at h = 1"]) == rows[0].remainders[0]

    wrong = dataclasses.replace(rows[0], slope=1.0, remainders=(4e-3, 2e-3))
    monkeypatch.setattr(module, "check_gradient", lambda *_, **__: [wrong, *rows])
    assert (
        cli.main(
            ["check-grad", str(tmp_path / "small.toml"), "--out", str(tmp_path / "out"), "--quiet"]
        )
        == 3
    )
    named = f"{wrong.objective} by {wrong.family}"
    said = (
        "jaxgel: the remainder does not fall as h^2, nor is the derivative the difference "
        f"quotient: {named}\n"
    )
    assert capsys.readouterr().err == said


def test_unusable_arguments_are_one_line_and_exit_code_2(capsys):
    for arguments, message in (
        ([], "CASE"),
        (["smaple-1"], "did you mean 'sample-1'"),
        (["sample-1", "--states", "x"], "states"),
    ):
        assert cli.main(["check-grad", *arguments]) == 2
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1
