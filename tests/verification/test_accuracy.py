"""Error bars of a path's numbers from clouds of several spacings."""

import csv
import dataclasses
import json

import numpy as np
import pytest

import jaxgel
from jaxgel._validation import Inadmissible
from jaxgel.cases import load_case, point_accuracy_of
from jaxgel.equilibrium import Change
from jaxgel.io import write_accuracy
from jaxgel.plotting import plot_accuracy
from jaxgel.verification.several_clouds import spacings_near

GEL, MU = jaxgel.Gel(Nv=1e-3, chi=1e-4), [-4.0, -3.0, -2.0]
BEAM = """
gel = { Nv = 1e-3, chi = 1e-4 }
sweep = { mu = [-4.5, -1.0] }
discretisation = { spacing = 0.125 }
[plate]
width = 4.0
height = 0.5
edges = { left = "fixed", right = "fixed", top = "free", bottom = "free" }
"""
PLATE = jaxgel.Plate(
    8,
    8,
    [jaxgel.Ellipse((0.3, -0.2), (2.4, 1.6), 0.4)],
    spacing=0.8,
    nodes_per_hole=16,
    core=(3.2, 3.0),
)


def path_at(spacing):
    """The tilted plate swollen on a cloud of that spacing."""
    model = jaxgel.discretise(jaxgel.make_cloud(PLATE, spacing=spacing))
    return jaxgel.sweep(jaxgel.Problem(model, GEL, contact=False), MU)


@pytest.fixture(scope="module")
def found():
    """Accuracy of the plate at spacing 0.8."""
    return jaxgel.accuracy(path_at, 0.8)


@pytest.mark.slow
def test_squares_of_the_other_clouds_are_even(found):
    """Spacings from about sqrt(2) coarser to sqrt(2) finer, of even numbers of squares."""
    counts = 8 / found.spacings
    np.testing.assert_allclose(counts % 2, 0, atol=1e-9)
    assert (
        found.spacings[0] > 0.95
        and found.spacings[-1] < 0.6
        and 0.8 in found.spacings
        and len(found.nodes) >= 4
    )
    assert spacings_near(jaxgel.Plate(8, 4), 0.5) == pytest.approx([4 / 6, 4 / 12])


@pytest.mark.slow
def test_bars_hold_the_values_of_a_fine_cloud(found):
    """On a cloud a third as coarse most of the numbers lie within the bars."""
    fine = path_at(8 / 32)
    within = []
    for name, bars in found.bars.items():
        quantity = jaxgel.observables.QUANTITIES[name]
        exact = np.asarray(quantity.of(fine)) * quantity.scale
        within += (np.abs(bars.own - exact) <= bars.error + 1e-9 * np.abs(exact)).tolist()
    # of 24 numbers of one plate, whose errors go together; benchmarks/error_bars.py has twenty
    # plates
    assert np.mean(within) >= 0.8


@pytest.mark.slow
def test_mirrored_states_are_compared_by_their_size(found):
    """A path that has buckled to the other side has the same error bars."""

    def mirrored(spacing):
        path = path_at(spacing)
        switched = np.full(len(path), int(Change.NONE))
        switched[1] = int(Change.BIFURCATION)
        path = dataclasses.replace(path, switched=switched)
        if spacing == 0.8:
            return path
        flipped = np.asarray(path.x).copy()
        # every displacement reversed
        flipped[1:] = 2 * np.asarray(path.model.cloud.nodes) - flipped[1:]
        return dataclasses.replace(path, x=flipped)

    bars = jaxgel.accuracy(mirrored, 0.8, quantities=["core_rotation"]).bars["core_rotation"]
    assert np.all(bars.values > 0)
    np.testing.assert_allclose(bars.own, found.bars["core_rotation"].own)
    # a reversed strain is no exact mirror image
    np.testing.assert_allclose(bars.values, found.bars["core_rotation"].values, rtol=0.2)


@pytest.mark.thorough
def test_what_cannot_be_compared_is_refused(refused):
    """An unknown quantity, no path, and paths at other values."""

    def wandering(spacing):
        model = jaxgel.discretise(jaxgel.make_cloud(PLATE, spacing=1.6))
        return jaxgel.sweep(jaxgel.Problem(model, GEL, contact=False), [-4.0 - spacing])

    rows = [
        (lambda: jaxgel.accuracy(path_at, 0.8, quantities=["turn"]), "quantities: 'turn'"),
        (lambda: jaxgel.accuracy(lambda spacing: None, 0.8), "path_at: .* is not accepted"),
        (
            lambda: jaxgel.accuracy(wandering, 0.8),
            "path_at: the mu at spacing .* are not those at 0.8",
        ),
    ]
    refused(lambda attempt: attempt(), rows)


@pytest.mark.slow
def test_files_and_figure_hold_the_error_bars(found, tmp_path):
    """accuracy.csv and .json of every quantity and state, and a figure with panels."""
    write_accuracy(found, tmp_path, {})
    rows = list(csv.DictReader((tmp_path / "accuracy.csv").read_text().splitlines()))
    record = json.loads((tmp_path / "accuracy.json").read_text())
    assert (
        len(rows) == len(record["states"]) == len(found.bars) * len(MU)
        and record["nodes"] == found.nodes.tolist()
    )
    last = next(row for row in rows if row["mu"] == "-2.0" and row["quantity"] == "core_rotation")
    bars = found.bars["core_rotation"]
    numbers = bars.own[-1], bars.error[-1], *bars.values[:, -1]
    np.testing.assert_allclose(
        [float(last[key]) for key in ("value", "error", *(f"on {n} nodes" for n in found.nodes))],
        numbers,
        rtol=1e-12,
    )
    assert len(plot_accuracy(found)) >= len(found.bars)


@pytest.mark.slow
def test_command_writes_what_it_prints(tmp_path, capsys):
    """Table on the terminal, accuracy.csv of all states, accuracy.json with clouds, a figure."""
    arguments = [
        "accuracy",
        "sample-1",
        "--spacing",
        "1.1",
        "--steps",
        "3",
        "--mu-end",
        "-3",
        "--quantities",
        "core_rotation,energy",
    ]
    arguments += ["--gradient", "Nv"]
    assert jaxgel.cli.main([*arguments, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    rows = list(csv.DictReader((tmp_path / "accuracy.csv").read_text().splitlines()))
    record = json.loads((tmp_path / "accuracy.json").read_text())
    assert len(rows) == 6 and {row["quantity"] for row in rows} == {"core_rotation", "energy"}
    last = next(row for row in rows if row["mu"] == "-3.0" and row["quantity"] == "core_rotation")
    assert f"{float(last['value']):.5g}" in printed and f"{float(last['error']):.2g}" in printed
    assert record["nodes"] == sorted(record["nodes"]) and len(record["states"]) == 6
    assert (
        float(last[f"on {record['nodes'][-1]} nodes"])
        == record["states"][4][f"on {record['nodes'][-1]} nodes"]
    )
    assert (tmp_path / "accuracy.png").stat().st_size > 10_000
    slope, of_energy = csv.DictReader((tmp_path / "slopes.csv").read_text().splitlines())
    assert (slope["quantity"], slope["input"], of_energy["quantity"]) == (
        "core_rotation",
        "Nv",
        "energy",
    ) and f"{float(slope['slope']):.4g}" in printed
    assert 0 < float(slope["error"]) < abs(float(slope["slope"]))


@pytest.mark.slow
def test_critical_points_get_error_bars(tmp_path, capsys, refused):
    """A beam between walls buckles as it swells, without a jump: its loop has no fold."""
    (tmp_path / "beam.toml").write_text(BEAM)
    arguments = [
        "accuracy",
        str(tmp_path / "beam.toml"),
        "--no-plots",
        "--quantities",
        "energy",
        "--out",
        str(tmp_path / "out"),
    ]
    assert jaxgel.cli.main([*arguments, "--points", "onset,fold_up"]) == 0
    onset, fold = csv.DictReader((tmp_path / "out" / "points.csv").read_text().splitlines())
    assert f"{float(onset['value']):.5g}" in capsys.readouterr().out
    assert 0 < float(onset["error"]) < 0.05 * abs(float(onset["value"])) and fold["value"] == "nan"
    case = load_case(str(tmp_path / "beam.toml"))
    refused(
        lambda name: point_accuracy_of(case, [name]),
        [("onsets", "points: 'onsets' is .*onset, fold_up, fold_down, loop_width")],
    )


@pytest.mark.slow
def test_a_cloud_that_leaves_a_ligament_empty_is_replaced_by_a_finer_one(found):
    """A spacing above 0.85 is refused: one finer than 0.8 takes its place."""

    def narrow(spacing):
        if spacing > 0.85:
            raise Inadmissible("spacing: too coarse for a ligament")
        return path_at(spacing)

    nodes = jaxgel.accuracy(narrow, 0.8, quantities=["energy"]).nodes
    assert len(nodes) == 3 and nodes[0] == found.nodes[list(found.spacings).index(0.8)]
