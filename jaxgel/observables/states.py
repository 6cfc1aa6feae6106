"""A function of one state, evaluated at all states of a path."""

import functools

import jax
import jax.numpy as jnp


def over_states(function, path):
    """``function(x, model)`` at every state of the path."""
    return _mapped(function)(jnp.asarray(path.x), path.model)


@functools.cache
def _mapped(function):
    return jax.jit(jax.vmap(function, in_axes=(0, None)))
