"""Step control in the chemical potential: given values with cuts, adaptive steps.

Both yield accepted states one after another, each with its factor, and return how they ended: a `Status` and the mu it belongs to.
``attempt(mu, states)`` gives the state at ``mu``, whatever its status, after the accepted ``states``.
"""

import dataclasses
from collections.abc import Callable, Generator

import numpy as np

from ..equilibrium import State, Status

MAX_CUTS = 8  # halvings of a step in mu before the sweep gives up
GROWTH = {4: 2.0, 5: 1.6, 6: 1.3, 7: 1.1, 8: 1.0}  # of an adaptive step after so many corrections; 0.6 after more
Steps = Generator[State, None, tuple[Status, float]]


def given_values(attempt: Callable, values: list[float], before: list[State]) -> Steps:
    """States at the given values of mu, after those ``before``; a failed step is cut, its intermediate states are not kept."""
    states = list(before)
    for mu in values:
        state, status = _reach(attempt, mu, states)
        if state is None:
            return status, states[-1].mu if states else mu
        states.append(state.light)
        yield state
        del state  # its factor is freed before the next factorisation
    return Status.CONVERGED, values[-1]


def _reach(attempt, target, states):
    """State at ``target``, by way of intermediate states where the direct step fails, and its status; or None and the reason."""
    history, spent, cuts, goal = list(states), 0, 0, target
    while True:
        found = attempt(goal, history)
        spent += found.newton_iterations
        if found.status.ok:
            if goal == target:
                return dataclasses.replace(found, newton_iterations=spent), found.status
            history.append(found.light)
            goal = target if cuts <= 1 else min(target, 2 * goal - history[-2].mu)
            cuts = max(0, cuts - 1)
        elif not history or cuts >= MAX_CUTS or found.status is Status.SELF_CONTACT:
            return None, found.status if not history or found.status is Status.SELF_CONTACT else Status.STEP_TOO_SMALL
        else:
            cuts += 1
            goal = history[-1].mu + 0.5 * (goal - history[-1].mu)


def adaptive(attempt: Callable, ends: tuple[float, float], before: list[State], max_steps: int) -> Steps:
    """States from the first to the last value, at most ``max_steps``; the number of Newton iterations of a state sets the next step."""
    first, last = ends
    states, least, spent = list(before), 1e-5 * (last - first), 0
    step = states[-1].stride if states and np.isfinite(states[-1].stride) else (last - first) / 8
    goal = _ahead(states[-1].mu, step, last) if states else first
    while len(states) < max_steps:
        found = attempt(goal, states)
        spent += found.newton_iterations
        if found.status.ok:
            step *= 2.0 if found.newton_iterations < 4 else GROWTH.get(found.newton_iterations, 0.6)
            found, spent = dataclasses.replace(found, newton_iterations=spent, stride=step), 0
            states.append(found.light)
            yield found
            if goal >= last:
                return Status.CONVERGED, last
        elif not states or found.status is Status.SELF_CONTACT:
            return found.status, states[-1].mu if states else goal
        else:
            step = 0.4 * (goal - states[-1].mu)
            if step < least:
                return Status.STEP_TOO_SMALL, states[-1].mu
        del found  # its factor is freed before the next factorisation
        goal = _ahead(states[-1].mu, step, last)
    return Status.TOO_MANY_STEPS, states[-1].mu


def _ahead(mu, step, last):
    """The mu a ``step`` ahead, or ``last`` where little would be left to it."""
    return last if mu + step > last - 0.3 * step else mu + step
