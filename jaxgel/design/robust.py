"""Robust design: manufacturing errors and their effect on the objective."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from .._types import Array, Float, Scalar
from ..geometry import Plate
from ..materials import AnyGel

LEAST = 1e-300  # of a variance: its root has a derivative


@dataclasses.dataclass(frozen=True, eq=False)
class Spread:
    """Samples of a design as it is made, with errors that are the same for every design.

    The objective of a problem with a spread is the mean of the samples, worse by ``weight``
    standard deviations.
    """

    change: Callable[[Plate, AnyGel, Float[Array, " d"]], tuple[Plate, AnyGel]]
    """Function of plate, gel and errors (d,) to both as they are made; traceable.

    The unit of the errors is the standard deviation.
    """
    errors: Float[np.ndarray, "n d"]
    """Errors of every sample, two samples at least."""
    weight: float = 1.0
    """Standard deviations that the objective gives up."""

    def __post_init__(self) -> None:
        if (
            np.ndim(self.errors) != 2
            or len(self.errors) < 2
            or not np.all(np.isfinite(self.errors))
        ):
            raise ValueError(
                f"errors: an array of shape {np.shape(self.errors)} is not (n, d) with n >= 2 "
                "rows of finite numbers"
            )
        if not 0 <= self.weight < np.inf:
            raise ValueError(
                f"weight: {self.weight!r} is not a number of standard deviations, 0 or more"
            )

    def objective(self, values: Float[Array, " n"], maximise: bool) -> Scalar:
        """Mean of the values (n,) of all samples, less or plus the standard deviations.

        Less if they are maximised.
        """
        deviation = jnp.sqrt(jnp.var(values, ddof=1) + LEAST)
        return jnp.mean(values) + (-self.weight if maximise else self.weight) * deviation
