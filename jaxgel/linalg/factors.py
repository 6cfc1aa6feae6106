"""Sparse symmetric systems in a fixed pattern: analyse, factor, solve, count pivots.

Analysed once, factored for each tangent; negative pivots are counted. The tangent is handed over as
2 x 2 blocks of node pairs (i <= j); a ``Pattern`` has their positions in the matrix of the free
degrees of freedom. Factors are ``multifrontal``; the residual of every solution is checked, which
finds the tangents that are singular to working precision. A `Bordered` matrix is not symmetric and
has LU factors.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from .._threads import few_threads
from .._types import Array, Float, Int
from .multifrontal import Fronts, factorise
from .pattern import Pattern

Columns = Float[Array, " f"] | Float[Array, "f r"]

MAX_REFINEMENTS = 20
BACKWARD_ERROR = 1e-12  # largest of an accepted solution
ENOUGH = 1e-15  # backward error of a solution that Newton's method takes without refinement
# of a bordered matrix: a pivot below this share of its column's largest entry leaves the order of
# least fill
PIVOTING = 1e-3
# of a matrix whose entries are looked at together, lest a copy of it all be made
COLUMNS_TOGETHER = 20_000


class SingularTangent(ArithmeticError):
    """Zero pivot, or a wrong solution: the tangent is singular to working precision."""


@dataclasses.dataclass(frozen=True, eq=False)
class Factor:
    """A factorised tangent."""

    pattern: Pattern
    """Its pattern."""
    matrix: sp.csc_matrix
    """The free-free matrix it was made from."""
    fronts: Fronts
    """Its triangular factors, front by front."""

    @property
    def negative_pivots(self) -> int:
        """Number of negative pivots = number of negative eigenvalues of the tangent."""
        return self.fronts.negative_pivots

    def product(self, vectors: Columns) -> Columns:
        """Products (f,) or (f, r) of the tangent with vectors."""
        return columnwise(self.matrix.dot, vectors)

    def apply(self, rhs: Columns) -> Columns:
        """Solution (f,) or (f, r) without refinement or check: sufficient for an increment."""
        with few_threads(self.pattern.size):
            return self.fronts.solve(rhs)

    def accurate(self, rhs: Columns) -> Columns:
        """Solution of `solve`; raises ``SingularTangent``."""
        return self.solve(rhs)[0]

    def solve(self, rhs: Columns, *, refine: bool = True) -> tuple[Columns, float]:
        """Solution (f,) or (f, r), and its backward error |b - K x| / (|K| |x| + |b|).

        It is refined until the corrections stop shrinking: in soft modes the residual tells
        nothing. Without ``refine`` the first solution is taken if it will do for a Newton step.
        Raises ``SingularTangent`` if refinement does not converge, or to no better backward error
        than ``BACKWARD_ERROR`` and a residual of 1e-4 of the right-hand side.
        """
        rhs = np.asarray(rhs)
        # a diverging Newton iterate ends as a status
        with np.errstate(over="ignore", invalid="ignore"):
            solution, before, scale = self.apply(rhs), np.inf, np.linalg.norm(rhs)
            for _ in range(MAX_REFINEMENTS):
                residual, norm = rhs - self.product(solution), np.linalg.norm(solution)
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

    @functools.cached_property
    def size(self) -> int:
        """Bytes it fills: the fronts and the matrix."""
        return self.fronts.size + 8 * self.matrix.nnz

    @functools.cached_property
    def norm(self) -> float:
        """Largest column sum of the matrix, an upper bound of its spectral norm."""
        data, first = self.matrix.data, self.matrix.indptr[:-1]
        starts = np.split(first, range(COLUMNS_TOGETHER, len(first), COLUMNS_TOGETHER))
        stops = [*(start[0] for start in starts[1:]), len(data)]
        sums = (
            np.add.reduceat(np.abs(data[a[0] : b]), a - a[0]).max()
            for a, b in zip(starts, stops, strict=True)
        )
        return float(max(sums))


def columnwise(
    function: Callable[[np.ndarray], Any], vectors: Columns
) -> Float[np.ndarray, " g"] | Float[np.ndarray, "g m"]:
    """Values (g,) or (g, m) of a linear ``function`` of each column of ``vectors``.

    These are (f,) or (f, m). For products of sparse matrices that takes half as long as SciPy's
    with all columns at once.
    """
    return (
        function(vectors)
        if vectors.ndim == 1
        else np.stack([function(vector) for vector in vectors.T], axis=1)
    )


def factor(pattern: Pattern, pairs: Float[Array, "p 2 2"]) -> Factor:
    """``Factor`` of the tangent given by pair blocks (n_pairs, 2, 2).

    Raises ``SingularTangent``.
    """
    entries = pattern.entries(pairs)
    matrix = pattern.matrix_of(entries)
    if not np.all(np.isfinite(matrix.data)):
        raise SingularTangent("the tangent is not finite")
    try:
        with few_threads(pattern.size), np.errstate(over="ignore", invalid="ignore"):
            return Factor(pattern, matrix, factorise(pattern.tree, entries))
    except np.linalg.LinAlgError as error:
        raise SingularTangent(str(error)) from error


class Bordered:
    """Factor of [[K, sides], [rows^T, corner]] in ``order`` if pivots allow; SingularTangent.

    K is the ``matrix`` (f, f).
    """

    def __init__(
        self,
        order: Int[np.ndarray, " f"],
        matrix: sp.csc_matrix,
        sides: Float[np.ndarray, "f b"],
        rows: Float[np.ndarray, "f b"],
        corner: Float[np.ndarray, "b b"],
    ) -> None:
        self.order = order
        self.matrix = sp.block_array(
            [[matrix[order][:, order], sides[order]], [rows[order].T, corner]], format="csc"
        )
        try:
            self.lu = splu(
                self.matrix,
                permc_spec="NATURAL",
                diag_pivot_thresh=PIVOTING,
                options=dict(Equil=False),
            )
        except RuntimeError as error:
            raise SingularTangent(str(error)) from error

    def solve(self, upper: np.ndarray, lower: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solution (f,) and (b,) for right-hand sides (f,) and (b,), refined twice."""
        rhs = np.concatenate([upper[self.order], lower])
        solution = self.lu.solve(rhs)
        for _ in range(2):
            solution += self.lu.solve(rhs - self.matrix @ solution)
        x = np.empty(len(upper))
        x[self.order] = solution[: len(upper)]
        return x, solution[len(upper) :]

    @classmethod
    def of(
        cls,
        factor: Factor,
        sides: Float[np.ndarray, "f b"],
        rows: Float[np.ndarray, "f b"],
        corner: Float[np.ndarray, "b b"],
    ) -> "Bordered":
        """That of a factorised tangent."""
        return cls(factor.pattern.tree.order, factor.matrix, sides, rows, corner)
