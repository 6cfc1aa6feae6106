"""Branch switching: branches along the mode of a critical point, and past folds.

A branch is followed in its arc length, ds^2 = dvalue^2 + |dx|^2 / (n spacing^2) with the change of
the control in its scale, 1 kT for mu, and the n nodes' displacements, so that folds are points like
any other (Keller's pseudo-arc-length continuation). States form a `path.Path`, whose control may
turn.
"""

from collections.abc import Callable

import numpy as np

from .._deprecated import old_arguments
from .._types import Array, Float
from .._validation import Inadmissible
from ..continuation import Path, check_is_path
from ..equilibrium import (
    Conditions,
    Stability,
    State,
    StateNotFound,
    Status,
    accepted,
    solve,
    solve_bordered,
)
from ..mechanics import Problem, restrict, scatter
from .critical import check_untraced
from .points import CriticalPoint

# of the spacing: largest displacement along the mode of the first state of a new branch
FIRST_AMPLITUDE = 0.05
MAX_STATES = 200
MAX_STEP = 0.25  # in arc length
LEAST_STEP = 1e-4  # of the largest


@old_arguments
def switch_branch(
    problem: Problem,
    point: CriticalPoint,
    *,
    sign: int = 1,
    direction: Float[Array, " m"] | None = None,
    end: float | None = None,
) -> Path:
    """`Path` of the branch that leaves a bifurcation along its mode.

    Arguments:

    - `problem`: the `Problem` on whose branch the bifurcation lies.
    - `point`: the bifurcation, a `CriticalPoint` of `critical_points`.
    - `sign`: 1 or -1, the side of the branch.
    - `direction` (m,): combination of the modes of a multiple bifurcation, dimensionless; the first
      mode by default.
    - `end`: value of the control, in its unit, at which the path ends; if it is None or not
      reached, the path ends after `MAX_STATES` (200) states.

    Returns the path; `path.stop` says how it ended, and `continue_branch` continues it. It may
    start towards lower values (subcritical) and turn at a fold.

    Raises `ValueError` if `point` is a fold, which has no other branch.

    See docs/howto/bifurcation.md.
    """
    check_untraced("switch_branch", problem)
    if point.kind == "fold":
        at = f"{problem.control.name} = {float(point.value):.6g}"
        raise Inadmissible(
            f"point: the {point.kind} at {at} has no other branch; use continue_branch"
        )
    problem = problem.prepared
    direction = (
        np.eye(point.multiplicity)[0] if direction is None else np.asarray(direction, dtype=float)
    )
    states, stop = leaving(
        problem, point, sign * np.tensordot(direction / np.linalg.norm(direction), point.modes, 1)
    )
    return followed(problem, states, end) if stop.ok else _path(problem, states, stop)


def leaving(
    problem: Problem, point: CriticalPoint, mode: Float[Array, "n 2"]
) -> tuple[list[State], Status]:
    """Two states of the branch that leaves a bifurcation along a ``mode`` (n, 2), and its status.

    Fewer if the search fails.
    """
    along = restrict(mode, problem.free)
    size = FIRST_AMPLITUDE * problem.model.cloud.spacing / np.abs(along).max()
    row = along / np.linalg.norm(along)
    nothing, states = np.zeros((len(along), 0)), []
    for amplitude in (size, 2 * size):
        start = (
            point.x + amplitude * mode if not states else states[-1].x + (amplitude - size) * mode
        )
        target = amplitude * np.linalg.norm(along)
        conditions = Conditions(
            row[:, None], np.zeros(1), point.x, float(point.value), np.array([target])
        )
        value = states[-1].value if states else float(point.value)
        state, _ = solve_bordered(problem, value, start, point.pressure, nothing, conditions)
        if not state.status.ok:
            return states, state.status
        states.append(_accepted(problem, state))
    return states, Status.CONVERGED


@old_arguments
def continue_branch(
    path: Path,
    *,
    end: float | None = None,
    max_step: float = MAX_STEP,
    max_states: int = MAX_STATES,
) -> Path:
    """`Path` that continues the last two states of a path in arc length, past folds.

    Arguments:

    - `path`: the `Path`, of at least two states.
    - `end`: value of the control, in its unit, at which the new path ends; if it is None or not
      reached, the path ends after `max_states` states.
    - `max_step`: largest step in arc length, dimensionless.
    - `max_states`: largest number of new states.

    Returns the path of the new states only; `stop` says how it ended.

    Raises `ValueError` for a path of fewer than two states, and for a traced one.

    See docs/howto/bifurcation.md.

    >>> import jaxgel
    >>> cloud = jaxgel.make_cloud(jaxgel.Plate(1.0, 1.0, edges={"top": "free"}), spacing=0.25)
    >>> problem = jaxgel.Problem(jaxgel.discretise(cloud), jaxgel.Gel(1e-3, 0.1), contact=False)
    >>> path = jaxgel.sweep(problem, [-0.5, -0.45])
    >>> continue_branch(path, end=-0.4).value.round(9).tolist()
    [-0.4]
    """
    check_is_path(path)
    check_untraced("continue_branch", path.x)
    if len(path) < 2:
        raise Inadmissible(f"path: {len(path)} states do not give a direction; it needs two")
    return followed(path.problem.prepared, [path[-2], path[-1]], end, max_step, max_states, given=2)


def followed(
    problem: Problem,
    states: list[State],
    end: float | None,
    max_step: float = MAX_STEP,
    max_states: int = MAX_STATES,
    given: int = 0,
    until: Callable[[State], bool] | None = None,
) -> Path:
    """`Path` of the ``states``, at least two, but the first ``given``, continued in arc length.

    It goes to the value ``end``, to the first state of which ``until`` says so, or to
    ``max_states`` states.
    """
    free, (weight, slack) = problem.free, _weights(problem)
    nothing, stop, length = np.zeros((len(free), 0)), Status.TOO_MANY_STEPS, None
    while len(states) - given < max_states:
        old, last = states[-2], states[-1]
        dx, rise = restrict(np.asarray(last.x) - np.asarray(old.x), free), last.value - old.value
        done = np.sqrt(weight * dx @ dx + slack * rise**2)
        dx, rise = dx / done, rise / done
        length = min(1.5 * done if length is None else length, max_step)
        conditions = Conditions(
            (weight * dx)[:, None],
            np.array([slack * rise]),
            np.asarray(last.x),
            last.value,
            np.array([length]),
        )
        start = last.x + length * np.asarray(scatter(dx, free))
        slope = (np.asarray(last.pressure) - np.asarray(old.pressure)) / done
        state, _ = solve_bordered(
            problem,
            last.value + length * rise,
            start,
            last.pressure + length * slope,
            nothing,
            conditions,
        )
        if not state.status.ok or _turned(state, last, (dx, rise), (weight, slack), free):
            length *= 0.4
            if length < LEAST_STEP * max_step:
                stop = Status.STEP_TOO_SMALL if state.status.ok else state.status
                break
            continue
        if (
            end is not None
            and (state.value - end) * (last.value - end) <= 0
            and state.value != last.value
        ):
            at_end = _interpolated_end(problem, last, state, end)
            states += [_accepted(problem, at_end)] if at_end.status.ok else []
            stop = at_end.status
            break
        states.append(_accepted(problem, state))
        if until is not None and until(states[-1]):
            stop = Status.CONVERGED
            break
        length *= (
            1.6 if state.newton_iterations <= 4 else 1.0 if state.newton_iterations <= 6 else 0.6
        )
    return _path(problem, states[given:], stop)


def arc_length(
    problem: Problem,
    start: tuple[Float[Array, "n 2"], float],
    end: tuple[Float[Array, "n 2"], float],
) -> float:
    """Arc length of the straight line between two pairs of positions (n, 2) and value."""
    dx, change = (
        restrict(np.asarray(end[0]) - np.asarray(start[0]), problem.free),
        float(end[1]) - float(start[1]),
    )
    weight, slack = _weights(problem)
    return float(np.sqrt(weight * dx @ dx + slack * change**2))


def _weights(problem):
    """Weights of the squares of displacements and of the change of the control in an arc length."""
    return 1 / (
        problem.model.n_nodes * problem.model.cloud.spacing**2
    ), 1 / problem.control.scale**2


def _turned(state, last, direction, weights, free):
    """Whether a step in arc length turned by more than 45 degrees from its direction.

    The direction is that of the unknowns and the control.
    """
    moved, change = (
        restrict(np.asarray(state.x) - np.asarray(last.x), free),
        state.value - last.value,
    )
    forward = weights[0] * (moved @ direction[0]) + weights[1] * change * direction[1]
    return forward < 0.7 * np.sqrt(weights[0] * moved @ moved + weights[1] * change**2)


def _interpolated_end(problem, last, state, end):
    """`State` at the value ``end`` between two states."""
    share = (end - last.value) / (state.value - last.value)
    x, pressure = (
        old + share * (new - old)
        for old, new in ((last.x, state.x), (last.pressure, state.pressure))
    )
    return solve(problem, end, x, pressure, own_factor=True)


def _path(problem: Problem, states, stop):
    if not states:
        raise StateNotFound(f"no state of the branch was found: {stop.text}")
    return Path.from_states(problem, states, stop=stop)


def _accepted(problem, state):
    """A converged state with a factor of its own tangent and the number of negative eigenvalues."""
    return accepted(problem, state, Stability(state.factor.negative_pivots)).light
