"""Sizes of the arrays that compiled programs take.

A program serves arrays of one size only, and what a plate needs is compiled again for every other
number of nodes or points. So arrays are padded to a ladder of sizes, inertly, and what comes out is
cut: plates of similar size share their programs. Padding, cutting, picking rows and multiplying by
sparse matrices are linear maps that NumPy computes, also inside derivatives, so that nothing is
compiled for them.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from ._primitives import primitive
from ._tracing import is_traced, outside_traces
from ._types import Array, Float, Int

NODES = 768  # times a power of 2 there is room for nodes
MANY = 1024  # and times a power of 2 for volume groups and others
ROWS = 2048  # times a power of 2 rows are evaluated together if each takes little time


def rung(count: int, steps: int = 2) -> int:
    """Least size that holds ``count``: of 1, 2, ...

    ``steps``, and from there on of ``steps`` equal parts of every doubling.

    >>> [rung(n) for n in (1, 5, 7, 900, 1100)], rung(900, steps=4)
    ([1, 6, 8, 1024, 1536], 1024)
    """
    part = 1
    while steps * 2 * part < count:
        part *= 2
    return count if count <= steps else -(-count // part) * part


def room(count: int, least: int | None = None) -> int:
    """The ``least`` room, ``MANY`` by default, times a power of 2: what holds ``count``."""
    least = MANY if least is None else least
    return least * rung(-(-count // least), 1)


def step(count: int, sizes: tuple[int, ...]) -> int:
    """Least of the ascending ``sizes`` that holds ``count``; beyond them a `rung`.

    Each doubling has 4 of these.
    """
    return next((size for size in sizes if size >= count), rung(count, 4))


def padded(values: Array, count: int) -> Any:
    """``count`` rows: those of the values, and the last one again."""
    return resized(values, (count, *values.shape[1:]), edge=True)


def resized(values: Array, shape: tuple[int, ...], *, edge: bool = False) -> Any:
    """An array of another ``shape`` with the same first corner, cut or padded with zeros.

    With ``edge`` the last values are repeated instead, and what is cut off is added to the last
    that stays. Both are linear, and the reverse of either is the same back to the shape of the
    values.
    """
    if values.shape == shape:
        return values
    sizes = {"own": values.shape, "shape": tuple(shape), "edge": edge}
    return _resized.bind(values, **sizes) if is_traced(values) else _resize(values, **sizes)


def taken(values: Array, numbers: Int[np.ndarray, "..."]) -> Any:
    """The rows of an array with these ``numbers``."""
    return (
        _taken.bind(values, rows=_Rows(numbers, len(values)))
        if is_traced(values)
        else np.asarray(values)[numbers]
    )


def joined(parts: list[Array]) -> Any:
    """The rows of several arrays, one after the other."""
    return (
        _joined.bind(*parts, counts=tuple(map(len, parts)))
        if is_traced(parts)
        else np.concatenate(parts)
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Matrices:
    """A sparse matrix (p, q) for each column of an array; hashed by identity."""

    columns: tuple[sp.sparray, ...]
    """The matrices."""

    @functools.cached_property
    def transposed(self) -> "Matrices":
        """The transposed matrices."""
        made = Matrices(tuple(matrix.T for matrix in self.columns))  # views
        made.__dict__["transposed"] = self
        return made


def multiplied(values: Float[Array, "q k"], matrices: Matrices) -> Any:
    """The products (p, k) of the ``matrices``, one for each column of the ``values``."""
    return (
        _multiplied.bind(values, matrices=matrices)
        if is_traced(values)
        else _multiply(values, matrices=matrices)
    )


def at_numbers(program: Callable[..., Array], owner: Any, rows: np.ndarray) -> np.ndarray:
    """Values, NumPy, of ``program(owner, rows)`` at concrete rows; also inside traces.

    It maps each row to one.
    """
    with outside_traces():
        return np.asarray(program(owner, padded(rows, ROWS * rung(-(-len(rows) // ROWS), 1))))[
            : len(rows)
        ]


# --- the linear maps ------------------------------------------------------------------------------


def _resize(values, *, own, shape, edge):
    values = np.asarray(values)
    for axis, (before, after) in enumerate(zip(own, shape, strict=True)):
        if before > after:
            first = (slice(None),) * axis
            rest, values = values[*first, after:], values[*first, :after]
            if edge:
                values = values.copy()
                values[*first, -1] += rest.sum(axis=axis)
    if values.shape == shape:
        return values
    grown = np.zeros(shape, values.dtype)
    grown[*map(slice, values.shape)] = values
    if edge:
        for axis, before in enumerate(values.shape):
            first = (slice(None),) * axis
            grown[*first, before:] = grown[*first, before - 1 : before]
    return grown


def _resize_by_jax(values, *, own, shape, edge):
    for axis, (before, after) in enumerate(zip(own, shape, strict=True)):
        first = (slice(None),) * axis
        if before < after:
            ends = [(0, after - before if k == axis else 0) for k in range(len(shape))]
            values = jnp.pad(values, ends, mode="edge" if edge else "constant")
        elif before > after:
            rest, values = values[*first, after:], values[*first, :after]
            values = values.at[*first, -1].add(rest.sum(axis=axis)) if edge else values
    return values


@dataclasses.dataclass(frozen=True, eq=False)
class _Rows:
    """Which rows are taken; hashed by identity."""

    numbers: Int[np.ndarray, "..."]
    """Their numbers."""
    count: int
    """Number of rows there are."""


def _take(values, *, rows):
    return np.asarray(values)[rows.numbers]


def _add(values, *, rows):
    width = math.prod(values.shape[rows.numbers.ndim :])  # not -1, which no rows leave open
    columns, numbers = np.asarray(values).reshape(rows.numbers.size, width).T, rows.numbers.ravel()
    # whole numbers of no rows
    sums = [np.bincount(numbers, column, minlength=rows.count).astype(float) for column in columns]
    return np.stack(sums, axis=1).reshape(rows.count, *values.shape[rows.numbers.ndim :])


def _linear(name, by_numpy, by_jax, shape, reverse):
    """The primitive of a linear map of an array: ``shape(own, **sizes)`` is that of its values."""

    def jvp(args, dots, **sizes):
        (values,), (dot,) = args, dots
        return made.bind(values, **sizes), None if dot is None else made.bind(dot, **sizes)

    def transpose(cotangent, _, **sizes):
        return [None if cotangent is None else reverse(cotangent, **sizes)]

    def batch(args, axes, **sizes):
        return jax.vmap(functools.partial(by_jax, **sizes), axes)(*args), 0

    made = primitive(
        name,
        value=lambda values, **sizes: jax.device_put(by_numpy(values, **sizes)),
        traced=by_jax,
        shapes=lambda values, **sizes: values.update(shape=shape(values.shape, **sizes)),
        jvp=jvp,
        transpose=transpose,
        batch=batch,
        several=False,
    )
    return made


_resized = _linear(
    "resized",
    _resize,
    _resize_by_jax,
    lambda _, shape, **__: shape,
    lambda cotangent, own, shape, edge: _resized.bind(cotangent, own=shape, shape=own, edge=edge),
)
_taken = _linear(
    "taken",
    _take,
    lambda values, rows: values[rows.numbers],
    lambda own, rows: (*rows.numbers.shape, *own[1:]),
    lambda cotangent, rows: _added.bind(cotangent, rows=rows),
)
_added = _linear(
    "added",
    _add,
    lambda values, rows: (
        jnp.zeros((rows.count, *values.shape[rows.numbers.ndim :])).at[rows.numbers].add(values)
    ),
    lambda own, rows: (rows.count, *own[rows.numbers.ndim :]),
    lambda cotangent, rows: _taken.bind(cotangent, rows=rows),
)


def _multiply(values, *, matrices):
    return np.stack(
        [
            matrix @ column
            for matrix, column in zip(matrices.columns, np.asarray(values).T, strict=True)
        ],
        axis=1,
    )


def _multiply_by_jax(values, *, matrices):
    entries = [matrix.tocoo() for matrix in matrices.columns]
    sums = [
        jnp.zeros(m.shape[0]).at[m.row].add(m.data * column[m.col])
        for m, column in zip(entries, values.T, strict=True)
    ]
    return jnp.stack(sums, axis=1)


_multiplied = _linear(
    "multiplied",
    _multiply,
    _multiply_by_jax,
    lambda own, matrices: (matrices.columns[0].shape[0], *own[1:]),
    lambda cotangent, matrices: _multiplied.bind(cotangent, matrices=matrices.transposed),
)


def _join_jvp(parts, dots, *, counts):
    dots = [
        np.zeros(part.shape, part.dtype) if dot is None else dot
        for part, dot in zip(parts, dots, strict=True)
    ]
    return _joined.bind(*parts, counts=counts), _joined.bind(*dots, counts=counts)


def _join_transpose(cotangent, _, *, counts):
    ends = np.cumsum([0, *counts])
    return [
        None if cotangent is None else taken(cotangent, np.arange(first, end))
        for first, end in itertools.pairwise(ends)
    ]


def _join_batch(parts, axes, **_):
    size = next(
        part.shape[axis] for part, axis in zip(parts, axes, strict=True) if axis is not None
    )
    moved = [
        jnp.repeat(p[None], size, axis=0) if a is None else jnp.moveaxis(p, a, 0)
        for p, a in zip(parts, axes, strict=True)
    ]
    return jnp.concatenate(moved, axis=1), 0


_joined = primitive(
    "joined",
    value=lambda *parts, **_: jax.device_put(np.concatenate(parts)),
    traced=lambda *parts, **_: jnp.concatenate(parts),
    shapes=lambda first, *_, counts: first.update(shape=(sum(counts), *first.shape[1:])),
    jvp=_join_jvp,
    transpose=_join_transpose,
    batch=_join_batch,
    several=False,
)
