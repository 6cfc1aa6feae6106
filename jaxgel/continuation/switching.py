"""Change of branch in a sweep: from an unstable state to a stable one at the same value."""

import jax.numpy as jnp
import numpy as np

from .._types import Array, Float
from ..equilibrium import Stability, State, Status, solve, solve_pinned
from ..linalg import SingularTangent
from ..mechanics import Problem, gather, restrict, scatter
from .frames import Frames
from .stability import oriented

FIRST_AMPLITUDE = 0.02  # of the spacing: largest displacement of the first pinned state
GROWTH = 1.5  # of the amplitude from one pinned state to the next
LEANING = 1e-5  # of the energy in the network: symmetric plates have 2e-9 and less
MAX_PINNED = 24  # pinned states before the search for another branch gives up
MAX_SWITCHES = 6  # branches tried one after the other until one is stable


def stable_state(
    frames: Frames,
    state: State,
    stability: Stability,
    *,
    expected: Float[np.ndarray, "n 2"] | None = None,
) -> tuple[State, Stability] | None:
    """Stable `State` and `Stability`, reached from an unstable one at the same value; or None.

    It has no negative eigenvalues. Along the mode of the lowest eigenvalue the way leads `across`,
    with the symmetries that the mode leaves. Loads that push choose the side, and before them the
    positions ``expected`` (n, 2), mm, of the branch that a sweep came along, if these lean to one.
    """
    for _ in range(MAX_SWITCHES):
        mode = oriented(stability.vectors[:, :1], frames.problem)[:, 0]
        frame = frames.along_mode(state, mode)
        mode, problem = frame.along(mode), frame.problem
        push = (
            _lean(frame, mode, expected, state)
            or np.asarray(gather(problem.loads, problem.free)) @ mode
        )
        found = across(problem, frame.part(state), -mode if push < 0 else mode)
        if found is None:
            return None
        try:
            stability, found = frame.check(found)
        except SingularTangent:
            return None
        state = frame.whole(found)
        if stability.negative == 0:
            return state, stability
    return None


def _lean(frame, mode, expected, state):
    """Amplitude of ``expected`` along a mode (v . N v = 1) from an unstable state; 0 if elsewhere.

    ``expected`` are positions.
    """
    if expected is None:
        return 0.0
    apart = restrict(np.asarray(expected) - np.asarray(state.x), frame.problem.free)
    along = mode @ (frame.stiffness @ apart)
    return along if along**2 > LEANING * (apart @ (frame.stiffness @ apart)) else 0.0


def across(problem: Problem, state: State, mode: Float[Array, " f"]) -> State | None:
    """The next `State` along a ``mode`` (f,) of an unstable one at its value, or None.

    It has a factor of its own tangent. The state is pinned at growing amplitudes of the mode. The
    force that holds it points outwards at first; where it changes sign lies an equilibrium of
    another branch, and Newton's method without the pin finds it.
    """
    mode = mode / np.linalg.norm(mode)
    start, pressure = jnp.asarray(state.x), state.pressure
    amplitude, force_before = (
        FIRST_AMPLITUDE * problem.model.cloud.spacing / np.abs(mode).max(),
        None,
    )
    x = start + amplitude * scatter(mode, problem.free)
    for _ in range(MAX_PINNED):
        pinned, force = solve_pinned(problem, state.value, x, pressure, mode, start, amplitude)
        if not pinned.status.ok:
            return None
        if force_before is not None and np.sign(force) != np.sign(force_before):
            found = solve(problem, state.value, pinned.x, pinned.pressure, own_factor=True)
            moved = float(
                np.linalg.norm(restrict(np.asarray(found.x) - np.asarray(start), problem.free))
            )
            return (
                found
                if found.status is Status.CONVERGED and moved > 0.5 * amplitude / GROWTH
                else None
            )
        x = pinned.x + (GROWTH - 1) * (pinned.x - start)
        pressure, amplitude, force_before = pinned.pressure, GROWTH * amplitude, force
    return None
