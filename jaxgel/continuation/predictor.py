"""Prediction of the next state of a sweep from the states before it."""

import jax
import numpy as np

from ..equilibrium import acting, dry_state
from ..mechanics import reduced, residual, spread, state_pressure

EXTRAPOLATED = 7  # most states from which the next one is predicted


def _rate(problem, mu, state):
    """dx/dmu (n, 2), mm/kT, of the branch on which the ``Equilibrium`` at ``mu`` lies."""
    pull = _pull_of_mu(state.x, acting(problem, state).model, problem.gel, mu, problem.loads, problem.free)
    return np.asarray(spread(state.factor.apply(np.asarray(pull)), state.x.shape, problem.free))


@jax.jit
def _pull_of_mu(x, model, gel, mu, loads, free):
    """Forces (f,) on the free degrees of freedom that an increase of mu brings, mm/v."""
    return -reduced(jax.jvp(lambda mu: residual(x, model, gel, mu, loads), (mu,), (1.0,))[1], free)


@jax.jit
def _pressure_rate(x, rate, model, gel, mu):
    """dp/dmu (g,), 1/v, at positions ``x`` (n, 2) that change at the ``rate`` (n, 2)."""
    return jax.jvp(lambda x, mu: state_pressure(x, model, gel, mu), (x, mu), (rate, 1.0))[1]


def _same_branch(done):
    """The last states, at most ``EXTRAPOLATED``, that lie on one branch."""
    recent = done[-EXTRAPOLATED:]
    first = max((k for k, step in enumerate(recent) if step.switched), default=0)
    return recent[first:]


def _predict(problem, mu, history):
    """Positions and pressures at ``mu`` by extrapolation through states of ``history``; the dry state without any.

    The first state of a sweep has its rate of change, which serves where it is alone.
    It goes through as many of the last states as would have predicted the last one best, and through one more where that is all of them:
    a polynomial of high degree is good on a smooth path and leaves the branch where that has turned.
    """
    if not history:
        return dry_state(problem.model, problem.gel, mu)
    if len(history) == 1 and history[0].rate is not None:
        last, share = history[0], mu - history[0].mu
        rate = _pressure_rate(last.x, last.rate, problem.model, problem.gel, last.mu)
        return np.asarray(last.x) + share * last.rate, np.asarray(last.pressure) + share * np.asarray(rate)
    at = np.array([step.mu for step in history])
    x = np.stack([np.asarray(step.x) for step in history])
    misses = [np.linalg.norm(np.tensordot(_weights(at[-k - 1 : -1], at[-1]), x[-k - 1 : -1], 1) - x[-1]) for k in range(1, len(at))]
    best = int(np.argmin(misses)) + 1 if misses else 1
    used = len(at) if best == len(at) - 1 else best
    weights = _weights(at[-used:], mu)
    return np.tensordot(weights, x[-used:], 1), np.tensordot(weights, [np.asarray(step.pressure) for step in history[-used:]], 1)


def _weights(at, mu):
    """Weights (k,) with which states at the values ``at`` (k,) of mu give the state at ``mu`` on the polynomial through them (Lagrange)."""
    others = [np.delete(at, i) for i in range(len(at))]
    return np.array([np.prod((mu - other) / (a - other)) for a, other in zip(at, others, strict=True)])
