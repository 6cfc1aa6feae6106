"""Curved sides of cells: an edge along an outline is part of the parabola through three neighbouring fine vertices of the outline.

Points on a parabola are sums of its three vertices with the weights of `parabola`, so that they follow the outline smoothly.

Interfaces are the outlines of regions with a material of their own. The gradient of the displacement jumps across them, so that either
side has shape functions of its own nodes, and of those on the interface, which belong to both. Between these nodes an interface is a curve
of third degree through four of them, two on either side where no corner is nearer. Its points are sums of node positions, and the same
sums of nodal values are the one trace that fields have from both sides.
"""

import dataclasses

import numpy as np
import scipy.sparse as sp

from .._types import Float, Int
from ..geometry import Plate, arc_points
from .outlines import OUTLINE_SEGMENTS, Outline, fine_outlines, loop
from .quadtree import Background

STENCIL = 4  # nodes of a curve of third degree
SAME = 1e-9  # difference of two shares of an arc that are the same


@dataclasses.dataclass(frozen=True, eq=False)
class Curves:
    """The fine segments of all outlines, two to a parabola; NumPy arrays."""

    ends: Int[np.ndarray, "s 2"]
    """Vertex numbers of the ends of each segment."""
    vertices: Int[np.ndarray, "s 3"]
    """Vertex numbers of its parabola."""
    start: Float[np.ndarray, " s"]
    """Parameter of its first end on the parabola: 0 or 1/2."""

    def points(self, segment: Int[np.ndarray, " p"], fraction: Float[np.ndarray, " p"]) -> tuple[np.ndarray, np.ndarray]:
        """Vertex numbers (p, 3) and weights (p, 3) of the points at a ``fraction`` of their ``segment``."""
        return self.vertices[segment], parabola(self.start[segment] + fraction / 2)


def curves_of(outlines: tuple[Outline, ...]) -> Curves:
    """``Curves`` of all outlines."""
    lines = [loop(outline) for outline in outlines]
    none = np.zeros((0, 2), int)
    ends = np.concatenate([none, *(np.stack([line[:-1], line[1:]], axis=1) for line in lines)])
    first = [np.arange(len(line) - 1) // 2 * 2 for line in lines]
    vertices = np.concatenate([np.zeros((0, 3), int), *(line[k[:, None] + np.arange(3)] for line, k in zip(lines, first, strict=True))])
    return Curves(ends, vertices, np.concatenate([np.zeros(0), *(np.arange(len(k)) % 2 / 2 for k in first)]))


def parabola(t: Float[np.ndarray, " p"]) -> Float[np.ndarray, "p 3"]:
    """Weights of the three points of a parabola, at the parameters 0, 1/2 and 1, in its point at ``t``."""
    return np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)], axis=-1)


def middles(
    edges: Int[np.ndarray, "e 2"], curves: Curves, cut_segments: Int[np.ndarray, " v"], cut_fractions: Float[np.ndarray, " v"]
) -> tuple[Int[np.ndarray, "e 3"], Float[np.ndarray, "e 3"]]:
    """Vertex numbers and weights of the middle of every edge: on the parabola of an edge along an outline, half-way elsewhere.

    ``cut_segments`` (v,) is the segment on which a vertex was cut, -1 for other vertices, at the fraction ``cut_fractions`` (v,).
    """
    numbers, weights = edges[:, [0, 1, 1]], np.tile([0.5, 0.5, 0.0], (len(edges), 1))
    if len(curves.ends) == 0:
        return numbers, weights
    segment = np.where(cut_segments[edges[:, 0]] >= 0, cut_segments[edges[:, 0]], cut_segments[edges[:, 1]])
    segment = np.where(segment >= 0, segment, _whole_segments(edges, curves.ends))
    own = curves.ends[segment]
    fractions = []
    for end in edges.T:
        cut = (cut_segments[end] == segment) & (segment >= 0)
        at = np.where(end == own[:, 0], 0.0, np.where(end == own[:, 1], 1.0, np.nan))
        fractions.append(np.where(cut, cut_fractions[end], at))
    middle = np.mean(fractions, axis=0)
    on = (segment >= 0) & np.isfinite(middle)
    numbers[on], weights[on] = curves.points(segment[on], middle[on])
    return numbers, weights


def _whole_segments(edges, ends):
    """The segment (e,) that is an edge, in either direction; -1 for none."""
    size = max(edges.max(), ends.max()) + 1
    key, wanted = np.sort(ends, axis=1) @ [size, 1], np.sort(edges, axis=1) @ [size, 1]
    order = np.argsort(key)
    at = order[np.minimum(np.searchsorted(key, wanted, sorter=order), len(key) - 1)]
    return np.where(key[at] == wanted, at, -1)


# --- interfaces ---------------------------------------------------------------------------------------------------------------


def make_interfaces(plate: Plate, background: Background, offset: int) -> tuple[tuple[Outline, ...], Float[np.ndarray, "o 2"]]:
    """The fine outline of every interface, its vertices numbered from ``offset``, and its points (o, 2).

    Their nodes are about as far apart as those of the background.
    """
    regions = plate.with_regions_as_holes
    interfaces, points = fine_outlines(regions, None, background, offset)
    for interface in interfaces:
        own = interface.vertices - offset
        nodes = np.asarray(arc_points(regions, interface.arc, interface.s[::OUTLINE_SEGMENTS]))
        points[own] = interpolation_along(interface, regions) @ nodes
    return interfaces, points


def interpolation_along(interface: Outline, regions: Plate) -> sp.csr_array:
    """Matrix (m, k) that takes values at the nodes of an interface to its fine vertices; ``regions`` is the plate of its arc."""
    arc, corners = interface.arc, regions.holes[interface.arc.hole].corners
    turns = np.add.outer(np.asarray(corners), [0.0, 1.0]).ravel()
    shares = (turns - arc.start) / (arc.end - arc.start)
    nodes = interface.s[::OUTLINE_SEGMENTS]
    count, period = len(nodes), 1.0 if interface.closed else np.inf
    kinks = np.flatnonzero([np.any(np.abs(shares - s) < SAME) for s in nodes])
    rows, columns, values = [], [], []
    for k, s in enumerate(interface.s):
        first = k // OUTLINE_SEGMENTS
        own = [k // OUTLINE_SEGMENTS] if k % OUTLINE_SEGMENTS == 0 else _stencil(first, count, interface.closed, kinks)
        at = nodes[np.mod(own, count)] + np.floor_divide(own, count) * (period if interface.closed else 0.0)
        rows += [k] * len(own)
        columns += list(np.mod(own, count))
        values += list(_lagrange(at, s))
    return sp.csr_array((values, (rows, columns)), shape=(len(interface.s), count))


def interface_traces(
    regions: Plate,
    interfaces: tuple[Outline, ...],
    first_node: int,
    n_nodes: int,
    cuts: tuple[np.ndarray, np.ndarray, np.ndarray],
    size: int,
) -> sp.csr_array:
    """Matrix (v, n) from nodal values to those at all vertices on interfaces, ``size`` = v; the rows of other vertices are empty.

    The nodes of the interfaces are numbered from ``first_node`` on, of ``n_nodes`` = n. ``cuts`` are the numbers (k,) of vertices that were
    cut, and the vertices (k, 3) and weights (k, 3) of the parabola on which each of them lies.
    """
    traces, node = sp.csr_array((size, n_nodes)), first_node
    for interface in interfaces:
        own = interpolation_along(interface, regions).tocoo()
        entries = own.data, (interface.vertices[own.coords[0]], node + own.coords[1])
        traces = traces + sp.csr_array(entries, shape=(size, n_nodes))
        node += own.shape[1]
    numbers, at, weights = cuts
    if not interfaces or not len(numbers):
        return traces
    spread = sp.csr_array((weights.ravel(), (np.repeat(numbers, 3), at.ravel())), shape=(size, size))
    return sp.csr_array(traces + spread @ traces)


def _stencil(first, count, closed, kinks):
    """Numbers of up to ``STENCIL`` neighbouring nodes around the interval that begins at node ``first``, none beyond a corner.

    On a closed line they may be negative, or ``count`` and more.
    """
    low, high = (-np.inf, np.inf) if closed else (0, count - 1)
    around = np.concatenate([kinks - count, kinks, kinks + count]) if closed else kinks
    low = max([low, *around[around <= first]])
    high = min([high, *around[around > first]])
    size = int(min(STENCIL, high - low + 1, count))
    start = int(min(max(first - (size - 2) // 2, low), high - size + 1))
    return list(range(start, start + size))


def _lagrange(at, s):
    """Weights of the values ``at`` a few parameters in that of their polynomial at ``s``."""
    apart = at[:, None] - at[None, :]
    factors = np.where(np.eye(len(at), dtype=bool), 1.0, (s - at)[None, :] / np.where(apart == 0, 1.0, apart))
    return factors.prod(axis=1)
