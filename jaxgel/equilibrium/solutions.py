"""Solutions of K dx = b with the tangents K of many states, one JAX primitive and its rules.

They are found on the host, with the factors that the sweep left behind: between compiled programs.
In one, each tangent is factorised again.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._compiled import tangents as tangents_of
from .._primitives import primitive
from .._threads import few_threads
from ..discretisation import Body
from ..linalg import (
    RECENT_FACTORS,
    BlockPattern,
    SingularTangent,
    block_elimination_of,
    elimination_of,
)
from ..mechanics import (
    factorised_tangent,
    gather,
    hessian_product,
    linearise,
    pair_product,
    scatter,
    tangent_blocks,
)

# states that are differentiated together: per cell one product of small matrices; more would leave
# the cache
STATES_TOGETHER = 4
BYTES_TOGETHER = 2**28  # most that their positions gathered cell by cell may fill


def states_together(count: int, model: Body) -> int:
    """Number of states, of ``count``, that are differentiated together."""
    return min(
        count,
        STATES_TOGETHER,
        max(1, BYTES_TOGETHER // (16 * sum(block.nodes.size for block in model.blocks))),
    )


@dataclasses.dataclass(frozen=True)
class _Products:
    """Products like ``v`` (k, f) or (k, f, r) of the tangents, of the leaves of `solutions`."""

    structure: object
    """Tree structure of the leaves."""

    def __call__(self, v, *leaves):
        x, pressure, values, problem = jax.tree.unflatten(self.structure, leaves)

        def product(state):
            v, x, pressure, value = state
            field, (now, mu) = scatter(v, problem.free), problem.at(value)
            return gather(
                hessian_product(x, field, now.model, now.gel, mu, now.loads, pressure), problem.free
            )

        def of_all(v):
            return lax.map(
                product, (v, x, pressure, values), batch_size=states_together(len(x), problem.model)
            )

        return [of_all(v) if v.ndim == 2 else jax.vmap(of_all, 2, 2)(v)]


def _solutions_jvp(primals, tangents, *, structure, pattern):
    """K x = b gives K dx = db - dK x, the latter by the energy, whose arguments the leaves are."""
    (rhs, *leaves), (change, *dots) = primals, tangents
    solution = solutions.bind(rhs, *leaves, structure=structure, pattern=pattern)
    if any(dot is not None for dot in dots):
        (moved,) = tangents_of(_Products(structure), [solution, *leaves], [None, *dots], [solution])
        change = -moved if change is None else change - moved
    return solution, change if change is None else solutions.bind(
        change, *leaves, structure=structure, pattern=pattern
    )


def _solutions_transpose(cotangent, args, *, structure, pattern):
    """Tangents are symmetric."""
    found = (
        None
        if cotangent is None
        else solutions.bind(cotangent, *args[1:], structure=structure, pattern=pattern)
    )
    return [found, *(None for _ in args[1:])]


def _solved(rhs, *leaves, structure, **_):
    """On the host, with values; 0 for 0 at no cost, nan if a tangent is singular."""
    x, pressure, values, problem = jax.tree.unflatten(structure, leaves)
    rhs, x, pressure, values = map(np.asarray, (rhs, x, pressure, values))
    found = np.zeros(rhs.shape)
    with few_threads(len(problem.free)):
        for k in np.flatnonzero(np.any(rhs != 0, axis=tuple(range(1, rhs.ndim)))):
            try:
                solve = _factor(problem, x[k], pressure[k], values[k]).accurate
                columns = rhs[k].reshape(len(rhs[k]), -1).T
                found[k] = np.stack([solve(b) for b in columns], axis=1).reshape(rhs[k].shape)
            except SingularTangent:
                found[k] = np.nan
    return jax.device_put(found)


def _factor(problem, x, pressure, value):
    """Factor of the tangent at a state, the one that the sweep has left if it is kept."""
    lists, (now, mu) = problem.model.lists, problem.at(value)
    made = RECENT_FACTORS.find(lists, (x, pressure, now.gel))
    if made is None:
        made = factorised_tangent(now, x, pressure, linearise(now, x, pressure, mu))
        RECENT_FACTORS.add(made, lists, (x, pressure, now.gel))
    return made


def _solved_in_program(rhs, *leaves, structure, pattern):
    """The same inside a compiled program, for positive definite tangents; nan if one is not."""
    x, pressure, values, shared = jax.tree.unflatten(structure, leaves)
    made = block_elimination_of if isinstance(pattern, BlockPattern) else elimination_of
    elimination = lax.optimization_barrier(made(pattern))
    size = elimination.size

    def of_state(state):
        rhs, x, pressure, value = state
        now, mu = shared.at(value)
        blocks = tangent_blocks(now, x, pressure, linearise(now, x, pressure, mu))
        factors = elimination.cholesky(blocks)

        def solve(b):
            v = jnp.zeros_like(b).at[:size].set(elimination.solve(factors, b[:size]))
            left = b - gather(
                pair_product(blocks, now.operators.pairs, scatter(v, shared.free)), shared.free
            )
            return v.at[:size].add(elimination.solve(factors, left[:size]))

        return solve(rhs) if rhs.ndim == 1 else jax.vmap(solve, 1, 1)(rhs)

    return lax.map(of_state, (rhs, x, pressure, values))


def _solved_batch(args, axes, *, structure, pattern):
    """Right-hand sides (b, k, f) for the same states are columns."""
    (rhs, *states), (axis, *others) = args, axes
    if any(other is not None for other in others):
        return jax.vmap(
            functools.partial(_solved_in_program, structure=structure, pattern=pattern), axes
        )(*args), 0
    columns = jnp.moveaxis(rhs, axis, -1)
    found = solutions.bind(
        columns.reshape(*columns.shape[:2], -1), *states, structure=structure, pattern=pattern
    )
    return found.reshape(columns.shape), columns.ndim - 1


solutions = primitive(
    "equilibrium_solutions",
    value=_solved,
    traced=_solved_in_program,
    shapes=lambda rhs, *_, **__: rhs,
    jvp=_solutions_jvp,
    transpose=_solutions_transpose,
    batch=_solved_batch,
    several=False,
)
"""Solutions of the tangents of states for right-hand sides (k, f) or (k, f, r).

They are like the right-hand sides; the states are described by the other arguments: the leaves of
(x (k, n, 2), pressure (k, g), values (k,) of the control, `Problem`) with the tree ``structure``.
In a program the last is its shared form, and the ``pattern`` that of its tangents or of their
blocks; else it is None.
"""
