"""Sparse symmetric systems in a fixed pattern: analyse once, factor for each tangent, solve, count negative pivots.

The tangent is handed over as 2 x 2 blocks of node pairs (i <= j); a ``Pattern`` knows where they go in the matrix of the free degrees
of freedom. Factors are ``multifrontal``; the residual of every solution is checked, which finds the tangents that are singular to
working precision.

The solver ``"direct"`` keeps factors in double precision, ``"iterative"`` in single precision: half the memory, as the preconditioner of
an iteration in double precision that ends at the same residual. Both eliminate in double precision, so the inertia is the same, and both
serve derivatives. ``"auto"``, the default, is the direct one up to ``LARGE_BYTES`` of factor.
"""

import collections
import contextlib
import copy
import dataclasses
import functools
import threading

import numpy as np
import scipy.sparse as sp
from threadpoolctl import ThreadpoolController

from .multifrontal import dissect, factorise

MAX_REFINEMENTS = 20
BACKWARD_ERROR = 1e-12  # largest of an accepted solution
NEGLIGIBLE = 1e-13  # relative error of the solutions of a matrix near a factorised one
LEFT = 0.3  # largest share of the error that one of their iterations may leave: where they converge more slowly, a new factor costs less
ENOUGH = 1e-15  # backward error of a solution that Newton's method takes without refinement: that of a factor in double precision
REMEMBERED_BYTES = 2**29  # most that the factors kept for `solve_near` may fill, those of all patterns together
ONE_THREAD = 20_000  # unknowns up to which BLAS uses one thread: several fight over fronts as small as theirs
SOLVERS = ("auto", "direct", "iterative")
LARGE_BYTES = 2**31  # of a factor in double precision, above which "auto" is "iterative": 1.3e5 nodes of sample 1
COLUMNS = 20_000  # of a matrix whose entries are looked at together, lest a copy of it all be made


class SingularTangent(ArithmeticError):
    """The factorisation met a zero pivot, or its solutions do not solve: the tangent is singular to working precision."""


@dataclasses.dataclass(frozen=True, eq=False)
class Pattern:
    """Where the entries of node-pair blocks go in the free-free matrix; NumPy arrays, hashed by identity."""

    n_pairs: int
    """Number of node pairs i <= j."""
    free: np.ndarray
    """(f,) or (f, k) degrees of freedom of each unknown, see ``constraints``."""
    structure: sp.csc_matrix
    """The free-free matrix (f, f) of a tangent with, in place of its values, ``source``."""
    tree: object
    """``multifrontal.Tree``."""
    joined: sp.csr_matrix | None = None
    """Takes the entries of the pair blocks (4 n_pairs,) to those of the pairs of nodes that stand for others; None where all do."""
    narrower: object = None
    """``Pattern`` of the first pairs alone, for tangents whose other blocks are zero; None without."""
    solver: str = "auto"
    """``"direct"``, ``"iterative"``, or ``"auto"``: by the size of the factor."""

    @property
    def precision(self):
        """Type of the numbers in which factors are kept."""
        large = 8 * self.tree.fill > LARGE_BYTES
        return np.float32 if self.solver == "iterative" or (self.solver == "auto" and large) else np.float64

    @property
    def source(self):
        """(nnz,) entry of the flattened pair blocks, joined where nodes move together, that each stored matrix entry takes."""
        return self.structure.data

    def fitting(self, pairs):
        """The narrower pattern where it holds all of the pair blocks (n_pairs, 2, 2), otherwise this one."""
        return self.narrower if self.narrower is not None and not np.any(np.asarray(pairs)[self.narrower.n_pairs :]) else self

    def matrix(self, pairs):
        """The free-free matrix (f, f), CSC, from pair blocks (n_pairs, 2, 2)."""
        matrix = copy.copy(self.structure)  # the constructor would check the indices once more
        matrix.data = self.entries(pairs)[self.source]
        return matrix

    def entries(self, pairs):
        """Entries (e,) of the pair blocks (n_pairs, 2, 2), added up where nodes move together."""
        entries = np.asarray(pairs)[: self.n_pairs].reshape(-1)
        return entries if self.joined is None else self.joined @ entries


@dataclasses.dataclass(frozen=True, eq=False)
class Factor:
    """A factorised tangent."""

    pattern: Pattern
    """Its pattern."""
    matrix: sp.csc_matrix
    """The free-free matrix it was made from."""
    fronts: object
    """``multifrontal.Fronts``."""

    @functools.cached_property
    def negative_pivots(self):
        """Number of negative pivots = number of negative eigenvalues of the matrix."""
        return self.fronts.negative_pivots

    def apply(self, rhs):
        """Solution (f,) or (f, r) for the right-hand side without refinement or check: enough for a correction."""
        with few_threads(len(self.pattern.free)):
            return self.fronts.solve(rhs)

    def inverse(self, rhs):
        """Solution (f,) or (f, r) as accurate as that of a factor in double precision; not checked where the factor is one."""
        return self.apply(rhs) if self.pattern.precision is np.float64 else self.solve(rhs)[0]

    def solve(self, rhs, *, refine=True):
        """Solution (f,) or (f, r) for the right-hand side, and its backward error |b - K x| / (|K| |x| + |b|).

        It is refined until the corrections stop shrinking: in soft modes the residual tells nothing. Without ``refine`` the first
        solution is taken where it will do for a Newton step. Raises ``SingularTangent`` where refinement does not converge, or to no
        better backward error than ``BACKWARD_ERROR`` and a residual of 1e-4 of the right-hand side.
        """
        rhs = np.asarray(rhs)
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging Newton iterate ends as a status
            solution, before, scale = self.apply(rhs), np.inf, np.linalg.norm(rhs)
            for _ in range(MAX_REFINEMENTS):
                residual, norm = rhs - self.matrix @ solution, np.linalg.norm(solution)
                size = np.linalg.norm(residual)
                error = float(size / (self.norm * norm + scale + np.finfo(float).tiny))
                if not refine and error < ENOUGH:
                    break
                correction = self.apply(residual)
                change = np.linalg.norm(correction)
                if not change < 0.5 * before:
                    break
                solution, before = solution + correction, change
            else:
                error = np.inf
        if not (error < BACKWARD_ERROR and size <= 1e-4 * scale):
            raise SingularTangent(f"the linear solve left a backward error of {error:.1e}")
        return solution, error

    def solve_other(self, rhs, product):
        """Solution (f,) for another matrix, by its ``product`` with vectors (f,); None where that is far from the factorised one.

        Conjugate gradients with the factor as preconditioner: where the two matrices differ by a share s, an iteration leaves about s / 2
        of the error. That is measured in the norm of the factorised matrix, in which stiff and soft directions count alike. The last
        step is a plain correction, which needs no product and leaves the share s, at most twice what the slowest iteration left: at most
        ``NEGLIGIBLE`` of the solution remains. Of an indefinite matrix the norm may happen to vanish: then None as well.
        """
        solution, residual, slowest, apply = np.zeros(len(rhs)), rhs, 0.0, self.fronts.solve
        with few_threads(len(rhs)), np.errstate(all="ignore"):  # a far matrix ends as None
            direction = z = apply(rhs)
            size = residual @ z
            left, enough = np.inf, NEGLIGIBLE**2 * abs(size)
            while not left <= enough or not enough:
                image = product(direction)
                step = size / (direction @ image)
                solution, residual = solution + step * direction, residual - step * image
                z = apply(residual)
                size, last = residual @ z, size
                slowest = max(abs(size / last), slowest)  # nan if that is
                if not slowest < LEFT**2:
                    return None
                direction, left = z + size / last * direction, 4 * slowest * abs(size)
        return solution + z

    @functools.cached_property
    def size(self):
        """Bytes it fills: the fronts and the matrix."""
        return self.fronts.size + 8 * self.matrix.nnz

    @functools.cached_property
    def norm(self):
        """Largest column sum of the matrix, an upper bound of its spectral norm."""
        data, first = self.matrix.data, self.matrix.indptr[:-1]
        starts = np.split(first, range(COLUMNS, len(first), COLUMNS))
        stops = [*(start[0] for start in starts[1:]), len(data)]
        sums = (np.add.reduceat(np.abs(data[a[0] : b]), a - a[0]).max() for a, b in zip(starts, stops, strict=True))
        return float(max(sums))


def analyse(pair_nodes, points, free, solver="auto"):
    """``Pattern`` for node pairs (p, 2) with i <= j between nodes at ``points`` (n, 2) and free degrees of freedom (f,).

    The pairs include (i, i) for every node.
    """
    n_pairs, joined = len(pair_nodes), None
    if free.ndim == 2:
        pair_nodes, joined = _join(pair_nodes, len(points), free)
    own = free if joined is None else free[:, 0]
    local = np.full(2 * len(points), -1)
    local[own] = np.arange(len(own))
    structure = _sources(pair_nodes, len(points))[own][:, own]
    structure.sort_indices()
    tree = dissect(pair_nodes, local.reshape(-1, 2), points)
    return Pattern(n_pairs, free, structure.T, tree, joined, solver=solver)


def _sources(pairs, n):
    """Transpose (2 n, 2 n) of the matrix that has, where node pairs (p, 2) put an entry, its number in their blocks (p, 2, 2)."""
    graph = _pair_graph(pairs, n)
    order = np.array([[[0, 1], [2, 3]], [[0, 2], [1, 3]]], dtype=np.int32)[(graph.data < 0).astype(np.int8)]
    blocks = 4 * (np.abs(graph.data) - 1)[:, None, None] + order
    return sp.bsr_matrix((blocks, graph.indices, graph.indptr), shape=(2 * n, 2 * n)).tocsr()


def _pair_graph(pairs, n):
    """Sparse matrix (n, n) with the number of each node pair (p, 2), i <= j, counted from 1: negative at (j, i), and where i = j."""
    i, j = pairs.T
    apart, number = i != j, np.arange(1, len(pairs) + 1, dtype=np.int32)
    ends = np.concatenate([i, j[apart]]), np.concatenate([j, i[apart]])
    return sp.csr_matrix((np.concatenate([np.where(apart, number, -number), -number[apart]]), ends), shape=(n, n))


def _join(pair_nodes, n, free):
    """Pairs (q, 2) of nodes that stand for others, and the matrix (4 q, 4 p) that adds up the blocks of the pairs (p, 2) they stand for."""
    first = np.arange(n)
    for column in free.T[1:]:
        real = column < 2 * n
        first[column[real] // 2] = free[real, 0] // 2
    pairs = first[pair_nodes]
    flipped = pairs[:, 0] > pairs[:, 1]
    keys = np.sort(pairs, axis=1) @ [n, 1]
    known = np.union1d(keys, np.arange(n) * (n + 1))
    place = np.searchsorted(known, keys)
    block, turned = np.arange(4).reshape(2, 2), np.arange(4).reshape(2, 2).T
    p = np.arange(len(pairs))
    rows, columns = [4 * place[:, None] + np.where(flipped[:, None], turned.ravel(), block.ravel())], [4 * p[:, None] + block.ravel()]
    both = (pairs[:, 0] == pairs[:, 1]) & (pair_nodes[:, 0] != pair_nodes[:, 1])  # a node and its image: the block and its transpose
    rows.append(4 * place[both][:, None] + turned.ravel())
    columns.append(4 * p[both][:, None] + block.ravel())
    rows, columns = (np.concatenate(parts).ravel() for parts in (rows, columns))
    joined = sp.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(4 * len(known), 4 * len(pairs)))
    return np.stack([known // n, known % n], axis=1), joined


def factor(pattern, pairs):
    """``Factor`` of the tangent given by pair blocks (n_pairs, 2, 2); raises ``SingularTangent``."""
    pattern = pattern.fitting(pairs)
    matrix = pattern.matrix(pairs)
    if not np.all(np.isfinite(matrix.data)):
        raise SingularTangent("the tangent is not finite")
    try:
        with few_threads(len(pattern.free)), np.errstate(over="ignore", invalid="ignore"):
            return Factor(pattern, matrix, factorise(pattern.tree, pattern.entries(pairs), pattern.precision))
    except np.linalg.LinAlgError as error:
        raise SingularTangent(str(error)) from error


def remember(made, x):
    """Keep the ``Factor`` of a tangent at the nodal positions ``x`` (n, 2), or next to them, for `solve_near`.

    The oldest ones are forgotten where they fill too much memory together.
    """
    with _remembering:
        _remembered.append((made, np.asarray(x)))
        while len(_remembered) > 1 and sum(kept.size for kept, _ in _remembered) > REMEMBERED_BYTES:
            _remembered.popleft()


_remembering = threading.Lock()
_remembered = collections.deque()  # the latest factors, newest last; not kept by the patterns, which compiled programs keep alive


def solve_near(pattern, x, rhs, product, pairs):
    """Solution (f,) for a tangent at the nodal positions ``x`` (n, 2), with the remembered factor that is nearest if that will do.

    The factors of a differentiated sweep so serve its derivatives; the solution does not depend on which one was used. The tangent is
    given by its ``product`` with vectors (f,) and, where it must be factorised, by the pair blocks (n_pairs, 2, 2) that ``pairs()`` makes.
    NaN where it is singular: for use inside compiled programs, which cannot raise.
    """
    nearest = _nearest(pattern, x)
    solution = None if nearest is None else nearest.solve_other(rhs, product)
    if solution is None:
        try:
            made = factor(pattern, pairs())
            remember(made, x)
            solution = made.solve_other(rhs, product)
            solution = made.solve(rhs)[0] if solution is None else solution
        except SingularTangent:
            return np.full(np.shape(rhs), np.nan)
    return solution


def _nearest(pattern, x):
    """The remembered factor, the latest one, of the positions nearest ``x``; None without."""
    with _remembering:
        known = [(made, at) for made, at in reversed(_remembered) if made.pattern in (pattern, pattern.narrower)]
    nearest, least = None, np.inf
    for made, at in known:
        away = (at - x).ravel()
        if (distance := away @ away) < least:
            nearest, least = made, distance
        if not distance:
            break
    return nearest


def few_threads(unknowns):
    """Context in which BLAS uses one thread where the ``unknowns`` are few.

    A sweep stays within it: threads that are let go after every front or product wait for the next one by turning over a core each.
    """
    return _thread_pools().limit(limits=1, user_api="blas") if unknowns <= ONE_THREAD else contextlib.nullcontext()


@functools.cache
def _thread_pools():
    return ThreadpoolController()  # searching the loaded libraries takes milliseconds, so once
