"""One state of a sweep after another, with contact and branches."""

import dataclasses

import numpy as np

from ..equilibrium import Equilibrium, Status, Step, dry_state, incremental_step, overlaps, relax, relax_along, solve, touches, wall_step
from .predictor import _predict, _rate, _same_branch
from .stability import lowest_modes, nearby_modes, stable_state

SNAP = 5e-3  # kT: a step this short that fails with contact ends on another branch, by relaxation
LEAST_RAMP = 1 / 200  # of the motion of a plate's edges, which may come in steps before the first state


class SweepFailed(ArithmeticError):
    """Not even the first state of a sweep was found; the text says why."""


def _weak_attempt(problem, mu, done):
    """``Step`` at ``mu`` of a model whose essential conditions are imposed weakly."""
    return wall_step(problem, mu, *_predict(problem, mu, _same_branch(done)))


def _incremental_attempt(problem, mu, done):
    """``Step`` at ``mu`` by the paper's algorithm."""
    return incremental_step(problem, mu, _predict(problem, mu, _same_branch(done))[0] if done else None)


def _until_contact(attempt, model, mu, done):
    """``attempt`` that ends the sweep where hole boundaries overlap."""
    step = attempt(mu, done)
    return dataclasses.replace(step, status=Status.SELF_CONTACT) if step.status.ok and overlaps(model, step.x) else step


def _attempt(problem, stiffness, stable, mu, done):
    """``Step`` at ``mu`` (whatever its status) from the state extrapolated from those before on its branch."""
    history = _same_branch(done)
    (found, switched), modes = _reached(problem, stable, mu, history), None
    if found.status.ok:
        modes, start = nearby_modes(problem, stiffness, found, mu, history[-1].modes if history else None)
        if modes is None:
            found = dataclasses.replace(found, factor=None)  # its memory is wanted
            modes, found = lowest_modes(problem, stiffness, found, mu, start)
        other = _stable(problem, stiffness, mu, found, modes) if stable and modes.negative > 0 else None
        if other is not None:
            found, modes, switched = dataclasses.replace(other[0], iterations=found.iterations + other[0].iterations), other[1], True
    step = Step.at(problem, mu, found, modes, switched=switched)
    return step if done or not found.status.ok else dataclasses.replace(step, rate=_rate(problem, mu, found))


def _reached(problem, stable, mu, history):
    """``Equilibrium`` at ``mu`` from the state that ``history`` predicts, and whether it lies on another branch.

    Where holes touch, a step that moves the gel farther than the range of contact is refused, and a short one that fails relaxes.
    """
    x, pressure = _predict(problem, mu, history)
    if not history:
        found = solve(problem, mu, x, pressure)
        return found if found.status.ok or not problem.model.cloud.plate.moved else _ramped(problem, mu, found), False
    if problem.apart is None:
        return solve(problem, mu, x, pressure), False
    last, most = history[-1], float(problem.model.contact.range)
    far = not np.abs(x - last.x).max() < most
    acted = touches(problem.model, last.x) if last.apart is None else not last.apart
    near = (acted or far) and touches(problem.model, x)
    if far and (acted or near):
        return Equilibrium(x, pressure, Status.NOT_CONVERGED, 0, float("nan"), None), False
    found = solve(problem, mu, x, pressure, near=near)
    if found.status.ok and not found.apart and not np.abs(found.x - last.x).max() < most:
        found = dataclasses.replace(found, status=Status.NOT_CONVERGED)
    if found.status.ok or not stable or mu - last.mu > SNAP:
        return found, False
    relaxed = relax(problem, mu, last.x, last.pressure)
    return dataclasses.replace(relaxed, iterations=found.iterations + relaxed.iterations), relaxed.status.ok


def _ramped(problem, mu, failed):
    """First ``Equilibrium`` of a plate whose edges are moved step by step, where moving them at once ``failed``."""
    model, (x, pressure) = problem.model, dry_state(problem.model, problem.gel)
    whole, x = x - model.cloud.nodes, model.cloud.nodes
    share, step, iterations = 0.0, 1 / 8, failed.iterations
    while share < 1:
        more = min(step, 1 - share)
        found = solve(problem, mu, x + more * whole, pressure)
        iterations += found.iterations
        if found.status.ok:
            x, pressure, share = found.x, found.pressure, share + more
        elif step < LEAST_RAMP:
            break
        else:
            step /= 2
    return dataclasses.replace(found, iterations=iterations)


def _stable(problem, stiffness, mu, found, modes):
    """Stable ``Equilibrium`` and its ``Modes`` from an unstable one: next to it on a branch that leaves there, or by relaxation."""
    other = None if problem.apart is not None and touches(problem.model, found.x) else stable_state(problem, mu, found, modes)
    if other is None and problem.apart is not None:
        state = relax_along(problem, mu, found, modes.vectors[:, 0])
        if state.status.ok:
            modes, state = lowest_modes(problem, stiffness, state, mu)
            other = (state, modes) if modes.negative == 0 else None
    return other
