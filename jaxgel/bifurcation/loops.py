"""Loops: the stable branch up and down along a control, the limits of stability at which it jumps, and the unstable branch between them."""

import dataclasses

import numpy as np
from jax.lax import stop_gradient

from .._threads import few_threads
from .._tracing import is_traced
from .._types import Scalar
from .._validation import Inadmissible
from ..continuation import (
    STEP_CONTROL,
    Adaptive,
    Followed,
    Following,
    Path,
    StabilityAnalysis,
    StepControl,
    check_sweep,
)
from ..equilibrium import NEWTON, UNOBSERVED, Change, Newton, Observer, Stability, State, StateNotFound, accepted, solve
from ..mechanics import Problem, restrict
from .branches import MAX_STATES, arc_length, followed, leaving
from .critical import ends_of, located, with_floats, without_derivatives_by
from .limits import limits_of
from .points import CriticalPoint
from .search import Searches, inside

MAX_STEPS = 400  # accepted states of both ways together
LONGEST = 0.1  # step along the unstable branch, in its arc length, or
FEWEST = 30  # of its steps from one end to the other, if these are farther apart
SAME = 1e-3  # of the spacing: how far two states of one branch at one value may be from each other
RESULTS = ("up", "down", "unstable", "jumps_up", "jumps_down")  # fields of a loop that were computed
BEYOND = 0.25  # of the range: how far past its ends the unstable branch is followed


@dataclasses.dataclass(frozen=True, eq=False)
class Loop:
    """The stable states of a gel driven from one value of a control to another and back, and where they jump."""

    up: Path
    """States from the first value to the last; ``switched`` after a jump, and where a branch leaves another one."""
    down: Path | None
    """States from the last value back to the first; None where the way up did not reach it."""
    jumps_up: tuple[CriticalPoint, ...]
    """Folds and subcritical bifurcations at which a stable branch ends on the way up; their ``value`` is differentiable, see `loop`."""
    jumps_down: tuple[CriticalPoint, ...]
    """Those on the way down."""
    unstable: Path | None
    """Unstable states from ``fold_up`` to ``fold_down``; None where there are none, or where they were not asked for."""
    joined: bool
    """Whether the unstable branch ends at ``fold_down``."""
    unlocated: tuple[float, ...] = ()
    """Values after jumps whose limit of stability was not found."""

    @property
    def fold_up(self) -> CriticalPoint | None:
        """Limit of stability at which the way up first leaves the branch of the first value; None where it does not."""
        return self.jumps_up[0] if self.jumps_up else None

    @property
    def fold_down(self) -> CriticalPoint | None:
        """Limit of stability at which the way down comes back to that branch, the last one of this way; None where there is none."""
        return self.jumps_down[-1] if self.jumps_down else None

    @property
    def width(self) -> Scalar | None:
        """Width of the loop in the control's unit: how much later it jumps on the way up than down; 0 without jumps.

        None if it is not known: with one jump only, with jumps that were not located, and without a way down.
        """
        if self.fold_up is None and self.fold_down is None:
            return None if self.unlocated or self.down is None else 0.0
        if self.fold_up is None or self.fold_down is None:
            return None
        rising = float(self.up.value[-1]) > float(self.up.value[0])
        return (self.fold_up.value - self.fold_down.value) * (1.0 if rising else -1.0)

    @property
    def critical(self) -> Path | None:
        """The states at the jumps, those of the way up first; without energies, None where there is none."""
        states = [_state_of(point) for point in (*self.jumps_up, *self.jumps_down)]
        return Path.from_states(self.up.problem, states) if states else None

    def states_at(self, value: float) -> tuple[State, State]:
        """The stable states at a ``value`` of the control on the way up and down; the same one where there is only one.

        ValueError outside the loop's range, and where it has no way down; ArithmeticError where a state is not found.
        """
        if self.down is None:
            raise Inadmissible(f"{self._name}: the loop has no way down, {self.stop_text}")
        still = self.still
        states = _state_at(still.up, value, still.jumps_up), _state_at(still.down, value, still.jumps_down)
        traced = is_traced(self.up.x)
        return without_derivatives_by(states, self.up.x, "states_at", "value of a jump of the loop") if traced else states

    @property
    def still(self) -> "Loop":
        """The loop whose jumps have no derivatives: numbers also where the loop is differentiated."""
        results = with_floats(stop_gradient, (self.up, self.down, self.unstable, self.jumps_up, self.jumps_down))
        return dataclasses.replace(self, **dict(zip(RESULTS, results, strict=True)))

    @property
    def stop_text(self) -> str:
        """How the way ended: "converged" where it came back to the first value, otherwise a diagnosis in one line."""
        return (self.up if self.down is None else self.down).stop_text

    @property
    def text(self) -> str:
        """One line that says what it is."""
        if self.fold_up is None and self.fold_down is None:
            jumped = f"; jumps before {', '.join(f'{value:.6g}' for value in self.unlocated)} were not located" if self.unlocated else ""
            return ("no fold found" if jumped or self.down is None else "no loop: up and down the same branch, width 0") + jumped
        said = [
            f"{way} {self._name} = {float(point.value):.6g} ({point.kind})"
            for way, points in (("up", self.jumps_up), ("down", self.jumps_down))
            for point in points
        ]
        branch = "" if self.unstable is None else f"; unstable branch of {len(self.unstable)} states" + (", joined" if self.joined else "")
        width = "width unknown" if self.width is None else f"width {float(self.width):.6g}{self._unit}"
        return f"{width}, jumps {', '.join(said)}{branch}"

    def __repr__(self) -> str:
        ways = [path.value[[0, -1]] for path in (self.up, self.down) if path is not None]
        values = " ... ".join(f"{value:.4g}" for value in [ways[0][0], *(way[1] for way in ways)])
        return f"Loop over {self._name} = {values}{self._unit}: {self.text}; {self.stop_text}"

    @property
    def _name(self):
        return self.up.control.name

    @property
    def _unit(self):
        return f" {self.up.control.unit}".rstrip()


def loop(
    problem: Problem,
    between: tuple[float, float],
    *,
    unstable: bool = True,
    symmetry: str = "auto",
    until_contact: bool = False,
    max_steps: int = MAX_STEPS,
    newton: Newton = NEWTON,
    steps: StepControl = STEP_CONTROL,
    observer: Observer = UNOBSERVED,
) -> Loop:
    """`Loop` of the stable branch of a `Problem` ``between`` two values (first, last) of its control, and back, in steps of its own.

    Where a stable branch ends, the gel relaxes to another stable state, whose ``switched`` says so; where there is none the loop ends,
    with the reason in ``stop_text``. The limits of stability are located to ``search.TOLERANCE``; their values, and so the width, are
    differentiable once in everything that the problem depends on, forward and reverse; the states are not (ValueError). With
    ``unstable`` the branch between ``fold_up`` and ``fold_down`` is followed in arc length. ``symmetry``, ``until_contact``, ``newton``,
    ``steps`` and ``observer`` are those of `sweep`; at most ``max_steps`` states are accepted. ValueError for unusable ends, gel or
    control, inside jit or vmap and for second derivatives; ``SweepFailed`` where the first state is not found.
    """
    first, last = ends_of(problem, between)
    options = Following("stable", symmetry, True, until_contact, newton, steps, observer, jumps=True)
    made = []

    def find(problem):
        made[:] = [_loop(problem.prepared, Adaptive(first, last, first, max_steps=max_steps), options, unstable)]
        return [*made[0].jumps_up, *made[0].jumps_down]

    points = located("loop", find, problem)
    found, count = made[0], len(made[0].jumps_up)
    if is_traced(problem):
        up, down, branch = without_derivatives_by((found.up, found.down, found.unstable), problem, "loop", "value of a jump")
        found = dataclasses.replace(found, up=up, down=down, unstable=branch)
    return dataclasses.replace(found, jumps_up=tuple(points[:count]), jumps_down=tuple(points[count:]))


def _loop(problem, way, options, unstable):
    """`Loop` of a problem without tracers."""
    check_sweep(problem, np.array(way.values))
    with few_threads(2 * problem.model.n_nodes):
        sweep = Followed(problem, way, options)
        return _with_limits(problem, sweep.light_states(), way.values[:2], sweep, unstable)


def _with_limits(problem, states, ends, sweep, unstable):
    """`Loop` of the states of a sweep from the first of the ``ends`` to the last and back."""
    turn = next((k for k, state in enumerate(states) if state.value == ends[1]), len(states))
    ways, limits, searches = [states[: turn + 1], states[turn:]], [], Searches(problem)
    for number, way in enumerate(ways):
        limits.append(limits_of(searches, way))
        jumps = {limit.at for limit in limits[-1]}
        ways[number] = [
            dataclasses.replace(state, switched=state.switched or Change.RELAXATION) if k in jumps else state for k, state in enumerate(way)
        ]

    def path(way, last):
        reason = dict(stop=sweep.stop, stop_text=sweep.stop_text) if last else {}
        return Path.from_states(problem, way, **reason)

    paths = [path(way, last=number == 1 or not ways[1]) if way else None for number, way in enumerate(ways)]
    made = Loop(
        *paths,
        *(tuple(limit.point for limit in found if limit.point is not None) for found in limits),
        unstable=None,
        joined=False,
        unlocated=tuple(way[limit.at].value for way, found in zip(ways, limits, strict=True) for limit in found if limit.point is None),
    )
    if not unstable or made.fold_up is None:
        return made
    first = next(limit.at for limit in limits[0] if limit.point is not None)
    return _with_unstable(made, ways[0][first - 1], ways[0][first])


def _with_unstable(made, before, after):
    """The loop with the unstable branch from ``fold_up``, between the states ``before`` and ``after`` it."""
    problem, point, end = made.up.problem.prepared, made.fold_up, made.fold_down
    if point.kind == "fold":
        at = _state_of(point)
        start = [before, accepted(problem, at, at.stability)]
    else:
        start, stop = leaving(problem, point, np.copysign(1.0, _along(problem, point, after.x)) * point.modes[0])
        if not stop.ok:
            return made
    far = point if end is None else end
    longest = max(LONGEST, arc_length(problem, (after.x, point.value), (far.x, far.value)) / FEWEST)
    search = _End(made, longest)
    path = followed(problem, start, None, longest, MAX_STATES, given=1, until=search)
    between = np.flatnonzero(path.negative_pivots > 0)
    between = between[:-1] if search.joined and end.kind != "fold" else between  # the last one may lie behind the end
    return dataclasses.replace(made, unstable=path[between] if len(between) else None, joined=search.joined)


def _along(problem, point, x):
    """Amplitude of the first mode of a point at the positions ``x``."""
    free, stiffness = problem.free, StabilityAnalysis(problem).stiffness
    return restrict(np.asarray(x) - np.asarray(point.x), free) @ (stiffness @ restrict(point.modes[0], free))


def _state_of(point):
    """The `State` of a critical point; its negative eigenvalues are not counted, since one eigenvalue is 0 but for round-off."""
    stability = Stability(-1, np.asarray(point.eigenvalues))
    return State(float(point.value), float(point.mu), point.x, point.pressure, stability=stability)


class _End:
    """Whether a state is the last one of the unstable branch of a loop: where it joins the way down, or leaves the range of the control."""

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
            self.joined = state.negative_pivots == 0 and inside(state.value, self.low, self.high) and self._is_stable_one(state)
        else:
            self.joined = arc_length(self.made.up.problem, (state.x, state.value), (end.x, end.value)) < self.longest
        return self.joined

    def _is_stable_one(self, state):
        """Whether a stable state is that of the way down."""
        spacing = self.made.up.model.cloud.spacing
        try:
            other = _state_at(self.made.down, state.value, self.made.jumps_down)
        except (StateNotFound, Inadmissible):  # no state was found, or the way down ended before
            return False
        return float(np.abs(np.asarray(other.x) - np.asarray(state.x)).max()) < SAME * spacing


def _state_at(path, value, jumps):
    """Stable `State` at a ``value`` of the control on one way of a loop."""
    k = next((k for k in range(len(path) - 1) if min(path.value[k : k + 2]) <= value <= max(path.value[k : k + 2])), None)
    name = path.control.name
    if k is None:
        low, high = sorted(path.value[[0, -1]])
        raise Inadmissible(f"{name}: {value:g} is outside of the loop, which goes from {low:g} to {high:g}")
    before, after = path[k], path[k + 1]
    share = (value - before.value) / (after.value - before.value)
    if after.switched:
        limits = [float(point.value) for point in jumps if inside(float(point.value), before.value, after.value)]
        share = 0.0 if limits and (value - limits[0]) * (after.value - before.value) < 0 else 1.0
    x, pressure = (here + share * (there - here) for here, there in ((before.x, after.x), (before.pressure, after.pressure)))
    problem = path.problem.prepared
    found = solve(problem, float(value), x, pressure, own_factor=True)
    if not found.status.ok:
        raise StateNotFound(f"no state at {name} = {value:.6g}: {found.status.text}")
    return accepted(problem, found, Stability(found.factor.negative_pivots)).light
