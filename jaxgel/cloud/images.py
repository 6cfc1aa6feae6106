"""Images of points and shapes: by symmetries of the square and by the periods of a plate. Host NumPy."""

import numpy as np
import shapely
from scipy.spatial import cKDTree

from .._types import Float, Int
from ..geometry import SYMMETRIES, Plate, image_offsets


def nearest_points(points: Float[np.ndarray, "v d"], moved: Float[np.ndarray, "p d"]) -> tuple[Int[np.ndarray, " p"], float]:
    """The number (p,) of the one of the ``points`` (v, d) nearest each of the ``moved`` ones (p, d), and the largest distance."""
    distance, nearest = cKDTree(points).query(moved)
    return nearest, distance.max(initial=0.0)


def symmetries_of(points: Float[np.ndarray, "p 2"], tolerance: float) -> list[tuple[np.ndarray, Int[np.ndarray, " p"]]]:
    """The symmetries of the square that the points (p, 2) have: matrix (2, 2), and the point (p,) to which it takes each of them."""
    found = []
    for matrix in map(np.array, SYMMETRIES.values()):
        image, distance = nearest_points(points, points @ matrix.T)
        found += [(matrix, image)] if distance < tolerance else []
    return found


def translated(plate: Plate, shapes: np.ndarray | shapely.Geometry) -> list:
    """The ``shapes``, shapely geometries (m,) or one, translated to each of the neighbours of a periodic plate in the lattice."""
    return [shapely.transform(shapes, lambda at, by=by: at + by) for by in image_offsets(plate)[1:]]
