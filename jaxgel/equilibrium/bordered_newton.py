"""Equilibria that satisfy side conditions: held by unknown forces, or at an unknown chemical potential.

The unknowns are the positions x and pressures p, forces s along given columns C and, where there is one condition more than columns,
mu. The conditions are R (x - origin) + slope (mu - mu_origin) = target. Newton's method factorises the tangent with these rows and columns
around it, which is regular where the tangent itself is singular. In the mixed form dp carries -dmu, as the osmotic pressure at a
given volume ratio falls by what mu rises.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from ..linalg import Bordered, SingularTangent, factor
from ..mechanics import picked, pressure_step, reduced, residual, spread
from .newton import CONSTRAINT_TOLERANCE, TOLERANCE, free_rhs, linearised, tangent_at
from .state import Equilibrium, Status

MAX_ITERATIONS = 15
MISS = 1e-10  # largest error of a condition, relative to its target
ROUND_OFF = 1e-13  # and relative to the positions


@dataclasses.dataclass(frozen=True, eq=False)
class Conditions:
    """b conditions on a state: rows . (x - origin) + slopes (mu - mu_origin) = targets."""

    rows: np.ndarray
    """(f, b) on the free degrees of freedom."""
    slopes: np.ndarray
    """(b,) on mu."""
    origin: np.ndarray
    """(n, 2) positions."""
    mu_origin: float
    """Chemical potential, kT."""
    targets: np.ndarray
    """(b,) values."""


def solve_bordered(problem, mu, x, pressure, columns, conditions):
    """``Equilibrium`` under forces along ``columns`` (f, m) that meets m or m + 1 ``Conditions``, its mu (), and the forces (m,).

    With m + 1 conditions mu is unknown too. The state has a factor of its own tangent.
    """
    free, model, gel = problem.free, problem.model, problem.gel
    forces, mu, origin = np.zeros(columns.shape[1]), float(mu), picked(np.asarray(conditions.origin), free)
    b, m = conditions.rows.shape[1], columns.shape[1]
    for iterations in range(MAX_ITERATIONS + 1):
        args = model, gel, jnp.asarray(mu), problem.loads, problem.fixed
        now, measures = linearised(x, pressure, *args, free)
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging iterate ends as a status
            size = float(np.linalg.norm(np.asarray(reduced(now.rhs, free)) + columns @ forces) * float(measures[2]))
        at = picked(np.asarray(x), free)
        miss = conditions.targets - (at - origin) @ conditions.rows - conditions.slopes * (mu - conditions.mu_origin)
        allowed = ROUND_OFF * np.linalg.norm(conditions.rows, axis=0) * np.linalg.norm(at) + MISS * np.abs(conditions.targets)
        met = size < TOLERANCE and float(measures[1]) < CONSTRAINT_TOLERANCE and np.all(np.abs(miss) <= allowed)
        if not np.isfinite(size + float(measures[1])) or (iterations == MAX_ITERATIONS and not met):
            status = Status.NOT_CONVERGED if np.isfinite(size) else Status.NOT_FINITE
            return Equilibrium(x, pressure, status, iterations, size, None), mu, forces
        try:
            pairs = tangent_at(x, pressure, now, model, gel, problem.fixed)
            if met:
                return Equilibrium(x, pressure, Status.CONVERGED, iterations, size, factor(problem.pattern, pairs)), mu, forces
            pattern = problem.pattern.fitting(pairs)
            sides = np.concatenate([columns, -mu_force(problem, x, mu)[:, None]], axis=1)[:, :b]
            corner = np.concatenate([np.zeros((b, m)), conditions.slopes[:, None]], axis=1)[:, :b]
            system = Bordered(pattern.tree.order, pattern.matrix(pairs), -sides, conditions.rows, corner)
            dx, change = system.solve(np.asarray(free_rhs(now, now, model, free)) + columns @ forces, miss)
        except SingularTangent:
            return Equilibrium(x, pressure, Status.SINGULAR, iterations, size, None), mu, forces
        forces, change_mu = forces + change[:m], float(change[m:].sum())
        x, pressure = _moved(x, pressure, dx, change_mu, now, model, free)
        mu += change_mu
    raise AssertionError("unreachable")


@jax.jit
def _moved(x, p, correction, change_mu, now, model, free):
    dx = spread(correction, x.shape, free)
    return x + dx, p + pressure_step(dx, now, now, model) - change_mu


def mu_force(problem, x, mu):
    """Derivative (f,) of the residual with respect to mu at the positions ``x`` (n, 2), mm."""
    force = _mu_force(x, problem.model, problem.gel, jnp.asarray(mu, dtype=float), problem.loads)
    return np.asarray(reduced(force, problem.free))


@jax.jit
def _mu_force(x, model, gel, mu, loads):
    return jax.jvp(lambda mu: residual(x, model, gel, mu, loads), (mu,), (1.0,))[1]
