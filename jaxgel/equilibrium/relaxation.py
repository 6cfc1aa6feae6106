"""Relaxation: how a state that lost its stability finds a stable one, as an overdamped gel does by itself.

Pseudo-transient continuation (Kelley & Keyes 1998): implicit Euler steps of N dx/dt = -r with the stiffness N of the dry network as
viscosity, (K + alpha N) dx = -r, where 1 / alpha is the step in time. Alpha stays large enough for a positive definite matrix, so the
energy falls and no saddle attracts, and goes to zero with the residual, which ends in Newton's method.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np

from ..linalg import SingularTangent, factor
from ..mechanics import spread
from .newton import CONSTRAINT_TOLERANCE, TOLERANCE, _advance, free_rhs, linearised, tangent_at
from .problem import overlaps
from .state import Equilibrium, Status

FIRST_DAMPING = 0.5  # alpha, in units of the network's stiffness like the eigenvalues of ``stability``
LARGEST_DAMPING = 1e4
MAX_ITERATIONS = 200
KICK = 0.02  # of the spacing: largest displacement along the mode that starts the motion


def relax(problem, mu, x, pressure):
    """Stable ``Equilibrium`` at ``mu`` into which positions ``x`` (n, 2) with pressures (g,) relax; its status says if none was found."""
    args = problem.model, problem.gel, jnp.asarray(mu, dtype=float), problem.loads, problem.fixed, problem.free
    now, measures = linearised(x, pressure, *args)
    damping, size, iterations, kept = FIRST_DAMPING, float(measures[0]), 0, None
    while np.isfinite(size) and iterations < MAX_ITERATIONS:
        if size < TOLERANCE and float(measures[1]) < CONSTRAINT_TOLERANCE and kept is not None:
            status = Status.CROSSED if overlaps(problem.model, x) else Status.CONVERGED
            return Equilibrium(x, pressure, status, iterations, size, kept)
        try:
            kept, damping = _definite(problem, tangent_at(x, pressure, now, *args[:2], problem.fixed), damping)
            correction, _ = kept.solve(np.asarray(free_rhs(now, now, problem.model, args[-1])), refine=False)
        except SingularTangent:
            return Equilibrium(x, pressure, Status.SINGULAR, iterations, size, None)
        x, pressure, now, measures = _advance(x, pressure, correction, now, now, *args, 1.0)
        iterations, before, size = iterations + 1, size, float(measures[0])
        damping *= np.clip(size / before, 0.2, 0.9)  # switched evolution relaxation, biased to longer steps
    status = Status.NOT_CONVERGED if np.isfinite(size) else Status.NOT_FINITE
    return Equilibrium(x, pressure, status, iterations, size, None)


def relax_along(problem, mu, state, mode):
    """``relax`` from an unstable ``Equilibrium``, pushed along ``mode`` (f,)."""
    amplitude = KICK * problem.model.cloud.spacing / np.abs(mode).max()
    x = state.x + spread(amplitude * mode, state.x.shape, problem.free)
    found = relax(problem, mu, x, state.pressure)
    return dataclasses.replace(found, iterations=found.iterations + state.iterations)


def _definite(problem, pairs, damping):
    """``Factor`` of the tangent ``pairs`` + damping N without negative pivots, and the damping that this took."""
    pairs, network = np.asarray(pairs), float(problem.gel.Nv) * np.asarray(problem.fixed.laplacian)[:, None, None] * np.eye(2)
    while damping < LARGEST_DAMPING:
        shifted = pairs.copy()
        shifted[: len(network)] += damping * network
        made = factor(problem.pattern, shifted)
        if made.negative_pivots == 0:
            return made, damping
        damping = 2 * damping + 0.01
    raise SingularTangent("no damping made the tangent positive definite")
