"""The symmetries of the square, and which of them a plate's edges have."""

import numpy as np

from .._types import Float
from .boundary import EDGES
from .plate import Plate

SYMMETRIES = {
    "x -> -x": ((-1, 0), (0, 1)),
    "y -> -y": ((1, 0), (0, -1)),
    "x <-> y": ((0, 1), (1, 0)),
    "x <-> -y": ((0, -1), (-1, 0)),
    "rotation by 90": ((0, -1), (1, 0)),
    "rotation by 180": ((-1, 0), (0, -1)),
    "rotation by 270": ((0, 1), (-1, 0)),
}
"""Name -> matrix (2, 2) of every symmetry of the square but the identity."""
_NORMALS = dict(zip(EDGES, ((-1, 0), (1, 0), (0, -1), (0, 1)), strict=True))


def keeps_edges(plate: Plate, matrix: Float[np.ndarray, "2 2"]) -> bool:
    """Whether the plate moved by a ``matrix`` (2, 2) of `SYMMETRIES` has the same conditions.

    The same sides, conditions, displacements and deformation.
    """
    size, moves, names = (
        np.array([plate.width, plate.height]),
        plate.displacement,
        {normal: edge for edge, normal in _NORMALS.items()},
    )
    image = {
        edge: names[tuple(int(c) for c in np.array(matrix) @ normal)]
        for edge, normal in _NORMALS.items()
    }
    free = np.array(
        [[int((min(i, j), max(i, j)) in plate.free_strains) for j in range(2)] for i in range(2)]
    )
    return bool(
        np.array_equal(np.abs(matrix) @ size, size)
        and all(plate.edges[image[edge]] == condition for edge, condition in plate.edges.items())
        and all(np.array_equal(matrix @ move, moves[image[edge]]) for edge, move in moves.items())
        and np.array_equal(matrix @ plate.dry_deformation, plate.dry_deformation @ matrix)
        and np.array_equal(np.abs(matrix) @ free @ np.abs(matrix).T, free)
    )
