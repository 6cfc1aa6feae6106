"""Location of critical points: changes of the number of negative eigenvalues, and folds.

At a bifurcation the state is symmetric and the mode v is not. A cloud is not as symmetric as its
plate, so a small force along v holds the state where the energy's third derivative along v
vanishes: there the eigenvalue is stationary in the amplitude of the mode, and the critical value is
free of the cloud's imperfection to first order. At a fold v . dr/dvalue is not zero, and no force
is needed.
"""

import dataclasses
import itertools
import warnings
from typing import Any

import numpy as np
import scipy.sparse as sp

from .._deprecated import old_arguments
from ..continuation import Adaptive, Path, StabilityAnalysis, check_is_path, oriented, sweep
from ..equilibrium import (
    Conditions,
    Observer,
    Stability,
    State,
    control_force,
    solve,
    solve_bordered,
)
from ..linalg import Bordered, nearest_modes
from ..mechanics import Problem, restrict, scatter
from ..symmetry import characters
from .points import KEPT, CriticalPoint, Expansion, expand

ITERATIONS = 15
TOLERANCE = 1e-9  # of a critical value, in scales of the control
# below this a step that is no longer half the one before is round-off, large if the gel is nearly
# incompressible
ROUND_OFF = 1e-6
# of the distance between two states: a fold's value is stationary, so that its mode needs more
# steps than its value
LAST_STEP = 1e-4
# crossings closer than this, in scales of the control, are searched as one multiple eigenvalue
TOGETHER = 5e-3


class PointNotLocated(UserWarning):
    """The critical point between two states with different inertia was not located.

    The number of negative eigenvalues changes between these states of a branch.
    """


def locate(
    problem: Problem, ends: tuple[float, float], most: int, observer: Observer, **options: Any
) -> list[CriticalPoint]:
    """The first ``most`` critical points of the dry state's branch between the ``ends``.

    They are ordered from one end to the other. Further ``options`` are those of the `sweep` along
    it.
    """
    steps, control = [], problem.control

    def accepted(state):
        steps.append(state.light)
        observer.accepted(state)

    seen = dataclasses.replace(observer, accepted=accepted)
    path = sweep(
        problem, Adaptive(*ends), branch="symmetric", eigenvalues=True, observer=seen, **options
    )
    shared = Shared.of(problem.prepared)
    points = []
    for earlier, (before, after) in zip([None, *steps], itertools.pairwise(steps), strict=False):
        if len(points) == most:
            break
        known = len(points)
        if before.negative_pivots != after.negative_pivots:
            found = crossings(shared, earlier, before, after)
            if not found:
                where = f"{control.name} = {before.value:.6g} and {after.value:.6g}"
                counts = f"{before.negative_pivots} to {after.negative_pivots}"
                text = (
                    f"critical_points: between {where} the negative eigenvalues change from "
                    f"{counts}, and no point was located"
                )
                warnings.warn(text, PointNotLocated, stacklevel=2)
            for point in found:
                again = point.multiplicity > 1 and any(
                    abs(point.value - other.value) < shared.together for other in points
                )
                points += [] if again else [point]  # an unsymmetric cloud splits a double one
        elif earlier is not None and heads_for_fold(earlier, before, after.value):
            points += [
                fold
                for fold in fold_next_to(shared, earlier, before)
                if inside(fold.value, before.value, after.value)
            ]
        for point in points[known:]:
            observer.located(point)
    if not path.stop.ok and len(points) < most and len(steps) > 1:
        for fold in fold_next_to(shared, *steps[-2:]):
            points.append(fold)
            observer.located(fold)
    return sorted(points, key=lambda point: abs(point.value - ends[0]))[:most]


@old_arguments
def folds(path: Path) -> list[CriticalPoint]:
    """`CriticalPoint`s of kind "fold" at which the control turns along a path.

    Arguments:

    - `path`: a `Path` of `switch_branch` or `continue_branch`.

    Returns a list in the order of the path, empty without a fold. The values have no derivatives.

    Raises `ValueError` if `path` is no `Path`.

    See docs/howto/bifurcation.md.

    >>> import jaxgel
    >>> cloud = jaxgel.make_cloud(jaxgel.Plate(1.0, 1.0, edges={"top": "free"}), spacing=0.25)
    >>> problem = jaxgel.Problem(jaxgel.discretise(cloud), jaxgel.Gel(1e-3, 0.1), contact=False)
    >>> path = jaxgel.sweep(problem, [-0.5, -0.45])
    >>> folds(jaxgel.continue_branch(path, end=-0.4))
    []
    """
    check_is_path(path)
    shared, rise = Shared.of(path.problem.prepared), np.diff(path.value)
    states = [path[k] for k in range(len(path))]
    turns = np.flatnonzero(rise[1:] * rise[:-1] < 0)
    return [point for k in turns for point in fold_next_to(shared, states[k], states[k + 1])]


def heads_for_fold(earlier: State, before: State, value: float) -> bool:
    """Whether two stable steps head for a fold before ``value``.

    There the square of the lowest eigenvalue, linear in it, vanishes.
    """
    far, near = earlier.lowest_eigenvalue**2, before.lowest_eigenvalue**2
    ahead = abs(before.value - earlier.value) * near / (far - near) if far > near else np.inf
    return before.negative_pivots == 0 and ahead < abs(value - before.value)


def inside(value: float, low: float, high: float, slack: float = 0.0) -> bool:
    """Whether a value lies between two others, in either order."""
    return bool(min(low, high) - slack < value < max(low, high) + slack)


@dataclasses.dataclass(frozen=True, eq=False)
class Shared:
    """What the search of all points shares."""

    problem: Problem
    analysis: StabilityAnalysis

    @classmethod
    def of(cls, problem: Problem) -> "Shared":
        """What searches of a problem share."""
        return cls(problem, StabilityAnalysis(problem))

    @property
    def tolerance(self) -> float:
        """Of a critical value, in the control's unit."""
        return TOLERANCE * self.problem.control.scale

    @property
    def round_off(self) -> float:
        """Largest step, in the control's unit, that may be round-off."""
        return ROUND_OFF * self.problem.control.scale

    @property
    def together(self) -> float:
        """Distance, in the control's unit, within which crossings are searched as one."""
        return TOGETHER * self.problem.control.scale

    @property
    def stiffness(self) -> sp.csr_matrix:
        """That of the network, (f, f)."""
        return self.analysis.stiffness


def crossings(shared: Shared, before: State | None, low: State, high: State) -> list[CriticalPoint]:
    """Critical points between two states with different numbers of negative eigenvalues.

    Halves the interval until they are apart. If Newton's method leapt from one side of a fold to
    the other there is no bifurcation: then the branch is followed from ``low``, in the direction
    from the state ``before`` it (None without one).
    """
    change, close = (
        high.negative_pivots - low.negative_pivots,
        abs(high.value - low.value) < shared.together,
    )
    if change == 0:
        return []
    point = _bifurcation(shared, low, high, abs(change)) if abs(change) == 1 or close else None
    if point is not None:
        return [point]
    value = 0.5 * (low.value + high.value)
    middle = (
        None
        if close
        else solve(
            shared.problem,
            value,
            0.5 * (low.x + high.x),
            0.5 * (low.pressure + high.pressure),
            own_factor=True,
        )
    )
    if middle is None or not middle.status.ok:
        found = fold_next_to(shared, before, low) if before is not None else []
        return [
            fold for fold in found if inside(fold.value, low.value, high.value, shared.together)
        ]
    middle = counted(middle)
    return crossings(shared, before, low, middle) + crossings(shared, low, middle, high)


def counted(state: State) -> State:
    """A state with a factor of its own tangent and the number of negative eigenvalues."""
    return dataclasses.replace(state.light, stability=Stability(state.factor.negative_pivots))


def _bifurcation(shared, low, high, multiplicity):
    """``CriticalPoint`` between two states by Newton's method; None if it fails.

    It is on the mean eigenvalue and a simple mode's amplitude.
    """
    problem = shared.problem

    def between(value):
        t = (value - low.value) / (high.value - low.value)
        return (1 - t) * low.x + t * high.x, (1 - t) * low.pressure + t * high.pressure

    value, modes, amplitude, limit = (
        0.5 * (low.value + high.value),
        None,
        np.zeros(multiplicity),
        0.1 * problem.model.cloud.spacing,
    )
    before = np.inf
    for _ in range(ITERATIONS):
        x, pressure = between(value)
        if modes is None:
            state = solve(problem, value, x, pressure, own_factor=True)
            if not state.status.ok:
                return None
            _, modes = nearest_modes(state.factor, shared.stiffness, multiplicity)
            if multiplicity == 1 and not _alone(shared, modes):
                multiplicity, amplitude = 2, np.zeros(2)
                _, modes = nearest_modes(state.factor, shared.stiffness, 2)
        held = shared.stiffness @ modes
        pins = Conditions(held, np.zeros(multiplicity), x, value, amplitude)
        state, forces = solve_bordered(problem, value, x, pressure, held, pins)
        if not state.status.ok:
            return None
        eigenvalues, modes = nearest_modes(state.factor, shared.stiffness, multiplicity, modes)
        local = expand(problem, shared.stiffness, state, modes)
        step = -np.mean(eigenvalues) / local.slope
        if multiplicity == 1:  # to where the third derivative vanishes
            most = limit / np.abs(modes).max()
            amplitude = amplitude - np.clip(local.cubic / local.quartic, -most, most)
        if abs(step) < shared.tolerance or before / 2 < abs(step) < shared.round_off:
            return _point(
                shared, state, value + step, modes, eigenvalues, local, forces, low.negative_pivots
            )
        value, before = value + step, abs(step)
        if not inside(value, low.value, high.value, shared.together):
            return None
    return None


def _alone(shared, modes):
    """Whether the symmetries of the cloud keep or reverse the first mode (f, m).

    If one turns it into another there are two.
    """
    field = np.asarray(scatter(modes[:, 0], shared.problem.free))
    return all(
        abs(character) > KEPT
        for character in characters(field[None], shared.problem.model).values()
    )


def _point(shared, state, value, modes, eigenvalues, local, forces, unstable, kind="bifurcation"):
    problem = shared.problem
    signed = oriented(modes, problem)
    fields = np.stack([np.asarray(scatter(v, problem.free)) for v in signed.T])
    spacing = problem.model.cloud.spacing
    return CriticalPoint(
        value=float(value),
        mu=float(problem.at(value)[1]),
        kind=kind,
        x=np.asarray(state.x),
        pressure=np.asarray(state.pressure),
        modes=fields,
        eigenvalues=np.asarray(eigenvalues),
        slope=float(local.slope),
        curvature=-local.quartic / (3 * local.slope) if kind == "bifurcation" else float("nan"),
        imperfection=float(np.linalg.norm(forces) * np.abs(fields).max() / spacing),
        symmetries=characters(fields, problem.model),
        unstable=int(unstable),
        correction=np.asarray(scatter(local.correction, problem.free)),
    )


def fold_next_to(shared: Shared, before: State, last: State) -> list[CriticalPoint]:
    """The fold next to two states of a branch by the secant method; [] if there is none.

    There the control is stationary along the branch.
    """
    problem, free = shared.problem, shared.problem.free
    along = restrict(np.asarray(last.x) - np.asarray(before.x), free)
    between = np.sqrt(along @ (shared.stiffness @ along))
    row, nothing = shared.stiffness @ along[:, None] / between, np.zeros((len(free), 0))

    def rise(state):
        """Tangent (f,) of the branch per unit of the row, and that of the control."""
        column = control_force(problem, state)[:, None]
        system = Bordered.of(state.factor, column, row, np.zeros((1, 1)))
        dx, change = system.solve(np.zeros(len(free)), np.ones(1))
        return dx, float(change[0])

    ends = [
        solve(problem, end.value, end.x, end.pressure, own_factor=True) for end in (before, last)
    ]
    state, at, earlier = ends[1], 0.0, -between
    slope_before, (dx, slope) = rise(ends[0])[1], rise(ends[1])
    for _ in range(ITERATIONS):
        if slope == slope_before:
            return []
        step = np.clip(-slope * (at - earlier) / (slope - slope_before), -5 * between, 5 * between)
        earlier, slope_before, at = at, slope, at + step
        start = state.x + step * scatter(dx, free)
        there = Conditions(row, np.zeros(1), np.asarray(last.x), state.value, np.array([at]))
        state, _ = solve_bordered(problem, state.value, start, state.pressure, nothing, there)
        if not state.status.ok:
            return []
        dx, slope = rise(state)
        if abs(slope * step) < shared.tolerance and abs(step) < LAST_STEP * between:
            mode = dx[:, None] / np.sqrt(dx @ (shared.stiffness @ dx))
            force = control_force(problem, state)
            local = Expansion(-float(mode[:, 0] @ force), 0.0, float("nan"), np.zeros(len(free)))
            eigenvalue = [float(mode[:, 0] @ state.factor.product(mode)[:, 0])]
            return [
                _point(
                    shared,
                    state,
                    state.value,
                    mode,
                    eigenvalue,
                    local,
                    np.zeros(1),
                    last.negative_pivots,
                    kind="fold",
                )
            ]
    return []
