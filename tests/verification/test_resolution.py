"""What a cloud resolves of its plate, and how a run says that it does not."""

import json

import numpy as np
import pytest

import jaxgel
from jaxgel.verification.resolved import rounded_down

SLIT = jaxgel.Plate(
    6.0, 4.0, [jaxgel.Circle((-1.1, 0.0), 0.9), jaxgel.Circle((1.1, 0.0), 0.9)]
)  # a ligament of 0.4 mm, and 1.0 mm at the edges


@pytest.mark.parametrize("spacing", [0.5, 0.2, 0.1])
def test_squares_across_the_narrowest_ligament(spacing):
    """The ligament is 0.4 mm wide, in squares of the spacing.

    Outline nodes of a circle turn by 360 degrees in all.
    """
    cloud = jaxgel.make_cloud(SLIT, spacing=spacing)
    found = jaxgel.resolution(cloud)
    side = cloud.topology.node_spacing.min()
    assert (
        found.ligament == pytest.approx(0.4, rel=1e-2) and found.between == "holes[0] and holes[1]"
    )
    assert found.squares_across == pytest.approx(0.4 / side, rel=0.02)
    assert found.turn == pytest.approx(360 / found.nodes_per_hole, rel=0.02)
    assert found.nodes_per_square == pytest.approx(
        side / (2 * np.pi * 0.9 / found.nodes_per_hole), rel=0.05
    )


def test_refinement_across_ligaments_counts():
    """With five nodes across the ligament its squares are four."""
    assert jaxgel.resolution(jaxgel.make_cloud(SLIT, spacing=0.4, across=5)).squares_across >= 3


def test_ligaments_move_with_the_holes():
    """Holes that come closer on the same cloud narrow the ligament."""
    cloud = jaxgel.make_cloud(SLIT, spacing=0.2)
    closer = cloud.at(SLIT.at([{"centre": (-1.05, 0.0)}, {"centre": (1.05, 0.0)}]))
    assert jaxgel.resolution(closer).ligament == pytest.approx(0.3, rel=1e-2)


def test_corners_are_resolved_and_plates_without_holes_have_no_ligament():
    """A square hole turns at its corners alone; a plate without holes has nothing to resolve."""
    square = jaxgel.Plate(
        4.0, 4.0, [jaxgel.Polygon([(-0.8, -0.8), (0.8, -0.8), (0.8, 0.8), (-0.8, 0.8)])]
    )
    assert jaxgel.resolution(jaxgel.make_cloud(square, spacing=0.4)).turn < 1e-9
    none = jaxgel.resolution(jaxgel.make_cloud(jaxgel.Plate(1.0, 1.0), spacing=0.2))
    assert none.squares_across == np.inf and none.turn == 0 and none.warnings == []
    assert none.table()["ligament"] is None


@pytest.mark.parametrize(
    ("case", "spacing"),
    [("sample-1", 9), ("sample-1", 1.5), ("sample-3", 9), ("sample-3", 3), ("sample-3", 1.5)],
)
def test_coarse_clouds_of_samples_are_named_and_the_advice_resolves_them(case, spacing):
    """The line names the ligament and a spacing; a cloud of that spacing has no such line."""
    plate = jaxgel.sample(case)
    line = jaxgel.resolution(jaxgel.make_cloud(plate, spacing=spacing)).warnings[0]
    assert "ligament between holes[0]" in line and "\n" not in line
    advice = float(line.split("use spacing = ")[1].split(",")[0])
    assert jaxgel.resolution(jaxgel.make_cloud(plate, spacing=advice)).warnings == []


@pytest.mark.slow
def test_default_clouds_of_the_samples_are_fine_enough():
    """Samples 1 to 8 have 1.8 squares across and more; the lattice has one, which is said."""
    for number in range(1, 9):
        plate = jaxgel.sample(f"sample-{number}")
        assert jaxgel.resolution(jaxgel.make_cloud(plate)).warnings == []
    assert (
        "1 squares wide"
        in jaxgel.resolution(jaxgel.make_cloud(jaxgel.sample("lattice"))).warnings[0]
    )


@pytest.mark.slow
def test_a_coarse_run_says_so_on_stderr_and_in_its_summary(tmp_path, capsys):
    """One line on stderr, the same in summary.json, with the numbers and Newton's work."""
    assert (
        jaxgel.cli.main(
            [
                "run",
                "sample-1",
                "--spacing",
                "9",
                "--steps",
                "2",
                "--mu-end",
                "-4.5",
                "--quiet",
                "--no-plots",
                "--out",
                str(tmp_path),
            ]
        )
        == 0
    )
    lines = [line for line in capsys.readouterr().err.splitlines() if "squares wide" in line]
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert len(lines) == 1 and summary["resolution"]["warnings"][0] in lines[0]
    assert (
        summary["resolution"]["squares_across"] == pytest.approx(0.44, abs=0.01)
        and summary["newton_per_state"] > 0
    )


def test_numbers_are_rounded_down_to_two_digits():
    """What is suggested is never coarser than what is needed."""
    assert [rounded_down(value) for value in (0.5, 0.1999, 1.0774, 33.3, 0.01)] == [
        0.5,
        0.19,
        1.0,
        33.0,
        0.01,
    ]
