"""The tangent of a symmetric state as the factors of its blocks."""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from .._types import Array, Float, Int
from ..linalg import Factor, Pattern, columnwise, solve_near_factor
from ..symmetry import Basis

Columns = Float[Array, " b"] | Float[Array, "b r"]

NEGLIGIBLE = 1e-12  # part of a right-hand side in a block that is round-off: that of shape functions leaves 4e-14


@dataclasses.dataclass(frozen=True, eq=False)
class Diagonal:
    """The blocks of a tangent, one copy of each, as one factorised matrix (b, b), with what eigenvalues need of a ``linalg.Factor``."""

    factors: tuple[Factor, ...]
    """The factor of every block."""
    cuts: Int[np.ndarray, " _"]
    """Where the coordinates of each block begin, and where the last ones end."""

    @property
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues of the matrix."""
        return sum(made.negative_pivots for made in self.factors)

    @functools.cached_property
    def matrix(self) -> sp.csc_matrix:
        """The matrix (b, b) itself."""
        return sp.block_diag([made.matrix for made in self.factors], format="csc")

    def apply(self, rhs: Columns) -> Columns:
        """Solution (b,) or (b, r) for the right-hand side, without refinement."""
        return self._by_block(rhs, Factor.apply)

    def inverse(self, rhs: Columns) -> Columns:
        """Solution (b,) or (b, r) as accurate as that of a factor in double precision."""
        return self._by_block(rhs, Factor.inverse)

    def product(self, vectors: Columns) -> Columns:
        """Products of the matrix, with what is condensed in it, with vectors."""
        return self._by_block(vectors, lambda made, part: columnwise(made.product, part))

    def _by_block(self, values, function):
        parts = zip(self.factors, self.cuts[:-1], self.cuts[1:], strict=True)
        return np.concatenate([function(made, values[start:end]) for made, start, end in parts])


@dataclasses.dataclass(frozen=True, eq=False)
class BlockFactor:
    """A factorised tangent of the whole plate at a symmetric state, as the factors of its blocks.

    It has of a ``linalg.Factor`` what derivatives and predictions need.
    """

    pattern_of_plate: Callable[[], Pattern]
    """Makes the pattern of the whole tangent, for which there often is no need; it holds no model, as factors are kept."""
    bases: tuple[Basis, ...]
    """The `Basis` of every block."""
    factors: tuple[Factor, ...]
    """The factor of every block."""
    pressure: Float[np.ndarray, " g"]
    """Pressures of the state whose tangent it is, kT/v."""

    @property
    def pattern(self) -> Pattern:
        """The pattern of the whole tangent."""
        return self.pattern_of_plate()

    @property
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues of the whole tangent."""
        return sum(made.negative_pivots * basis.representation.copies for basis, made in zip(self.bases, self.factors, strict=True))

    @property
    def size(self) -> int:
        """Bytes it fills."""
        return sum(made.size for made in self.factors)

    def is_of(self, pressure: Float[Array, " g"]) -> bool:
        """Whether it is of the very tangent of a state with this ``pressure``, at the positions with which it is kept."""
        return np.array_equal(self.pressure, pressure)

    def apply(self, rhs: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
        """Solution (f,) for the right-hand side, block by block, without refinement; a block that it does not excite is left out."""
        return self._by_block(rhs, Factor.apply)

    def inverse(self, rhs: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
        """The same, as accurate as that of a factor in double precision."""
        return self._by_block(rhs, Factor.inverse)

    def _by_block(self, rhs, solve):
        solution, size = np.zeros(len(rhs)), np.linalg.norm(rhs)
        for basis, made in zip(self.bases, self.factors, strict=True):
            for fields in basis.fields:
                part = fields.T @ rhs
                if np.linalg.norm(part) > NEGLIGIBLE * size:
                    solution += fields @ solve(made, part)
        return solution

    def solve_other(self, rhs: Float[np.ndarray, " f"], product: Callable[[np.ndarray], np.ndarray]) -> Float[np.ndarray, " f"] | None:
        """Solution (f,) for another matrix, see ``linalg.solve_near_factor``."""
        return solve_near_factor(rhs, product, self.apply)
