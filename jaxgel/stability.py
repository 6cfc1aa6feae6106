"""Stability of an equilibrium, and the way from an unstable state to the stable branch that left it.

A state is stable where its tangent has no negative eigenvalue. The number of negative pivots counts them; inverse iteration with the
factor that is at hand gives the eigenvalue nearest zero and its mode.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np

from .equilibrium import Status, solve, solve_pinned

INVERSE_ITERATIONS = 30
FIRST_AMPLITUDE = 0.02  # of the spacing: largest displacement of the first pinned state
GROWTH = 1.5  # of the amplitude from one pinned state to the next
MAX_PINNED = 24  # pinned states before the search for another branch gives up
MAX_SWITCHES = 6  # branches tried one after the other until one is stable


@dataclasses.dataclass(frozen=True, eq=False)
class Mode:
    """Eigenvalue of the tangent nearest zero, with its mode."""

    eigenvalue: float
    """kT/v."""
    vector: np.ndarray
    """(f,) free degrees of freedom, of unit Euclidean norm; the sign makes the largest entry positive."""


def nearest_mode(factor):
    """``Mode`` of the factorised tangent by inverse iteration, from a fixed start without symmetry."""
    vector = np.sin(1.0 + np.arange(len(factor.pattern.free)) ** 1.5)
    vector /= np.linalg.norm(vector)
    eigenvalue = np.inf
    for _ in range(INVERSE_ITERATIONS):
        image, _ = factor.solve(vector, refine=False)
        before, eigenvalue = eigenvalue, 1.0 / (vector @ image)
        vector = image / np.linalg.norm(image)
        if abs(eigenvalue - before) < 1e-6 * abs(eigenvalue):
            break
    return Mode(float(eigenvalue), vector * np.sign(vector[np.argmax(np.abs(vector))]))


def stable_state(problem, mu, x, pressure, factor):
    """``Equilibrium`` without negative pivots at ``mu``, reached from an unstable one (x, pressure, factor); None if none is found.

    Along the mode of the eigenvalue nearest zero the state is pinned at growing amplitudes. The force that holds it points outwards at
    first; where it changes sign lies an equilibrium of another branch, and Newton's method without the pin finds it.
    """
    for _ in range(MAX_SWITCHES):
        found = _across(problem, mu, x, pressure, nearest_mode(factor).vector)
        if found is None:
            return None
        if found.factor.negative_pivots == 0:
            return found
        x, pressure, factor = found.x, found.pressure, found.factor
    return None


def _across(problem, mu, x, pressure, mode):
    """The next ``Equilibrium`` along ``mode`` (f,), with a factor of its own tangent, or None."""
    start, free = jnp.asarray(x), problem.pattern.free
    largest = np.abs(mode).max()
    amplitude, force_before = FIRST_AMPLITUDE * problem.model.cloud.spacing / largest, None
    direction = jnp.zeros(start.size).at[free].add(mode).reshape(start.shape)
    x = start + amplitude * direction
    for _ in range(MAX_PINNED):
        pinned, force = solve_pinned(problem, mu, x, pressure, mode, start, amplitude)
        if not pinned.status.ok:
            return None
        if force_before is not None and np.sign(force) != np.sign(force_before):
            found = solve(problem, mu, pinned.x, pinned.pressure, fresh=True)
            moved = float(jnp.linalg.norm(found.x - start))
            return found if found.status is Status.CONVERGED and moved > 0.5 * amplitude / GROWTH else None
        x = pinned.x + (GROWTH - 1) * (pinned.x - start)
        pressure, amplitude, force_before = pinned.pressure, GROWTH * amplitude, force
    return None
