"""A function of one state, evaluated at all states of a path."""

import functools
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp

from .._types import Array, Float
from ..discretisation import Model


@runtime_checkable
class States(Protocol):
    """States of a model that need not be in equilibrium; a path is one."""

    model: Model
    """The model."""
    x: Float[Array, "k n 2"]
    """Nodal positions, mm."""


def over_states(function: Callable[[Float[Array, "n 2"], Model], Any], path: States) -> Any:
    """``function(x, model)`` at every state: its arrays with a leading axis of k."""
    return _mapped(function, jnp.asarray(path.x), path.model)


@functools.partial(jax.jit, static_argnums=0)
def _mapped(function: Callable, x: Float[Array, "k n 2"], model: Model) -> Any:
    return jax.vmap(function, in_axes=(0, None))(x, model)
