"""The first state of a sweep: directly, by moving edges in steps, or from lower mu."""

import dataclasses

from ..controls import Control
from ..equilibrium import Newton, Observer, State, StateNotFound, Status, dry_state, remedy, solve
from ..mechanics import Problem
from .predictor import predict
from .steps import Adaptive, adaptive

FAR_BELOW = 5.0  # kT: where a control's first state is approached from
# of the motion of a plate's edges, which may come in steps before the first state
LEAST_RAMP = 1 / 200


class SweepFailed(StateNotFound):
    """Not even the first state of a sweep was found; the text says why."""


def first_state_failed(control: Control, value: float, status: Status) -> SweepFailed:
    """The error of a sweep whose first state was not found."""
    return SweepFailed(
        f"sweep: no equilibrium at {control.name} = {value:.6g}: "
        f"{status.text}{remedy(status, control.name)}"
    )


def first_state(problem: Problem, value: float, newton: Newton, observer: Observer) -> State:
    """The first `State` of a sweep, whatever its status."""
    found = solve(problem, value, *dry_state(problem, value), newton=newton, observer=observer)
    if not found.status.ok and (problem.moves_edges or problem.model.cloud.plate.moved):
        found = _ramped(problem, value, found, newton)
    return found if found.status.ok else _approached(problem, value, found, newton)


def _ramped(problem, value, failed, newton):
    """First state of a plate whose edges move step by step, if moving them at once ``failed``."""
    model, pressure = problem.model, dry_state(problem)[1]
    whole, x = problem.dry_positions(value) - model.cloud.nodes, model.cloud.nodes
    share, step, iterations = 0.0, 1 / 8, failed.newton_iterations
    now, mu = problem.at(value)
    while share < 1:
        more = min(step, 1 - share)
        found = solve(now, mu, x + more * whole, pressure, newton=newton)
        iterations += found.newton_iterations
        if found.status.ok:
            x, pressure, share = found.x, found.pressure, share + more
        elif step < LEAST_RAMP:
            break
        else:
            step /= 2
    return dataclasses.replace(found, value=value, newton_iterations=iterations)


def _approached(problem, value, failed, newton):
    """First state by way of lower mu on the dry gel's branch, if going there at once ``failed``."""
    (now, mu), start, spent = problem.at(value), dry_state(problem, value), failed.newton_iterations

    def attempt(mu, states):
        return solve(now, mu, *(predict(now, mu, states) if states else start), newton=newton)

    for found in adaptive(attempt, Adaptive(float(mu) - FAR_BELOW, float(mu)), []):
        spent += found.newton_iterations
        if found.mu == float(mu):
            return dataclasses.replace(found, value=value, newton_iterations=spent)
    return dataclasses.replace(failed, newton_iterations=spent)
