"""Translations of a periodic plate, and its smallest cell."""

import dataclasses
import itertools

import numpy as np

from .._types import Float
from ..geometry import Plate, outline_points

MOST = 8  # parts into which a side of a periodic plate may be divided
SAME = 1e-9  # of the shorter side: how far an outline may lie from its image
OUTLINE_POINTS = np.arange(24) / 24


def check_periodic(plate: Plate) -> tuple[bool, bool]:
    """Whether a plate is periodic along x and along y; ValueError where it is along neither."""
    periodic = plate.edges["left"] == "periodic", plate.edges["bottom"] == "periodic"
    if not any(periodic):
        raise ValueError("edges: no two opposite edges are periodic; waves are those of a periodic cell")
    return periodic


def translations(plate: Plate) -> tuple[int, int]:
    """Into how many equal cells a periodic plate with its holes can be divided along x and along y; 1 along a side that is not periodic.

    >>> import jaxgel
    >>> holes = [jaxgel.Circle((x, y), 0.9) for x in (-1, 1) for y in (-1, 1)]
    >>> translations(jaxgel.Plate(4, 4, holes, edges="periodic"))
    (2, 2)
    """
    periodic, sides = check_periodic(plate), np.array([plate.width, plate.height])
    most = [MOST if along else 1 for along in periodic]
    outlines = np.array([np.asarray(outline_points(hole, OUTLINE_POINTS)) for hole in plate.holes]).reshape(-1, len(OUTLINE_POINTS), 2)
    steps = [[np.where(np.arange(2) == axis, sides / m, 0.0) for m in range(1, most[axis] + 1)] for axis in range(2)]
    x, y = (max(m for m, shift in enumerate(some, 1) if _is_kept(outlines, shift, sides)) for some in steps)
    return x, y


def _is_kept(outlines: Float[np.ndarray, "h q 2"], shift: Float[np.ndarray, " 2"], sides: Float[np.ndarray, " 2"]) -> bool:
    """Whether every outline, moved by ``shift``, lies on one of them or on one of its images a side away."""
    for outline in outlines:
        apart = outline + shift - outlines
        apart -= np.round(apart.mean(axis=1, keepdims=True) / sides) * sides
        if not (np.abs(apart).max(axis=(1, 2)) < SAME * sides.min()).any():
            return False
    return True


def primitive_cell(plate: Plate) -> Plate:
    """The smallest cell of which a periodic plate consists: itself where its holes are all different.

    Cells of other shapes, such as the rhombic one of a face-centred lattice, are not looked for. Raises ValueError where no edges are
    periodic and where every cell cuts a hole.

    >>> import jaxgel
    >>> holes = [jaxgel.Circle((x, y), 0.9) for x in (-1, 1) for y in (-1, 1)]
    >>> cell = primitive_cell(jaxgel.Plate(4, 4, holes, edges="periodic"))
    >>> cell.width, [hole.centre for hole in cell.holes]
    (2.0, [(0.0, 0.0)])
    """
    parts = np.array(translations(plate))
    if tuple(parts) == (1, 1):
        return plate
    sides = np.array([plate.width, plate.height])
    size = sides / parts
    for shares in itertools.product((0.0, 0.25, 0.5, 0.75), repeat=2):  # until no hole is cut
        holes = _holes_inside(plate, -sides / 2 + np.array(shares) * size, size)
        if len(holes) * parts.prod() == len(plate.holes):
            width, height = map(float, size)
            return dataclasses.replace(plate, width=width, height=height, holes=holes, core=(0.0, 0.0), cells=None, reference=None)
    raise ValueError(f"holes: every cell of {size[0]:g} x {size[1]:g} mm that repeats cuts one; shift the plate")


def _holes_inside(plate, corner, size):
    """The holes that lie in the cell of a ``size`` (2,) with its lower left ``corner`` (2,), relative to its middle."""
    sides, found = np.array([plate.width, plate.height]), []
    for hole in plate.holes:
        outline = np.asarray(outline_points(hole, OUTLINE_POINTS))
        shift = -np.floor((outline.mean(axis=0) - corner) / sides) * sides - corner
        if np.all((outline + shift > 0) & (outline + shift < size)):
            place = "centre" if "centre" in hole.shapes else "vertices"
            found.append(dataclasses.replace(hole, **{place: getattr(hole, place) + shift - size / 2}))
    return tuple(found)
