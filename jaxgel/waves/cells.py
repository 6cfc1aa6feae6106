"""Translations of a periodic plate, and its smallest cell."""

import dataclasses

import numpy as np

from .._types import Float
from ..geometry import Plate, outline_points

SAME = 1e-9  # of the shorter side: how far an outline may lie from its image
FAR = 1e3  # sides that stand for the period of a side without one
OUTLINE_POINTS = np.arange(24) / 24


def check_periodic(plate: Plate) -> tuple[bool, bool]:
    """Whether a plate is periodic along x and along y; ValueError if it is along neither."""
    periodic = plate.edges["left"] == "periodic", plate.edges["bottom"] == "periodic"
    if not any(periodic):
        raise ValueError(
            "edges: no two opposite edges are periodic; waves are those of a periodic cell"
        )
    return periodic


def translations(plate: Plate) -> tuple[int, int]:
    """Number of equal cells of a periodic plate along x and y; 1 along other sides.

    Into which it can be divided with its holes; others are not periodic. A plate with regions is
    not divided.

    >>> import jaxgel
    >>> holes = [jaxgel.Circle((x, y), 0.9) for x in (-1, 1) for y in (-1, 1)]
    >>> translations(jaxgel.Plate(4, 4, holes, edges="periodic"))
    (2, 2)
    """
    periodic, sides = np.array(check_periodic(plate)), np.array([plate.width, plate.height])
    outlines = np.array([np.asarray(outline_points(hole, OUTLINE_POINTS)) for hole in plate.holes])
    found, periods = [1, 1], np.where(periodic, sides, FAR * sides)
    for axis in np.flatnonzero(periodic & (not plate.regions)):
        for m in range(2, len(plate.holes) + 1):
            if _is_kept(
                outlines,
                np.where(np.arange(2) == axis, sides / m, 0.0),
                periods,
                SAME * sides.min(),
            ):
                found[axis] = m
    return found[0], found[1]


def _is_kept(
    outlines: Float[np.ndarray, "h q 2"],
    shift: Float[np.ndarray, " 2"],
    periods: Float[np.ndarray, " 2"],
    tolerance: float,
    among: Float[np.ndarray, "k q 2"] | None = None,
) -> bool:
    """Whether every outline, moved by ``shift``, lies on one ``among`` others or its image.

    Without others it is tried among themselves.
    """
    for outline in outlines:
        apart = outline + shift - (outlines if among is None else among)
        apart -= np.round(apart.mean(axis=1, keepdims=True) / periods) * periods
        if not (np.abs(apart).max(axis=(1, 2)) < tolerance).any():
            return False
    return True


def primitive_cell(plate: Plate) -> Plate:
    """Smallest cell of a periodic plate: the plate itself if its holes are all different.

    Arguments:

    - `plate`: the periodic `Plate`.

    Returns a `Plate` whose positions, mm, are relative to the middle of the cell. A plate with
    regions is its own cell. Fields of a gel are not considered, and neither are cells of other
    shapes, such as the rhombic one of a face-centred lattice.

    Raises `ValueError` if no edges are periodic.

    >>> import jaxgel
    >>> holes = [jaxgel.Circle((x, y), 0.9) for x in (-1, 1) for y in (-1, 1)]
    >>> cell = primitive_cell(jaxgel.Plate(4, 4, holes, edges="periodic"))
    >>> cell.width, [hole.centre.tolist() for hole in cell.holes]
    (2.0, [[0.0, 0.0]])
    """
    parts = np.array(translations(plate))
    if tuple(parts) == (1, 1):
        return plate
    sides = np.array([plate.width, plate.height])
    size, holes, outlines = sides / parts, [], []
    periods = np.where(check_periodic(plate), size, FAR * sides)
    for hole in plate.holes:
        outline = np.asarray(outline_points(hole, OUTLINE_POINTS))
        if outlines and _is_kept(
            outline[None], np.zeros(2), periods, SAME * sides.min(), among=np.array(outlines)
        ):
            continue  # an image of another hole
        outlines.append(outline)
        by = (sides - size) / 2
        holes.append(
            hole.translated(
                by - np.where(parts > 1, np.round((outline.mean(axis=0) + by) / size) * size, 0.0)
            )
        )
    width, height = map(float, size)
    return dataclasses.replace(
        plate, width=width, height=height, holes=tuple(holes), core=None, reference=None
    )
