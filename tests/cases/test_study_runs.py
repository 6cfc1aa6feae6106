"""Searches from several starts: the draw, the table of optima, interruptions, failures.

An interruption or a failed start loses nothing.
"""

import csv
import json
import multiprocessing
import os
import signal
import threading
import time
import tomllib

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from studies import STUDY, changed, interrupt, one_cloud

from jaxgel.cases import (
    OPTIMA,
    VERIFIED,
    Study,
    draw_starts,
    resumed_study,
    run_study,
    starts,
    study_from_table,
)
from jaxgel.cli import command_line as cli
from jaxgel.design import read_log, search
from jaxgel.io import Workers

ANGLE = '[[parameters]]\nof = "angle"\nlower = 0.3\nupper = 0.5\n'
SMALL = (
    changed(STUDY, ("evaluations = 4", "evaluations = 2\nstarts = 3"))
    + ANGLE
    + "[output]\nfigures = false\n"
)


def study(*changes):
    """The small study with some texts of its file replaced."""
    return study_from_table(tomllib.loads(changed(SMALL, *changes)), "small")


def table(folder):
    """Rows of starts.csv, without the seconds that they took."""
    with (folder / OPTIMA).open(newline="") as stream:
        return [
            {key: value for key, value in row.items() if key != "seconds"}
            for row in csv.DictReader(stream)
        ]


def test_starts_are_drawn_within_the_bounds_among_valid_plates():
    starts = draw_starts(study(("starts = 3", "starts = 12")))
    axes = np.array([start["semi_axes"] for start in starts])
    assert axes.shape == (12, 2) and axes[0].tolist() == [2.4, 1.6]
    assert np.all((axes >= [2.1, 1.4]) & (axes <= [2.7, 1.8]))
    # mm^2, the constraint on the dry plate, which the smallest ellipse does not meet
    assert np.all(np.pi * axes.prod(axis=1) >= 10.0)
    assert draw_starts(study()) == starts[:3]  # fewer of them are the first ones
    assert draw_starts(study(("starts = 3", "starts = 3\nseed = 1")))[1:] != starts[1:3]


def test_wrong_numbers_of_starts_are_refused(refused):
    refused(
        lambda written: study(("starts = 3", f"starts = {written}")),
        [
            ("0", "search.starts: 0 is not a whole number of at least 1 and of at most 999"),
            ("-1", "search.starts: -1 is not a whole number"),
            ("1.5", "search.starts: 1.5 is not a whole number"),
            ('"many"', "search.starts: 'many' is not a whole number"),
            ("true", "search.starts: True is not a whole number"),
            ("1e9", "search.starts: 1000000000.0 is not a whole number"),
            ("1000000000", "search.starts: 1000000000 is not a whole number"),
            ("3\nseed = -1", "search.seed: -1 is not a whole number of at least 0"),
        ],
        literal=True,
    )


def test_a_seed_without_starts_is_refused():
    with pytest.raises(
        ValueError,
        match=r"^search: starts is missing; give a whole number of at least 1 and of at most 999$",
    ):
        study(("starts = 3", "seed = 1"))


def test_bounds_without_valid_plates_are_one_line(tmp_path):
    """The largest ellipse has 15.3 mm^2."""
    with pytest.raises(
        ValueError,
        match=(
            r"^search.starts: 3 is too many, only 0 of 100 draws .* \(.*hole_area >= 15.3 is not "
            r"met"
        ),
    ):
        run_study(study(("above = 10.0", "above = 15.3")), tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL there")
def test_a_killed_worker_loses_no_search(tmp_path):
    """Two processes, one of them killed, give what one process gives.

    It is killed once it has a sweep in its log.
    """
    small, one, two = study(("starts = 3", "starts = 2")), tmp_path / "one", tmp_path / "two"
    with Workers(1) as executor:
        run_study(small, one, executor=executor)

    def kill():
        deadline = time.monotonic() + 300
        while time.monotonic() < deadline and not list(two.glob("starts/*/design.json")):
            time.sleep(0.002)
        os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    with Workers(2) as executor:
        run_study(small, two, executor=executor)
    thread.join()
    for row, other in zip(table(one), table(two), strict=True):
        # of converged states
        np.testing.assert_allclose(float(row["best_value"]), float(other["best_value"]), rtol=1e-9)


def replaced(self, vector):
    """In place of a sweep: a paraboloid over the semi-axes, and its pullback.

    It is highest at 2.3 and 1.7 mm; nothing is reported.
    """
    found = jax.vjp(
        lambda v: (
            jnp.sum((self.problem.parameters(v)["semi_axes"] - jnp.array([2.3, 1.7])) ** 2)[None]
            - 1.0
        ),
        jnp.asarray(vector),
    )
    return *found, {}


def verified(self, parameters, **_):
    """In place of a verification."""
    return dict(
        valid=True,
        reason="valid",
        nodes=0,
        spacing=1.2,
        value=0.0,
        semi_axes=np.asarray(parameters["semi_axes"]).tolist(),
    ), None


@pytest.fixture(scope="module", params=["replaced", pytest.param("true", marks=pytest.mark.slow)])
def sweeps(request):
    """Sweeps by a paraboloid, or true ones on one cloud; a list of axes without a cloud.

    On one cloud for all programs are compiled once.
    """
    without = []
    with pytest.MonkeyPatch.context() as patch:
        one_cloud(patch, without)
        if request.param == "replaced":
            patch.setattr(search.Search, "_forward", replaced)
            patch.setattr(Study, "verify", verified)
        yield without


@pytest.fixture(scope="module")
def whole(sweeps, tmp_path_factory):
    """Folder, `Design` and verified.json of four searches, of which the third has no cloud."""
    folder, four = tmp_path_factory.mktemp("starts") / "out", study(("starts = 3", "starts = 4"))
    sweeps.append(draw_starts(four)[2]["semi_axes"][0])
    return folder, *run_study(four, folder)


def test_the_table_has_a_row_for_every_start_and_the_best_is_verified(whole):
    folder, design, verified = whole
    assert {file.name for file in folder.iterdir()} == {
        "starts.json",
        OPTIMA,
        "starts",
        "best.toml",
        VERIFIED,
    }
    rows = table(folder)
    assert [row["start"] for row in rows] == ["1", "2", "3", "4"]
    assert [row["outcome"] for row in rows] == ["exhausted", "exhausted", "failed", "exhausted"]
    for row, start in zip(rows, draw_starts(study(("starts = 3", "starts = 4"))), strict=True):
        assert [
            float(row[f"start_{name}"]) for name in ("semi_axes_0", "semi_axes_1", "angle")
        ] == [*start["semi_axes"], start["angle"]]
    assert (
        rows[2]["reason"] == "plate: no cloud"
        and rows[2]["best_value"] == rows[2]["distance"] == ""
    )
    ended = [row for row in rows if row["outcome"] == "exhausted"]
    assert all(
        row["feasible"] == "True" and row["evaluations"] == "2" and row["reason"] == ""
        for row in ended
    )
    best = max(ended, key=lambda row: float(row["best_value"]))
    assert [row for row in ended if float(row["distance"]) == 0.0] == [best]
    assert [float(best[f"best_semi_axes_{i}"]) for i in range(2)] == verified["parameters"][
        "semi_axes"
    ]
    assert (
        float(best["best_value"])
        == design.value
        == verified["search"]["value"]
        > float(best["start_value"])
    )
    assert json.loads((folder / VERIFIED).read_text()) == verified and verified["best"]["valid"]


def test_the_command_prints_the_table_and_repeats_no_search(whole, capsys):
    folder, design, _ = whole
    before = table(folder)
    assert cli.main(["resume", str(folder)]) == 0
    head, *lines = capsys.readouterr().out.splitlines()[:5]
    assert head.split("  ")[0] == "start" and head.endswith("reason")
    assert [line.split()[0] for line in lines] == ["1", "2", "3", "4"]
    assert lines[2].endswith("plate: no cloud") and any(
        f"{design.value:.6g}" in line for line in lines
    )
    assert table(folder) == before


def test_start_1_is_the_single_search(whole, tmp_path):
    single = study(("\nstarts = 3", ""))
    design, _ = run_study(single, tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == {"design.json", "best.toml", VERIFIED}
    logs = [read_log(folder)["evaluations"] for folder in (tmp_path, whole[0] / "starts" / "001")]
    for entry in [*logs[0], *logs[1]]:
        del entry["seconds"]
    assert logs[0] == logs[1]
    assert float(table(whole[0])[0]["best_value"]) == design.value


def test_interrupted_searches_go_on_to_the_same_numbers_and_are_not_repeated(
    whole, tmp_path, monkeypatch
):
    """Ctrl-C in the fourth sweep, the second of the second search; two starts at first."""
    calls = interrupt(monkeypatch, 4)
    with pytest.raises(KeyboardInterrupt):
        run_study(study(("starts = 3", "starts = 2")), tmp_path)
    assert [row["start"] for row in table(tmp_path)] == ["1"]
    four = study(("starts = 3", "starts = 4"))
    with pytest.raises(ValueError, match=r"^out: .* holds searches already; resume them"):
        run_study(four, tmp_path)
    with pytest.raises(ValueError, match=r"^out: starts.json in .* is damaged or of another study"):
        run_study(study(("at = -1.8", "at = -3.0")), tmp_path, resume=True)
    _, verified = run_study(four, tmp_path, resume=True)
    assert len(calls) == 4 + 1 + 2
    assert table(tmp_path) == table(whole[0]) and verified == whole[2]
    assert run_study(resumed_study(tmp_path), tmp_path, resume=True)[1] == verified
    assert len(calls) == 4 + 1 + 2


def test_an_interruption_before_the_first_design_leaves_no_failed_start(tmp_path, monkeypatch):
    interrupt(monkeypatch, 1)
    with pytest.raises(KeyboardInterrupt):
        run_study(study(), tmp_path)
    assert table(tmp_path) == [] and not list(tmp_path.glob("starts/*/*"))


def test_searches_that_share_a_cloud_are_not_resumed_on_clouds_of_their_own(
    tmp_path, refused, monkeypatch
):
    for together in (True, False):
        (tmp_path / str(together)).mkdir()
        starts._begin(study(), tmp_path / str(together), False, together)
    text = r"out: the searches in .* share {}; resume them {} --device"
    refused(
        lambda before, now: starts._begin(study(), tmp_path / str(before), True, now),
        [
            (True, False, text.format("a cloud", "with")),
            (False, True, text.format("no cloud", "without")),
        ],
        whole=True,
    )
    drawn = draw_starts(study())
    monkeypatch.setattr(starts, "draw_starts", None)  # it takes minutes for hundreds
    assert starts._begin(study(), tmp_path / "True", True, True) == drawn


def test_where_all_starts_fail_the_study_does(tmp_path, monkeypatch):
    monkeypatch.setattr(
        search.Search,
        "_forward",
        lambda self, vector: (_ for _ in ()).throw(search.Invalid("no state")),
    )
    with pytest.raises(
        ValueError,
        match=(
            r"^search.starts: none of 3 is a valid design; start 1: start: .* not valid: no "
            r"state; see .*csv$"
        ),
    ):
        run_study(study(), tmp_path)
    assert [row["outcome"] for row in table(tmp_path)] == ["failed"] * 3


def test_the_picture_of_the_optima_has_the_parameters_in_the_order_of_their_names(
    tmp_path, monkeypatch
):
    """A design's own may be in another order; a start without a value, and none at all, too."""
    drawn = []

    def draw(*args):
        drawn.append(args)
        return plt.figure()

    monkeypatch.setattr("jaxgel.plotting.draw_optima", draw)
    found = {"angle": 0.4, "semi_axes": [2.1, 1.8]}
    design = {"parameters": found, "value": 2.0, "history": [{"value": None}], "feasible": True}
    starts._draw_optima(study().problem, {2: {"design": design}, 1: {"design": None}}, tmp_path)
    ((names, shares, values, at_start, feasible),) = drawn
    assert names == ["semi_axes_0", "semi_axes_1", "angle"]
    np.testing.assert_allclose(shares, [[0.0, 1.0, 0.5]], atol=1e-12)
    assert values.tolist() == [2.0] and np.isnan(at_start).all() and feasible.all()
    assert (tmp_path / "optima.png").stat().st_size > 0
    plt.close("all")
