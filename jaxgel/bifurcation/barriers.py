"""Energy barriers between two stable states at one value of a control.

A gel goes from one stable state to another over a saddle of the energy, an equilibrium with exactly
one negative eigenvalue; of several that are found the lowest counts. The derivative of a barrier
needs none of the states: their residual vanishes, so that the energy changes as it does with the
unknowns at rest (envelope theorem), and the constrained nodes where the dry plate and the control
move them.
"""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._deprecated import old_arguments
from .._programs import fitted
from .._types import Scalar
from ..continuation import StabilityAnalysis, across
from ..equilibrium import State, StateNotFound, accepted, solve, solve_pinned
from ..mechanics import Problem, restrict, scatter, shared_tangents, total_energy
from .critical import located
from .deflation import find_states_by_deflation
from .loops import Loop

# of the way between two states: where their saddle is looked for
SHARES = (0.5, 0.45, 0.55, 0.35, 0.65)
PULLS = 20  # states on the way along which a force pulls the gel from one to the other
KICKS = (0.5, 1.5)  # of the spacing: how far along a mode, too
APART = 1e-3  # of the spacing: equilibria nearer to each other are the same


@dataclasses.dataclass(frozen=True, eq=False)
class Barrier:
    """Energy barrier between a stable state and a saddle; `barrier` returns two."""

    height: Scalar
    """Energy of the saddle less that of the state, kT/v mm^2; differentiable, see `barrier`."""
    state: State
    """The stable state."""
    saddle: State
    """The saddle: the equilibrium between, with one negative eigenvalue."""


@old_arguments
def barrier(
    problem: Problem, value: Scalar, between: Loop | tuple[State, State]
) -> tuple[Barrier, Barrier]:
    """Two `Barrier`s at a value of the control: from each of two stable states to the saddle.

    Arguments:

    - `problem`: the `Problem`, with its control.
    - `value` (): value of the control, in its unit.
    - `between`: the two stable `State`s; or a `Loop`, whose states at `value` are taken, with the
      saddle on its unstable branch.

    For two states, and for a loop without an unstable branch at `value`, the saddle is computed by
    deflation from points between the states.

    Returns (from the first state, from the second one). The heights, kT/v mm^2, are differentiable
    once in everything that `problem` and `value` depend on, forward and reverse.

    Raises `ArithmeticError` if a state is not found or unstable, if both states are the same, or if
    no equilibrium with exactly one negative eigenvalue is found between them; `ValueError` inside
    `jax.jit` or `jax.vmap`.

    Example: docs/howto/bifurcation.md.
    """
    between = between.still if isinstance(between, Loop) else between

    def find(of):
        return _barriers(of[0].prepared, float(of[1]), between)

    first, second = located(
        "barrier", find, (problem, jnp.asarray(value, dtype=float)), "height", _change_of_height
    )
    return first, second


def _barriers(problem, value, between):
    """[`Barrier`, `Barrier`] of a problem without tracers."""
    analysis = StabilityAnalysis(problem)
    given = between.states_at(value) if isinstance(between, Loop) else between
    states = [_state(analysis, value, state.x, state.pressure) for state in given]
    where, spacing = f"{problem.control.name} = {value:.6g}", problem.model.cloud.spacing
    if any(state is None or state.negative_pivots for state in states):
        raise StateNotFound(
            f"barrier: a state between which it lies was not found at {where}, or is unstable"
        )
    first, second = (np.asarray(state.x) for state in states)
    if np.abs(first - second).max() < APART * spacing:
        raise StateNotFound(f"barrier: both states are the same at {where}")
    found = _on_unstable_branch(analysis, value, between) if isinstance(between, Loop) else []
    saddles = _saddles(analysis, value, found, states)
    if not saddles:
        found += _by_deflation(analysis, value, states)
        saddles = _saddles(analysis, value, found, states)
    if not saddles:
        counts = sorted({state.negative_pivots for state in found})
        seen = f"; those found have {', '.join(map(str, counts))}" if counts else ""
        raise StateNotFound(
            "barrier: no equilibrium with exactly one negative eigenvalue was found at "
            f"{where}{seen}"
        )
    saddle = min(saddles, key=lambda state: state.energy)
    return [Barrier(saddle.energy - state.energy, state.light, saddle.light) for state in states]


def _state(analysis, value, x, pressure):
    """`State` with its stability, or None."""
    found = solve(analysis.problem, value, jnp.asarray(x), jnp.asarray(pressure), own_factor=True)
    return _accepted(analysis, found) if found.status.ok else None


def _accepted(analysis, found):
    stability, found = analysis.check(found)
    return accepted(analysis.problem, found, stability)


def _on_unstable_branch(analysis, value, loop):
    """Equilibria at a value on the unstable branch of a loop, between whose states they lie."""
    path, found = loop.unstable, []
    if path is None:
        return found
    ends = [
        loop.fold_up,
        *(path[k] for k in range(len(path))),
        *([loop.fold_down] if loop.joined else []),
    ]
    for before, after in itertools.pairwise(ends):
        low, high = float(before.value), float(after.value)
        if low != high and (value - low) * (value - high) <= 0:
            share = (value - low) / (high - low)
            x, p = (
                here + share * (there - here)
                for here, there in ((before.x, after.x), (before.pressure, after.pressure))
            )
            found.append(_state(analysis, value, x, p))
    return [state for state in found if state is not None]


def _by_deflation(analysis, value, states):
    """Equilibria at a value between two stable ones, by deflation.

    It begins at a good start, or else at points of a straight line.
    """
    problem, known = analysis.problem, [np.asarray(state.x) for state in states]
    for starts in (
        _turn_of_force(problem, value, *states),
        [(1 - share) * known[0] + share * known[1] for share in SHARES],
    ):
        found = [
            _accepted(analysis, state)
            for state in find_states_by_deflation(problem, value, known=known, starts=starts)
        ]
        if any(state.negative_pivots for state in found):
            return found
    return []


def _turn_of_force(problem, value, first, second):
    """[x] next to an equilibrium between two stable ones, where the force along the line turns.

    [] without one.
    """
    at, pressure = np.asarray(first.x), np.asarray(first.pressure)
    way = restrict(np.asarray(second.x) - at, problem.free)
    length = np.linalg.norm(way)
    x, before, force = at + np.asarray(scatter(way / PULLS, problem.free)), (at, pressure), np.inf
    for number in range(1, PULLS):
        pulled, after = solve_pinned(
            problem, value, x, pressure, way / length, first.x, length * number / PULLS
        )
        if not pulled.status.ok:
            return []
        now, last = (np.asarray(pulled.x), np.asarray(pulled.pressure)), before
        if after <= 0 < force:
            return [
                now[0]
                if not np.isfinite(force)
                else last[0] + force / (force - after) * (now[0] - last[0])
            ]
        x, pressure = (2 * new - old for new, old in zip(now, last, strict=True))
        before, force = now, after
    return []


def _saddles(analysis, value, found, stable):
    """The saddles among equilibria, and those that others reach along their second mode."""
    saddles = []
    for start in found:
        state = start
        while state is not None and state.negative_pivots > 1:
            state = _lower(analysis, value, state, stable)
        saddles += [state] if state is not None else []
    return saddles


def _lower(analysis, value, state, stable):
    """Saddle next to an unstable equilibrium along its second mode; None without one.

    It has fewer negative eigenvalues, though some.
    """
    problem, mode = analysis.problem, state.modes[:, 1]
    reached = [across(problem, state, mode)]
    if reached[0] is None:
        step = (
            np.asarray(scatter(mode, problem.free))
            * problem.model.cloud.spacing
            / np.abs(mode).max()
        )
        starts = [np.asarray(state.x) + kick * step for kick in KICKS]
        known = [np.asarray(one.x) for one in (*stable, state)]
        reached = find_states_by_deflation(problem, value, known=known, starts=starts)
    more = [_accepted(analysis, one) for one in reached]
    return next((one for one in more if 0 < one.negative_pivots < state.negative_pivots), None)


def _change_of_height(point, _, of, dots):
    shared, shared_dots = shared_tangents(of[0], dots[0])
    states = (
        fitted(np.asarray(state.x), "n", shared.lengths) for state in (point.saddle, point.state)
    )
    return _energy_change(*states, (shared, of[1]), (shared_dots, dots[1]))


@compiled()
def _energy_change(saddle, state, of, dots):
    """Tangent () of the difference of two states' energies, the unknowns at rest."""

    def height(of):
        problem, value = of
        nodes, (now, mu) = problem.model.nodes, problem.at(value)
        moved = problem.carried(nodes - jax.lax.stop_gradient(nodes), jax.lax.stop_gradient(value))
        energies = [
            total_energy(problem.placed(x + moved, value), now.model, now.gel, mu, now.loads)
            for x in (saddle, state)
        ]
        return energies[0] - energies[1]

    return jax.jvp(height, (of,), (dots,))[1]
