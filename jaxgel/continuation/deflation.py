"""Further equilibria at one chemical potential, by deflation."""

import jax
import jax.numpy as jnp
import numpy as np

from ..equilibrium import CONSTRAINT_TOLERANCE, TOLERANCE, Equilibrium, Status, free_rhs, linearised, prepare, tangent_at
from ..linalg import SingularTangent, factor
from ..mechanics import picked, pressure_step, spread, state_pressure

MAX_DEFLATED = 60  # Newton iterations of a deflated solve


def deflated(model, gel, *, mu, known, starts, loads=None):
    """``Equilibrium`` states at one mu that are not among the positions ``known`` (k, n, 2), from the positions ``starts`` (s, n, 2).

    Newton's method on the residual times prod_i (1 + n spacing^2 / |x - x_i|^2), which does not vanish at the known states (Farrell,
    Birkisson & Funke 2015): its step is Newton's own, stretched. Each state that is found is deflated too.
    """
    problem, known, found = prepare(model, gel, loads), [np.asarray(x) for x in known], []
    for start in starts:
        pressure = state_pressure(jnp.asarray(start), model, problem.gel, mu)
        pressure = jnp.where(jnp.isfinite(pressure), pressure, -problem.gel.Nv)
        state = _deflated_newton(problem, mu, jnp.asarray(start), pressure, known)
        if state.status.ok:
            known.append(np.asarray(state.x))
            found.append(state)
    return found


def _deflated_newton(problem, mu, x, pressure, known):
    args = problem.model, problem.gel, jnp.asarray(mu, dtype=float), problem.loads, problem.fixed
    free = problem.free
    weight = 1 / (x.shape[0] * problem.model.cloud.spacing**2)
    now, measures = linearised(x, pressure, *args, free)
    for iterations in range(MAX_DEFLATED + 1):
        size, constraint = float(measures[0]), float(measures[1])
        if not np.isfinite(size + constraint) or np.abs(np.asarray(x)).max() > 1e3 * problem.model.cloud.plate.width:
            break
        if size < TOLERANCE and constraint < CONSTRAINT_TOLERANCE:
            made = factor(problem.pattern, tangent_at(x, pressure, now, *args[:2], problem.fixed))
            return Equilibrium(x, pressure, Status.CONVERGED, iterations, size, made)
        try:
            made = factor(problem.pattern, tangent_at(x, pressure, now, *args[:2], problem.fixed))
            step, _ = made.solve(np.asarray(free_rhs(now, now, problem.model, free)), refine=False)
        except SingularTangent:
            break
        slope = 0.0  # of log prod_i (1 + 1 / d_i) along the step, d_i the squared distance
        for other in known:
            apart = picked(np.asarray(x) - other, free)
            d = weight * apart @ apart
            slope -= 2 * weight * (apart @ step) / (d * (d + 1))
        most = problem.model.cloud.spacing / np.abs(step).max()
        stretch = np.clip(1 / (1 - slope) if slope != 1 else most, -most, most)
        x, pressure, now, measures = _stretched(x, pressure, step, stretch, now, *args, free)
    return Equilibrium(x, pressure, Status.NOT_CONVERGED, iterations, size, None)


@jax.jit
def _stretched(x, p, step, stretch, now, model, gel, mu, loads, fixed, free):
    dx = spread(step, x.shape, free)
    x, p = x + stretch * dx, p + stretch * pressure_step(dx, now, now, model)
    return x, p, *linearised(x, p, model, gel, mu, loads, fixed, free)
