"""Other branches: along a mode from a critical point, past folds, by deflation, and with an imperfection.

A branch is followed in its arc length, ds^2 = dmu^2 + |dx|^2 / (n spacing^2) with the n nodes' displacements, so that folds are points
like any other (Keller's pseudo-arc-length continuation). States are the `path.Step`s of a `path.Path`, whose mu need not increase.
"""

import jax.numpy as jnp
import numpy as np

from ..equilibrium import Conditions, Status, Step, prepare, solve, solve_bordered
from ..mechanics import picked, spread
from .path import Path
from .stability import lowest_modes, nearby_modes, network_stiffness

FIRST_AMPLITUDE = 0.05  # of the spacing: largest displacement along the mode of the first state of a new branch
MAX_STATES = 200
LEAST_STEP = 1e-4  # of the largest


def switch(model, gel, point, *, sign=1, direction=None, mu_end=None, max_step=0.25, max_states=MAX_STATES, loads=None):
    """``Path`` of the branch that leaves a bifurcation along its mode, to ``mu_end`` or ``max_states`` states.

    ``sign`` 1 or -1 chooses the side, ``direction`` (m,) the combination of the modes of a multiple one (the first by default). The path
    may start towards lower mu (subcritical) and turn at a fold. ``path.stop`` says how it ended; ValueError for a fold, which no
    branch leaves.
    """
    if point.kind == "fold":
        raise ValueError(f"point: the {point.kind} at mu = {float(point.mu):.6g} has no other branch; use continue_branch")
    problem = prepare(model, gel, loads)
    direction = np.eye(point.multiplicity)[0] if direction is None else np.asarray(direction, dtype=float)
    mode = sign * np.tensordot(direction / np.linalg.norm(direction), point.modes, 1)
    along = picked(mode, problem.free)
    size = FIRST_AMPLITUDE * model.cloud.spacing / np.abs(along).max()
    row = along / np.linalg.norm(along)
    nothing = np.zeros((len(along), 0))
    steps = []
    for amplitude in (size, 2 * size):
        start = point.x + amplitude * mode if not steps else steps[-1].x + (amplitude - size) * mode
        target = amplitude * np.linalg.norm(along)
        conditions = Conditions(row[:, None], np.zeros(1), point.x, float(point.mu), np.array([target]))
        state, mu, _ = solve_bordered(problem, steps[-1].mu if steps else float(point.mu), start, point.pressure, nothing, conditions)
        if not state.status.ok:
            return _ended(problem, steps, state.status)
        steps.append(_step(problem, mu, state, steps))
    return _followed(problem, steps, mu_end, max_step, max_states)


def continue_branch(path, *, mu_end=None, max_step=0.25, max_states=MAX_STATES, loads=None):
    """``Path`` that goes on from the last two states of a path in its arc length, past folds, to ``mu_end`` or ``max_states`` states.

    It holds the new states only.
    """
    problem = prepare(path.model, path.gel, loads)
    if len(path) < 2:
        raise ValueError(f"path: {len(path)} states do not give a direction; it needs two")
    steps = [_bare(path, k) for k in (-2, -1)]
    return _followed(problem, steps, mu_end, max_step, max_states, known=2)


def solve_from(path, k, loads=None):
    """``Step`` under other ``loads`` from state ``k`` of a path, at its mu; ArithmeticError where Newton's method does not find one."""
    problem = prepare(path.model, path.gel, loads)
    state = solve(problem, float(path.mu[k]), jnp.asarray(path.x[k]), jnp.asarray(path.pressure[k]), fresh=True)
    if not state.status.ok:
        raise ArithmeticError(f"no state at mu = {float(path.mu[k]):.6g}: {state.status.text}")
    return _step(problem, float(path.mu[k]), state, [])


def _bare(path, k):
    return Step(
        mu=float(path.mu[k]),
        x=np.asarray(path.x[k]),
        pressure=np.asarray(path.pressure[k]),
        status=Status.CONVERGED,
        newton_iterations=0,
        residual=0.0,
        energy=float(path.energy[k]),
        negative_pivots=int(path.negative_pivots[k]),
    )


def _followed(problem, steps, mu_end, max_step, max_states, known=0):
    """Path of the states of ``steps`` but the first ``known``, continued in arc length."""
    free, spacing = problem.free, problem.model.cloud.spacing
    weight = 1 / (len(steps[0].x) * spacing**2)
    nothing, stop, length = np.zeros((len(free), 0)), Status.TOO_MANY_STEPS, None
    while len(steps) - known < max_states:
        old, last = steps[-2], steps[-1]
        dx, dmu = picked(np.asarray(last.x) - np.asarray(old.x), free), last.mu - old.mu
        done = np.sqrt(weight * dx @ dx + dmu**2)
        dx, dmu = dx / done, dmu / done
        length = min(1.5 * done if length is None else length, max_step)
        conditions = Conditions((weight * dx)[:, None], np.array([dmu]), np.asarray(last.x), last.mu, np.array([length]))
        start = last.x + length * np.asarray(spread(dx, last.x.shape, free))
        slope = (np.asarray(last.pressure) - np.asarray(old.pressure)) / done
        state, mu, _ = solve_bordered(problem, last.mu + length * dmu, start, last.pressure + length * slope, nothing, conditions)
        moved = picked(np.asarray(state.x) - np.asarray(last.x), free)
        forward = weight * (moved @ dx) + (mu - last.mu) * dmu
        turned = forward < 0.7 * np.sqrt(weight * moved @ moved + (mu - last.mu) ** 2)
        if not state.status.ok or turned:
            length *= 0.4
            if length < LEAST_STEP * max_step:
                stop = Status.STEP_TOO_SMALL if state.status.ok else state.status
                break
            continue
        if mu_end is not None and (mu - mu_end) * (last.mu - mu_end) <= 0 and mu != last.mu:
            share = (mu_end - last.mu) / (mu - last.mu)
            x, pressure = (old + share * (new - old) for old, new in ((last.x, state.x), (last.pressure, state.pressure)))
            at_end = solve(problem, mu_end, x, pressure, fresh=True)
            steps += [_step(problem, mu_end, at_end, steps)] if at_end.status.ok else []
            stop = at_end.status
            break
        steps.append(_step(problem, mu, state, steps))
        length *= 1.6 if state.iterations <= 4 else 1.0 if state.iterations <= 6 else 0.6
    return _ended(problem, steps[known:], stop)


def _ended(problem, steps, stop):
    if not steps:
        raise ArithmeticError(f"no state of the branch was found: {stop.text}")
    return Path.from_steps(problem.model, problem.gel, steps, stop=stop)


def _step(problem, mu, state, steps):
    """``Step`` of a state with a factor of its own tangent."""
    stiffness = network_stiffness(problem)
    modes, start = nearby_modes(problem, stiffness, state, mu, steps[-1].modes if steps else None)
    if modes is None:
        modes, state = lowest_modes(problem, stiffness, state, mu, start)
    return Step.at(problem, mu, state, modes)


def imperfection(model, gel, point, size, *, direction=None):
    """Dead nodal loads (n, 2), kT/v mm, that push along a bifurcation's mode: a sweep under them buckles without a bifurcation.

    ``size`` is the largest displacement, in node spacings, that they would cause in the dry network alone; its sign chooses the side.
    """
    problem = prepare(model, gel)
    direction = np.eye(point.multiplicity)[0] if direction is None else np.asarray(direction, dtype=float)
    mode = np.tensordot(direction, point.modes, 1)
    along = picked(mode, problem.free)
    force = network_stiffness(problem) @ along * (size * model.cloud.spacing / np.linalg.norm(mode, axis=1).max())
    free = problem.free
    return spread(force, mode.shape, free if free.ndim == 1 else free[:, 0])  # one node takes the force of what moves together
