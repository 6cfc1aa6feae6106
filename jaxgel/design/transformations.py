"""Methods of optax on the augmented Lagrangian: gradient transformations and line searches.

Every design is projected on the bounds.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float
from .lagrangian import SHORTEST, Invalid, Lagrangian, Stuck

MULTIPLIER_STEPS = 10  # first-order steps between two updates of the multipliers


def first_order(search: Any, *, transformation: Any, step: float) -> None:
    """Steps of an optax transformation, projected on the bounds, until the evaluations are used up.

    One to an invalid design is halved.
    """
    import optax

    transformation, now = optax.with_extra_args_support(transformation), search.at(search.start)
    lagrangian, state = (
        Lagrangian(len(now.values) - 1),
        transformation.init(jnp.asarray(now.vector)),
    )
    value_fn = _projected_lagrangian(search, lagrangian)
    while True:
        for _ in range(MULTIPLIER_STEPS):
            gradient, value = (
                now.gradient(lagrangian.weights(now.values)),
                lagrangian.value(now.values),
            )
            update, state = _update(transformation, gradient, state, now.vector, value, value_fn)
            now = search.settle(_step(search, now, np.clip(np.asarray(update), -step, step)).vector)
        lagrangian.update(now.values)


def check_transformation(transformation: Any, vector: Float[Array, " d"]) -> None:
    """Raise ValueError, one line, for an optax transformation with unsupported arguments.

    Its update takes more than ``value``, ``grad`` and ``value_fn``.
    """
    import optax

    def bowl(v):
        return jnp.sum((v - 0.5) ** 2)

    value, gradient = jax.value_and_grad(bowl)(jnp.asarray(vector))
    transformation = optax.with_extra_args_support(transformation)
    try:
        _update(
            transformation, gradient, transformation.init(jnp.asarray(vector)), vector, value, bowl
        )
    except TypeError as problem:
        given = "value, grad and value_fn are given to it"
        raise ValueError(
            f"method: the update of the optax transformation cannot be called ({problem}); {given}"
        ) from None


def _update(transformation, gradient, state, vector, value, value_fn):
    """Update and new state of a transformation.

    Its loops are Python's, not compiled: a line search calls ``value_fn``, a sweep, in one.
    """
    with jax.disable_jit():
        gradient = jnp.asarray(gradient)
        return transformation.update(
            gradient,
            state,
            jnp.asarray(vector),
            value=jnp.asarray(value),
            grad=gradient,
            value_fn=value_fn,
        )


def _projected_lagrangian(search, lagrangian):
    """Augmented Lagrangian of a scaled, projected design, for JAX; inf if invalid."""

    @jax.custom_vjp
    def value(v):
        try:
            return jnp.asarray(lagrangian.value(_evaluation(search, v).values))
        except Invalid:
            return jnp.asarray(jnp.inf)

    def forward(v):
        try:
            here = _evaluation(search, v)
            with jax.disable_jit(False):
                slope = here.gradient(lagrangian.weights(here.values))
        except Invalid:
            return jnp.asarray(jnp.inf), jnp.zeros_like(v)
        return jnp.asarray(lagrangian.value(here.values)), jnp.where(
            (v >= 0) & (v <= 1), slope, 0.0
        )

    value.defvjp(forward, lambda slope, cotangent: (cotangent * slope,))
    return value


def _evaluation(search, v):
    with jax.disable_jit(False):
        return search.at(np.clip(np.asarray(v), 0.0, 1.0))


def _step(search, now, update):
    """The evaluation after the longest valid part of an update."""
    part = 1.0
    while part >= SHORTEST:
        target = np.clip(now.vector + part * update, 0.0, 1.0)
        if np.array_equal(target, now.vector):
            raise Stuck
        try:
            return search.at(target)
        except Invalid:
            part *= 0.5
    raise Stuck
