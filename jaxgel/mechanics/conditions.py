"""Essential conditions as one sparse matrix C: homogeneous nodal fields are C v.

Degrees of freedom are numbered 2 node + component. The unknowns v (f,) of a plate are those of its
free nodes; with periodic edges or symmetries one unknown moves several degrees of freedom, with
either sign, and free components of the macroscopic deformation of a periodic cell are further
unknowns. So nodal fields are C v, forces on the unknowns C^T F and the tangent is C^T K C.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from .._sizes import NODES, resized, room
from .._tracing import is_traced
from .._types import Array, Bool, Float, Int

Entries = tuple[Int[Array, " _"], Int[Array, " _"], Float[Array, " _"]]
"""Rows, columns and values of a sparse matrix."""


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["masters", "fields", "readings"],
    meta_fields=["size"],
)
@dataclasses.dataclass(frozen=True, eq=False)
class Free:
    """The unknowns of a plate; a pytree. The macroscopic ones are the last."""

    masters: Int[Array, " f"]
    """Degree of freedom that stands for each unknown.

    Those of macroscopic ones are numbered on from ``size``.
    """
    fields: Entries
    """The matrix C (2n, f)."""
    readings: Entries
    """A left inverse (f, 2n) of C, by values at the masters."""
    size: int
    """Number 2n of degrees of freedom."""

    def __len__(self) -> int:
        return self.masters.shape[0]

    @staticmethod
    def of(
        masters: Int[np.ndarray, " f"], fields: sp.csr_matrix, readings: sp.csr_matrix
    ) -> "Free":
        """The unknowns with these ``masters``, C (2n, f) and left inverse (f, 2n)."""
        size, macroscopic = fields.shape[0], masters >= fields.shape[0]
        return Free(
            np.where(macroscopic, size - 1 + np.cumsum(macroscopic), masters),
            _entries(fields),
            _entries(readings),
            size,
        )

    @property
    def matrix(self) -> sp.csr_matrix:
        """C (2n, f)."""
        return _matrix(self.fields, (self.size, len(self)))

    @property
    def left_inverse(self) -> sp.csr_matrix:
        """The left inverse (f, 2n) of C."""
        return _matrix(self.readings, (len(self), self.size))

    @property
    def n_macroscopic(self) -> int:
        """Number of macroscopic unknowns."""
        return int(np.sum(np.asarray(self.masters) >= self.size))

    @property
    def held(self) -> Bool[np.ndarray, " d"]:
        """Which degrees of freedom (2n,) no unknown moves, but for macroscopic ones."""
        return self.matrix[:, : len(self) - self.n_macroscopic].getnnz(axis=1) == 0

    def reduced(self, basis: sp.csr_matrix, leaders: Int[np.ndarray, " b"]) -> "Free":
        """Unknowns (b,) that move those of the plate as the columns of a ``basis`` (f, b) do.

        Its rows ``leaders`` are the unit matrix.
        """
        return Free.of(
            np.asarray(self.masters)[leaders], self.matrix @ basis, self.left_inverse[leaders]
        )

    @property
    def shared(self) -> "Free":
        """The same with room for more nodes and unknowns, which move nothing."""
        nodes = room(self.size // 2, NODES)
        macroscopic = self.masters - self.size
        masters = resized(
            np.where(macroscopic >= 0, 2 * nodes + macroscopic, self.masters),
            (2 * nodes,),
            edge=True,
        )
        return Free(
            masters, _with_room(self.fields, nodes), _with_room(self.readings, nodes), 2 * nodes
        )


def _with_room(entries, nodes):
    """Entries of a sparse matrix, and zeros at the place of the last one, for so many nodes."""
    row, column, value = entries
    size = room(len(value), 2 * nodes)
    return (
        resized(row, (size,), edge=True),
        resized(column, (size,), edge=True),
        resized(value, (size,)),
    )


def _entries(matrix):
    """`Entries` of a sparse matrix."""
    matrix = matrix.tocoo()
    return matrix.row, matrix.col, matrix.data


def _matrix(entries, shape):
    row, column, value = map(np.asarray, entries)
    return sp.csr_matrix((value, (row, column)), shape=shape)


def _product(entries, vector, size):
    """Product (size,) of a sparse matrix with a vector; of numbers by NumPy."""
    row, column, value = entries
    if is_traced(entries, vector):
        return jnp.zeros(size).at[row].add(value * vector[column])
    return np.bincount(row, np.asarray(value) * np.asarray(vector)[column], minlength=size)


def gather(forces: Float[Array, "n 2"], free: Free) -> Float[Array, " f"]:
    """Generalised forces C^T F (f,) on the unknowns for nodal forces F (n, 2)."""
    row, column, value = free.fields
    return _product((column, row, value), forces.ravel(), len(free))


def scatter(vector: Float[Array, " f"], free: Free) -> Float[Array, "n 2"]:
    """Nodal field C v (n, 2) of a vector v (f,) of the unknowns, zero if nothing is free."""
    return _product(free.fields, vector, free.size).reshape(-1, 2)


def restrict(field: Float[Array, "n 2"], free: Free) -> Float[Array, " f"]:
    """Values (f,) of the unknowns in a nodal field (n, 2), at the master degrees of freedom."""
    return _product(free.readings, field.ravel(), len(free))


def with_free_values(
    values: Float[Array, " f"], positions: Float[Array, "n 2"], free: Free
) -> Float[Array, "n 2"]:
    """Nodal positions (n, 2) with unknowns ``values`` (f,), the rest as in ``positions`` (n, 2).

    These satisfy the conditions.
    """
    return positions + scatter(values - restrict(positions, free), free)


def constrained_part(field: Float[Array, "n 2"], free: Free) -> Float[Array, "n 2"]:
    """Prescribed part of a nodal field (n, 2): the field less that of its unknowns."""
    return field - scatter(restrict(field, free), free)
