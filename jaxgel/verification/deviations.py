"""Standard deviations of numbers from those of their inputs, to first order."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from .._types import Array, Float


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """Numbers (q,), their derivatives by d independent inputs, and deviations; of `uncertainty`."""

    inputs: tuple[str, ...]
    """Names (d,) of the inputs, one for every component."""
    input_deviations: Float[np.ndarray, " d"]
    """Standard deviations of the inputs, in their units."""
    names: tuple[str, ...]
    """Names (q,) of the numbers."""
    values: Float[np.ndarray, " q"]
    """The numbers at the values of the inputs."""
    slopes: Float[np.ndarray, "q d"]
    """Exact derivative of every number by every input."""

    @property
    def contributions(self) -> Float[np.ndarray, "q d"]:
        """Standard deviation of every number by each input alone, with the derivative's sign."""
        return self.slopes * self.input_deviations

    @property
    def deviations(self) -> Float[np.ndarray, " q"]:
        """Standard deviations of the numbers."""
        return np.linalg.norm(self.contributions, axis=1)

    def ranked(self, name: str) -> list[tuple[str, float]]:
        """Inputs and their shares of the variance of a number, largest first.

        None for a number that depends on no input.
        """
        parts = self.contributions[self.names.index(name)] ** 2
        order = np.argsort(-parts, kind="stable")
        return [(self.inputs[i], float(parts[i] / parts.sum())) for i in order if parts[i] > 0]


def uncertainty(
    function: Callable[[dict[str, Any]], Mapping[str, Any]],
    inputs: Mapping[str, Any],
    deviations: Mapping[str, Any],
) -> Uncertainty:
    """`Uncertainty` of the numbers of a function by the standard deviations of its inputs.

    Arguments:

    - `function`: function of a dict as `inputs` that returns name -> number.
    - `inputs`: name -> number or array.
    - `deviations`: the same names -> standard deviations of independent errors, a number or an
      array for each, in the unit of the input.

    The propagation is of first order, by one reverse pass for each number.

    Raises `ValueError` for a name without a deviation, and for deviations that are not finite or
    below 0.

    >>> areas = lambda v: {"area": v["a"] * v["b"]}
    >>> found = uncertainty(areas, {"a": 2.0, "b": 3.0}, {"a": 0.1, "b": 0.2})
    >>> print(found.deviations.round(6), found.ranked("area")[0][0])
    [0.5] b
    """
    if inputs.keys() != deviations.keys():
        raise ValueError(
            f"deviations: {sorted(deviations)} given for the inputs {sorted(inputs)}; give one of "
            "each"
        )
    own = {name: jnp.asarray(value, dtype=float) for name, value in inputs.items()}
    spread = {
        name: np.broadcast_to(np.asarray(deviations[name], dtype=float), np.shape(value))
        for name, value in own.items()
    }
    wrong = next(
        (name for name, value in spread.items() if not np.all(np.isfinite(value) & (value >= 0))),
        None,
    )
    if wrong is not None:
        raise ValueError(
            f"deviations: {deviations[wrong]!r} of {wrong} is not a finite standard deviation of "
            "at least 0"
        )
    flat, unravel = ravel_pytree(own)
    names: list[str] = []

    def numbers(vector: Float[Array, " d"]) -> Float[Array, " q"]:
        found = function(unravel(vector))
        names[:] = found
        return jnp.stack([jnp.asarray(value, dtype=float) for value in found.values()])

    values, pull = jax.vjp(numbers, flat)
    slopes = np.stack([np.asarray(pull(row)[0]) for row in jnp.eye(len(names))])
    own_deviations = np.asarray(
        ravel_pytree({name: jnp.asarray(value) for name, value in spread.items()})[0]
    )
    return Uncertainty(components_of(own), own_deviations, tuple(names), np.asarray(values), slopes)


def components_of(inputs: Mapping[str, Any]) -> tuple[str, ...]:
    """Name of every component of inputs in the order of `ravel_pytree`: "semi_axes_0", ...

    It is `jax.flatten_util.ravel_pytree`.
    """
    return tuple(
        name + "".join(f"_{i}" for i in at)
        for name in sorted(inputs)
        for at in np.ndindex(np.shape(inputs[name]))
    )
