"""Motion of the background with the holes: a thin-plate spline through nodes and edge vertices.

Outline nodes move with their hole, vertices on the edges of the plate slide along them in
proportion to the nearest arc ends there, and the spline carries both displacements inwards. It is
linear in the displacements and exact for affine ones.
"""

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from .._types import Float
from ..geometry import edge_lines
from .outlines import Lines

REST = -1  # source of a displacement of zero: a corner of the plate


def morph_matrices(
    background: Float[np.ndarray, "b 2"], lines: Lines
) -> tuple[sp.csr_array, sp.csr_array]:
    """Matrices (b, o), x and y, from outline displacement to that of ``background`` (b, 2).

    These are vertices. The ``lines`` are numbered. Controls of the spline are the outline nodes
    and, after them, the vertices on the plate's edges.
    """
    plate, n, outline, ends = (
        lines.plate,
        len(background),
        np.concatenate([line.points for line in lines.both]),
        [],
    )
    for line in lines.both:
        ends += [
            (line.arc.start_edge, line.vertices[0] - n),
            (line.arc.end_edge, line.vertices[-1] - n),
        ]
    nodes = np.concatenate([line.nodes for line in lines.both]) - n
    length, (on_edges, *slides) = (
        max(plate.width, plate.height),
        _edge_slides(plate, background, outline, ends),
    )
    # an outline may end on an edge of the plate vertex
    apart = cKDTree(outline[nodes]).query(background[on_edges])[0] > 1e-9 * length
    on_edges, sources, fraction, along = (column[apart] for column in (on_edges, *slides))
    controls = np.concatenate([outline[nodes], background[on_edges]])
    matrix = thin_plate_matrix(controls, background, length)
    matrix[on_edges] = np.eye(len(controls))[len(nodes) :]
    shares = np.stack([1 - fraction, fraction], axis=1)
    made = []
    for axis in range(2):
        slides = (along == axis)[:, None] & (sources != REST)
        rows = np.concatenate([np.arange(len(nodes)), len(nodes) + np.nonzero(slides)[0]])
        entries = np.concatenate([np.ones(len(nodes)), shares[slides]])
        # the others have no controls
        columns, numbers = np.unique(np.concatenate([nodes, sources[slides]]), return_inverse=True)
        of_outline = sp.csr_array((entries, (rows, numbers)), (len(controls), len(columns)))
        products = sp.coo_array((of_outline.T @ matrix.T).T)
        made.append(
            sp.csr_array((products.data, (products.row, columns[products.col])), (n, len(outline)))
        )
    return tuple(made)


def _edge_slides(plate, background, outline, arc_ends):
    """Background vertices (w,) on edges, their sources (w, 2), fractions (w,) and axes (w,).

    ``arc_ends`` are (edge, outline vertex).
    """
    size = np.array([plate.width, plate.height])
    corners = np.flatnonzero((np.abs(background) == size / 2).all(axis=1))
    found = [
        (
            corners,
            np.full((len(corners), 2), REST),
            np.zeros(len(corners)),
            np.zeros(len(corners), dtype=int),
        )
    ]
    for edge, (axis, coordinate) in edge_lines(plate).items():
        along, half = 1 - axis, size[1 - axis] / 2
        ends = np.array([number for where, number in arc_ends if where == edge], dtype=int)
        ends = ends[np.argsort(outline[ends, along])]
        stops = np.concatenate([[-half], outline[ends, along], [half]])
        source = np.concatenate([[REST], ends, [REST]])
        on = np.flatnonzero(
            (background[:, axis] == coordinate) & (np.abs(background[:, along]) < half)
        )
        t = background[on, along]
        k = np.searchsorted(stops, t) - 1
        between = np.stack([source[k], source[k + 1]], axis=1)
        found.append(
            (on, between, (t - stops[k]) / (stops[k + 1] - stops[k]), np.full(len(on), along))
        )
    return tuple(np.concatenate(column) for column in zip(*found, strict=True))


def thin_plate_matrix(
    controls: Float[np.ndarray, "c 2"], points: Float[np.ndarray, "p 2"], length: float
) -> Float[np.ndarray, "p r"]:
    """Thin-plate spline matrix (p, c) from ``controls`` (c, 2) to ``points`` (p, 2).

    Exact for linear fields.
    """

    def kernel(a, b):
        r2 = cdist(a / length, b / length, "sqeuclidean")
        return 0.5 * r2 * np.log(np.where(r2 > 0, r2, 1.0))

    def linear(a):
        return np.concatenate([np.ones((len(a), 1)), a / length], axis=1)

    tail = linear(controls)
    system = np.block([[kernel(controls, controls), tail], [tail.T, np.zeros((3, 3))]])
    evaluate = np.concatenate([kernel(points, controls), linear(points)], axis=1)
    return np.linalg.solve(system, evaluate.T)[: len(controls)].T
