"""Newton's method: one iteration for all increments, and the equilibrium at one mu.

The loop runs on the host, so that a person sees each step; its kernels are compiled once per model
shape, with everything that changes along a sweep traced.
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
    crosses_lines,
    factorised_tangent,
    linearise,
    pressure_step,
    scatter,
    step_limit,
)
from .observer import UNOBSERVED, Observer
from .state import State, as_number, control_pressure, linearised
from .status import Status, of_iterate, of_outlines

SLOW = 0.1  # a step that leaves more than this of the error makes a new factor worth its cost
# of the error in an iteration with contact: a larger rise means a point pair was pushed far into
# the contact barrier
LARGEST_RISE = 3.0
MAX_HALVINGS = 6  # of such a correction


@dataclasses.dataclass(frozen=True)
class Newton:
    """Tolerances of Newton's method; a user's argument of `sweep` and others."""

    tolerance: float = 1e-10
    """Largest norm of the residual over that of the network's nodal forces and the loads ()."""
    constraint_tolerance: float = 1e-11
    """Largest difference of J from that of the pressure, J*(p), see `mechanics.mixed` ()."""
    max_iterations: int = 30
    """Largest number of increments for one state; beyond it the step of the control is refused."""

    def assess(self, state: State) -> tuple[float, bool]:
        """Residual norm of a linearised iterate, nan if not finite, and whether it is converged."""
        residual, violation = (
            float(state.linearisation.residual_norm),
            float(state.linearisation.violation),
        )
        return residual if np.isfinite(
            violation
        ) else np.nan, residual < self.tolerance and violation < self.constraint_tolerance

    def error(self, state: State) -> float:
        """Larger of residual norm and constraint violation over their tolerances."""
        linearisation = state.linearisation
        return max(
            float(linearisation.residual_norm) / self.tolerance,
            float(linearisation.violation) / self.constraint_tolerance,
        )


NEWTON = Newton()


class Correction:
    """One kind of Newton correction, used for one solve."""

    most = NEWTON.max_iterations
    """Iterations after which it ends without a solution."""

    def assess(self, problem: Problem, state: State) -> tuple[float, bool]:  # noqa: ARG002
        """Residual norm of the iterate, nan or inf if not finite, and whether it converged.

        That is, solves all equations.
        """
        return NEWTON.assess(state)

    def __call__(self, problem: Problem, state: State) -> State:
        """The next iterate; raises `linalg.SingularTangent`."""
        raise NotImplementedError

    def finish(self, problem: Problem, state: State) -> State:
        """The solution, here with a factor of its own tangent; raises `linalg.SingularTangent`."""
        made = factorised_tangent(
            problem.with_pairs(state.pairs), state.x, state.pressure, state.linearisation
        )
        return dataclasses.replace(state, factor=made)


def iterate(
    problem: Problem, state: State, correction: Correction, observer: Observer = UNOBSERVED
) -> State:
    """The `State` in which the iteration from ``state`` with a kind of ``correction`` ends.

    Its status says how.
    """
    while True:
        observer.iteration(state)
        residual, solved = correction.assess(problem, state)
        status = of_iterate(residual, solved, state.newton_iterations >= correction.most)
        try:
            if status is Status.CONVERGED:
                return correction.finish(
                    problem, dataclasses.replace(state, status=status, residual=residual)
                )
            if status is not None:
                return dataclasses.replace(state, status=status, residual=residual)
            state = correction(problem, state)
        except SingularTangent:
            return dataclasses.replace(
                state, status=Status.SINGULAR, residual=residual, factor=None
            )


@dataclasses.dataclass
class Chord(Correction):
    """Chord Newton increments: the factor is kept while each reduces the error by ``SLOW``.

    With ``own_factor`` every correction gets its own factor, and so does the solution, which has
    none otherwise. The factor is kept here and not in the iterates: it is freed before the next
    factorisation.
    """

    own_factor: bool = False
    newton: Newton = NEWTON
    contact: bool = True
    """Whether pairs of points that touch are looked for at every iterate; if not, they are none."""
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
        if (
            self.own_factor
            or state.touches
            or self.factor is None
            or error > SLOW * self.error_before
        ):
            # free the last factor before the next factorisation
            self.factor, self.factorised_at = None, state.linearisation
            self.factor = factorised_tangent(
                problem.with_pairs(state.pairs), state.x, state.pressure, state.linearisation
            )
        rhs = condensed_rhs(problem, state.linearisation, self.factorised_at)
        dx, _ = self.factor.solve(np.asarray(rhs), refine=False)
        self.error_before = error
        found = advanced(problem, state, dx, self.factorised_at, contact=self.contact)
        for halvings in range(1, MAX_HALVINGS + 1 if found.touches else 0):
            if self.newton.error(found) < max(LARGEST_RISE * error, 1.0):
                break
            found = advanced(problem, state, dx, self.factorised_at, share=0.5**halvings)
        return found

    def finish(self, problem: Problem, state: State) -> State:
        """The solution, with a factor of its own tangent where that was asked for."""
        self.factor = None
        return (
            super().finish(problem, state)
            if self.own_factor
            else dataclasses.replace(state, factor=None)
        )


def starting(
    problem: Problem, value: Chemical, x: Float[Array, "n 2"], pressure: Float[Array, " g"]
) -> State:
    """Iterate at a ``value`` with given positions and pressures, linearised; edges prescribed.

    It is a value of the control.
    """
    value, x = as_number(value), problem.placed(x, value)
    now, mu = problem.at(value)
    now = now.touching(x)
    return State(
        value,
        as_number(mu),
        x,
        pressure,
        pairs=now.pairs,
        linearisation=linearise(now, x, pressure, mu),
    )


def advanced(
    problem: Problem,
    state: State,
    dx: Float[Array, " f"],
    factorised_at: Linearisation,
    *,
    share: float = 1.0,
    step: float = 0.0,
    limited: bool = True,
    contact: bool = True,
) -> State:
    """The iterate after a ``share`` of the increment ``dx`` and the control's ``step``.

    Linearised there; ``dx`` is that of the unknowns. If surfaces touch before or after it and the
    step is ``limited``, it leaves every pair of points a part of its distance.
    """
    value, x, pressure = state.value + share * step, state.x, state.pressure
    if step:
        x, pressure = (
            problem.placed(x, value),
            np.asarray(pressure) + share * step * control_pressure(problem, state),
        )
    now, mu = problem.at(value)
    at = x, pressure, dx, state.linearisation, factorised_at
    moved, pressed = _stepped(now, *at, share)
    there = now.touching(moved) if contact else now
    if limited and (state.touches or there.pairs):
        share = share * step_limit(x, scatter(dx, problem.free), problem.model)
        moved, pressed = _stepped(now, *at, share)
        there = now.touching(moved)
    linearisation, count = linearise(there, moved, pressed, mu), state.newton_iterations + 1
    return State(
        value,
        as_number(mu),
        moved,
        pressed,
        pairs=there.pairs,
        newton_iterations=count,
        linearisation=linearisation,
    )


@program(x="n", p="g", correction="f", returns=("n", "g"), inside=True)
def _stepped(problem, x, p, correction, linearisation, factorised_at, share):
    """Positions and pressures after a ``share`` of the ``correction`` of the unknowns."""
    dx = scatter(correction, problem.free)
    return x + share * dx, p + share * pressure_step(
        dx, linearisation, factorised_at, problem.model
    )


def solve(
    problem: Problem,
    value: Chemical,
    x: Float[Array, "n 2"],
    pressure: Float[Array, " g"],
    *,
    own_factor: bool = False,
    newton: Newton = NEWTON,
    observer: Observer = UNOBSERVED,
) -> State:
    """`State` of equilibrium at a ``value`` from positions ``x``, mm, and pressures, kT/v.

    It is a value of the control. Newton's method on the mixed form (see ``mechanics.mixed``): every
    p is feasible, so no line search guards J > 1. With ``own_factor`` the state has a factor of its
    own tangent. Contact is left out until surfaces touch at the start or in the solution. A state
    with contact in which an outline crosses itself is not accepted.
    """
    x, (now, mu) = problem.placed(x, value), problem.at(value)
    start = starting(now, mu, x, pressure)
    found = iterate(now, start, Chord(own_factor, newton, start.touches), observer)
    if found.status.ok and not start.touches and now.touching(found.x).pairs:
        found = iterate(now, start, Chord(own_factor, newton), observer)
    return uncrossed(problem, found, value)


def uncrossed(problem: Problem, state: State, value: Chemical) -> State:
    """A state found at a ``value`` of the control.

    With contact its status says whether an outline crosses itself, or a surface a line.
    """
    status = (
        of_outlines(state.x, problem.model, contact=True)
        if problem.has_contact and state.status.ok
        else state.status
    )
    if problem.has_contact and status.ok and crosses_lines(state.x, problem.at(value)[0].model):
        status = Status.CROSSED
    return dataclasses.replace(state, value=float(value), status=status)


def with_own_factor(problem: Problem, state: State) -> State:
    """The state with a factor of its own tangent; raises `linalg.SingularTangent`."""
    if state.factor is not None:
        return state
    acting, now = linearised(problem, state)
    return dataclasses.replace(
        state, linearisation=now, factor=factorised_tangent(acting, state.x, state.pressure, now)
    )
