"""Symmetries of a square plate: those that a cloud has, and how they act on modes."""

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from .._types import Float
from ..discretisation import Model

SYMMETRIES = {
    "x -> -x": ((-1, 0), (0, 1)),
    "y -> -y": ((1, 0), (0, -1)),
    "x <-> y": ((0, 1), (1, 0)),
    "x <-> -y": ((0, -1), (-1, 0)),
    "rotation by 90": ((0, -1), (1, 0)),
    "rotation by 180": ((-1, 0), (0, -1)),
}


def symmetries(model: Model) -> dict[str, tuple[Any, ...]]:
    """Name of each of ``SYMMETRIES`` that the cloud has -> (matrix (2, 2), number (n,) of the node where each node goes)."""
    nodes, plate = np.asarray(model.cloud.nodes), model.cloud.plate
    tree, found = cKDTree(nodes), {}
    for name, matrix in SYMMETRIES.items():
        distance, image = tree.query(nodes @ np.array(matrix, dtype=float).T)
        matrix, moves = np.array(matrix, dtype=float), plate.displacement
        alike = _edges_after(plate.edges, matrix) == dict(plate.edges)
        alike &= {edge: tuple(matrix @ move) for edge, move in _edges_after(moves, matrix).items()} == dict(moves)
        alike &= np.array_equal(matrix @ plate.deformation, plate.deformation @ matrix)
        if distance.max() < 1e-6 * model.cloud.spacing and alike:
            found[name] = matrix, image
    return found


def _edges_after(values, matrix):
    """Edge -> value of the plate turned or mirrored by ``matrix``."""
    normals = {"left": (-1, 0), "right": (1, 0), "bottom": (0, -1), "top": (0, 1)}
    names = {normal: edge for edge, normal in normals.items()}
    return {names[tuple(int(c) for c in matrix @ normals[edge])]: value for edge, value in dict(values).items()}


def characters(modes: Float[np.ndarray, "m n 2"], permutations: dict[str, tuple[Any, ...]]) -> dict[str, float]:
    """Name -> trace of the symmetry in the space of the modes (m, n, 2), orthonormalised."""
    flat = np.linalg.qr(modes.reshape(len(modes), -1).T)[0]
    traces = {}
    for name, (matrix, image) in permutations.items():
        moved = np.empty_like(modes)
        fields = flat.T.reshape(modes.shape)
        moved[:, image] = fields @ matrix.T
        traces[name] = float(np.sum(fields * moved))
    return traces
