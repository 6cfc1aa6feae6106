"""Sparse symmetric systems in a fixed pattern: analyse once, factor for each tangent, solve, count negative pivots.

The tangent is handed over as 2 x 2 blocks of node pairs (i <= j); a ``Pattern`` knows where they go in the matrix of the free degrees
of freedom. Factors are SciPy's SuperLU in symmetric mode: no row exchange, so that the signs of the pivots give the inertia
(Sylvester). Pivots too small for that are found by the residual of the solve, which is always checked.
"""

import collections
import dataclasses
import functools

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from threadpoolctl import ThreadpoolController

MAX_REFINEMENTS = 20
BACKWARD_ERROR = 1e-12  # largest of an accepted solution
REMEMBERED_BYTES = 2**29  # most that the factors kept for `solve_near` may fill, those of all patterns together
NEARNESS = 1e-2  # largest relative difference of two tangents of which one's factor refines the other's solutions


class SingularTangent(ArithmeticError):
    """The factorisation met a zero pivot, or its solutions do not solve: the tangent is singular to working precision."""


@dataclasses.dataclass(frozen=True, eq=False)
class Pattern:
    """Where the entries of node-pair blocks go in the free-free matrix; NumPy arrays, hashed by identity."""

    n_pairs: int
    """Number of node pairs i <= j."""
    free: np.ndarray
    """(f,) numbers of the free degrees of freedom, 2 node + component."""
    source: np.ndarray
    """(nnz,) entry of the flattened pair blocks (n_pairs, 2, 2) that each stored matrix entry takes, in permuted CSC order."""
    indices: np.ndarray
    """(nnz,) row numbers of the permuted CSC matrix."""
    indptr: np.ndarray
    """(f + 1,) column starts of the permuted CSC matrix."""
    order: np.ndarray
    """(f,) fill-reducing order: row k of the permuted matrix is free degree of freedom order[k]."""
    narrower: object = None
    """``Pattern`` of the first pairs alone, for tangents whose other blocks are zero; None without."""

    def fitting(self, pairs):
        """The narrower pattern where it holds all of the pair blocks (n_pairs, 2, 2), otherwise this one."""
        return self.narrower if self.narrower is not None and not np.any(np.asarray(pairs)[self.narrower.n_pairs :]) else self

    def matrix(self, pairs):
        """The permuted free-free matrix (f, f), CSC, from pair blocks (n_pairs, 2, 2)."""
        return sp.csc_matrix((np.asarray(pairs).reshape(-1)[self.source], self.indices, self.indptr), shape=(len(self.free),) * 2)


@dataclasses.dataclass(frozen=True, eq=False)
class Factor:
    """A factorised tangent."""

    pattern: Pattern
    """Its pattern."""
    matrix: sp.csc_matrix
    """The permuted matrix it was made from."""
    lu: object
    """SciPy's SuperLU object."""
    negative_pivots: int
    """Number of negative pivots = number of negative eigenvalues of the matrix."""

    def solve(self, rhs, matrix=None, *, refine=True):
        """Solution (f,) or (f, r) for the right-hand side, and its backward error |b - K x| / (|K| |x| + |b|).

        It is refined, against ``matrix`` where that is given in place of the factorised one, until the residual stops falling; without
        ``refine`` the first solution is taken where it will do for a Newton step. Raises ``SingularTangent`` where refinement does
        not converge, or to no better backward error than ``BACKWARD_ERROR`` and a residual of 1e-4 of the right-hand side.
        """
        matrix = self.matrix if matrix is None else matrix
        rhs = np.asarray(rhs)[self.pattern.order]
        with _one_thread(), np.errstate(over="ignore", invalid="ignore"):  # a diverging Newton iterate ends as a status
            solution, before, scale = self.lu.solve(rhs), np.inf, np.linalg.norm(rhs)
            for _ in range(MAX_REFINEMENTS):
                residual = rhs - matrix @ solution
                size = np.linalg.norm(residual)
                error = float(size / (self.norm * np.linalg.norm(solution) + scale + np.finfo(float).tiny))
                if not size < 0.5 * before or (not refine and error < BACKWARD_ERROR):
                    break
                solution, before = solution + self.lu.solve(residual), size
            else:
                error = np.inf
        if not (error < BACKWARD_ERROR and size <= 1e-4 * scale):
            raise SingularTangent(f"the linear solve left a backward error of {error:.1e}")
        unpermuted = np.empty_like(solution)
        unpermuted[self.pattern.order] = solution
        return unpermuted, error

    @property
    def size(self):
        """Bytes it fills: the triangular factors twice, as SuperLU keeps them and as SciPy hands them out, and the matrix."""
        return 24 * self.lu.nnz + 12 * self.matrix.nnz

    @functools.cached_property
    def norm(self):
        """Largest column sum of the matrix, an upper bound of its spectral norm."""
        return float(np.abs(self.matrix).sum(axis=0).max())


def analyse(pair_nodes, n_nodes, free):
    """``Pattern`` for node pairs (p, 2) with i <= j and free degrees of freedom (f,), with a fill-reducing order found once."""
    i, j = pair_nodes[:, 0], pair_nodes[:, 1]
    local = np.full(2 * n_nodes, -1)
    local[free] = np.arange(len(free))
    entry = np.arange(4 * len(i)).reshape(-1, 2, 2)
    rows = np.broadcast_to((2 * i[:, None] + np.arange(2))[:, :, None], entry.shape)
    columns = np.broadcast_to((2 * j[:, None] + np.arange(2))[:, None, :], entry.shape)
    lower = (i != j)[:, None, None] & np.ones((2, 2), dtype=bool)
    row = local[np.concatenate([rows.ravel(), columns[lower]])]
    column = local[np.concatenate([columns.ravel(), rows[lower]])]
    source = np.concatenate([entry.ravel(), entry[lower]])
    kept = (row >= 0) & (column >= 0)
    row, column, source = row[kept], column[kept], source[kept]

    order = _fill_reducing_order(row, column, len(free))
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    matrix = sp.csc_matrix((np.arange(len(row)) + 1.0, (rank[row], rank[column])), shape=(len(free),) * 2)
    matrix.sort_indices()
    return Pattern(len(i), free, source[matrix.data.astype(np.int64) - 1], matrix.indices, matrix.indptr, order)


def factor(pattern, pairs):
    """``Factor`` of the tangent given by pair blocks (n_pairs, 2, 2); raises ``SingularTangent``."""
    pattern = pattern.fitting(pairs)
    matrix = pattern.matrix(pairs)
    if not np.all(np.isfinite(matrix.data)):
        raise SingularTangent("the tangent is not finite")
    try:
        with _one_thread():
            lu = splu(
                matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, relax=10, panel_size=20, options=dict(SymmetricMode=True, Equil=False)
            )
    except RuntimeError as error:
        raise SingularTangent(str(error)) from error
    # SymmetricMode post-orders rows and columns alike; only then are the signs of diag U the inertia
    negative = int(np.sum(lu.U.diagonal() < 0)) if np.array_equal(lu.perm_r, lu.perm_c) else -1
    made = Factor(pattern, matrix, lu, negative)
    _remembered.append(made)
    while len(_remembered) > 1 and sum(kept.size for kept in _remembered) > REMEMBERED_BYTES:
        _remembered.popleft()
    return made


_remembered = collections.deque()  # the latest factors, newest last; not kept by the patterns, which compiled programs keep alive


def solve_near(pattern, pairs, rhs):
    """Solution (f,) or (f, r) for the tangent given by pair blocks (n_pairs, 2, 2), with a remembered factor where one is near.

    The factors of a sweep so serve its derivatives: the solution is refined against the given tangent, so it does not depend on
    which factor was used. NaN where the tangent is singular: for use inside compiled programs, which cannot raise.
    """
    pattern = pattern.fitting(pairs)
    matrix = pattern.matrix(pairs)
    try:
        nearest = _nearest(pattern, matrix)
        if nearest is not None:
            try:
                return nearest.solve(rhs, matrix)[0]
            except SingularTangent:
                pass
        return factor(pattern, pairs).solve(rhs)[0]
    except SingularTangent:
        return np.full(np.shape(rhs), np.nan)


def _nearest(pattern, matrix):
    """The remembered factor whose tangent differs least from ``matrix``, or None; judged by a sample of the entries."""
    sample = slice(None, None, max(1, matrix.nnz // 4096))
    wanted = matrix.data[sample]
    scale = np.linalg.norm(wanted)
    known = [made for made in _remembered if made.pattern is pattern]
    distance = [np.linalg.norm(made.matrix.data[sample] - wanted) for made in known]
    best = int(np.argmin(distance)) if distance else -1
    return known[best] if best >= 0 and distance[best] < NEARNESS * scale else None


def _one_thread():
    """Context in which BLAS uses one thread: several fight over fronts as small as these."""
    return _thread_pools().limit(limits=1, user_api="blas")


@functools.cache
def _thread_pools():
    return ThreadpoolController()  # searching the loaded libraries takes milliseconds, so once


def _fill_reducing_order(row, column, size):
    """SuperLU's minimum-degree order of a symmetric pattern, found on a positive definite matrix with that pattern."""
    values = np.where(row == column, 2.0 * size, -1.0)
    matrix = sp.csc_matrix((values, (row, column)), shape=(size, size))
    lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=dict(SymmetricMode=True, Equil=False))
    return np.argsort(lu.perm_c)
