"""What a design is judged by: functions of a swollen path, or of the dry plate alone, whose values JAX differentiates.

An objective is any function of a `path.Path` that gives a number; `value_at` and `misfit` make the usual ones. A constraint is a
function of the path, or of the plate, that is met where it is not negative. Lengths in mm, angles in degrees.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._types import Array, Float
from ..continuation import Path


def value_at(quantity: Callable[[Path], Float[Array, " k"]], mu: float) -> Callable[[Path], Float[Array, ""]]:
    """Function of a path: ``quantity(path)`` (k,), such as ``rotation_angle``, at one ``mu``, linear between the states of the path."""
    return lambda path: jnp.interp(mu, jnp.asarray(path.mu), quantity(path))


def misfit(
    quantity: Callable[[Path], Float[Array, " k"]], mu: Sequence[float], curve: Sequence[float] | Float[Array, " k"]
) -> Callable[[Path], Float[Array, ""]]:
    """Function of a path: mean square () of ``quantity(path)``, read at ``mu`` (k,), less ``curve`` (k,); nan in it are left out."""
    at, wanted = np.asarray(mu, dtype=float), np.asarray(curve, dtype=float)
    given = np.isfinite(wanted)
    return lambda path: jnp.mean((jnp.interp(at[given], jnp.asarray(path.mu), quantity(path)) - wanted[given]) ** 2)


def weighted_sum(weights: Sequence[float], functions: Sequence[Callable[..., Any]]) -> Callable[[Path], Float[Array, ""]]:
    """Function of a path: the sum of ``functions``, each times its weight."""
    pairs = list(zip(weights, functions, strict=True))
    return lambda path: sum(weight * function(path) for weight, function in pairs)
