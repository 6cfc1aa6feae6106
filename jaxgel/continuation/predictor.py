"""Prediction of the next state of a sweep from the states before it."""

import numpy as np

from .._types import Array, Float
from ..equilibrium import State, control_force, dry_state, pressure_rate
from ..mechanics import Problem, scatter

EXTRAPOLATED = 7  # most states from which the next one is predicted


def same_branch(states: list[State]) -> list[State]:
    """The last states, at most ``EXTRAPOLATED``, on one branch without a turn of the control."""
    recent = states[-EXTRAPOLATED:]
    first = max((k for k, state in enumerate(recent) if state.switched), default=0)
    steps = np.diff([state.value for state in recent])
    turns = np.flatnonzero(steps[1:] * steps[:-1] < 0) + 1
    return recent[max([first, *turns]) :]


def predict(
    problem: Problem, value: float, history: list[State]
) -> tuple[Float[Array, "n 2"], Float[Array, " g"]]:
    """Positions, mm, and pressures, kT/v, extrapolated to a ``value`` from ``history``.

    The dry state without any. The first state of a sweep has its rate of change, which serves if it
    is alone.
    """
    if not history:
        return dry_state(problem, value)
    if len(history) == 1 and history[0].rate is not None:
        last, share = history[0], value - history[0].value
        return np.asarray(last.x) + share * last.rate, np.asarray(
            last.pressure
        ) + share * pressure_rate(problem, last, last.rate)
    return extrapolated(value, history)


def extrapolated(
    value: float, states: list[State]
) -> tuple[Float[Array, "n 2"], Float[Array, "..."]]:
    """Positions and pressures at a ``value`` by the polynomial through the last states.

    At least one state is needed. It goes through as many of them as would have predicted the last
    one best, and through one more if that is all of them: a polynomial of high degree is good on a
    smooth path and leaves the branch if that has turned.
    """
    history = states[-EXTRAPOLATED:]
    at = np.array([state.value for state in history])
    x = np.stack([np.asarray(state.x) for state in history])
    misses = [
        np.linalg.norm(np.tensordot(_weights(at[-k - 1 : -1], at[-1]), x[-k - 1 : -1], 1) - x[-1])
        for k in range(1, len(at))
    ]
    best = int(np.argmin(misses)) + 1 if misses else 1
    used = len(at) if best == len(at) - 1 else best
    weights = _weights(at[-used:], value)
    return np.tensordot(weights, x[-used:], 1), np.tensordot(
        weights, [np.asarray(state.pressure) for state in history[-used:]], 1
    )


def rate_of_change(problem: Problem, state: State) -> Float[np.ndarray, "n 2"]:
    """dx/dvalue, mm over the control's unit, of a ``state`` with a factor; 0 if edges prescribe."""
    return np.asarray(scatter(state.factor.apply(-control_force(problem, state)), problem.free))


def _weights(at, value):
    """Lagrange weights (k,) of states at the values ``at`` (k,) for the ``value``."""
    others = [np.delete(at, i) for i in range(len(at))]
    return np.array(
        [np.prod((value - other) / (a - other)) for a, other in zip(at, others, strict=True)]
    )
