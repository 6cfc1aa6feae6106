"""Newton's method: one iteration for all corrections, and the equilibrium at one chemical potential.

The loop runs on the host, so that a person sees each step; its kernels are compiled once per model shape, with everything that
changes along a sweep traced.
"""

import dataclasses
import functools
from typing import Any, Protocol, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float, Scalar
from ..linalg import Factor, SingularTangent, factor
from ..mechanics import (
    Linearisation,
    Problem,
    condensed_rhs,
    factorised_tangent,
    linearise,
    pressure_step,
    scatter,
    step_limit,
    tangent,
    touches,
)
from .state import State, acting_problem, control_pressure, of_control
from .status import Status, of_iterate, of_outlines

MAX_ITERATIONS = 30
TOLERANCE = 1e-10  # of the residual, relative to the forces of the network
CONSTRAINT_TOLERANCE = 1e-11  # of J - J*(p), see ``mechanics.mixed``
SLOW = 0.1  # a step that leaves more than this of the error makes a new factor worth its cost
LARGEST_RISE = 3.0  # of the error in an iteration with contact: a larger rise means a point pair was pushed far into the contact barrier
MAX_HALVINGS = 6  # of such a correction


P = TypeVar("P", contravariant=True)  # a problem of one formulation


class Correction(Protocol[P]):
    """One kind of Newton correction, used for one solve."""

    def assess(self, problem: P, state: State) -> tuple[float, bool]:
        """Residual norm of the iterate, nan or inf where a part is not finite, and whether it solves all equations."""
        ...

    def exhausted(self, state: State) -> bool:
        """Whether the iteration ends here without a solution."""
        ...

    def __call__(self, problem: P, state: State) -> State:
        """The next iterate; raises `linalg.SingularTangent`."""
        ...

    def finish(self, problem: P, state: State) -> State:
        """The solution with its factor; raises `linalg.SingularTangent`."""
        ...


def iterate(problem: P, state: State, correction: Correction[P]) -> State:
    """The `State` in which the iteration from ``state`` with a kind of ``correction`` ends; its status says how."""
    while True:
        residual, solved = correction.assess(problem, state)
        status = of_iterate(residual, solved, correction.exhausted(state))
        try:
            if status is Status.CONVERGED:
                return correction.finish(problem, dataclasses.replace(state, status=status, residual=residual))
            if status is not None:
                return dataclasses.replace(state, status=status, residual=residual)
            state = correction(problem, state)
        except SingularTangent:
            return dataclasses.replace(state, status=Status.SINGULAR, residual=residual, factor=None)


@dataclasses.dataclass
class Chord:
    """Newton's corrections with a factor that is kept for as long as each leaves less than ``SLOW`` of the error.

    With ``own_factor`` every correction gets its own factor, and so does the solution. The factor is kept here and not in the iterates:
    it is freed before the next factorisation.
    """

    own_factor: bool = False
    factor: Factor | None = None
    factorised_at: Linearisation | None = None
    error_before: float = np.inf

    def assess(self, problem: Problem, state: State) -> tuple[float, bool]:  # noqa: ARG002
        """See `Correction`."""
        return assess_equilibrium(state)

    def exhausted(self, state: State) -> bool:
        """See `Correction`."""
        return state.newton_iterations >= MAX_ITERATIONS

    def __call__(self, problem: Problem, state: State) -> State:
        """The next iterate, damped where contact multiplies the error."""
        error = relative_error(state)
        if self.own_factor or self.factor is None or error > SLOW * self.error_before:
            self.factor, self.factorised_at = None, state.linearisation  # free the last factor before the next factorisation
            self.factor = factorised_tangent(problem, state.x, state.pressure, state.linearisation)
        rhs = condensed_rhs(problem, state.linearisation, self.factorised_at)
        dx, _ = self.factor.solve(np.asarray(rhs), refine=False)
        self.error_before = error
        found = advanced(problem, state, dx, self.factorised_at)
        for halvings in range(1, MAX_HALVINGS + 1 if problem.has_contact else 0):
            if relative_error(found) < max(LARGEST_RISE * error, 1.0):
                break
            found = advanced(problem, state, dx, self.factorised_at, share=0.5**halvings)
        return found

    def finish(self, problem: Problem, state: State) -> State:
        """The solution with the last factor, or its own."""
        if self.own_factor:
            self.factor = None
            self.factor = factorised_tangent(problem, state.x, state.pressure, state.linearisation)
        return dataclasses.replace(state, factor=self.factor)


def starting(problem: Problem, value: Scalar, x: Float[Array, "n 2"], pressure: Float[Array, " g"]) -> State:
    """Iterate at a ``value`` of the control with the given positions and pressures, linearised there; edges are as prescribed."""
    value, x = float(value), problem.placed(x, value)
    now, mu = problem.at(value)
    return of_control(problem, State(float(mu), x, pressure, linearisation=linearise(now, x, pressure, jnp.asarray(mu))), value)


def assess_equilibrium(state: State) -> tuple[float, bool]:
    """Residual norm of a linearised iterate, nan where it is not finite, and whether it is an equilibrium."""
    residual, violation = float(state.linearisation.residual_norm), float(state.linearisation.violation)
    return residual if np.isfinite(violation) else np.nan, residual < TOLERANCE and violation < CONSTRAINT_TOLERANCE


def relative_error(state: State) -> float:
    """Residual norm and constraint violation of a linearised iterate over their tolerances, the larger one."""
    return max(float(state.linearisation.residual_norm) / TOLERANCE, float(state.linearisation.violation) / CONSTRAINT_TOLERANCE)


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
    x, pressure, linearisation = _advanced(
        now, x, pressure, jnp.asarray(mu), dx, state.linearisation, factorised_at, share, limited=limited
    )
    found = State(float(mu), x, pressure, newton_iterations=state.newton_iterations + 1, linearisation=linearisation)
    return of_control(problem, found, value)


@functools.partial(jax.jit, static_argnames="limited")
def _advanced(problem, x, p, mu, correction, linearisation, factorised_at, share, *, limited=True):
    dx = scatter(correction, x.shape, problem.free)
    share = share * step_limit(x, dx, problem.model) if problem.has_contact and limited else share
    x, p = x + share * dx, p + share * pressure_step(dx, linearisation, factorised_at, problem.model)
    return x, p, linearise(problem, x, p, mu)


def solve(
    problem: Problem,
    value: Scalar,
    x: Float[Array, "n 2"],
    pressure: Float[Array, " g"],
    *,
    own_factor: bool = False,
    near_contact: bool | None = None,
) -> State:
    """`State` of equilibrium at a ``value`` of the control, from positions ``x``, mm, and pressures, kT/v.

    Newton's method on the mixed form (see ``mechanics.mixed``): every p is feasible, so no line search guards J > 1. With ``own_factor``
    the state has a factor of its own tangent. Contact is left out until an outline comes near itself: at the start, where
    ``near_contact`` does not already say so, and in the solution. A state in which an outline crosses itself is not accepted.
    """
    now, mu = problem.at(value)
    return of_control(problem, _solved(now, mu, problem.placed(x, value), pressure, own_factor, near_contact), value)


def _solved(problem, mu, x, pressure, own_factor, near_contact):
    """`solve` at a chemical potential."""
    if not problem.has_contact:
        return iterate(problem, starting(problem, mu, x, pressure), Chord(own_factor))
    if not (touches(x, problem.model) if near_contact is None else near_contact):
        free = problem.without_contact
        found = iterate(free, starting(free, mu, x, pressure), Chord(own_factor))
        if not (found.status.ok and touches(found.x, problem.model)):
            return dataclasses.replace(found, contact_active=False)
    found = dataclasses.replace(iterate(problem, starting(problem, mu, x, pressure), Chord(own_factor=True)), contact_active=True)
    return dataclasses.replace(found, status=of_outlines(found.x, problem.model, contact=True)) if found.status.ok else found


def with_own_factor(problem: Problem, state: State) -> State:
    """The state with a factor of its own tangent."""
    if state.linearisation is None:
        found = solve(problem, state.value, state.x, state.pressure, own_factor=True)
        return dataclasses.replace(found, newton_iterations=state.newton_iterations)
    acting = acting_problem(problem, state)
    return dataclasses.replace(state, factor=factorised_tangent(acting, state.x, state.pressure, state.linearisation))


# --- inside jit and vmap -----------------------------------------------------------------------------------------------------


def solve_traced(problem: Problem, value: Scalar, x: Array, pressure: jax.Array) -> tuple[jax.Array, jax.Array, dict[str, Any]]:
    """`solve` inside jit or vmap: positions (n, 2), pressures (g,) and a dict of status, newton_iterations and residual.

    The loop is a ``while_loop``; only the sparse solves leave for the host. Positions are nan where it did not converge.
    """
    start = problem.placed(x, value)
    problem, mu = problem.at(value)
    free, pattern = problem.free, problem.pattern

    def solved(linearisation):
        return (linearisation.residual_norm < TOLERANCE) & (linearisation.violation < CONSTRAINT_TOLERANCE)

    def going(iterate):
        _, _, linearisation, iterations = iterate
        finite = jnp.isfinite(linearisation.residual_norm + linearisation.violation)
        return ~solved(linearisation) & finite & (iterations < MAX_ITERATIONS)

    def step(iterate):
        x, p, linearisation, iterations = iterate
        pairs = tangent(problem, x, p, linearisation)
        rhs = condensed_rhs(problem, linearisation, linearisation)
        shape = jax.ShapeDtypeStruct((len(free),), x.dtype)
        dx = jax.pure_callback(functools.partial(_host_step, pattern), shape, rhs, pairs, vmap_method="sequential")
        return *_advanced(problem, x, p, mu, dx, linearisation, linearisation, 1.0), iterations + 1

    first = (start, pressure, linearise(problem, start, pressure, mu), jnp.asarray(0))
    x, p, linearisation, iterations = jax.lax.while_loop(going, step, first)
    finite = jnp.isfinite(linearisation.residual_norm + linearisation.violation)
    failed = jnp.where(finite, int(Status.NOT_CONVERGED), int(Status.NOT_FINITE))
    done = solved(linearisation)
    report = dict(status=jnp.where(done, int(Status.CONVERGED), failed), newton_iterations=iterations, residual=linearisation.residual_norm)
    return jnp.where(done, x, jnp.nan), p, report


def _host_step(pattern, rhs, pairs):
    """Newton correction (f,); nan where the tangent is singular."""
    try:
        return factor(pattern, pairs).solve(rhs)[0]
    except SingularTangent:
        return np.full(rhs.shape, np.nan)
