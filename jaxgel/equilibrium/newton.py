"""Equilibrium at one chemical potential: Newton's method on the mixed form, with a status that says how it ended.

The loop runs on the host, so that a person sees each step; its kernels are compiled once per model shape, with everything that
changes along a sweep traced.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from ..linalg import SingularTangent, factor
from ..mechanics import condensed_rhs, constants, free_dofs, linearise, pressure_step, reduced, spread, step_limit, tangent, tangent_pattern
from .problem import acting, overlaps, touches
from .state import Equilibrium, Status

MAX_ITERATIONS = 30
TOLERANCE = 1e-10  # of the residual, relative to the forces of the network
CONSTRAINT_TOLERANCE = 1e-11  # of J - J*(p), see ``mixed.linearise``
FINE = 50  # spacings across the plate up to which round-off leaves less than a fifth of that; it grows with their number
SLOW = 0.1  # a step that leaves more than this of the imbalance makes a new factor worth its cost
LARGEST_RISE = 3.0  # of the imbalance in an iteration with contact: more is a pair of points thrown deep into each other, again and again
MAX_HALVINGS = 6  # of such a correction


def solve(problem, mu, x, pressure, *, fresh=False, near=None):
    """``Equilibrium`` at the chemical potential ``mu`` (kT), from positions ``x`` (n, 2) and pressures (g,).

    Newton's method on the mixed form (see ``mixed``): every p is feasible, so no line search guards J > 1. A factor serves for as
    long as each correction leaves less than ``SLOW`` of the imbalance; the last one is kept. With ``fresh`` every correction gets its
    own factor, and so does the solution. Contact is left out until an outline comes near itself: at the start, where ``near`` does not
    already say so, and in the solution. A state in which one crosses itself is not accepted.
    """
    if problem.apart is not None and not (touches(problem.model, x) if near is None else near):
        found = solve(problem.apart, mu, x, pressure, fresh=fresh)
        if not (found.status.ok and touches(problem.model, found.x)):
            return dataclasses.replace(found, apart=True)
    found = _newton(problem, mu, x, pressure, fresh=fresh or problem.apart is not None)
    if problem.apart is not None and found.status.ok and overlaps(problem.model, found.x):
        return dataclasses.replace(found, status=Status.CROSSED)
    return found


def with_own_factor(problem, mu, state):
    """The ``Equilibrium`` at ``mu`` (kT) with a factor of its own tangent."""
    if state.linearisation is None:
        return dataclasses.replace(solve(problem, mu, state.x, state.pressure, fresh=True), iterations=state.iterations)
    problem = acting(problem, state)
    pairs = tangent_at(state.x, state.pressure, state.linearisation, problem.model, problem.gel, problem.fixed)
    return dataclasses.replace(state, factor=factor(problem.pattern, pairs))


def _newton(problem, mu, x, pressure, *, fresh):
    args = problem.model, problem.gel, jnp.asarray(mu, dtype=float), problem.loads, problem.fixed
    now, measures = linearised(x, pressure, *args, problem.free)
    kept, basis, iterations, before = None, None, 0, np.inf
    while True:
        size, constraint = float(measures[0]), float(measures[1])
        if not np.isfinite(size + constraint):
            return Equilibrium(x, pressure, Status.NOT_FINITE, iterations, size, kept)
        if size < TOLERANCE and constraint < CONSTRAINT_TOLERANCE:
            if fresh:
                kept = None  # its memory is wanted
                kept = factor(problem.pattern, tangent_at(x, pressure, now, *args[:2], problem.fixed))
            return Equilibrium(x, pressure, Status.CONVERGED, iterations, size, kept, linearisation=now)
        if iterations == MAX_ITERATIONS:
            return Equilibrium(x, pressure, Status.NOT_CONVERGED, iterations, size, kept)
        imbalance = _imbalance(measures)
        try:
            if fresh or kept is None or imbalance > SLOW * before:
                basis, kept = now, None  # the memory of the last factor is wanted
                kept = factor(problem.pattern, tangent_at(x, pressure, basis, *args[:2], problem.fixed))
            rhs = free_rhs(now, basis, problem.model, problem.free)
            correction, _ = kept.solve(np.asarray(rhs), refine=False)
        except SingularTangent:
            return Equilibrium(x, pressure, Status.SINGULAR, iterations, size, kept)
        x, pressure, now, measures = _advanced(problem, x, pressure, correction, now, basis, imbalance, args)
        iterations, before = iterations + 1, imbalance


def _imbalance(measures):
    """The measures of `linearised` over their tolerances, the larger one."""
    return max(float(measures[0]) / TOLERANCE, float(measures[1]) / CONSTRAINT_TOLERANCE)


def _advanced(problem, x, pressure, correction, now, basis, imbalance, args):
    """``_advance`` by the whole correction, or where contact then multiplies the ``imbalance``, by half of it and so on."""
    whole = x, pressure, correction, now, basis, *args, problem.free
    found = _advance(*whole, 1.0)
    for halvings in range(1, MAX_HALVINGS + 1 if problem.apart is not None else 0):
        if _imbalance(found[3]) < max(LARGEST_RISE * imbalance, 1.0):
            break
        found = _advance(*whole, 0.5**halvings)
    return found


@jax.jit
def linearised(x, p, model, gel, mu, loads, fixed, free):
    """``mixed.linearise``, and the measures (relative residual, constraint, 1 / scale of the residual).

    The constraint is that of ``mixed.linearise`` over what a cloud as fine as this can reach: positions differ by a share spacing / size.
    """
    now, (network, constraint) = linearise(x, p, model, gel, mu, loads, fixed)
    topology = model.lists.topology
    across = max(topology.plate.width, topology.plate.height) / topology.node_spacing.min()
    constraint = constraint / max(1.0, across / FINE)
    per_force = 1 / (network + jnp.linalg.norm(loads))
    return now, (jnp.linalg.norm(reduced(now.rhs, free)) * per_force, constraint, per_force)


@jax.jit
def free_rhs(now, basis, model, free):
    """``mixed.condensed_rhs`` on the free degrees of freedom (f,)."""
    return reduced(condensed_rhs(now, basis, model), free)


tangent_at = jax.jit(tangent)
"""Compiled ``mixed.tangent``."""


@jax.jit
def _advance(x, p, correction, now, basis, model, gel, mu, loads, fixed, free, share):
    """Positions and pressures after a ``share`` of a correction (f,) of the free degrees of freedom, linearised there."""
    dx = spread(correction, x.shape, free)
    share = share * step_limit(x, dx, model) if model.contact is not None else share
    x, p = x + share * dx, p + share * pressure_step(dx, now, basis, model)
    return x, p, *linearised(x, p, model, gel, mu, loads, fixed, free)


def solve_traced(model, gel, mu, loads, x, pressure):
    """``solve`` inside jit or vmap: positions (n, 2), pressures (g,) and a dict of status, iterations, residual, negative pivots.

    The loop is a ``while_loop``; only the sparse solves leave for the host. Positions are nan where it did not converge.
    """
    pattern = tangent_pattern(model.lists, free_dofs(model.lists.topology), model.contact, model.solver)
    free, fixed = pattern.free, constants(model)
    args = model, gel, mu, loads, fixed, free

    def going(state):
        _, _, _, (size, constraint, _), iterations, _ = state
        done = (size < TOLERANCE) & (constraint < CONSTRAINT_TOLERANCE)
        return ~done & jnp.isfinite(size + constraint) & (iterations < MAX_ITERATIONS)

    def step(state):
        x, p, now, _, iterations, _ = state
        shapes = (jax.ShapeDtypeStruct(free.shape[:1], x.dtype), jax.ShapeDtypeStruct((), int))
        system = tangent(x, p, now, model, gel, fixed), free_rhs(now, now, model, free)
        correction, negative = jax.pure_callback(functools.partial(_host_step, pattern), shapes, *system, vmap_method="sequential")
        return *_advance(x, p, correction, now, now, *args, 1.0), iterations + 1, negative

    state = (x, pressure, *linearised(x, pressure, *args), jnp.asarray(0), jnp.asarray(0))
    x, p, _, (size, constraint, _), iterations, negative = jax.lax.while_loop(going, step, state)
    done = (size < TOLERANCE) & (constraint < CONSTRAINT_TOLERANCE)
    failed = jnp.where(jnp.isfinite(size + constraint), int(Status.NOT_CONVERGED), int(Status.NOT_FINITE))
    status = jnp.where(done, int(Status.CONVERGED), failed)
    report = dict(status=status, newton_iterations=iterations, residual=size, negative_pivots=negative)
    return jnp.where(done, x, jnp.nan), p, report


def _host_step(pattern, pairs, rhs):
    """Newton correction (f,) and number of negative pivots; nan and -1 where the tangent is singular."""
    try:
        made = factor(pattern, pairs)
        return made.solve(rhs)[0], np.asarray(made.negative_pivots)
    except SingularTangent:
        return np.full(rhs.shape, np.nan), np.asarray(-1)
