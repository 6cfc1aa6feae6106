"""Newton's method in a compiled program: `newton.solve` without contact, stable branch."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from .._types import Array, Bool, Chemical, Float, Int
from ..linalg import Elimination, Factors, is_definite
from ..mechanics import (
    Equations,
    Linearisation,
    condensed_rhs,
    linearise,
    pressure_step,
    scatter,
    tangent_blocks,
)
from .newton import SLOW, Newton
from .status import Status

ITERATING = -1  # in place of a `Status`


class Iterate(NamedTuple):
    """An iterate, or the state in which the iteration has ended."""

    x: Float[Array, "n 2"]
    """Nodal positions, mm."""
    pressure: Float[Array, " g"]
    """Pressure of the volume groups, kT/v."""
    factors: Factors
    """Factor of a tangent: of the state's own if it converged."""
    factorised_at: Linearisation
    """The mixed form that this tangent belongs to."""
    linearisation: Linearisation
    """The mixed form about the iterate before; about the state itself if it converged."""
    error: Float[Array, ""]
    """Larger of residual norm and constraint violation of the last iterate over tolerances."""
    iterations: Int[Array, ""]
    """Linear solves so far."""
    status: Int[Array, ""]
    """`Status`, or ``ITERATING``."""


def first_iterate(
    problem: Equations,
    elimination: Elimination,
    value: Chemical,
    x: Float[Array, "n 2"],
    pressure: Float[Array, " g"],
) -> Iterate:
    """An iterate at a ``value`` with positions ``x`` and ``pressure``, without a usable factor.

    It is a value of the control.
    """
    problem, mu = problem.at(value)
    shapes = jax.eval_shape(lambda: linearise(problem, x, pressure, mu))
    now = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), shapes)
    sizes = jax.eval_shape(lambda: elimination.cholesky(tangent_blocks(problem, x, pressure, now)))
    factors = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), sizes)
    return Iterate(
        x, pressure, factors, now, now, jnp.zeros(()), jnp.zeros((), int), jnp.asarray(ITERATING)
    )


def solve_traced(
    problem: Equations,
    elimination: Elimination,
    value: Chemical,
    x: Float[Array, "n 2"],
    pressure: Float[Array, " g"],
    last: Iterate,
    has_factor: Bool[Array, ""],
    newton: Newton,
) -> Iterate:
    """Final `Iterate` of Newton's method at a ``value`` from ``x``, mm, and ``pressure``, kT/v.

    It is a value of the control. The first corrections use the factor of the ``last`` state if it
    ``has_factor``. A tangent that is not positive definite ends it with the status
    ``LOST_STABILITY``.
    """
    now, mu = problem.at(value)

    def correct(at: Iterate) -> Iterate:
        linearisation = linearise(now, at.x, at.pressure, mu)
        residual, violation = (
            linearisation.residual_norm / newton.tolerance,
            linearisation.violation,
        )
        error = jnp.maximum(residual, violation / newton.constraint_tolerance)
        solved, finite = error < 1, jnp.isfinite(error)

        def factorised():
            return elimination.cholesky(
                tangent_blocks(now, at.x, at.pressure, linearisation)
            ), linearisation

        fresh = solved | (error > SLOW * at.error)
        factors, there = lax.cond(fresh, factorised, lambda: (at.factors, at.factorised_at))
        definite = is_definite(factors)
        ended = [~finite, ~definite, solved, at.iterations >= newton.max_iterations]
        status = (Status.NOT_FINITE, Status.LOST_STABILITY, Status.CONVERGED, Status.NOT_CONVERGED)
        status = jnp.select(ended, [jnp.asarray(int(one)) for one in status], ITERATING)

        def corrected():
            rhs = condensed_rhs(now, linearisation, there)
            size = elimination.size
            solution = jnp.zeros(rhs.shape).at[:size].set(elimination.solve(factors, rhs[:size]))
            dx = scatter(solution, now.free)
            return at.x + dx, at.pressure + pressure_step(dx, linearisation, there, now.model)

        moved, pressed = lax.cond(status == ITERATING, corrected, lambda: (at.x, at.pressure))
        iterations = at.iterations + (status == ITERATING)
        return Iterate(moved, pressed, factors, there, linearisation, error, iterations, status)

    start = last._replace(
        x=problem.placed(x, value),
        pressure=pressure,
        error=jnp.where(has_factor, jnp.inf, 0.0),
        iterations=jnp.zeros((), int),
        status=jnp.asarray(ITERATING),
    )
    return lax.while_loop(lambda at: at.status == ITERATING, correct, start)
