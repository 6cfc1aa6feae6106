"""Newton's method for a state whose amplitude along a mode is held."""

import jax.numpy as jnp
import numpy as np

from ..linalg import SingularTangent, factor
from ..mechanics import picked, reduced
from .newton import CONSTRAINT_TOLERANCE, MAX_ITERATIONS, TOLERANCE, _advance, free_rhs, linearised, tangent_at
from .state import Equilibrium, Status


def solve_pinned(problem, mu, x, pressure, mode, origin, amplitude):
    """``Equilibrium`` under a force along ``mode`` (f,) that holds mode . (x - origin) at ``amplitude``, and the force ().

    Newton's method on the system bordered by the pin; the tangent may be indefinite but must not be singular.
    """
    args = problem.model, problem.gel, jnp.asarray(mu, dtype=float), problem.loads, problem.fixed
    free, force, kept = problem.free, 0.0, None
    origin = np.asarray(picked(np.asarray(origin), free))
    now, measures = linearised(x, pressure, *args, free)
    for iterations in range(MAX_ITERATIONS):
        rhs = np.asarray(free_rhs(now, now, problem.model, free)) + force * mode
        miss = amplitude - mode @ (picked(np.asarray(x), free) - origin)
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging iterate ends as a status
            size = float(np.linalg.norm(np.asarray(reduced(now.rhs, free)) + force * mode) * float(measures[2]))
        if not np.isfinite(size + float(measures[1])):
            return Equilibrium(x, pressure, Status.NOT_FINITE, iterations, size, None), force
        if size < TOLERANCE and float(measures[1]) < CONSTRAINT_TOLERANCE and abs(miss) < 1e-9 * abs(amplitude):
            return Equilibrium(x, pressure, Status.CONVERGED, iterations, size, kept), force
        try:
            kept = factor(problem.pattern, tangent_at(x, pressure, now, *args[:2], problem.fixed))
            both, _ = kept.solve(np.stack([rhs, mode], axis=1))
        except SingularTangent:
            return Equilibrium(x, pressure, Status.SINGULAR, iterations, size, None), force
        more = (miss - mode @ both[:, 0]) / (mode @ both[:, 1])
        x, pressure, now, measures = _advance(x, pressure, both[:, 0] + more * both[:, 1], now, now, *args, free, 1.0)
        force += more
    return Equilibrium(x, pressure, Status.NOT_CONVERGED, MAX_ITERATIONS, size, None), force
