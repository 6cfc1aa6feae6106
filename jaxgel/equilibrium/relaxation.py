"""Relaxation of an unstable state to a stable one by overdamped motion.

Pseudo-transient continuation (Kelley & Keyes 1998): implicit Euler steps of N dx/dt = -r with the
stiffness N of the dry network as viscosity, (K + alpha N) dx = -r, where 1 / alpha is the step in
time. Alpha stays large enough for a positive definite matrix, so the energy falls and no saddle
attracts, and goes to zero with the residual, which ends in Newton's method.
"""

import dataclasses

import numpy as np

from .._types import Array, Chemical, Float
from ..linalg import Factor, SingularTangent, factor
from ..mechanics import Problem, condensed_rhs, scatter, tangent
from .newton import NEWTON, Correction, Newton, advanced, iterate, starting, uncrossed
from .state import State

# alpha, in units of the network's stiffness like the eigenvalues of the tangent
FIRST_DAMPING = 0.5
LARGEST_DAMPING = 1e4
MAX_ITERATIONS = 200
KICK = 0.02  # of the spacing: largest displacement along the mode that starts the motion


def relax(
    problem: Problem,
    value: Chemical,
    x: Float[Array, "n 2"],
    pressure: Float[Array, " g"],
    newton: Newton = NEWTON,
) -> State:
    """Stable `State` at a ``value`` of the control into which positions ``x`` with pressures relax.

    Its status says if none was found.
    """
    now, mu = problem.at(value)
    return uncrossed(
        problem,
        iterate(now, starting(now, mu, problem.placed(x, value), pressure), Damped(newton)),
        value,
    )


def relax_along(
    problem: Problem, state: State, mode: Float[np.ndarray, " f"], newton: Newton = NEWTON
) -> State:
    """`relax` from an unstable state, pushed along ``mode``."""
    amplitude = KICK * problem.model.cloud.spacing / np.abs(mode).max()
    x = state.x + scatter(amplitude * mode, problem.free)
    found = relax(problem, state.value, x, state.pressure, newton)
    return dataclasses.replace(
        found, newton_iterations=found.newton_iterations + state.newton_iterations
    )


@dataclasses.dataclass
class Damped(Correction):
    """Newton's corrections with the damped tangent K + alpha N, positive definite."""

    newton: Newton = NEWTON
    damping: float = FIRST_DAMPING
    factor: Factor | None = None
    size_before: float | None = None
    most = MAX_ITERATIONS

    def assess(self, problem: Problem, state: State) -> tuple[float, bool]:  # noqa: ARG002
        """See `newton.Correction`; the damping follows the residual."""
        size, solved = self.newton.assess(state)
        if self.size_before is not None:  # switched evolution relaxation, biased to longer steps
            self.damping *= np.clip(size / self.size_before, 0.2, 0.9)
        self.size_before = size
        return size, solved and self.factor is not None

    def __call__(self, problem: Problem, state: State) -> State:
        """The next iterate."""
        acting = problem.with_pairs(state.pairs)
        self._factorise(acting, tangent(acting, state.x, state.pressure, state.linearisation))
        dx, _ = self.factor.solve(
            np.asarray(condensed_rhs(problem, state.linearisation, state.linearisation)),
            refine=False,
        )
        return advanced(problem, state, dx, state.linearisation)

    def finish(self, problem: Problem, state: State) -> State:  # noqa: ARG002
        """The solution, without a factor."""
        return state

    def _factorise(self, problem, pairs):
        """Factor of the tangent with the least damping that leaves no negative pivots."""
        network = problem.network[:, None, None] * np.eye(2)
        while self.damping < LARGEST_DAMPING:
            shifted = pairs.copy()
            shifted[: len(network)] += self.damping * network
            self.factor = factor(problem.pattern, shifted)
            if self.factor.negative_pivots == 0:
                return
            self.damping = 2 * self.damping + 0.01
        raise SingularTangent("no damping made the tangent positive definite")
