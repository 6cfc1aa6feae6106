"""Step control: prescribed values of the control with step cuts, and adaptive steps.

Both yield accepted states one after another, each with its factor, and return how they ended: a
`Status` and the value it belongs to. ``attempt(value, states)`` gives the state at a ``value``,
whatever its status, after the accepted ``states``.
"""

import dataclasses
import itertools
from collections.abc import Callable, Generator

import numpy as np

from ..equilibrium import Change, State, Status

# failures that say more than that the step has become too small
NAMED = (Status.SELF_CONTACT, Status.LEAPT)
MAX_STEPS = 400  # accepted states of a sweep with chosen steps
# of the way: shorter steps are not tried if the gel relaxes to no stable state from the unstable
# one at their end
SHORT = 5e-3
# of an adaptive step after so many corrections; 0.6 after more
GROWTH = {4: 2.0, 5: 1.6, 6: 1.3, 7: 1.1, 8: 1.0}
Steps = Generator[State, None, tuple[Status, float]]


@dataclasses.dataclass(frozen=True, init=False)
class Adaptive:
    """Range of a control in which a sweep chooses its steps; a user's argument of `sweep`.

    `Adaptive(first, last, *others)`: the first value, those at which the control turns, and the
    last. Raises `ValueError`, one line, for values that are not numbers, and for traced ones.

    >>> Adaptive(25.0, 40.0, 25.0).values
    (25.0, 40.0, 25.0)
    """

    values: tuple[float, ...]
    """The first value, the turning points, and the last, in the unit of the control."""
    max_steps: int
    """Largest number of accepted states."""

    def __init__(
        self, first: float, last: float, *others: float, max_steps: int = MAX_STEPS
    ) -> None:
        try:
            values = tuple(map(float, (first, last, *others)))
        except (TypeError, ValueError):  # JAX's errors for traced values are TypeErrors
            raise ValueError(
                "Adaptive: the ends must be concrete numbers; differentiate a sweep over a list "
                "of values instead"
            ) from None
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "max_steps", max_steps)


@dataclasses.dataclass(frozen=True)
class StepControl:
    """Criteria to refuse or cut a step of the control, or take it for a jump; argument of `sweep`.

    The defaults serve every example of jaxgel. A jump whose step would be longer than `snap` or
    `leap` is approached in shorter steps, so that it has a definite value of the control.
    """

    max_cuts: int = 8
    """Largest number of halvings of a step to a given value."""
    first_step: float = 0.125
    """First adaptive step, as a share of the range between two ends."""
    least_step: float = 1e-5
    """Share of the range between two ends or values; a shorter step that fails ends the sweep."""
    snap: float = 5e-3
    """Largest failed step, in the control's scale, that counts as the end of the stable branch.

    The gel then relaxes to another state."""
    leap: float = 2e-2
    """Longest step, in the control's scale, in which a gel may change its phase."""
    foreseen: float = 0.2
    """Deviation of ln J from its prediction from which a part of the gel has changed its phase."""
    much: float = 0.2
    """Least volume fraction of the gel that changes its phase in a jump."""


STEP_CONTROL = StepControl()


def given_values(
    attempt: Callable[[float, list[State]], State],
    values: list[float],
    before: list[State],
    control: StepControl = STEP_CONTROL,
) -> Steps:
    """States at the given values, after those ``before``; failed steps are halved.

    The intermediate states of a step that is cut are not kept.
    """
    states = list(before)
    for value in values:
        state, status = _reach(attempt, value, states, control)
        if state is None:
            return status, states[-1].value if states else value
        states.append(state.light)
        yield state
        del state  # its factor is freed before the next factorisation
    return Status.CONVERGED, values[-1]


def _reach(attempt, target, states, control):
    """State at ``target``, by way of intermediate states if the direct step fails, and its status.

    Or None and the reason.
    """
    history, spent, cuts, goal, switched = list(states), 0, 0, target, Change.NONE
    least = control.least_step * abs(target - states[-1].value) if states else 0.0
    while True:
        found = attempt(goal, history)
        spent += found.newton_iterations
        if found.status.ok:
            switched = switched or found.switched
            if goal == target:
                return dataclasses.replace(
                    found, newton_iterations=spent, switched=switched
                ), found.status
            history.append(found.light)
            goal = target if cuts <= 1 else _nearer(goal, 2 * goal - history[-2].value, target)
            cuts = max(0, cuts - 1)
        elif (
            not history
            or cuts >= control.max_cuts
            or abs(goal - history[-1].value) < least
            or found.status is Status.SELF_CONTACT
        ):
            return (
                None,
                found.status if not history or found.status in NAMED else Status.STEP_TOO_SMALL,
            )
        else:
            cuts += 1
            goal = history[-1].value + 0.5 * (goal - history[-1].value)


def adaptive(
    attempt: Callable, ends: Adaptive, before: list[State], control: StepControl = STEP_CONTROL
) -> Steps:
    """States from the first to the last of the ``ends``, turning at those between.

    They continue those ``before``. The number of Newton iterations of a state sets the next step.
    """
    states = list(before)
    for first, last in itertools.pairwise(ends.values):
        status, value = yield from _leg(attempt, first, last, states, ends.max_steps, control)
        if status is not Status.CONVERGED:
            break
    return status, value


def _leg(attempt, first, last, states, max_steps, control):
    """States between two values, the first of which is found if there are no ``states`` yet.

    These are added to.
    """
    least, spent, step = (
        control.least_step * abs(last - first),
        0,
        control.first_step * abs(last - first),
    )
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
    """The value a ``step`` towards ``last``, or that if little would be left to it."""
    left = last - value
    return last if abs(left) < 1.3 * step else value + np.copysign(step, left)


def _nearer(value, goal, last):
    """``goal`` or ``last``, whichever comes first on the way from ``value``."""
    return goal if abs(goal - value) < abs(last - value) else last
