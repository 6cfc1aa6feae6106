"""Functions of patches, mapped over a block or summed, without its padding.

The leading axis of arrays and results is that of the patches; numbers among the arrays are the same
for all.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from .._types import Array, Int

TOGETHER = 4  # patches: few enough to stay in the processor's cache


def over_patches(
    function: Callable[..., Any],
    arrays: tuple,
    count: Int[Array, ""] | None,
    *,
    reverse: bool = True,
) -> Any:
    """``function(*arrays)`` of the first ``count`` patches, and 0 for the others.

    Of all of them at once without a count. Without a ``reverse`` derivative it takes two thirds of
    the time.
    """
    if count is None:
        return function(*arrays)
    leaves, of_leaves = _mapped(function, arrays)
    if reverse:
        return _in_reversible_steps(of_leaves, leaves, count)
    shapes = jax.eval_shape(of_leaves, *(leaf[:TOGETHER] for leaf in leaves))
    empty = jax.tree.map(lambda s: jnp.zeros((len(leaves[0]), *s.shape[1:]), s.dtype), shapes)

    def add(total, first, *some):
        return jax.tree.map(
            lambda whole, part: lax.dynamic_update_slice_in_dim(whole, part, first[0], 0),
            total,
            of_leaves(*some),
        )

    return added_over_patches(empty, add, (jnp.arange(len(leaves[0])), *leaves), count)


def _mapped(function, arrays):
    """The arrays that have a row for each patch, and the function of these."""
    leaves, structure = jax.tree.flatten(arrays)
    mapped = [jnp.ndim(leaf) > 0 for leaf in leaves]

    def of_mapped(*some):
        own = iter(some)
        return function(
            *jax.tree.unflatten(
                structure,
                [next(own) if m else leaf for leaf, m in zip(leaves, mapped, strict=True)],
            )
        )

    return [jnp.asarray(leaf) for leaf, own in zip(leaves, mapped, strict=True) if own], of_mapped


def _in_reversible_steps(function, arrays, count):
    """The results by a loop over all patches, which steps over those of padding."""
    parts = [leaf.reshape(-1, TOGETHER, *leaf.shape[1:]) for leaf in arrays]
    nothing = jax.tree.map(
        lambda s: jnp.zeros(s.shape, s.dtype),
        jax.eval_shape(function, *(part[0] for part in parts)),
    )

    # around the condition: inside its branches it would keep copies of all arrays (JAX 0.10.1)
    @jax.checkpoint
    def step(_, numbered):
        first, *some = numbered
        return None, lax.cond(first < count, function, lambda *_: nothing, *some)

    found = lax.scan(step, None, (TOGETHER * jnp.arange(len(parts[0])), *parts))[1]
    return jax.tree.map(lambda v: v.reshape(-1, *v.shape[2:]), found)


def added_over_patches(
    total: Any, add: Callable[..., Any], arrays: tuple, count: Int[Array, ""]
) -> Any:
    """``add(total, *arrays)`` with a few of the first ``count`` patches after the others.

    It has no reverse derivatives.
    """

    def step(k: Array, total: Any) -> Any:
        return add(
            total,
            *jax.tree.map(lambda v: lax.dynamic_slice_in_dim(v, k * TOGETHER, TOGETHER), arrays),
        )

    return lax.fori_loop(0, (count + TOGETHER - 1) // TOGETHER, step, total)
