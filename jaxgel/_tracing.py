"""While JAX traces: a test for arrays without values, numbers beside them, and conditions."""

import contextlib
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap

outside_traces = jax.core.eval_context
"""Context or decorator in which numbers stay numbers, also inside traces.

``jax.ensure_compile_time_eval`` would trace the programs that are met once more, and compile each
of their operations with constants by itself.
"""


def is_traced(*trees: object) -> bool:
    """Whether any leaf of the pytrees is a tracer of JAX."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(trees))


def numbers_of(*trees: object) -> AbstractContextManager[None]:
    """`outside_traces`, unless a leaf of the pytrees is traced."""
    return contextlib.nullcontext() if is_traced(*trees) else outside_traces()


@custom_vmap
def everywhere(holds: Any) -> Any:
    """A condition () for ``jax.lax.cond``; under ``jax.vmap`` whether all of the batch meet it.

    One program then computes one of the branches, where it would compute both for a condition of
    each member. The branch for False must be right for those that meet it, too.
    """
    return holds


@everywhere.def_vmap
def _(_size, _mapped, holds):
    return everywhere(jnp.all(holds, axis=0)), False


def value_and_tangents(function: Callable[[Any], Any], at: Any, dots: Any) -> tuple[Any, Any]:
    """The value of a function of a pytree and its tangents, as ``jax.jvp`` gives them.

    Leaves that do not depend on the argument have zeros of NumPy, for which nothing is compiled.
    """
    structure, numbers = None, []

    def moving(at):
        nonlocal structure
        leaves, structure = jax.tree.flatten(function(at))
        numbers[:] = [number for number, leaf in enumerate(leaves) if is_traced(leaf)]
        return [leaves[number] for number in numbers], leaves

    _, moved, leaves = jax.jvp(moving, (at,), (dots,), has_aux=True)
    types = [jax.typeof(leaf).to_tangent_aval() for leaf in leaves]
    tangents = [np.zeros(one.shape, one.dtype) for one in types]
    for number, dot in zip(numbers, moved, strict=True):
        tangents[number] = dot
    return jax.tree.unflatten(structure, leaves), jax.tree.unflatten(structure, tangents)
