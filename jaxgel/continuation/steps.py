"""Step control in the chemical potential: given values with cuts, adaptive steps."""

import dataclasses

import numpy as np

from ..equilibrium import Status

MAX_CUTS = 8  # halvings of a step in mu before the sweep gives up
GROWTH = {4: 2.0, 5: 1.6, 6: 1.3, 7: 1.1, 8: 1.0}  # of a chosen step after so many corrections; 0.6 after more


def _given(attempt, targets, on_step, before):
    """The states ``before`` and those at the given values; a failed step is cut, its intermediate states are not kept."""
    done = list(before)
    for target in targets:
        step, status = _reach(attempt, target, done)
        if step is None:
            return done, status, done[-1].mu if done else target
        step = step.told(on_step)
        done.append(step)
    return done, Status.CONVERGED, targets[-1]


def _reach(attempt, target, done):
    """Step at ``target`` from the states done, by way of intermediate states where the direct one fails; or None and a status."""
    history, spent, cuts, goal = list(done), 0, 0, target
    while True:
        found = attempt(goal, history)
        spent += found.newton_iterations
        if found.status.ok:
            if goal == target:
                return dataclasses.replace(found, newton_iterations=spent), found.status
            history.append(found)
            goal = target if cuts <= 1 else min(target, 2 * goal - history[-2].mu)
            cuts = max(0, cuts - 1)
        elif not history or cuts >= MAX_CUTS or found.status is Status.SELF_CONTACT:
            return None, found.status if not history or found.status is Status.SELF_CONTACT else Status.STEP_TOO_SMALL
        else:
            cuts += 1
            goal = history[-1].mu + 0.5 * (goal - history[-1].mu)


def _chosen(attempt, targets, on_step, before, max_steps):
    """The states ``before`` and those up to the last value, the step set by the number of Newton iterations the last one took."""
    first, last = targets
    done, least, spent = list(before), 1e-5 * (last - first), 0
    step = done[-1].stride if done and np.isfinite(done[-1].stride) else (last - first) / 8
    goal = _ahead(done[-1].mu, step, last) if done else first
    while len(done) < max_steps:
        found = attempt(goal, done)
        spent += found.newton_iterations
        if found.status.ok:
            step *= 2.0 if found.newton_iterations < 4 else GROWTH.get(found.newton_iterations, 0.6)
            found, spent = dataclasses.replace(found, newton_iterations=spent, stride=step).told(on_step), 0
            done.append(found)
            if goal >= last:
                return done, Status.CONVERGED, last
        elif not done or found.status is Status.SELF_CONTACT:
            return done, found.status, done[-1].mu if done else goal
        else:
            step = 0.4 * (goal - done[-1].mu)
            if step < least:
                return done, Status.STEP_TOO_SMALL, done[-1].mu
        goal = _ahead(done[-1].mu, step, last)
    return done, Status.TOO_MANY_STEPS, done[-1].mu


def _ahead(mu, step, last):
    """The mu a ``step`` ahead, or ``last`` where little would be left to it."""
    return last if mu + step > last - 0.3 * step else mu + step
