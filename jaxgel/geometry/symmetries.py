"""The symmetries of the square, and which of them a plate's edges have."""

from collections.abc import Mapping
from typing import Any

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
    """Whether the plate turned or mirrored by a ``matrix`` (2, 2) of `SYMMETRIES` has the same sides, conditions, displacements and
    macroscopic deformation.
    """
    size, moves = np.array([plate.width, plate.height]), plate.displacement
    free = np.array([[int((min(i, j), max(i, j)) in plate.free_strains) for j in range(2)] for i in range(2)])
    return bool(
        np.array_equal(np.abs(matrix) @ size, size)
        and _after(plate.edges, matrix) == dict(plate.edges)
        and {edge: tuple(matrix @ move) for edge, move in _after(moves, matrix).items()}
        == {e: tuple(map(float, m)) for e, m in moves.items()}
        and np.array_equal(matrix @ plate.dry_deformation, plate.dry_deformation @ matrix)
        and np.array_equal(np.abs(matrix) @ free @ np.abs(matrix).T, free)
    )


def _after(values: Mapping[str, Any], matrix: Float[np.ndarray, "2 2"]) -> dict[str, Any]:
    """Edge -> value of the plate turned or mirrored by ``matrix``."""
    names = {normal: edge for edge, normal in _NORMALS.items()}
    return {names[tuple(int(c) for c in matrix @ _NORMALS[edge])]: value for edge, value in dict(values).items()}
