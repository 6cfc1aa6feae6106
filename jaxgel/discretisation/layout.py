"""Index arrays of a cloud's patches, padded to sizes that similar clouds share."""

import dataclasses
from typing import NamedTuple

import jax
import numpy as np

from .._memo import once_per_owner
from .._sizes import NODES, padded, room
from .._types import Array, Float, Int
from ..cloud import Quadrature
from .connectivity import Connectivity, Contour
from .interpolation import size_of_groups, widened
from .ladder import of_patch, patches_of_blocks


class Layout(NamedTuple):
    """Index arrays with inert padding: zero weights, zero lengths, patches cut off at the end.

    Index letters: ``n`` node, ``p`` point, ``l`` patch.
    """

    node_vertices: Int[np.ndarray, " n"]
    """Vertex of each node."""
    quadrature: Quadrature
    """The points; ``owner`` is the cell."""
    patch: Int[np.ndarray, " cells"]
    """Patch number of each cell."""
    nodes: Int[np.ndarray, "l a"]
    """Node list of each patch."""
    support: Float[np.ndarray, "l a"]
    """Support radii; 0 for padding."""
    contour: Contour
    """The contours."""
    points_of: tuple[Int[np.ndarray, "..."], ...]
    """Per block the numbers (c, q) of the patches' points, -1 for padding."""


class Cells(NamedTuple):
    """The integration cells as programs take them that sum over each."""

    of_points: tuple[Int[Array, "c q"], ...]
    """Per block of a shared body the cell of each quadrature point.

    Of padding, which has no weight, that of another point.
    """
    patch: Int[Array, " cells"]
    """Patch number of each cell."""


@once_per_owner
def cells_of(lists: Connectivity) -> Cells:
    """The ``Cells`` of a ``Connectivity``."""
    layout = layout_of(lists)
    of_points = (
        layout.quadrature.owner[np.where(numbers >= 0, numbers, numbers[:, :1])]
        for numbers in layout.points_of
    )
    return Cells(tuple(of_points), layout.patch)


@once_per_owner
def layout_of(lists: Connectivity) -> Layout:
    """The ``Layout`` of a ``Connectivity``."""
    topology = lists.topology
    nodes, support = (
        padded(widened(part), room(len(part))) for part in (lists.nodes, lists.support)
    )
    count = room(len(topology.node_vertices), NODES)
    counts, most = list(map(len, lists.patches)), [numbers.shape[1] for numbers in lists.points]
    linear = [bool(lists.linear[patches[0]]) for patches in lists.patches]
    sizes = patches_of_blocks(counts, most, linear, count)
    points, edges = [], []
    for kind, of_points, of_edges, size in zip(
        linear, lists.points, lists.contour.numbers, sizes, strict=True
    ):
        wide, rows, _ = of_patch(of_points.shape[1], of_edges.shape[1], 0, linear=kind)
        points.append(_rounded(of_points, size, wide))
        edges.append(_rounded(of_edges, size, rows))
    return Layout(
        padded(topology.node_vertices, count),
        _quadrature(topology.quadrature),
        padded(lists.patch_of_cell, room(max(len(lists.patch_of_cell), count), NODES)),
        nodes,
        support,
        _contour(lists.contour, tuple(edges)),
        tuple(points),
    )


def _quadrature(given):
    """Points, with further ones without weight."""
    count = len(given.owner)
    more = jax.tree.map(lambda values: padded(values, size_of_groups(count)), given)
    more.share[count:] = 0.0
    return more


def _contour(given, numbers):
    """Edges, with further ones of no length that follow themselves."""
    count = len(given.cell)
    edges = size_of_groups(2 * count) // 2
    rows = dataclasses.replace(given, numbers=(), on_interfaces=None)
    more = jax.tree.map(lambda values: padded(values, edges), rows)
    if edges > count:
        more.ends[count:] = more.middles[0][count:] = given.ends[-1, 0]
        more.following[count:], more.edge_ends[count:] = np.arange(count, edges), -1
    traces = given.on_interfaces
    if traces is not None:
        traces = tuple(padded(part, room(len(part))) for part in (traces[0], widened(traces[1])))
    return dataclasses.replace(more, numbers=numbers, on_interfaces=traces)


def _rounded(numbers, rows, columns):
    """Numbers (c, q) with so many rows and columns, -1 in the further columns."""
    wide = np.pad(numbers, ((0, 0), (0, columns - numbers.shape[1])), constant_values=-1)
    return padded(wide, rows)
