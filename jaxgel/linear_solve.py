"""Sparse symmetric systems in a fixed pattern: analyse once, factor for each tangent, solve, count negative pivots.

The tangent is handed over as 2 x 2 blocks of node pairs (i <= j); a ``Pattern`` knows where they go in the matrix of the free degrees
of freedom. Factors are SciPy's SuperLU in symmetric mode: no row exchange, so that the signs of the pivots give the inertia
(Sylvester). Pivots too small for that are found by the residual of the solve, which is always checked and refined.
"""

import dataclasses

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_limits

MAX_REFINEMENTS = 6


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

    def solve(self, rhs, matrix=None):
        """Solution (f,) or (f, r) for the right-hand side, and its relative residual; refined against ``matrix`` where given.

        Raises ``SingularTangent`` where refinement does not bring the residual below 1e-8 of the right-hand side.
        """
        matrix = self.matrix if matrix is None else matrix
        rhs = np.asarray(rhs)[self.pattern.order]
        scale = np.linalg.norm(rhs)
        if scale == 0.0:
            return np.zeros_like(rhs), 0.0
        with threadpool_limits(1, user_api="blas"):
            solution, error = self.lu.solve(rhs), np.inf
            for _ in range(MAX_REFINEMENTS):
                residual = rhs - matrix @ solution
                previous, error = error, np.linalg.norm(residual) / scale
                if error < 1e-13 or not error < 0.5 * previous:
                    break
                solution = solution + self.lu.solve(residual)
        if not error < 1e-8:
            raise SingularTangent(f"the linear solve left a relative residual of {error:.1e}")
        unpermuted = np.empty_like(solution)
        unpermuted[self.pattern.order] = solution
        return unpermuted, float(error)


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
    matrix = pattern.matrix(pairs)
    if not np.all(np.isfinite(matrix.data)):
        raise SingularTangent("the tangent is not finite")
    try:
        with threadpool_limits(1, user_api="blas"):
            lu = splu(
                matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, relax=10, panel_size=20, options=dict(SymmetricMode=True, Equil=False)
            )
    except RuntimeError as error:
        raise SingularTangent(str(error)) from error
    # SymmetricMode post-orders rows and columns alike; only then are the signs of diag U the inertia
    negative = int(np.sum(lu.U.diagonal() < 0)) if np.array_equal(lu.perm_r, lu.perm_c) else -1
    return Factor(pattern, matrix, lu, negative)


def _fill_reducing_order(row, column, size):
    """SuperLU's minimum-degree order of a symmetric pattern, found on a positive definite matrix with that pattern."""
    values = np.where(row == column, 2.0 * size, -1.0)
    matrix = sp.csc_matrix((values, (row, column)), shape=(size, size))
    lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=dict(SymmetricMode=True, Equil=False))
    return np.argsort(lu.perm_c)
