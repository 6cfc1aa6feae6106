"""Translations of periodic plates and their smallest cells."""

import numpy as np
import pytest

import jaxgel
from jaxgel.waves import primitive_cell, translations, wave_vectors_of_zone

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
        (jaxgel.Plate(4, 4, rows((-1, 1), (-1,)) + rows((-1, 1), (1,), 0.41), edges="periodic"), (2, 1)),
        (jaxgel.Plate(4, 4, [*rows((-1, 1), (-1,)), *rows((-1,), (1,)), jaxgel.Circle((1, 1), 0.4 + 1e-5)], edges="periodic"), (1, 1)),
    ],
    ids=["square", "row", "strip", "one", "two rows", "nearly"],
)
def test_a_plate_is_divided_into_equal_cells(plate, parts):
    assert translations(plate) == parts
    cell = primitive_cell(plate)
    assert (cell.width, cell.height) == (plate.width / parts[0], plate.height / parts[1])
    assert len(cell.holes) * np.prod(parts) == len(plate.holes)
    assert (cell is plate) == (parts == (1, 1))


def test_a_cell_of_polygons_has_its_polygon():
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    cell = primitive_cell(jaxgel.Plate(4, 2, [jaxgel.Polygon(square + [x, 0]) for x in (-1, 1)], edges="periodic"))
    np.testing.assert_allclose(cell.holes[0].vertices, square, atol=1e-12)


def test_a_plate_between_walls_has_no_waves():
    with pytest.raises(ValueError, match="edges: no two opposite edges are periodic"):
        translations(jaxgel.Plate(4, 4, rows((-1, 1), (-1, 1))))


def test_wave_vectors_stand_for_all_of_the_zone():
    """Images of the chosen ones under mirrors and k -> -k are the whole grid, and none is an image of another one."""
    plate = jaxgel.Plate(2, 2, rows((0,), (0,)), edges="periodic")
    mirrors = ("x -> -x", "y -> -y", "rotation by 180")
    chosen = [wave_vectors_of_zone(plate, 4, group) for group in ((), mirrors)]
    long = [int(np.sum(np.linalg.norm(k, axis=1) < 0.05) - 1) for k in chosen]
    assert long == [12, 7] and len(chosen[0]) == 12 + (64 + 4) / 2 and len(chosen[1]) == 7 + 25
    strip = wave_vectors_of_zone(jaxgel.Plate(2, 2, rows((0,), (0,)), edges=STRIP), 4)
    assert len(strip) == 1 + 5 and not strip[:, 1].any()
