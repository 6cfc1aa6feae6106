"""Quadrature points of the integration cells, which move with the cells' vertices.

A parallelogram, such as a whole background square, and a quadrilateral that a mirror of its piece
keeps carry 2 x 2 Gauss points, which do not prefer one of the diagonals; the rest is integrated
over its triangles. Index letters: ``p`` point, ``k`` vertex.
"""

import dataclasses

import jax
import numpy as np

from .._types import Array, Float, Int
from .cells import Partition

# equal weights, exact for cubics
EDGE_POINTS = np.array([0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)])
# local coordinates, equal weights, exact for quadratics
_TRIANGLE = np.array([[1, 1], [4, 1], [1, 4]]) / 6
_SQUARE = np.stack(np.meshgrid(EDGE_POINTS, EDGE_POINTS, indexing="ij"), axis=-1).reshape(-1, 2)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Quadrature:
    """Points of all cells, ordered by cell; NumPy arrays; a pytree."""

    corners: Int[np.ndarray, "p 4"]
    """Vertices of the triangle (the last one without weight) or quadrilateral of each point."""
    values: Float[np.ndarray, "p 4"]
    """Weights with which the corners make the point."""
    slopes: Float[np.ndarray, "p 2 4"]
    """Derivatives of these weights by two local coordinates."""
    share: Float[np.ndarray, " p"]
    """Quadrature weight over the Jacobian determinant of the local coordinates."""
    owner: Int[np.ndarray, " p"]
    """Cell number."""

    def points(self, vertices: Float[Array, "v 2"]) -> Float[Array, "p 2"]:
        """The points for these positions of the vertices, mm; without a program for numbers."""
        return vertices.__array_namespace__().einsum(
            "pk,pki->pi", self.values, vertices[self.corners]
        )

    def weights(self, vertices: Float[Array, "v 2"]) -> Float[Array, " p"]:
        """Quadrature weights of the points, mm^2: they add up to the area of each cell.

        Without a program for numbers.
        """
        a, b = vertices.__array_namespace__().einsum(
            "plk,pki->lpi", self.slopes, vertices[self.corners]
        )
        return self.share * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def cell_quadrature(partition: Partition) -> Quadrature:
    """``Quadrature`` of a ``Partition``."""
    triangles, owner, pairs = (
        partition.triangles,
        partition.cell_of_triangle,
        partition.quadrilaterals,
    )
    rest = np.setdiff1d(np.arange(len(triangles)), pairs)
    padded = np.concatenate([triangles[rest], triangles[rest][:, :1]], axis=1)
    r, s = _TRIANGLE.T
    slope = np.array([[-1.0, 1, 0, 0], [-1, 0, 1, 0]])
    parts = [
        _rule(
            padded,
            owner[rest],
            np.stack([1 - r - s, r, s, 0 * r], axis=1),
            np.broadcast_to(slope, (3, 2, 4)),
            1 / 6,
        )
    ]
    r, s = _SQUARE.T
    values = np.stack([(1 - r) * (1 - s), r * (1 - s), r * s, (1 - r) * s], axis=1)
    slopes = np.stack(
        [np.stack([s - 1, 1 - s, s, -s], axis=1), np.stack([r - 1, -r, r, 1 - r], axis=1)], axis=1
    )
    parts.append(_rule(_joined(triangles[pairs]), owner[pairs[:, 0]], values, slopes, 1 / 4))

    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.argsort(columns[-1], kind="stable")
    return Quadrature(*(column[order] for column in columns))


def _joined(pairs):
    """Corners (k, 4), anticlockwise, of pairs of triangles (k, 2, 3) with a common edge."""
    one, two = pairs[:, 0], pairs[:, 1]
    # the corner of the second triangle that the first has not
    alone = ~(two[:, :, None] == one[:, None, :]).any(axis=2)
    apart = ~(one[:, :, None] == two[:, None, :]).any(axis=2)  # opposite the common edge
    at = apart.argmax(axis=1)[:, None]
    a, b, c = (np.take_along_axis(one, (at + k) % 3, axis=1)[:, 0] for k in range(3))
    return np.stack(
        [a, b, np.take_along_axis(two, alone.argmax(axis=1)[:, None], axis=1)[:, 0], c], axis=1
    )


def _rule(corners, owner, values, slopes, share):
    """Columns of a ``Quadrature`` for elements with ``corners`` (e, 4) and the rule of one."""
    e, q = len(corners), len(values)
    columns = np.repeat(corners, q, axis=0), np.tile(values, (e, 1)), np.tile(slopes, (e, 1, 1))
    return *columns, np.full(e * q, share), np.repeat(owner, q)
