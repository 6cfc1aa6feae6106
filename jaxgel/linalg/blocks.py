"""Block diagonal matrices: factors of the blocks, also after a change of basis."""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from .._types import Float, Int
from .factors import Columns, Factor

# part of a right-hand side in a block that is round-off: shape functions leave 4e-14
NEGLIGIBLE = 1e-12


@dataclasses.dataclass(frozen=True, eq=False)
class Diagonal:
    """A block diagonal matrix (b, b), with what eigenvalues need of a `Factor`."""

    factors: tuple[Factor, ...]
    """The factor of every block."""
    cuts: Int[np.ndarray, " _"]
    """Where the coordinates of each block begin, and where the last ones end."""

    @property
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues."""
        return sum(made.negative_pivots for made in self.factors)

    @functools.cached_property
    def matrix(self) -> sp.csc_matrix:
        """The matrix (b, b) itself."""
        return sp.block_diag([made.matrix for made in self.factors], format="csc")

    def apply(self, rhs: Columns) -> Columns:
        """See `Factor.apply`."""
        return self._by_block(rhs, Factor.apply)

    def product(self, vectors: Columns) -> Columns:
        """Products (b,) or (b, r) with vectors."""
        return self._by_block(vectors, Factor.product)

    def _by_block(self, values, function):
        parts = zip(self.factors, self.cuts[:-1], self.cuts[1:], strict=True)
        return np.concatenate([function(made, values[start:end]) for made, start, end in parts])


@dataclasses.dataclass(frozen=True, eq=False)
class BlockFactor:
    """A factorised matrix (f, f), block diagonal in another basis, with repeated blocks."""

    fields: tuple[tuple[sp.csr_matrix, ...], ...]
    """For every block, per copy, the basis (f, b) of its coordinates."""
    factors: tuple[Factor, ...]
    """The factor of every block."""

    @property
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues."""
        pairs = zip(self.fields, self.factors, strict=True)
        return sum(made.negative_pivots * len(copies) for copies, made in pairs)

    @property
    def size(self) -> int:
        """Bytes it fills."""
        return sum(made.size for made in self.factors)

    def apply(self, rhs: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
        """See `Factor.apply`; a block that the right-hand side does not excite is left out."""
        return self._by_block(rhs, Factor.apply)

    def accurate(self, rhs: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
        """See `Factor.accurate`."""
        return self._by_block(rhs, Factor.accurate)

    def _by_block(self, rhs: Float[np.ndarray, " f"], solve: Callable) -> Float[np.ndarray, " f"]:
        solution, size = np.zeros(len(rhs)), np.linalg.norm(rhs)
        for copies, made in zip(self.fields, self.factors, strict=True):
            for fields in copies:
                part = fields.T @ rhs
                if np.linalg.norm(part) > NEGLIGIBLE * size:
                    solution += fields @ solve(made, part)
        return solution
