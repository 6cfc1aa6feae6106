"""Factors of sparse symmetric matrices by fronts: nested dissection of the nodes, dense LAPACK on each front.

A meshless node is coupled to all others within some spacings, so the fronts are large and dense arithmetic wins: on the paper's samples
a factor costs about a third of SuperLU's (benchmarks/kernels.py). The method is that of Duff and Reid (1983) with the dissection of
George (1973). A front's pivot block is factorised by Cholesky where it is positive definite and by its eigenvectors where it is not;
either way the signs of the pivots give the inertia (Sylvester). There is no exchange of pivots between fronts: a front that is singular
by itself raises, and round-off that grew shows in the residual of the solution.
"""

import dataclasses
import functools

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.linalg import get_blas_funcs
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf

LEAF = 40  # nodes of a part that is not divided any more
BALANCE = 0.35  # least share of the nodes on either side of a cut


@dataclasses.dataclass(frozen=True, eq=False)
class Front:
    """What is known of a front before there are numbers; ranks count in the order of elimination."""

    first: int
    """Rank of the first pivot."""
    end: int
    """Rank after the last pivot."""
    below: np.ndarray
    """(m,) ranks of the later unknowns that its pivots are coupled to, ascending."""
    corner: tuple
    """Sources and places of the matrix entries in the (k, k) pivot block, lower triangle, column by column."""
    side: tuple
    """Sources and places of the matrix entries in the (m, k) block below it, column by column."""
    children: tuple
    """For each child its number, how many of its rows below are pivots here, and the slices (of its update, of the block here) of both
    parts: runs of consecutive rows."""


@dataclasses.dataclass(frozen=True, eq=False)
class Tree:
    """Fronts in the order of elimination, children before parents."""

    order: np.ndarray
    """(f,) unknown of each rank."""
    fronts: tuple
    """The ``Front``s."""

    @functools.cached_property
    def fill(self):
        """Numbers of a factor."""
        return sum((front.end - front.first) * (front.end - front.first + len(front.below)) for front in self.fronts)


@dataclasses.dataclass(frozen=True, eq=False)
class Fronts:
    """Numbers of a factor, K = sum over fronts of [L; B] S [L; B]^T."""

    tree: Tree
    """Its fronts."""
    numbers: np.ndarray
    """(tree.fill,) all that the corners and sides hold: one piece of memory, given back at once."""
    corners: list
    """Per front L (k, k) lower triangular, or the inverse transpose of a full L where the pivot block is indefinite."""
    sides: list
    """Per front B (m, k)."""
    signs: list
    """Per front the signs (k,) S of the pivots; None where all are positive and L is triangular."""

    @property
    def negative_pivots(self):
        """Number of negative eigenvalues of the matrix."""
        return sum(int(np.sum(signs < 0)) for signs in self.signs if signs is not None)

    @property
    def size(self):
        """Bytes it fills."""
        return self.numbers.nbytes

    @functools.cached_property
    def _steps(self):
        """Per front its pivots, the unknowns below, L, B and S: what `solve` needs, which is called many times and takes little time."""
        numbers = zip(self.tree.fronts, self.corners, self.sides, self.signs, strict=True)
        return [(slice(front.first, front.end), front.below, *own) for front, *own in numbers]

    def solve(self, rhs):
        """Solution (f,) or (f, r), without refinement: as accurate as the precision in which the factor is kept."""
        y = np.asarray(rhs, dtype=float)[self.tree.order]
        y = y.ravel() if y.size == len(y) else y  # one vector: BLAS of level 2, which takes three quarters of the time
        scale = 1.0
        if self.numbers.dtype != y.dtype:  # single precision has a small range
            scale = np.abs(y).max(axis=0) + np.finfo(float).tiny
            y = (y / scale).astype(self.numbers.dtype)
        trsv, trsm = get_blas_funcs(("trsv", "trsm"), dtype=y.dtype)

        def triangular(L, z, transposed=0):
            if not len(z):  # a front whose nodes are all held
                return z
            return trsv(L, z, lower=1, trans=transposed, overwrite_x=1) if z.ndim == 1 else trsm(1.0, L, z, lower=1, trans_a=transposed)

        for pivots, below, L, B, signs in self._steps:
            z = y[pivots] = triangular(L, y[pivots]) if signs is None else (signs * (L.T @ y[pivots]).T).T
            y[below] -= B.dot(z)
        for pivots, below, L, B, signs in reversed(self._steps):
            z = B.T.dot(y.take(below, axis=0))
            z = y[pivots] - (z if signs is None else (signs * z.T).T)
            y[pivots] = triangular(L, z, transposed=1) if signs is None else L @ z
        solution = np.empty(y.shape)
        solution[self.tree.order] = scale * y
        return solution.reshape(np.shape(rhs))


def factorise(tree, values, dtype=float):
    """``Fronts`` of the matrix whose entries are ``values`` (s,), finite; LinAlgError where the pivot block of a front is singular.

    All arithmetic is in double precision; ``dtype`` is that in which the factor is kept. In single precision its error acts on L, whose
    condition number is the square root of the matrix's: the matrix itself, rounded so, would not even keep its inertia.
    """
    values, numbers, used = np.ravel(values), np.empty(tree.fill, dtype), 0
    corners, sides, signs, updates = [], [], [], {}
    for number, front in enumerate(tree.fronts):
        corner, side, update = _assembled(front, values, updates)
        L, status = dpotrf(corner, lower=1, clean=0)
        if status == 0:
            positive, B = None, dtrsm(1.0, L, side, side=1, lower=1, trans_a=1, overwrite_b=1) if len(side) else side
            update = dsyrk(-1.0, B, beta=1.0, c=update, lower=1, overwrite_c=1) if len(side) else update
        else:
            pivots, vectors = scipy.linalg.eigh(corner, lower=True, check_finite=False)
            if not np.all(np.abs(pivots) > np.finfo(float).tiny):
                raise np.linalg.LinAlgError("a pivot vanishes")
            positive, L = np.sign(pivots), vectors / np.sqrt(np.abs(pivots))
            B = side @ L
            update -= (B * positive) @ B.T
        updates[number] = update
        for block, kept in ((L, corners), (B, sides)):
            kept.append(numbers[used : used + block.size].reshape(block.shape, order="F"))
            kept[-1][:] = block
            used += block.size
        signs.append(positive)
    return Fronts(tree, numbers, corners, sides, signs)


def _assembled(front, values, updates):
    """Pivot block (k, k), block (m, k) below and update (m, m) of a front: matrix entries and its children's updates; lower triangles."""
    k, m = front.end - front.first, len(front.below)
    corner, side, update = (np.zeros(shape, order="F") for shape in ((k, k), (m, k), (m, m)))
    for block, (source, place) in ((corner, front.corner), (side, front.side)):
        block.reshape(-1, order="F")[place] = values[source]  # a view: the block is contiguous by columns
    for child, pivots, rows in front.children:
        below = updates.pop(child)
        blocks = {(0, 0): corner, (1, 0): side, (1, 1): update}
        for (i, j), block in blocks.items():
            part = below[pivots * i : len(below) if i else pivots, pivots * j : len(below) if j else pivots]
            for from_column, to_column in rows[j]:
                for from_row, to_row in rows[i]:
                    block[to_row, to_column] += part[from_row, from_column]
    return corner, side, update


# --- before there are numbers ------------------------------------------------------------------------------------------------


def dissect(pairs, unknowns, points):
    """``Tree`` for a symmetric matrix given by 2 x 2 blocks of node pairs (p, 2), i <= j, flattened.

    ``unknowns`` (n, 2) numbers the two components of each node, -1 for those that are not part of the matrix; ``points`` (n, 2) are
    positions, which decide where the nodes are divided.
    """
    n = len(points)
    graph = sp.csr_matrix((np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    graph = sp.csr_matrix(graph + graph.T)
    parts = []
    _divide(graph, np.arange(n), points, parts)
    below = _coupled(graph, parts)

    order = unknowns[np.concatenate([nodes for nodes, _ in parts])].ravel()
    order = order[order >= 0]
    rank = np.append(np.argsort(order), -1).astype(np.int32)[unknowns]  # (n, 2), -1 where there is no unknown
    sizes = [int(np.sum(unknowns[nodes] >= 0)) for nodes, _ in parts]
    ends = np.cumsum(sizes)
    ranks = [np.sort(rank[nodes][rank[nodes] >= 0]).astype(np.intp) for nodes in below]
    entries = _entries(pairs, rank, ends, ranks)
    fronts = []
    for number, (_, children) in enumerate(parts):
        first, end = int(ends[number]) - sizes[number], int(ends[number])
        maps = tuple(_child(child, ranks[child], first, end, ranks[number]) for child in children)
        fronts.append(Front(first, end, ranks[number], *entries[number], maps))
    return Tree(order, tuple(fronts))


def _divide(graph, nodes, points, parts):
    """Append the parts (pivot nodes, child parts) of the ``nodes`` (k,), whose ``graph`` (k, k) it is; returns the last one's number."""
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
    """The smallest separator of the nodes by a straight cut across either axis: (separator, left, right, axis along it), or None.

    With the nodes numbered in the order of a coordinate, those left of a cut at t that reach across it are a separator, and so are those
    to its right: their numbers for all t follow from the farthest neighbour of each node.
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
            found.append((np.flatnonzero(separator), *(np.flatnonzero(side & ~separator) for side in (place < t, place >= t)), 1 - axis))
    separator, left, right, along = min(found, key=lambda cut: len(cut[0]))
    return (separator, left, right, along) if len(left) and len(right) else None


def _coupled(graph, parts):
    """Nodes of later parts that each part is coupled to once its children are eliminated."""
    place = np.empty(graph.shape[0], dtype=int)
    place[np.concatenate([nodes for nodes, _ in parts])] = np.arange(graph.shape[0])
    below, end = [], 0
    for nodes, children in parts:
        end += len(nodes)
        reached = np.unique(np.concatenate([graph[nodes].indices, *(below[child] for child in children)]))
        below.append(reached[place[reached] >= end])
    return below


def _entries(pairs, rank, ends, below):
    """Per front sources and places of the matrix entries in its pivot block and in the block below, lower triangle by columns."""
    row, column = (np.broadcast_to(r, (len(pairs), 2, 2)).ravel() for r in (rank[pairs[:, 0]][:, :, None], rank[pairs[:, 1]][:, None]))
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
        result.append(((source[mine][inside], place[inside]), (source[mine][~inside], under[~inside].astype(np.int32))))
    return result


def _child(number, rows, first, end, below):
    """A child's number, its rows (b,) that are pivots of the parent, and the runs of both kinds of its rows in the parent's blocks."""
    pivots = int(np.searchsorted(rows, end))
    return number, pivots, (_runs(rows[:pivots] - first), _runs(np.searchsorted(below, rows[pivots:])))


def _runs(places):
    """Slices (of the list, of the places) of consecutive ``places`` (k,)."""
    starts = np.flatnonzero(np.diff(places, prepend=-2) != 1)
    stops = np.append(starts, len(places))[1:]
    runs = zip(starts.tolist(), stops.tolist(), places[starts].tolist(), strict=True)
    return tuple((slice(a, b), slice(place, place + b - a)) for a, b, place in runs)
