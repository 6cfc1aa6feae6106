"""Prediction of the next state of a sweep from the states before it."""

import jax
import numpy as np

from .._types import Array, Float
from ..equilibrium import State, acting_problem, dry_state
from ..mechanics import Problem, mu_force, scatter, state_pressure

EXTRAPOLATED = 7  # most states from which the next one is predicted


def same_branch(states: list[State]) -> list[State]:
    """The last states, at most ``EXTRAPOLATED``, that lie on one branch."""
    recent = states[-EXTRAPOLATED:]
    first = max((k for k, state in enumerate(recent) if state.switched), default=0)
    return recent[first:]


def predict(problem: Problem, mu: float, history: list[State]) -> tuple[Float[Array, "n 2"], Float[Array, " g"]]:
    """Positions, mm, and pressures, kT/v, at ``mu`` by extrapolation through states of ``history``; the dry state without any.

    The first state of a sweep has its rate of change, which serves where it is alone.
    The polynomial goes through as many of the last states as would have predicted the last one best, and through one more where that is
    all of them: a polynomial of high degree is good on a smooth path and leaves the branch where that has turned.
    """
    if not history:
        return dry_state(problem, mu)
    if len(history) == 1 and history[0].rate is not None:
        last, share = history[0], mu - history[0].mu
        rate = _pressure_rate(last.x, last.rate, problem, last.mu)
        return np.asarray(last.x) + share * last.rate, np.asarray(last.pressure) + share * np.asarray(rate)
    at = np.array([state.mu for state in history])
    x = np.stack([np.asarray(state.x) for state in history])
    misses = [np.linalg.norm(np.tensordot(_weights(at[-k - 1 : -1], at[-1]), x[-k - 1 : -1], 1) - x[-1]) for k in range(1, len(at))]
    best = int(np.argmin(misses)) + 1 if misses else 1
    used = len(at) if best == len(at) - 1 else best
    weights = _weights(at[-used:], mu)
    return np.tensordot(weights, x[-used:], 1), np.tensordot(weights, [np.asarray(state.pressure) for state in history[-used:]], 1)


def rate_of_change(problem: Problem, state: State) -> Float[np.ndarray, "n 2"]:
    """dx/dmu, mm/kT, of the branch on which a ``state`` with a factor lies."""
    pull = -np.asarray(mu_force(acting_problem(problem, state), state.x, state.mu, state.pressure))
    return np.asarray(scatter(state.factor.apply(pull), state.x.shape, problem.free))


@jax.jit
def _pressure_rate(x, rate, problem, mu):
    """dp/dmu (g,), 1/v, at positions ``x`` (n, 2) that change at the ``rate`` (n, 2)."""
    return jax.jvp(lambda x, mu: state_pressure(x, problem.model, problem.gel, mu), (x, mu), (rate, 1.0))[1]


def _weights(at, mu):
    """Weights (k,) with which states at the values ``at`` (k,) of mu give the state at ``mu`` on the polynomial through them (Lagrange)."""
    others = [np.delete(at, i) for i in range(len(at))]
    return np.array([np.prod((mu - other) / (a - other)) for a, other in zip(at, others, strict=True)])
