"""Nested dissection: elimination order and fronts of a sparse matrix; symbolic analysis."""

import dataclasses
import functools

import numpy as np
import scipy.sparse as sp

from .._types import Bool, Float, Int

LEAF = 40  # nodes of a part that is not divided any more
BALANCE = 0.35  # least share of the nodes on either side of a cut


@dataclasses.dataclass(frozen=True, eq=False)
class Front:
    """What is known of a front before there are numbers.

    Ranks count in the order of elimination.
    """

    first: int
    """Rank of the first pivot."""
    end: int
    """Rank after the last pivot."""
    positive: int
    """How many pivots, the first ones, are positive in a quasi-definite matrix.

    All in a positive definite one.
    """
    below: Int[np.ndarray, " m"]
    """(m,) ranks of the later unknowns that its pivots are coupled to, ascending."""
    corner: tuple
    """Sources and positions of entries in the (k, k) pivot block, lower triangle by columns.

    They are matrix entries.
    """
    side: tuple
    """Sources and positions of entries in the (m, k) block below, by columns.

    They are matrix entries.
    """
    children: tuple
    """For each child its number, its rows that are pivots here, and the slices of both parts.

    That is how many of its rows below are pivots; the slices are runs of consecutive rows (of its
    update, of the block here).
    """


@dataclasses.dataclass(frozen=True, eq=False)
class Tree:
    """Fronts in the order of elimination, children before parents."""

    order: Int[np.ndarray, " f"]
    """(f,) unknown of each rank."""
    fronts: tuple[Front, ...]
    """The ``Front``s."""

    @functools.cached_property
    def fill(self) -> int:
        """Numbers of a factor."""
        return sum(
            (front.end - front.first) * (front.end - front.first + len(front.below))
            for front in self.fronts
        )


def dissect(
    pairs: Int[np.ndarray, "p 2"],
    unknowns: Int[np.ndarray, "n 2"],
    points: Float[np.ndarray, "n 2"],
    *,
    last: int = 0,
    late: Bool[np.ndarray, " n"] | None = None,
) -> Tree:
    """``Tree`` of a symmetric matrix of 2 x 2 blocks of node pairs (p, 2), i <= j, flattened.

    ``unknowns`` (n, 2) numbers the two components of each node, -1 for those that are not part of
    the matrix; ``points`` (n, 2) are positions, which decide where the nodes are divided. Of the
    ``last`` nodes, which may be coupled to any others, there are few: they are eliminated at the
    end. In each front the ``late`` nodes, those with the negative pivots of a quasi-definite
    matrix, come after the others.
    """
    n = len(points)
    late = np.zeros(n, dtype=bool) if late is None else late
    near = n - last
    graph = sp.csr_matrix(
        (np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(n, n)
    )
    graph = sp.csr_matrix(graph + graph.T)
    parts = []
    _divide(graph[:near][:, :near], np.arange(near), points, parts)
    parts[-1] = np.append(parts[-1][0], np.arange(near, n)), parts[-1][1]
    parts = [(nodes[np.argsort(late[nodes], kind="stable")], children) for nodes, children in parts]
    below = _coupled(graph, parts)

    order = unknowns[np.concatenate([nodes for nodes, _ in parts])].ravel()
    order = order[order >= 0]
    # (n, 2), -1 if there is no unknown
    rank = np.append(np.argsort(order), -1).astype(np.int32)[unknowns]
    sizes = [int(np.sum(unknowns[nodes] >= 0)) for nodes, _ in parts]
    ends = np.cumsum(sizes)
    ranks = [np.sort(rank[nodes][rank[nodes] >= 0]).astype(np.intp) for nodes in below]
    entries = _entries(pairs, rank, ends, ranks)
    fronts = []
    for number, (nodes, children) in enumerate(parts):
        positive = int(np.sum(unknowns[nodes[~late[nodes]]] >= 0))
        first, end = int(ends[number]) - sizes[number], int(ends[number])
        maps = tuple(_child(child, ranks[child], first, end, ranks[number]) for child in children)
        fronts.append(Front(first, end, positive, ranks[number], *entries[number], maps))
    return Tree(order, tuple(fronts))


def _divide(graph, nodes, points, parts):
    """Append parts (pivot nodes, child parts) of the ``nodes`` (k,) by the ``graph`` (k, k).

    It is theirs; returns the last one's number.
    """
    cut = _best_cut(graph, points[nodes]) if len(nodes) > LEAF else None
    if cut is None:
        parts.append((nodes, []))
        return len(parts) - 1
    separator, left, right, along = cut
    children = [_divide(graph[side][:, side], nodes[side], points, parts) for side in (left, right)]
    pivots = nodes[separator]
    parts.append((pivots[np.argsort(points[pivots, along], kind="stable")], children))
    return len(parts) - 1


def _best_cut(graph, points):
    """Smallest separator by a straight cut: (separator, left, right, axis along it), or None.

    The cut may be across either axis. With the nodes numbered in the order of a coordinate, those
    left of a cut at t that reach across it are a separator, and so are those to its right: their
    numbers for all t follow from the farthest neighbour of each node.
    """
    n, found = len(points), []
    for axis in range(2):
        place = np.empty(n, dtype=int)
        place[np.lexsort((points[:, 1 - axis], points[:, axis]))] = np.arange(n)
        neighbours = place[graph.indices]
        last = np.maximum.reduceat(neighbours, graph.indptr[:-1])
        first = np.minimum.reduceat(neighbours, graph.indptr[:-1])
        cuts = np.arange(int(BALANCE * n), int((1 - BALANCE) * n) + 1)
        from_left = cuts - np.searchsorted(np.sort(last), cuts)
        from_right = np.searchsorted(np.sort(first), cuts) - cuts
        for sizes, reach, is_left in ((from_left, last, True), (from_right, first, False)):
            t = cuts[np.argmin(sizes)]
            separator = (place < t) & (reach >= t) if is_left else (place >= t) & (reach < t)
            found.append(
                (
                    np.flatnonzero(separator),
                    *(np.flatnonzero(side & ~separator) for side in (place < t, place >= t)),
                    1 - axis,
                )
            )
    separator, left, right, along = min(found, key=lambda cut: len(cut[0]))
    return (separator, left, right, along) if len(left) and len(right) else None


def _coupled(graph, parts):
    """Nodes of later parts that each part is coupled to once its children are eliminated."""
    place = np.empty(graph.shape[0], dtype=int)
    place[np.concatenate([nodes for nodes, _ in parts])] = np.arange(graph.shape[0])
    below, end = [], 0
    for nodes, children in parts:
        end += len(nodes)
        reached = np.unique(
            np.concatenate([graph[nodes].indices, *(below[child] for child in children)])
        )
        below.append(reached[place[reached] >= end])
    return below


def _entries(pairs, rank, ends, below):
    """Per front sources and positions of entries in its pivot block and the block below.

    The lower triangle by columns; they are matrix entries.
    """
    row, column = (
        np.broadcast_to(r, (len(pairs), 2, 2)).ravel()
        for r in (rank[pairs[:, 0]][:, :, None], rank[pairs[:, 1]][:, None])
    )
    twice = np.repeat(pairs[:, 0] == pairs[:, 1], 4) & (row < column)
    source = np.flatnonzero((row >= 0) & (column >= 0) & ~twice).astype(np.int32)
    low, high = np.minimum(row, column)[source], np.maximum(row, column)[source]
    owner = np.searchsorted(ends, low, side="right")
    by_owner = np.argsort(owner, kind="stable")
    stops = np.searchsorted(owner[by_owner], np.arange(len(ends) + 1))
    result = []
    for number, end in enumerate(ends):
        mine = by_owner[stops[number] : stops[number + 1]]
        first, end = int(ends[number - 1]) if number else 0, int(end)
        inside = high[mine] < end
        corner = low[mine] - first, high[mine] - first
        place = corner[1] + (end - first) * corner[0]
        under = np.searchsorted(below[number], high[mine]) + len(below[number]) * corner[0]
        result.append(
            (
                (source[mine][inside], place[inside]),
                (source[mine][~inside], under[~inside].astype(np.int32)),
            )
        )
    return result


def _child(number, rows, first, end, below):
    """A child's number, its rows (b,) that are pivots of the parent, and the runs of both kinds.

    These are in the parent's blocks.
    """
    pivots = int(np.searchsorted(rows, end))
    return (
        number,
        pivots,
        (_runs(rows[:pivots] - first), _runs(np.searchsorted(below, rows[pivots:]))),
    )


def _runs(positions):
    """Slices (of the list, of the positions) of consecutive ``positions`` (k,)."""
    starts = np.flatnonzero(np.diff(positions, prepend=-2) != 1)
    stops = np.append(starts, len(positions))[1:]
    runs = zip(starts.tolist(), stops.tolist(), positions[starts].tolist(), strict=True)
    return tuple((slice(a, b), slice(place, place + b - a)) for a, b, place in runs)
