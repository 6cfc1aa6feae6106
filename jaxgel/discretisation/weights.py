"""Weight functions of moving least squares and their square roots, derivatives finite."""

import jax
import jax.numpy as jnp
from jax import lax

from .._types import Array, Float, Scalar

# squared distance below which the singular weight stays what it is: its ninth derivative is still a
# number
_TINY = 1e-60


def singular_weight(
    distance_squared: Float[Array, "..."], support: Float[Array, "..."] | Scalar
) -> Float[Array, "..."]:
    """Singular weight function of Eq. (37), (rho/d)^2 (1 - d/rho)^2, of d^2; huge at d = 0.

    It is 0 outside the support.
    """
    return _positive(support * _inverse_root(distance_squared) - 1) ** 2


def singular_slope(
    distance_squared: Float[Array, "..."], support: Float[Array, "..."]
) -> Float[Array, "..."]:
    """Twice the derivative of `singular_weight` by d^2; times the offset it is the gradient.

    The offset is that from the node.
    """
    inverse = _inverse_root(distance_squared)
    return -2 * support * inverse**3 * _positive(support * inverse - 1)


@jax.custom_jvp
def _inverse_root(squared):
    """1 / sqrt, constant below `_TINY`; a maximum, not a choice, is what XLA vectorises."""
    return lax.rsqrt(jnp.maximum(squared, _TINY))


@_inverse_root.defjvp
def _inverse_root_jvp(primals, tangents):
    """Products only: JAX's own rule divides once more for each derivative."""
    inverse = _inverse_root(primals[0])
    return inverse, -0.5 * inverse**3 * tangents[0]


@jax.custom_jvp
def _positive(value):
    """The value if it is positive, otherwise 0; JAX's own rule for the maximum divides."""
    return jnp.maximum(value, 0.0)


@_positive.defjvp
def _positive_jvp(primals, tangents):
    return _positive(primals[0]), jnp.where(primals[0] > 0, tangents[0], 0.0)


def safe_sqrt(squared: Float[Array, "..."]) -> Float[Array, "..."]:
    """Square root with the derivative 0 at 0: there the weights depend on d through d^2 only."""
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)
