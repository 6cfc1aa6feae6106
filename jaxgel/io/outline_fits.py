"""Holes that follow a closed outline: Fourier outlines and polygons within a tolerance.

Lengths in mm.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import shapely

from .._sizes import at_numbers
from .._types import Float
from ..geometry import Fourier, Hole, Polygon, outline_points

MOST_TERMS = 24  # of a Fourier outline
SAMPLES = 720  # points of a hole's outline in a file


def fit_fourier(points: Float[np.ndarray, "m 2"], tolerance: float) -> Fourier:
    """``holes.Fourier`` with the fewest terms within ``tolerance`` mm of an outline (m, 2).

    The outline is closed; ValueError for none. Its centre is where the first harmonics vanish. The
    outline must be star-shaped about its centre.
    """
    points = _equidistant(points)
    for terms in range(1, MOST_TERMS + 1):
        centre = points.mean(axis=0)
        for _ in range(50):
            d = points - centre
            phi = np.unwrap(np.arctan2(d[:, 1], d[:, 0]))
            if not (np.all(np.diff(phi) > 0) and phi[-1] - phi[0] < 2 * np.pi):
                raise ValueError(
                    "the outline is not seen whole from its middle; use fit = 'polygon'"
                )
            k = np.arange(1, terms + 2)
            waves = np.concatenate(
                [np.ones((len(phi), 1)), np.cos(phi[:, None] * k), np.sin(phi[:, None] * k)], axis=1
            )
            radius, *rest = np.linalg.lstsq(waves, np.linalg.norm(d, axis=1), rcond=None)[0]
            cos, sin = np.split(np.array(rest), 2)
            shift = np.array([cos[0], sin[0]])
            centre = centre + shift
            if np.linalg.norm(shift) < 1e-12 * radius:
                break
        hole = Fourier(centre, radius, cos[1:] / radius, sin[1:] / radius)
        miss = shapely.hausdorff_distance(
            *(shapely.LinearRing(line) for line in (hole_points(hole), points))
        )
        if miss <= tolerance:
            return hole
    raise ValueError(
        f"{MOST_TERMS} terms miss the outline by {miss:.3g} mm; raise the tolerance of "
        f"{tolerance:.3g} mm or take fit = 'polygon'"
    )


def fit_polygon(points: Float[np.ndarray, "m 2"], tolerance: float) -> Polygon:
    """``holes.Polygon`` of points of an outline (m, 2), within ``tolerance`` mm.

    Closed; by Douglas and Peucker.
    """
    ring = shapely.simplify(shapely.Polygon(points), tolerance).normalize()
    return Polygon(np.asarray(shapely.orient_polygons(ring).exterior.coords)[:-1])


FITS: Mapping[str, Callable[[np.ndarray, float], Hole]] = {
    "fourier": fit_fourier,
    "polygon": fit_polygon,
}
"""Kind of the hole that an outline becomes, and the function that fits it."""


def _equidistant(points: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "s 2"]:
    """``SAMPLES`` points at equal distances along the closed outline (m, 2), anticlockwise."""
    ring = shapely.orient_polygons(shapely.Polygon(points)).exterior
    return shapely.get_coordinates(
        shapely.line_interpolate_point(ring, np.arange(SAMPLES) / SAMPLES, normalized=True)
    )


def hole_points(hole: Any) -> Float[np.ndarray, "s 2"]:
    """`SAMPLES` points of the outline of a hole and its corners, mm."""
    return at_numbers(outline_points, hole, np.union1d(np.arange(SAMPLES) / SAMPLES, hole.corners))


def hole_entries(kind: str, hole: Hole) -> dict[str, Any]:
    """The case-file table of a hole of that kind."""
    return {"kind": kind} | {name: np.asarray(value).tolist() for name, value in hole.theta.items()}
