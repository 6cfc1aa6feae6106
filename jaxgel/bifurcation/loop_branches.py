"""Branches of a hysteresis loop: states at any value, and the unstable branch between snaps."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .._validation import Inadmissible
from ..continuation import Path, StabilityAnalysis
from ..equilibrium import Stability, State, StateNotFound, accepted, solve
from ..mechanics import restrict
from .branches import MAX_STATES, arc_length, followed, leaving
from .points import CriticalPoint
from .search import inside

LONGEST = 0.1  # step along the unstable branch, in its arc length, or
FEWEST = 30  # of its steps from one end to the other, if these are farther apart
SAME = 1e-3  # of the spacing: how far two states of one branch at one value may be from each other
BEYOND = 0.25  # of the range: how far past its ends the unstable branch is followed


def unstable_branch(made: Any, before: State, after: State) -> tuple[Path | None, bool]:
    """Unstable branch of a `Loop` from ``fold_up``, and whether it joins the way down.

    ``before`` and ``after`` are the states on either side of that point; None without a branch.
    """
    problem, point, end = made.up.problem.prepared, made.fold_up, made.fold_down
    if point.kind == "fold":
        at = state_of_point(point)
        start = [before, accepted(problem, at, at.stability)]
    else:
        start, stop = leaving(
            problem, point, np.copysign(1.0, _along(problem, point, after.x)) * point.modes[0]
        )
        if not stop.ok:
            return None, False
    far = point if end is None else end
    longest = max(LONGEST, arc_length(problem, (after.x, point.value), (far.x, far.value)) / FEWEST)
    search = _End(made, longest)
    path = followed(problem, start, None, longest, MAX_STATES, given=1, until=search)
    between = np.flatnonzero(path.negative_pivots > 0)
    # the last one may lie behind the end
    between = between[:-1] if search.joined and end.kind != "fold" else between
    return path[between] if len(between) else None, search.joined


def _along(problem, point, x):
    """Amplitude of the first mode of a point at the positions ``x``."""
    free, stiffness = problem.free, StabilityAnalysis(problem).stiffness
    return restrict(np.asarray(x) - np.asarray(point.x), free) @ (
        stiffness @ restrict(point.modes[0], free)
    )


def state_of_point(point: CriticalPoint) -> State:
    """The `State` of a critical point.

    Its negative eigenvalues are not counted, since one eigenvalue is 0 but for round-off.
    """
    stability = Stability(-1, np.asarray(point.eigenvalues))
    return State(float(point.value), float(point.mu), point.x, point.pressure, stability=stability)


class _End:
    """Whether a state is the last one of the unstable branch of a loop.

    There it joins the way down, or leaves the range of the control.
    """

    def __init__(self, made, longest):
        self.made, self.longest, self.joined = made, longest, False
        self.low, self.high = sorted(made.up.value[[0, -1]])

    def __call__(self, state):
        room, end = BEYOND * (self.high - self.low), self.made.fold_down
        if not inside(state.value, self.low, self.high, room):
            return True
        if end is None:
            return False
        if end.kind == "fold":
            self.joined = (
                state.negative_pivots == 0
                and inside(state.value, self.low, self.high)
                and self._is_stable_one(state)
            )
        else:
            self.joined = (
                arc_length(self.made.up.problem, (state.x, state.value), (end.x, end.value))
                < self.longest
            )
        return self.joined

    def _is_stable_one(self, state):
        """Whether a stable state is that of the way down."""
        spacing = self.made.up.model.cloud.spacing
        try:
            other = state_at(self.made.down, state.value, self.made.jumps_down)
        except (StateNotFound, Inadmissible):  # no state was found, or the way down ended before
            return False
        return float(np.abs(np.asarray(other.x) - np.asarray(state.x)).max()) < SAME * spacing


def state_at(path: Path, value: float, jumps: Sequence[CriticalPoint]) -> State:
    """Stable `State` at a ``value`` of the control on one way of a loop."""
    k = next(
        (
            k
            for k in range(len(path) - 1)
            if min(path.value[k : k + 2]) <= value <= max(path.value[k : k + 2])
        ),
        None,
    )
    name = path.control.name
    if k is None:
        low, high = sorted(path.value[[0, -1]])
        raise Inadmissible(
            f"{name}: {value:g} is outside of the loop, which goes from {low:g} to {high:g}"
        )
    before, after = path[k], path[k + 1]
    share = (value - before.value) / (after.value - before.value)
    if after.switched:
        limits = [
            float(point.value)
            for point in jumps
            if inside(float(point.value), before.value, after.value)
        ]
        share = 0.0 if limits and (value - limits[0]) * (after.value - before.value) < 0 else 1.0
    x, pressure = (
        here + share * (there - here)
        for here, there in ((before.x, after.x), (before.pressure, after.pressure))
    )
    problem = path.problem.prepared
    found = solve(problem, float(value), x, pressure, own_factor=True)
    if not found.status.ok:
        raise StateNotFound(f"no state at {name} = {value:.6g}: {found.status.text}")
    return accepted(problem, found, Stability(found.factor.negative_pivots)).light
