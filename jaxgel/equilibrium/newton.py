"""Newton's method: one iteration for all corrections, and the equilibrium at one chemical potential.

The loop runs on the host, so that a person sees each step; its kernels are compiled once per model shape, with everything that
changes along a sweep traced.
"""

import dataclasses

import numpy as np

from .._programs import program
from .._types import Array, Chemical, Float
from ..linalg import Factor, SingularTangent
from ..mechanics import (
    Linearisation,
    Problem,
    condensed_rhs,
    factorised_tangent,
    linearise,
    pressure_step,
    scatter,
    step_limit,
    touches,
)
from .observer import UNOBSERVED, Observer
from .state import State, as_number, control_pressure, linearised
from .status import Status, of_iterate, of_outlines

SLOW = 0.1  # a step that leaves more than this of the error makes a new factor worth its cost
LARGEST_RISE = 3.0  # of the error in an iteration with contact: a larger rise means a point pair was pushed far into the contact barrier
MAX_HALVINGS = 6  # of such a correction


@dataclasses.dataclass(frozen=True)
class Newton:
    """When Newton's method ends."""

    tolerance: float = 1e-10
    """Largest norm of the residual over that of the network's nodal forces and the loads."""
    constraint_tolerance: float = 1e-11
    """Largest difference of a volume ratio J from that of the pressure, J*(p), see ``mechanics.mixed``."""
    max_iterations: int = 30
    """Most corrections of one state; after them the step of the control is refused."""

    def assess(self, state: State) -> tuple[float, bool]:
        """Residual norm of a linearised iterate, nan where it is not finite, and whether it is an equilibrium."""
        residual, violation = float(state.linearisation.residual_norm), float(state.linearisation.violation)
        return residual if np.isfinite(violation) else np.nan, residual < self.tolerance and violation < self.constraint_tolerance

    def error(self, state: State) -> float:
        """Residual norm and constraint violation of a linearised iterate over their tolerances, the larger one."""
        linearisation = state.linearisation
        return max(float(linearisation.residual_norm) / self.tolerance, float(linearisation.violation) / self.constraint_tolerance)


NEWTON = Newton()


class Correction:
    """One kind of Newton correction, used for one solve."""

    most = NEWTON.max_iterations
    """Iterations after which it ends without a solution."""

    def assess(self, problem: Problem, state: State) -> tuple[float, bool]:  # noqa: ARG002
        """Residual norm of the iterate, nan or inf where a part is not finite, and whether it solves all equations."""
        return NEWTON.assess(state)

    def __call__(self, problem: Problem, state: State) -> State:
        """The next iterate; raises `linalg.SingularTangent`."""
        raise NotImplementedError

    def finish(self, problem: Problem, state: State) -> State:
        """The solution, here with a factor of its own tangent; raises `linalg.SingularTangent`."""
        made = factorised_tangent(problem, state.x, state.pressure, state.linearisation)
        return dataclasses.replace(state, factor=made)


def iterate(problem: Problem, state: State, correction: Correction, observer: Observer = UNOBSERVED) -> State:
    """The `State` in which the iteration from ``state`` with a kind of ``correction`` ends; its status says how."""
    while True:
        observer.iteration(state)
        residual, solved = correction.assess(problem, state)
        status = of_iterate(residual, solved, state.newton_iterations >= correction.most)
        try:
            if status is Status.CONVERGED:
                return correction.finish(problem, dataclasses.replace(state, status=status, residual=residual))
            if status is not None:
                return dataclasses.replace(state, status=status, residual=residual)
            state = correction(problem, state)
        except SingularTangent:
            return dataclasses.replace(state, status=Status.SINGULAR, residual=residual, factor=None)


@dataclasses.dataclass
class Chord(Correction):
    """Newton's corrections with a factor that is kept for as long as each leaves less than ``SLOW`` of the error.

    With ``own_factor`` every correction gets its own factor, and so does the solution, which has none otherwise. The factor is kept here
    and not in the iterates: it is freed before the next factorisation.
    """

    own_factor: bool = False
    newton: Newton = NEWTON
    factor: Factor | None = None
    factorised_at: Linearisation | None = None
    error_before: float = np.inf

    def assess(self, problem: Problem, state: State) -> tuple[float, bool]:  # noqa: ARG002
        """See `Correction`."""
        return self.newton.assess(state)

    @property
    def most(self) -> int:
        """See `Correction`."""
        return self.newton.max_iterations

    def __call__(self, problem: Problem, state: State) -> State:
        """The next iterate, damped where contact multiplies the error."""
        error = self.newton.error(state)
        if self.own_factor or self.factor is None or error > SLOW * self.error_before:
            self.factor, self.factorised_at = None, state.linearisation  # free the last factor before the next factorisation
            self.factor = factorised_tangent(problem, state.x, state.pressure, state.linearisation)
        rhs = condensed_rhs(problem, state.linearisation, self.factorised_at)
        dx, _ = self.factor.solve(np.asarray(rhs), refine=False)
        self.error_before = error
        found = advanced(problem, state, dx, self.factorised_at)
        for halvings in range(1, MAX_HALVINGS + 1 if problem.has_contact else 0):
            if self.newton.error(found) < max(LARGEST_RISE * error, 1.0):
                break
            found = advanced(problem, state, dx, self.factorised_at, share=0.5**halvings)
        return found

    def finish(self, problem: Problem, state: State) -> State:
        """The solution, with a factor of its own tangent where that was asked for."""
        self.factor = None
        return super().finish(problem, state) if self.own_factor else dataclasses.replace(state, factor=None)


def starting(problem: Problem, value: Chemical, x: Float[Array, "n 2"], pressure: Float[Array, " g"]) -> State:
    """Iterate at a ``value`` of the control with the given positions and pressures, linearised there; edges are as prescribed."""
    value, x = as_number(value), problem.placed(x, value)
    now, mu = problem.at(value)
    return State(value, as_number(mu), x, pressure, linearisation=linearise(now, x, pressure, mu))


def advanced(
    problem: Problem,
    state: State,
    dx: Float[Array, " f"],
    factorised_at: Linearisation,
    *,
    share: float = 1.0,
    step: float = 0.0,
    limited: bool = True,
) -> State:
    """The iterate after a ``share`` of the correction ``dx`` of the unknowns, and of the control's ``step``, linearised there.

    Where the problem has contact and the step is ``limited``, it leaves every pair of points a part of its distance.
    """
    value, x, pressure = state.value + share * step, state.x, state.pressure
    if step:
        x, pressure = problem.placed(x, value), np.asarray(pressure) + share * step * control_pressure(problem, state)
    now, mu = problem.at(value)
    x, pressure = _stepped(now, x, pressure, dx, state.linearisation, factorised_at, share, limited=limited)
    linearisation = linearise(now, x, pressure, mu)
    return State(value, as_number(mu), x, pressure, newton_iterations=state.newton_iterations + 1, linearisation=linearisation)


@program(x="n", p="g", correction="f", returns=("n", "g"), static=("limited",))
def _stepped(problem, x, p, correction, linearisation, factorised_at, share, *, limited=True):
    """Positions and pressures after a ``share`` of the ``correction`` of the unknowns."""
    dx = scatter(correction, problem.free)
    share = share * step_limit(x, dx, problem.model) if problem.has_contact and limited else share
    return x + share * dx, p + share * pressure_step(dx, linearisation, factorised_at, problem.model)


def solve(
    problem: Problem,
    value: Chemical,
    x: Float[Array, "n 2"],
    pressure: Float[Array, " g"],
    *,
    own_factor: bool = False,
    near_contact: bool | None = None,
    newton: Newton = NEWTON,
    observer: Observer = UNOBSERVED,
) -> State:
    """`State` of equilibrium at a ``value`` of the control, from positions ``x``, mm, and pressures, kT/v.

    Newton's method on the mixed form (see ``mechanics.mixed``): every p is feasible, so no line search guards J > 1. With ``own_factor``
    the state has a factor of its own tangent. Contact is left out until an outline comes near itself: at the start, where
    ``near_contact`` does not already say so, and in the solution. A state in which an outline crosses itself is not accepted.
    """

    def solved(problem, own_factor):
        now, mu = problem.at(value)
        return iterate(now, starting(now, mu, x, pressure), Chord(own_factor, newton), observer)

    x = problem.placed(x, value)
    found = _with_contact(problem, x, near_contact, own_factor, solved) if problem.has_contact else solved(problem, own_factor)
    return dataclasses.replace(found, value=float(value))


def _with_contact(problem, x, near_contact, own_factor, solved):
    """What ``solved(problem, own_factor)`` finds without contact, or with it where an outline is near itself there or at ``x``."""
    if not (touches(x, problem.model) if near_contact is None else near_contact):
        found = solved(problem.without_contact, own_factor)
        if not (found.status.ok and touches(found.x, problem.model)):
            return dataclasses.replace(found, contact_active=False)
    found = dataclasses.replace(solved(problem, True), contact_active=True)
    return dataclasses.replace(found, status=of_outlines(found.x, problem.model, contact=True)) if found.status.ok else found


def with_own_factor(problem: Problem, state: State) -> State:
    """The state with a factor of its own tangent; raises `linalg.SingularTangent`."""
    if state.factor is not None:
        return state
    acting, now = linearised(problem, state)
    return dataclasses.replace(state, linearisation=now, factor=factorised_tangent(acting, state.x, state.pressure, now))
