"""Limits of stability: folds and bifurcations at which a sweep jumps from its stable branch."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..continuation import predict
from ..equilibrium import State, control_force, solve
from ..mechanics import restrict
from .points import CriticalPoint
from .search import Shared, counted, crossings, fold_next_to, heads_for_fold, inside

WORK = 1e-6  # of the control's force along the mode, relative: less is that of a bifurcation
# lowest eigenvalue at a fold, over the network's stiffness: 4e-11 at most were seen, 2e-5 short of
# a bifurcation
VANISHING = 1e-8
# imperfection of a bifurcation, which is round-off: with a larger one the branch ends at a fold
PERFECT = 1e-9
# of the way from the last state on a branch to the first on another, in search of its end
HALVES = 12


@dataclasses.dataclass(frozen=True, eq=False)
class Limit:
    """A jump of a sweep."""

    at: int
    """Number of the state after it."""
    point: CriticalPoint | None
    """Fold or subcritical bifurcation at which the branch ends; None if it was not located."""


def limits_of(shared: Shared, states: Sequence[State]) -> list[Limit]:
    """The jumps between ``states`` that a sweep found on stable branches, in their order.

    Supercritical bifurcations are none.
    """
    found = []
    for k in range(1, len(states)):
        earlier, before, after = states[k - 2] if k > 1 else None, states[k - 1], states[k]
        if earlier is not None and (
            before.switched or (before.value - earlier.value) * (after.value - before.value) < 0
        ):
            earlier = None  # of another branch, or on the other side
        if after.switched:
            points = _bifurcations(shared, earlier, before, after)
            if not points or any(map(_is_upheld, points)):
                points = (
                    _folds(shared, earlier, before, after)
                    or _last_folds(shared, before, after)
                    or points
                )
            limits = [point for point in points if point.kind == "fold" or point.subcritical]
            passed = bool(points) and not limits  # supercritical ones
            found += [] if passed else [Limit(k, limits[0] if limits else None)]
        elif earlier is not None and heads_for_fold(earlier, before, after.value):
            found += [Limit(k, point) for point in _folds(shared, earlier, before, after)]
    return found


def _folds(shared, earlier, before, after):
    """[fold] between two states on the branch that leads from ``earlier`` to ``before``, or []."""
    if earlier is None:
        return []
    found = fold_next_to(shared, earlier, before)
    return [
        fold
        for fold in found
        if inside(fold.value, before.value, after.value, shared.tolerance)
        and _is_fold(shared, fold)
    ]


def _is_fold(shared, point):
    """Whether the tangent is singular and the control does work on the mode, as at a fold.

    It does none if a branch ends at a symmetric one. Towards such an end both vanish like the way
    that is left, and the search for a fold stops short of it.
    """
    if abs(point.eigenvalues[0]) > VANISHING:
        return False
    state = State(point.value, point.mu, point.x, point.pressure)
    force, mode = (
        control_force(shared.problem, state),
        restrict(point.modes[0], shared.problem.free),
    )
    return abs(force @ mode) > WORK * np.linalg.norm(force) * np.linalg.norm(mode)


def _bifurcations(shared, earlier, before, after):
    """Critical points between two states on the branch of ``before``.

    If that goes on, unstable, to the value of ``after``.
    """
    start = [np.asarray(before.x), np.asarray(before.pressure)]
    if earlier is not None:
        share = (after.value - before.value) / (before.value - earlier.value)
        start = [
            here + share * (here - there)
            for here, there in zip(start, (earlier.x, earlier.pressure), strict=True)
        ]
    beyond = solve(shared.problem, after.value, *start, own_factor=True)
    return crossings(shared, earlier, before, counted(beyond)) if beyond.status.ok else []


def _is_upheld(point):
    """Whether only a force holds a state at a subcritical bifurcation.

    The branch of an imperfect plate folds back before it.
    """
    return point.kind == "bifurcation" and point.subcritical and point.imperfection > PERFECT


def _last_folds(shared, before, after):
    """[fold] at which the branch of ``before`` ends before the value of ``after``; [] without one.

    It is located from states ever nearer to it.
    """
    states, beyond = [before], after.value
    for _ in range(HALVES):
        value = 0.5 * (states[-1].value + beyond)
        found = solve(
            shared.problem, value, *predict(shared.problem, value, states[-2:]), own_factor=True
        )
        near = (
            found.status.ok
            and np.abs(found.x - states[-1].x).max() < np.abs(found.x - after.x).max()
        )
        if near and found.factor.negative_pivots == before.negative_pivots:
            states.append(counted(found))
        else:
            beyond = value
    return _folds(shared, *states[-2:], after) if len(states) > 1 else []
