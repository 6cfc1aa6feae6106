"""Step control: given values of the control with cuts, adaptive steps.

Both yield accepted states one after another, each with its factor, and return how they ended: a `Status` and the value it belongs to.
``attempt(value, states)`` gives the state at a ``value``, whatever its status, after the accepted ``states``.
"""

import dataclasses
import itertools
from collections.abc import Callable, Generator

import numpy as np

from ..equilibrium import State, Status

NAMED = (Status.SELF_CONTACT, Status.LEAPT)  # failures that say more than that the step has become too small
MAX_CUTS = 8  # halvings of a step before the sweep gives up
SHORT = 5e-3  # of the way: shorter steps are not tried where the gel relaxes to no stable state from the unstable one at their end
GROWTH = {4: 2.0, 5: 1.6, 6: 1.3, 7: 1.1, 8: 1.0}  # of an adaptive step after so many corrections; 0.6 after more
Steps = Generator[State, None, tuple[Status, float]]


def given_values(attempt: Callable[[float, list[State]], State], values: list[float], before: list[State]) -> Steps:
    """States at the given values, after those ``before``; a failed step is cut, its intermediate states are not kept."""
    states = list(before)
    for value in values:
        state, status = _reach(attempt, value, states)
        if state is None:
            return status, states[-1].value if states else value
        states.append(state.light)
        yield state
        del state  # its factor is freed before the next factorisation
    return Status.CONVERGED, values[-1]


def _reach(attempt, target, states):
    """State at ``target``, by way of intermediate states where the direct step fails, and its status; or None and the reason."""
    history, spent, cuts, goal, switched = list(states), 0, 0, target, False
    while True:
        found = attempt(goal, history)
        spent += found.newton_iterations
        if found.status.ok:
            switched = switched or found.switched
            if goal == target:
                return dataclasses.replace(found, newton_iterations=spent, switched=switched), found.status
            history.append(found.light)
            goal = target if cuts <= 1 else _nearer(goal, 2 * goal - history[-2].value, target)
            cuts = max(0, cuts - 1)
        elif not history or cuts >= MAX_CUTS or found.status is Status.SELF_CONTACT:
            return None, found.status if not history or found.status in NAMED else Status.STEP_TOO_SMALL
        else:
            cuts += 1
            goal = history[-1].value + 0.5 * (goal - history[-1].value)


def adaptive(attempt: Callable, ends: list[float], before: list[State], max_steps: int) -> Steps:
    """States from the first to the last of the ``ends`` by way of those between, at which the control turns; at most ``max_steps``.

    The number of Newton iterations of a state sets the next step; the first of each way is an eighth of it.
    """
    states = list(before)
    for first, last in itertools.pairwise(ends):
        status, value = yield from _leg(attempt, first, last, states, max_steps)
        if status is not Status.CONVERGED:
            break
    return status, value


def _leg(attempt, first, last, states, max_steps):
    """States between two values, the first of which is found if there are no ``states`` yet; these are added to."""
    least, spent, step = 1e-5 * abs(last - first), 0, abs(last - first) / 8
    goal = _ahead(states[-1].value, step, last) if states else first
    while len(states) < max_steps:
        found = attempt(goal, states)
        spent += found.newton_iterations
        if found.status.ok:
            step *= 2.0 if found.newton_iterations < 4 else GROWTH.get(found.newton_iterations, 0.6)
            found, spent = dataclasses.replace(found, newton_iterations=spent), 0
            states.append(found.light)
            yield found
            if goal == last:
                return Status.CONVERGED, last
        elif not states or found.status is Status.SELF_CONTACT:
            return found.status, states[-1].value if states else goal
        else:
            step, ended = 0.4 * abs(goal - states[-1].value), found.status is Status.UNSTABLE
            if step < (SHORT * abs(last - first) if ended else least):
                return Status.UNSTABLE if ended else Status.STEP_TOO_SMALL, states[-1].value
        del found  # its factor is freed before the next factorisation
        goal = _ahead(states[-1].value, step, last)
    return Status.TOO_MANY_STEPS, states[-1].value


def _ahead(value, step, last):
    """The value a ``step`` towards ``last``, or that where little would be left to it."""
    left = last - value
    return last if abs(left) < 1.3 * step else value + np.copysign(step, left)


def _nearer(value, goal, last):
    """``goal`` or ``last``, whichever comes first on the way from ``value``."""
    return goal if abs(goal - value) < abs(last - value) else last
