"""Translations of periodic plates and their smallest cells."""

import numpy as np
import pytest

import jaxgel
from jaxgel.geometry import SYMMETRIES
from jaxgel.waves import long_wave_number, primitive_cell, translations, wave_vectors_of_zone

STRIP = {"left": "periodic", "right": "periodic", "bottom": "fixed", "top": "free"}


def rows(xs, ys, radius=0.4):
    return [jaxgel.Circle((x, y), radius) for y in ys for x in xs]


@pytest.mark.parametrize(
    ("plate", "parts"),
    [
        (jaxgel.Plate(4, 4, rows((-1, 1), (-1, 1)), edges="periodic"), (2, 2)),
        (jaxgel.Plate(6, 2, rows((-2, 0, 2), (0,)), edges="periodic"), (3, 1)),
        (jaxgel.Plate(6, 2, rows((-2, 0, 2), (0,)), edges=STRIP), (3, 1)),
        (jaxgel.Plate(2, 2, rows((0,), (0,)), edges="periodic"), (1, 1)),
        (
            jaxgel.Plate(4, 4, rows((-1, 1), (-1,)) + rows((-1, 1), (1,), 0.41), edges="periodic"),
            (2, 1),
        ),
        (
            jaxgel.Plate(
                4,
                4,
                [*rows((-1, 1), (-1,)), *rows((-1,), (1,)), jaxgel.Circle((1, 1), 0.4 + 1e-5)],
                edges="periodic",
            ),
            (1, 1),
        ),
        (jaxgel.Plate(4, 1, edges=STRIP), (1, 1)),
        (
            jaxgel.Plate(
                4, 2, [jaxgel.Circle((-1, 1), 0.4), jaxgel.Circle((1, -1), 0.4)], edges=STRIP
            ),
            (1, 1),
        ),
        (jaxgel.Plate(6, 2, rows((-2, 0, 2), (1,)), edges=STRIP), (3, 1)),
        (jaxgel.Plate(22, 2, rows(range(-10, 11, 2), (0,)), edges="periodic"), (11, 1)),
        (
            jaxgel.Plate(
                4, 2, rows((-1, 1), (-0.5,)), edges=STRIP, regions=[jaxgel.Circle((1, 0.5), 0.3)]
            ),
            (1, 1),
        ),
    ],
    ids=[
        "square",
        "row",
        "strip",
        "one",
        "two rows",
        "nearly",
        "no holes",
        "edges",
        "cut",
        "eleven",
        "region",
    ],
)
def test_a_plate_is_divided_into_equal_cells(plate, parts):
    assert translations(plate) == parts
    cell = primitive_cell(plate)
    assert (cell.width, cell.height) == (plate.width / parts[0], plate.height / parts[1])
    assert len(cell.holes) * np.prod(parts) == len(plate.holes)
    assert (cell is plate) == (parts == (1, 1))
    if parts[1] == 1:
        assert {float(hole.centre[1]) for hole in cell.holes} == {
            float(hole.centre[1]) for hole in plate.holes
        }


def test_a_cell_of_polygons_has_its_polygon():
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    cell = primitive_cell(
        jaxgel.Plate(4, 2, [jaxgel.Polygon(square + [x, 0]) for x in (-1, 1)], edges="periodic")
    )
    np.testing.assert_allclose(cell.holes[0].vertices, square, atol=1e-12)


def test_a_plate_between_walls_has_no_waves():
    with pytest.raises(ValueError, match="edges: no two opposite edges are periodic"):
        translations(jaxgel.Plate(4, 4, rows((-1, 1), (-1, 1))))


MIRRORS = ("x -> -x", "y -> -y", "rotation by 180")
TURNS = ("rotation by 90", "rotation by 180", "rotation by 270")


@pytest.mark.parametrize(
    "group", [(), MIRRORS, TURNS, tuple(SYMMETRIES)], ids=["C1", "D2", "C4", "D4"]
)
def test_wave_vectors_stand_for_all_of_the_zone(group):
    """Their images under the group and k -> -k are the whole grid, without repetition."""
    chosen = (
        wave_vectors_of_zone(jaxgel.Plate(2, 2, rows((0,), (0,)), edges="periodic"), 4, group)
        * 2
        / np.pi
    )
    chosen = chosen[(np.linalg.norm(chosen, axis=1) > 0.1) | ~chosen.any(axis=1)]
    matrices = [np.eye(2), *(np.array(SYMMETRIES[name]) for name in group)]
    orbits = [
        {
            tuple(np.round(np.mod(sign * matrix @ k, 2), 6))
            for matrix in matrices
            for sign in (1, -1)
        }
        for k in chosen
    ]
    assert sum(map(len, orbits)) == len(set().union(*orbits)) == 64


def test_long_waves_run_in_all_directions():
    plate = jaxgel.Plate(10, 1, [jaxgel.Circle((0, 0), 0.3)], edges="periodic")
    long = wave_vectors_of_zone(plate, 2)[:12]
    # of nine digits over pi / side
    np.testing.assert_allclose(np.linalg.norm(long, axis=1), long_wave_number(plate), rtol=1e-6)
    angles = np.degrees(np.arctan2(long[:, 1], long[:, 0])) % 180
    np.testing.assert_allclose(
        np.sort(np.where(angles > 179.9, 0.0, angles)), 15 * np.arange(12), atol=1e-5
    )
    strip = wave_vectors_of_zone(jaxgel.Plate(2, 2, rows((0,), (0,)), edges=STRIP), 4)
    assert len(strip) == 1 + 5 and not strip[:, 1].any()
