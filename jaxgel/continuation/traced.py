"""A sweep as one compiled program for ``jax.jit`` and ``jax.vmap``: stable, at given values.

It follows the branch that continues the dry state for as long as its tangent is positive definite.
A plate that is known, or said, to be symmetric when the program is made is solved on a fundamental
region, and the tangent's other blocks are factorised at the given values. A sheet that loses
stability, whose outlines touch, whose Newton's method fails or that is not so symmetric has nan
from there on, and the `Status` that says why; in a batch the others go on.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from .._programs import fitted
from .._types import Array, Bool, Float, Int
from ..equilibrium import (
    Iterate,
    Newton,
    Status,
    control_rates,
    dry_state,
    first_iterate,
    solve_traced,
)
from ..linalg import BlockPattern, Pattern, elimination_of, is_definite
from ..mechanics import (
    Problem,
    pressure_change,
    restrict,
    scatter,
    state_pressure,
    tangent_blocks,
    touches_in_program,
    with_free_values,
)
from ..symmetry import bases, blocks_of_plate, has_symmetries, region
from .follow import Following

HISTORY = 4  # states from which the next one is predicted
LEAST_STEP = 1 / 64  # of the distance between two values: a shorter step is not tried


def pattern_in_program(problem: Problem, group: tuple[str, ...]) -> Pattern | BlockPattern:
    """Pattern of the tangents of the whole plate, of their blocks if states have a ``group``."""
    return blocks_of_plate(problem.model.lists, group) if group else problem.pattern


class _March(NamedTuple):
    """A sweep between two of its values.

    The history holds the latest states, the last one first.
    """

    values: Float[Array, " h"]
    x: Float[Array, "h n 2"]
    pressure: Float[Array, "h g"]
    count: Int[Array, ""]
    """Number of states in the history."""
    rate: tuple[Float[Array, "n 2"], Float[Array, " g"]]
    """Derivatives of positions and pressures by the control at the first state."""
    residual: Float[Array, ""]
    """Relative residual of the latest state."""
    energy: Float[Array, ""]
    """Its total energy, kT/v mm^2."""
    found: Iterate
    """The latest attempt."""
    step: Float[Array, ""]
    """Size of the next step."""
    least: Float[Array, ""]
    """Size of the smallest step that is tried."""
    iterations: Int[Array, ""]
    """Linear solves since the last value."""
    status: Int[Array, ""]
    """`Status` of the latest attempt that was not given up for a shorter step."""
    reached: Bool[Array, ""]
    """Whether the march is at its end."""


def check_for_program(options: Following, *, chosen: bool) -> None:
    """Raise ValueError, one line, for options a compiled sweep has not, and ``chosen`` steps."""
    if chosen:
        raise ValueError(
            "values: Adaptive steps are not available inside jax.jit and jax.vmap; give the "
            "values of the control"
        )
    if options.branch != "stable" or options.until_contact:
        name, value = (
            ("branch", options.branch) if options.branch != "stable" else ("until_contact", True)
        )
        raise ValueError(
            f"{name}: {value!r} is not available inside jax.jit and jax.vmap; call the sweep "
            "outside of them"
        )


def states_in_program(
    problem: Problem, values: Float[Array, " k"], newton: Newton, group: tuple[str, ...]
) -> tuple[Array, dict[str, Any]]:
    """Equilibria (k, n, 2) at ``values`` of the control and the columns of their `Path`, a dict.

    Solved on the region of a ``group``. See the module. What is not reached has the last state, and
    its value of the control, in its place, so that derivatives are finite.
    """
    whole, others = problem.prepared, []
    if group:
        problem = region(problem, group).problem
        others = [basis.pattern for basis in bases(whole.model.lists, group)[1:]]
    else:
        problem = whole
    eliminations = [elimination_of(pattern) for pattern in (problem.pattern, *others)]
    symmetric = jnp.asarray(has_symmetries(whole, group))
    leaves, structure = jax.tree.flatten((problem.shared, eliminations, values, symmetric))

    def states(*leaves):
        return _states(
            newton,
            functools.partial(touches_in_program, problem.model.lists.topology),
            *jax.tree.unflatten(structure, leaves),
        )

    # the sheets of a batch one after the other, each with the iterations that it needs
    if jax.default_backend() == "cpu":
        states = jax.custom_batching.sequential_vmap(states)
    # index arrays as constants would be folded, for minutes
    columns = states(*lax.optimization_barrier(leaves))
    x = fitted(columns.pop("x"), "kn", problem.lengths)
    if group:
        columns["pressure"] = _pressures(whole, x, columns["value"])
    else:
        columns["pressure"] = fitted(columns["pressure"], "kg", problem.lengths)
    return x, columns | {"operators": whole.operators}


def _pressures(problem, x, values):
    """Pressures (k, g) of all volume groups of a plate at its states (k, n, 2)."""
    leaves, structure = jax.tree.flatten(problem.shared)
    shared = jax.tree.unflatten(structure, lax.optimization_barrier(leaves))

    def pressure(state):
        x, value = state
        now, mu = shared.at(value)
        return state_pressure(x, now.model, now.gel, mu)

    # one state at a time: those of a batch have room, all states of all its sheets have not
    found = lax.map(pressure, (fitted(x, "kn", shared.lengths), values))
    return fitted(found, "kg", problem.lengths)


def _states(newton, touching, problem, eliminations, values, symmetric):
    """The columns of a path, in the sizes of the shared equations.

    None is looked for if the sheet is not ``symmetric``.
    """
    elimination, *others = eliminations
    x, pressure = dry_state(problem, values[0])
    start = _March(
        values=jnp.full(HISTORY, values[0]),
        x=jnp.zeros((HISTORY, *x.shape)).at[0].set(x),
        pressure=jnp.zeros((HISTORY, *pressure.shape)).at[0].set(pressure),
        count=jnp.zeros((), int),
        rate=(jnp.zeros_like(x), jnp.zeros_like(pressure)),
        residual=jnp.asarray(jnp.nan),
        energy=jnp.asarray(jnp.nan),
        found=first_iterate(problem, elimination, values[0], x, pressure),
        step=jnp.zeros(()),
        least=jnp.zeros(()),
        iterations=jnp.zeros((), int),
        status=jnp.where(symmetric, int(Status.CONVERGED), int(Status.ASYMMETRIC)),
        reached=jnp.zeros((), bool),
    )

    attempt = functools.partial(_attempt, problem, touching, elimination, newton)

    def to_value(before: _March, value: Float[Array, ""]) -> tuple[_March, dict[str, Any]]:
        distance = jnp.abs(value - before.values[0])
        march = before._replace(
            step=distance,
            least=LEAST_STEP * distance,
            iterations=jnp.zeros((), int),
            reached=before.status != Status.CONVERGED,
        )
        march = lax.while_loop(
            lambda march: ~march.reached, lambda march: attempt(march, value), march
        )
        if others:
            march = _if_definite(problem, others, march, before)
        ok, reached = march.status == Status.CONVERGED, march.values[0]
        column = {
            "x": march.x[0],
            "pressure": march.pressure[0],
            "mu": problem.at(reached)[1],
            "value": reached,
        }
        column |= {"residual": march.residual, "energy": march.energy, "status": march.status}
        return march, column | {
            "negative_pivots": jnp.where(ok, 0, -1),
            "newton_iterations": march.iterations,
        }

    columns = lax.scan(to_value, start, values)[1]
    columns |= {"derivative": columns["status"], "switched": jnp.zeros(values.shape, int)}
    return columns | {"lowest_eigenvalue": jnp.full(values.shape, jnp.nan)}


def _if_definite(problem, eliminations, march, before):
    """The march if the blocks of its tangent are definite; else that ``before``, at its end."""

    def definite():
        now, _ = problem.at(march.values[0])
        pairs = tangent_blocks(now, march.x[0], march.pressure[0], march.found.linearisation)
        return jnp.all(jnp.stack([is_definite(one.cholesky(pairs)) for one in eliminations]))

    converged = march.status == Status.CONVERGED
    lost = converged & ~lax.cond(converged, definite, lambda: jnp.ones((), bool))
    kept = {
        name: jnp.where(lost, getattr(before, name), getattr(march, name))
        for name in ("values", "x", "pressure", "residual", "energy")
    }
    return march._replace(status=jnp.where(lost, int(Status.LOST_STABILITY), march.status), **kept)


def _attempt(problem, touching, elimination, newton, march, value):
    """One step towards ``value``: the whole way, or what is left of it after steps that failed."""
    is_first, last = march.count == 0, march.values[0]
    whole = is_first | (march.step >= jnp.abs(value - last))
    at = jnp.where(whole, value, last + jnp.sign(value - last) * march.step)
    x, pressure = _predicted(march, at)
    x = with_free_values(restrict(x, problem.free), problem.dry_positions(at), problem.free)
    has_factor = ~is_first & (march.found.status == Status.CONVERGED)
    found = solve_traced(problem, elimination, at, x, pressure, march.found, has_factor, newton)
    converged = found.status == Status.CONVERGED
    touches = converged & touching(found.x, problem.model)
    ok = converged & ~touches

    def pushed(old, new):
        return jnp.where(ok, jnp.concatenate([new[None], old[:-1]]), old)

    rate = lax.cond(
        ok & is_first, lambda: _rate(problem, elimination, found, at), lambda: march.rate
    )
    shorter = jnp.minimum(march.step, jnp.abs(at - last)) / 2
    given_up = ~ok & (touches | is_first | (shorter < march.least))
    return march._replace(
        values=pushed(march.values, at),
        x=pushed(march.x, found.x),
        pressure=pushed(march.pressure, found.pressure),
        count=march.count + ok,
        rate=rate,
        residual=jnp.where(ok, found.linearisation.residual_norm, march.residual),
        energy=jnp.where(ok, found.linearisation.energy, march.energy),
        found=found,
        step=jnp.where(ok, 2 * march.step, shorter),
        iterations=march.iterations + found.iterations,
        status=jnp.where(
            given_up,
            jnp.where(touches, int(Status.SELF_CONTACT), found.status),
            int(Status.CONVERGED),
        ),
        reached=given_up | (ok & whole),
    )


def _predicted(march, value):
    """Positions and pressures at a ``value`` by the polynomial through the history.

    From one state alone by its rate.
    """
    at = march.values
    newer = jnp.arange(HISTORY)[:, None] > jnp.arange(HISTORY)
    apart = at[:, None] != at
    # of equal values the latest
    real = (jnp.arange(HISTORY) < march.count) & ~jnp.any(newer & ~apart, axis=1)
    others = real & apart
    ratios = jnp.where(others, (value - at) / jnp.where(others, at[:, None] - at, 1.0), 1.0)
    weights = jnp.where(real, jnp.prod(ratios, axis=1), 0.0)
    alone, further = march.count <= 1, value - at[0]
    return tuple(
        jnp.where(alone, states[0] + further * rate, jnp.tensordot(weights, states, 1))
        for states, rate in zip((march.x, march.pressure), march.rate, strict=True)
    )


def _rate(problem, elimination, found, value):
    """Derivatives of positions and pressures by the control, without prescribed displacements."""
    forces, pressure = control_rates(problem, found.x, value)
    size = len(elimination.order)
    rate = scatter(
        jnp.zeros(forces.shape).at[:size].set(-elimination.solve(found.factors, forces[:size])),
        problem.free,
    )
    return rate, pressure + pressure_change(rate, found.linearisation, problem.model)
