"""How the background follows the holes: a thin-plate spline through the outline nodes and the vertices on the plate's edges.

Outline nodes move with their hole, vertices on the edges of the plate slide along them in proportion to the nearest arc ends there,
and the spline carries both displacements inwards. It is linear in the displacements and exact for affine ones.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from .._types import Array, Float, Int
from ..geometry import edge_lines
from .outlines import Lines

REST = -1  # source of a displacement of zero: a corner of the plate


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Morph:
    """The linear map from the displacement of the outline vertices to that of the background vertices; a pytree of NumPy arrays."""

    matrix: Float[Array, "b c"]
    """From the displacement of the controls, outline nodes and then vertices on the plate's edges, to that of the background vertices."""
    nodes: Int[Array, " k"]
    """Outline vertices that are controls."""
    sources: Int[Array, "e 2"]
    """Outline vertices between which each vertex on an edge slides, or ``REST``."""
    fraction: Float[Array, " e"]
    """Its position between them, 0 at the first."""
    axis: Int[Array, " e"]
    """Axis along which it slides."""

    def displacement(self, outline: Float[Array, "o 2"]) -> Float[Array, "b 2"]:
        """Displacement (b, 2) of the background vertices for that of the outline vertices, (o, 2)."""
        ends = jnp.concatenate([outline, jnp.zeros((1, 2))])[self.sources]  # REST is the last row
        f = self.fraction[:, None]
        slide = ((1 - f) * ends[:, 0] + f * ends[:, 1]) * jax.nn.one_hot(self.axis, 2)
        return self.matrix @ jnp.concatenate([outline[self.nodes], slide])


def make_morph(background: Float[np.ndarray, "b 2"], lines: Lines) -> Morph:
    """``Morph`` of the vertices ``background`` (b, 2) with the numbered ``lines``."""
    plate, n, outline, ends = lines.plate, len(background), np.concatenate([line.points for line in lines.both]), []
    for line in lines.both:
        ends += [(line.arc.start_edge, line.vertices[0] - n), (line.arc.end_edge, line.vertices[-1] - n)]
    nodes = np.concatenate([line.nodes for line in lines.both]) - n
    length, (on_edges, *slides) = max(plate.width, plate.height), _edge_slides(plate, background, outline, ends)
    apart = cKDTree(outline[nodes]).query(background[on_edges])[0] > 1e-9 * length  # an outline may end on an edge of the plate vertex
    on_edges, sources, fraction, axis = (column[apart] for column in (on_edges, *slides))
    controls = np.concatenate([outline[nodes], background[on_edges]])
    matrix = thin_plate_matrix(controls, background, length)
    matrix[on_edges] = np.eye(len(controls))[len(nodes) :]
    return Morph(matrix, nodes, sources, fraction, axis)


def _edge_slides(plate, background, outline, arc_ends):
    """Background vertices (w,) on edges, their sources (w, 2), fractions (w,) and axes (w,); ``arc_ends`` are (edge, outline vertex)."""
    size = np.array([plate.width, plate.height])
    corners = np.flatnonzero((np.abs(background) == size / 2).all(axis=1))
    found = [(corners, np.full((len(corners), 2), REST), np.zeros(len(corners)), np.zeros(len(corners), dtype=int))]
    for edge, (axis, coordinate) in edge_lines(plate).items():
        along, half = 1 - axis, size[1 - axis] / 2
        ends = np.array([number for where, number in arc_ends if where == edge], dtype=int)
        ends = ends[np.argsort(outline[ends, along])]
        stops = np.concatenate([[-half], outline[ends, along], [half]])
        source = np.concatenate([[REST], ends, [REST]])
        on = np.flatnonzero((background[:, axis] == coordinate) & (np.abs(background[:, along]) < half))
        t = background[on, along]
        k = np.searchsorted(stops, t) - 1
        between = np.stack([source[k], source[k + 1]], axis=1)
        found.append((on, between, (t - stops[k]) / (stops[k + 1] - stops[k]), np.full(len(on), along)))
    return tuple(np.concatenate(column) for column in zip(*found, strict=True))


def thin_plate_matrix(controls: Float[np.ndarray, "c 2"], points: Float[np.ndarray, "p 2"], length: float) -> Float[np.ndarray, "p r"]:
    """Matrix (p, c) of the thin-plate spline that takes values at ``controls`` (c, 2) to ``points`` (p, 2), exact for linear fields."""

    def kernel(a, b):
        r2 = cdist(a / length, b / length, "sqeuclidean")
        return 0.5 * r2 * np.log(np.where(r2 > 0, r2, 1.0))

    def linear(a):
        return np.concatenate([np.ones((len(a), 1)), a / length], axis=1)

    tail = linear(controls)
    system = np.block([[kernel(controls, controls), tail], [tail.T, np.zeros((3, 3))]])
    evaluate = np.concatenate([kernel(points, controls), linear(points)], axis=1)
    return np.linalg.solve(system, evaluate.T)[: len(controls)].T
