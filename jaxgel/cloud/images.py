"""Images of points and shapes: by symmetries of the square and by the periods of a plate. Host NumPy."""

import numpy as np
import shapely
from scipy.spatial import cKDTree

from .._types import Float, Int
from ..geometry import SYMMETRIES, Plate, image_offsets


def symmetries_of(points: Float[np.ndarray, "p 2"], tolerance: float) -> list[tuple[np.ndarray, Int[np.ndarray, " p"]]]:
    """The symmetries of the square that the points (p, 2) have: matrix (2, 2), and the point (p,) to which it takes each of them."""
    tree, found = cKDTree(points), []
    for matrix in map(np.array, SYMMETRIES.values()):
        distance, image = tree.query(points @ matrix.T)
        found += [(matrix, image)] if distance.max() < tolerance else []
    return found


def translated(plate: Plate, shapes: np.ndarray | shapely.Geometry) -> list:
    """The ``shapes``, shapely geometries (m,) or one, translated to each of the neighbours of a periodic plate in the lattice."""
    return [shapely.transform(shapes, lambda at, by=by: at + by) for by in image_offsets(plate)[1:]]
