"""Augmented Lagrangian of a design with constraints, and ends of a search without a value."""

import numpy as np

from .._types import Array, Float

PENALTY = 10.0  # first rho; constraints and objective are scaled to 1
PENALTY_GROWTH = 3.0  # of rho if the violation has not fallen to a quarter
# by which the constraints of the augmented Lagrangian are to be met, since it comes from outside
MARGIN = 1e-3
SHORTEST = 2.0**-8  # of a step that is halved, and of a box


class Invalid(ArithmeticError):
    """A design without a usable value; the text says why.

    A function of a `DesignProblem` may raise it, too.
    """


class Exhausted(Exception):
    """The number of evaluations is used up."""


class Stuck(Exception):
    """No valid design however short the step."""


class Stalled(Exception):
    """A method went on in steps too short to change anything."""


class Lagrangian:
    """The augmented Lagrangian of values (1 + c,), its multipliers and penalty."""

    def __init__(self, n_constraints: int) -> None:
        self.multipliers, self.penalty, self.violation = np.zeros(n_constraints), PENALTY, np.inf

    def value(self, values: Float[Array, " c"]) -> float:
        """The augmented Lagrangian ()."""
        kept = self._kept(values)
        return values[0] + np.sum(kept**2 - self.multipliers**2) / (2 * self.penalty)

    def weights(self, values: Float[Array, " c"]) -> Float[Array, " c"]:
        """Its derivatives (1 + c,) with respect to the values."""
        return np.concatenate([[1.0], -self._kept(values)])

    def update(self, values: Float[Array, " c"]) -> None:
        """New multipliers, and a larger penalty if the violation falls slowly."""
        self.multipliers = self._kept(values)
        violation = float(np.max(np.maximum(MARGIN - values[1:], 0.0), initial=0.0))
        if violation > max(0.25 * self.violation, 2 * MARGIN):
            self.penalty *= PENALTY_GROWTH
        self.violation = violation

    def _kept(self, values):
        return np.maximum(0.0, self.multipliers - self.penalty * (values[1:] - MARGIN))
