"""Cholesky factors in compiled programs: the fronts of `multifrontal` as JAX functions.

The matrices are sparse. The host's factor has every inertia; this one is of a positive definite
matrix, and nan of any other.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jax import lax

from .._memo import once_per_owner
from .._types import Array, Bool, Float, Int
from .pattern import Pattern

Entries = tuple[Int[Array, " _"], Int[Array, " _"], Float[Array, " _"]]
"""Rows, columns and values of a sparse matrix."""
Factors = tuple[tuple[Float[Array, "..."], Float[Array, "..."]], ...]
"""Per front the corner L (k, k) and block B (m, k): the matrix is sum [L; B] [L; B]^T.

The corner is lower triangular, the block below it.
"""


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["entries", "below", "rows"],
    meta_fields=["children"],
)
@dataclasses.dataclass(frozen=True, eq=False)
class Columns:
    """The columns of a front, with k pivots and m unknowns below them; s = k + m."""

    entries: Int[Array, "s k"]
    """Number of the matrix entry at each place, of the lower triangle.

    Past the last entry for none.
    """
    below: Int[Array, " m"]
    """Ranks of the unknowns below, in the order of elimination."""
    rows: tuple[Int[Array, " s"], ...]
    """Per child the row of its update that is added at each place; past the last row for none."""
    children: tuple[int, ...]
    """Numbers of the fronts whose updates are added."""


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["order", "fronts", "joined"],
    meta_fields=["n_pairs", "n_entries"],
)
@dataclasses.dataclass(frozen=True, eq=False)
class Elimination:
    """How matrices of one `Pattern` are factorised; a pytree of index arrays."""

    order: Int[Array, " f"]
    """Unknown of each rank."""
    fronts: tuple[Columns, ...]
    """The fronts, children before parents; ranks of their pivots follow each other."""
    joined: Entries | None
    """The matrix ``Pattern.joined``."""
    n_pairs: int
    """Number of node pairs whose blocks are given."""
    n_entries: int
    """Number of entries that the fronts are made from."""

    @property
    def size(self) -> int:
        """Number f of unknowns."""
        return len(self.order)

    def cholesky(self, pairs: Float[Array, "p 2 2"]) -> Factors:
        """`Factors` of the matrix of the pair blocks (p, 2, 2); nan if not positive definite."""
        values, factors, updates = jnp.append(self._entries(pairs), 0.0), [], {}
        for number, front in enumerate(self.fronts):
            k, m = front.entries.shape[1], len(front.below)
            matrix = jnp.pad(values[front.entries], ((0, 0), (0, m)))
            for child, rows in zip(front.children, front.rows, strict=True):
                matrix += jnp.pad(updates.pop(child), (0, 1))[rows[:, None], rows]
            L, B, updates[number] = _eliminated(matrix[:k, :k], matrix[k:, :k], matrix[k:, k:])
            factors.append((L, B))
        return tuple(factors)

    def _entries(self, pairs):
        entries = pairs[: self.n_pairs].ravel()
        if self.joined is None:
            return entries
        row, column, value = self.joined
        return jnp.zeros(self.n_entries).at[row].add(value * entries[column])

    def solve(self, factors: Factors, rhs: Float[Array, " f"]) -> Float[Array, " f"]:
        """Solution (f,) for the right-hand side, without refinement."""
        y, ends = rhs[self.order], np.cumsum([len(L) for L, _ in factors])
        steps = [
            (slice(end - len(L), end), front.below, L, B)
            for end, front, (L, B) in zip(ends, self.fronts, factors, strict=True)
        ]
        for pivots, below, L, B in steps:
            z = _forward(L, y[pivots])
            y = y.at[pivots].set(z).at[below].add(-(B @ z))
        for pivots, below, L, B in reversed(steps):
            y = y.at[pivots].set(_backward(L, y[pivots] - y[below] @ B))
        return jnp.zeros(rhs.shape).at[self.order].set(y)


@dataclasses.dataclass(frozen=True, eq=False)
class BlockPattern:
    """The blocks of matrices that are block diagonal in another basis; hashed by identity."""

    fields: tuple[tuple[sp.csr_matrix, ...], ...]
    """For every block, per copy, the basis (f, b) of its coordinates."""
    patterns: tuple[Pattern, ...]
    """Where the entries of the matrix go in every block."""


@functools.partial(
    jax.tree_util.register_dataclass, data_fields=["fields", "blocks"], meta_fields=["size"]
)
@dataclasses.dataclass(frozen=True, eq=False)
class BlockElimination:
    """How matrices of one `BlockPattern` are factorised; a pytree of index arrays."""

    fields: tuple[tuple[Entries, ...], ...]
    """For every block, per copy, the basis (f, b)."""
    blocks: tuple[Elimination, ...]
    """That of every block."""
    size: int
    """Number f of unknowns."""

    def cholesky(self, pairs: Float[Array, "p 2 2"]) -> tuple[Factors, ...]:
        """`Factors` of the blocks of a matrix; nan if not positive definite."""
        return tuple(block.cholesky(pairs) for block in self.blocks)

    def solve(self, factors: tuple[Factors, ...], rhs: Float[Array, " f"]) -> Float[Array, " f"]:
        """Solution (f,) for the right-hand side, without refinement."""
        solution = jnp.zeros(rhs.shape)
        for copies, block, made in zip(self.fields, self.blocks, factors, strict=True):
            for row, column, value in copies:
                part = jnp.zeros(block.size).at[column].add(value * rhs[row])
                solution = solution.at[row].add(value * block.solve(made, part)[column])
        return solution


def is_definite(factors: Factors) -> Bool[Array, ""]:
    """Whether the factorised matrix is positive definite."""
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(L)) for L, _ in factors]))


# LAPACK's triangular solutions take one matrix; for many at once JAX 0.10 has code of XLA's own,
# which takes twice the time.


@jax.custom_batching.sequential_vmap
def _eliminated(corner, side, rest):
    """L and B of a front, and its update of the fronts above."""
    L = lax.linalg.cholesky(corner, symmetrize_input=False)
    B = lax.linalg.triangular_solve(L, side, left_side=False, lower=True, transpose_a=True)
    return L, B, rest - B @ B.T


@jax.custom_batching.sequential_vmap
def _forward(L, z):
    return lax.linalg.triangular_solve(L, z[:, None], left_side=True, lower=True)[:, 0]


@jax.custom_batching.sequential_vmap
def _backward(L, z):
    return lax.linalg.triangular_solve(L, z[:, None], left_side=True, lower=True, transpose_a=True)[
        :, 0
    ]


@once_per_owner
def elimination_of(pattern: Pattern) -> Elimination:
    """The `Elimination` of a ``Pattern``, of NumPy arrays."""
    tree, joined = pattern.tree, pattern.joined
    n_entries = 4 * pattern.n_pairs if joined is None else joined.shape[0]
    fronts = tuple(_columns(front, tree.fronts, n_entries) for front in tree.fronts)
    return Elimination(
        tree.order,
        fronts,
        None if joined is None else _entries(joined),
        pattern.n_pairs,
        n_entries,
    )


@once_per_owner
def block_elimination_of(pattern: BlockPattern) -> BlockElimination:
    """The `BlockElimination` of a ``BlockPattern``, of NumPy arrays."""
    fields = tuple(tuple(map(_entries, copies)) for copies in pattern.fields)
    size = pattern.fields[0][0].shape[0]
    return BlockElimination(fields, tuple(map(elimination_of, pattern.patterns)), size)


def _entries(matrix):
    matrix = matrix.tocoo()
    return matrix.row, matrix.col, matrix.data


def _columns(front, fronts, n_entries):
    """The `Columns` of one of the ``fronts``."""
    k, m = front.end - front.first, len(front.below)
    blocks = []
    for (source, place), height in ((front.corner, k), (front.side, m)):
        block = np.full(height * k, n_entries, np.int32)
        block[place] = source
        blocks.append(block.reshape(height, k, order="F"))
    rows = []
    for child, eliminated, runs in front.children:
        row = np.full(k + m, len(fronts[child].below), np.int32)
        for start, offset, part in ((0, 0, runs[0]), (k, eliminated, runs[1])):
            for source, target in part:
                row[start + target.start : start + target.stop] = (
                    np.arange(source.start, source.stop) + offset
                )
        rows.append(row)
    return Columns(
        np.concatenate(blocks),
        front.below,
        tuple(rows),
        tuple(child for child, *_ in front.children),
    )
