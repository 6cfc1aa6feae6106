"""Images of points and shapes: by symmetries of the square and by the periods of a plate.

Host NumPy.
"""

import numpy as np
import shapely
from scipy.spatial import cKDTree

from .._types import Float, Int
from ..geometry import SYMMETRIES, Plate, image_offsets


def symmetries_of(
    points: Float[np.ndarray, "p 2"], tolerance: float
) -> list[tuple[np.ndarray, Int[np.ndarray, " p"]]]:
    """Symmetries of the square of points (p, 2): matrix (2, 2) and images (p,) of the points."""
    tree, found = cKDTree(points), []
    for matrix in map(np.array, SYMMETRIES.values()):
        distance, image = tree.query(points @ matrix.T)
        found += [(matrix, image)] if distance.max() < tolerance else []
    return found


def translated(plate: Plate, shapes: np.ndarray | shapely.Geometry) -> list:
    """The ``shapes``, shapely (m,) or one, translated to each neighbour of a periodic plate."""
    return [shapely.transform(shapes, lambda at, by=by: at + by) for by in image_offsets(plate)[1:]]
