"""Sizes of the arrays that compiled programs take.

A program serves arrays of one size only, and what a plate needs is compiled again for every other number of nodes or points. So arrays are
padded to a ladder of sizes, inertly, and what comes out is cut: plates of similar size share their programs. Arrays of numbers are padded
and cut by NumPy, those of traces by two small programs.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ._tracing import is_traced
from ._types import Array


def rung(count: int, steps: int = 2) -> int:
    """Least size that holds ``count``: of 1, 2, ... ``steps``, and from there on of ``steps`` equal parts of every doubling.

    >>> [rung(n) for n in (1, 5, 7, 900, 1100)], rung(900, steps=4)
    ([1, 6, 8, 1024, 1536], 1024)
    """
    part = 1
    while steps * 2 * part < count:
        part *= 2
    return count if count <= steps else -(-count // part) * part


def padded(values: Array, count: int) -> Any:
    """``count`` rows: those of the values, and the last one again."""
    if count == len(values):
        return values
    if is_traced(values):
        return _padded(values, count)
    values = np.asarray(values)
    return values[np.minimum(np.arange(count), len(values) - 1)]


def cut(values: Any, shapes: Any) -> Any:
    """The first corner of each array of a pytree, of the shape that stands at its place in the flat tuple ``shapes``."""
    leaves, structure = jax.tree.flatten(values)
    if is_traced(leaves):
        return jax.tree.unflatten(structure, _cut(leaves, shapes))
    corners = [np.asarray(leaf)[tuple(map(slice, shape))] for leaf, shape in zip(leaves, shapes, strict=True)]
    return jax.tree.unflatten(structure, jax.device_put(corners))


def at_numbers(program: Callable[..., Array], owner: Any, rows: np.ndarray) -> np.ndarray:
    """Values, NumPy, of ``program(owner, rows)``, which maps each row to one, at rows that are numbers; also inside traces."""
    with jax.ensure_compile_time_eval():
        return np.asarray(program(owner, padded(rows, rung(len(rows)))))[: len(rows)]


@functools.partial(jax.jit, static_argnames="count")
def _padded(values, count):
    return values[jnp.minimum(jnp.arange(count), len(values) - 1)]


@functools.partial(jax.jit, static_argnames="shapes")
def _cut(leaves, shapes):
    return [leaf[tuple(map(slice, shape))] for leaf, shape in zip(leaves, shapes, strict=True)]
