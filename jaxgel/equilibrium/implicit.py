"""Derivatives of equilibrium states with respect to everything they depend on.

Invariant: the residual r(x; model, gel, mu, loads) vanishes on the free degrees of freedom. Differentiated, K dx = -dr at fixed x, with
the tangent K of the state itself. Written as a rule for tangents, it gives forward, reverse and second derivatives alike; the linear
solves run on the host with the factors that the sweep left behind (`linalg.solve_near`), and a state that nothing asks about
costs none. Outside ``jax.jit`` the solves lie between compiled programs, not in one: JAX's compilation cache on disk keeps no program
that calls the host, and would leave the whole of the rule to be compiled by every process.
"""

import dataclasses
import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from scipy.spatial import cKDTree

from .._memo import once_per_owner
from .._threads import ONE_THREAD, few_threads, usable_threads
from .._types import Array, Float
from ..linalg import solve_near
from ..mechanics import (
    Problem,
    TangentOperator,
    deformation_gradients,
    free_dofs,
    gather,
    is_sparse,
    linearise,
    prescribed_motion,
    residual,
    restrict,
    scatter,
    tangent,
    tangent_product,
)

STATES_TOGETHER = 4  # states that are differentiated together: per cell one product of small matrices; more would leave the cache
BYTES_TOGETHER = 2**28  # most that their positions gathered cell by cell may fill


def state_tangents(
    x: Float[Array, "k n 2"],
    pressure: Float[Array, "k g"],
    problem: Problem,
    mu: Float[Array, " k"],
    problem_dot: Problem,
    mu_dot: Float[Array, " k"],
) -> Float[Array, "k n 2"]:
    """Tangents of the equilibria ``x`` with ``pressure`` at ``mu`` for tangents of the ``problem`` and of mu.

    Constrained degrees of freedom move with the nodes of the dry plate. The ``operators`` of the problem need no tangents: they follow from
    the model. nan where a tangent is singular.
    """
    motion, rhs = _residual_changes(x, pressure, problem, mu, problem_dot, mu_dot)
    leaves, structure = jax.tree.flatten((x, pressure, mu, problem))
    return _moved(motion, _solutions.bind(rhs, *leaves, structure=structure), problem.free)


def _residual_changes(x, pressure, problem, mu, problem_dot, mu_dot):
    """Prescribed motions (k, n, 2) of the states, and -dr (k, f) left by them and the tangents of the inputs."""
    inputs, dots = ((_without_observation_points(q.model), q.gel, q.loads) for q in (problem, problem_dot))
    leaves, structure = jax.tree.flatten(inputs)
    dots = jax.tree.leaves(dots)
    floating = tuple(jnp.issubdtype(leaf.dtype, jnp.floating) for leaf in leaves)
    count, size = len(x), _together(len(x), problem.model)

    def grouped(values):
        return _in_groups(values, -(-count // size), size)

    states = [grouped(values) for values in (x, pressure, mu, mu_dot)]
    dots = [dot for dot, f in zip(dots, floating, strict=True) if f]
    return _ungrouped(_mapped(_ResidualChange(structure, floating), states, leaves, dots), count)


@functools.partial(jax.jit, static_argnums=0)
def _mapped(function, states, leaves, dots):
    """Values of ``function`` for one group of states after the other; only its arguments are kept for the reverse."""
    one = jax.checkpoint(lambda x, pressure, mu, mu_dot: function(x, pressure, mu, *leaves, mu_dot, *dots))
    return lax.map(lambda state: one(*state), states)


def _without_observation_points(model):
    """The model without the outline where only contact would need it: no residual depends on points at which states are observed."""
    return model if model.contact is not None else dataclasses.replace(model, outline=None)


@functools.partial(jax.jit, static_argnames=("number", "size"))
def _in_groups(values, number, size):
    """The values (k, ...) in groups (number, size, ...), padded with the last one."""
    rest = number * size - len(values)
    return jnp.concatenate([values, jnp.broadcast_to(values[-1:], (rest, *values.shape[1:]))]).reshape(number, size, *values.shape[1:])


@functools.partial(jax.jit, static_argnames="count")
def _ungrouped(values, count):
    return [value.reshape(-1, *value.shape[2:])[:count] for value in values]


@dataclasses.dataclass(frozen=True)
class _ResidualChange:
    """`_residual_changes` of states ``x`` (k, n, 2) with ``pressure`` (k, g) at ``mu`` (k,).

    Nodes move by F times the motion of the dry ones, which leaves the volume ratios nearly as they are: their change is multiplied by the
    bulk stiffness, and its round-off by that over the stiffness of the softest mode. F itself needs no derivative: the tangents of the
    states do not depend on the motion that is prescribed.
    """

    structure: object
    """Tree structure of (model, gel, loads), the leaves of which follow the states; then tangents of mu and of the leaves."""
    floating: tuple
    """Which leaves are of floating type and have a tangent."""

    def __call__(self, x, pressure, mu, *args):
        leaves, mu_dot, dots = args[: len(self.floating)], args[len(self.floating)], iter(args[len(self.floating) + 1 :])
        pairs = zip(leaves, self.floating, strict=True)
        dots = [next(dots) if f else np.zeros(leaf.shape, jax.dtypes.float0) for leaf, f in pairs]
        model, gel, loads = jax.tree.unflatten(self.structure, leaves)
        model_dot, gel_dot, loads_dot = jax.tree.unflatten(self.structure, dots)
        topology = model.lists.topology
        free = free_dofs(topology)
        dry_motion = jax.jvp(lambda cloud: cloud.nodes, (model.cloud,), (model_dot.cloud,))[1]
        prescribed = prescribed_motion(dry_motion, topology.plate, free)

        def one(state):
            x, pressure, mu, mu_dot = state
            along = jnp.einsum("nij,nj->ni", lax.stop_gradient(_nodal_gradients(x, model)), dry_motion)
            motion = prescribed + scatter(restrict(along, free), along.shape, free)
            forces = functools.partial(residual, pressure=pressure)
            change = jax.jvp(forces, (x, model, gel, mu, loads), (motion, model_dot, gel_dot, mu_dot, loads_dot))[1]
            return [motion, -gather(change, free)]

        return jax.vmap(one)((x, pressure, mu, mu_dot))


def _nodal_gradients(x, model):
    """Deformation gradients (n, 2, 2) at the nodes: of each the mean in the cell nearest it."""
    means = []
    for block in model.blocks:
        share = block.weight / jnp.sum(block.weight, axis=1, keepdims=True)
        means.append(deformation_gradients(x, dataclasses.replace(block, dphi=jnp.einsum("cq,cqai->cai", share, block.dphi)[:, None])))
    return jnp.concatenate(means)[_nearest_cells(model.lists), 0]


@once_per_owner
def _nearest_cells(lists):
    """The cell (n,), counted block after block, nearest each node of the reference cloud; host."""
    points = lists.topology.partition.vertices[lists.topology.node_vertices]
    cells = np.concatenate(lists.patches)
    real = lists.support[cells, :, None] > 0
    centres = np.sum(np.where(real, points[lists.nodes[cells]], 0.0), axis=1) / real.sum(axis=1)
    return cKDTree(centres).query(points)[1]


@jax.jit
def _moved(motion, correction, free):
    """Nodal motions (k, n, 2): the prescribed ones and the corrections (k, f) of the free degrees of freedom."""
    return motion + jax.vmap(lambda dx: scatter(dx, motion.shape[1:], free))(correction)


@functools.partial(jax.custom_jvp[Any], nondiff_argnums=(1,))
def first_order_only(values: Any, what: str) -> Any:  # noqa: ARG001
    """The ``values`` of ``what``; used in a rule for tangents, ValueError where that is differentiated once more."""
    return values


@first_order_only.defjvp
def _refuse(what, *_):
    raise ValueError(f"{what}: has first derivatives only")


@dataclasses.dataclass(frozen=True)
class Tangent:
    """Tangents of the values of ``function`` for its arguments and the tangents of those numbered ``which``."""

    function: object
    which: tuple

    def __call__(self, *args: jax.Array):
        count = len(args) - len(self.which)
        fixed = args[:count]

        def values(*some):
            given = dict(zip(self.which, some, strict=True))
            return self.function(*(given.get(i, arg) for i, arg in enumerate(fixed)))

        return jax.jvp(values, [fixed[i] for i in self.which], list(args[count:]))[1]


@functools.partial(jax.custom_jvp[Any], nondiff_argnums=(0,))
def with_derivatives_of(function: Callable[..., Any], values: Any, *inputs: Any) -> Any:  # noqa: ARG001
    """The ``values`` of ``function(*inputs)``, found otherwise; what their derivatives need is computed where these are asked for."""
    return values


@functools.partial(with_derivatives_of.defjvp, symbolic_zeros=True)
def _with_derivatives_jvp(function, primals, tangents):
    (values, *inputs), (_, *inputs_dot) = primals, tangents
    leaves, structure = jax.tree.flatten(inputs)
    dots = jax.tree.leaves(inputs_dot)
    which = tuple(i for i, dot in enumerate(dots) if not isinstance(dot, SymbolicZero) and dot.dtype != jax.dtypes.float0)
    if not which:
        return values, jax.tree.map(SymbolicZero.from_primal_value, values)
    return values, _remade(Tangent(_OfLeaves(function, structure), which), *leaves, *(dots[i] for i in which))


@dataclasses.dataclass(frozen=True)
class _OfLeaves:
    """``function`` of the leaves of its arguments."""

    function: object
    structure: object
    """Tree structure of the arguments."""

    def __call__(self, *leaves):
        return self.function(*jax.tree.unflatten(self.structure, leaves))


@functools.partial(jax.jit, static_argnums=0)
def _remade(function, *args):
    """Values of ``function`` by one program; only the arguments are kept for the reverse."""
    return jax.checkpoint(lambda *args: function(*args))(*args)


def _together(count, model):
    """Number of states, of ``count``, that are differentiated together."""
    return min(count, STATES_TOGETHER, max(1, BYTES_TOGETHER // (16 * sum(block.nodes.size for block in model.blocks))))


# --- linear solves: outside jit by products, or one compiled assembly per state, inside by a callback --------------------------

_solutions = Primitive("equilibrium_solutions")
"""Solutions as the right-hand sides (k, f) or (k, f, r) for the tangents of the states that the other arguments describe: the leaves of
(x (k, n, 2), pressure (k, g), mu (k,), `Problem`) with the tree ``structure``."""


@dataclasses.dataclass(frozen=True)
class _Products:
    """Products like ``v`` (k, f) or (k, f, r) of the tangents with ``v``, of the leaves that `_solutions` has."""

    structure: object
    """Tree structure of the leaves."""

    def __call__(self, v, *leaves):
        x, pressure, mu, problem = jax.tree.unflatten(self.structure, leaves)

        def product(state):
            v, x, pressure, mu = state
            return tangent_product(problem, x, pressure, mu, v)

        def of_all(v):
            return lax.map(product, (v, x, pressure, mu), batch_size=_together(len(x), problem.model))

        return of_all(v) if v.ndim == 2 else jax.vmap(of_all, 2, 2)(v)


def _pairs(problem, x, pressure, mu):
    """The tangent (p, 2, 2) at the state ``x`` (n, 2) with ``pressure`` (g,), by the programs of the sweep."""
    return tangent(problem, x, pressure, linearise(problem, x, pressure, mu))


def _solutions_jvp(primals, tangents, *, structure):
    """K x = b gives K dx = db - dK x, the latter by the energy, whose arguments the leaves are."""
    (rhs, *leaves), (change, *dots) = primals, tangents
    solution = _solutions.bind(rhs, *leaves, structure=structure)
    moving = tuple(i + 1 for i, dot in enumerate(dots) if type(dot) is not ad.Zero)
    if moving:
        moved = _remade(Tangent(_Products(structure), moving), solution, *leaves, *(dots[i - 1] for i in moving))
        change = -moved if type(change) is ad.Zero else change - moved
    return solution, change if type(change) is ad.Zero else _solutions.bind(change, *leaves, structure=structure)


def _solutions_transpose(cotangent, rhs, *leaves, structure):  # noqa: ARG001
    """Tangents are symmetric."""
    found = cotangent if type(cotangent) is ad.Zero else _solutions.bind(cotangent, *leaves, structure=structure)
    return [found, *(None for _ in leaves)]


@_solutions.def_impl
def _solved(rhs, *leaves, structure):
    """On the host, with values; 0 for 0 at no cost.

    Tangents with sparse products are not assembled, unless no recent factor will do; other small ones are solved side by side in threads.
    """
    x, pressure, mu, problem = jax.tree.unflatten(structure, leaves)
    pattern = problem.pattern
    rhs, x, pressure, mu = map(np.asarray, (rhs, x, pressure, mu))
    wanted, solutions = np.flatnonzero(np.any(rhs != 0, axis=tuple(range(1, rhs.ndim)))), np.zeros(rhs.shape)

    def solve(k, product=None):
        pairs = functools.cache(lambda: _pairs(problem, x[k], pressure[k], mu[k]))
        solutions[k] = _solve_columns(pattern, x[k], rhs[k], product or pattern.matrix(pairs()).__matmul__, pairs)

    with few_threads(len(pattern.free)):
        if is_sparse(problem) and len(wanted):
            products = TangentOperator(problem).at(x[wanted], pressure[wanted], mu[wanted])
            for k, product in zip(wanted, products, strict=True):
                solve(k, product)
        else:
            with ThreadPoolExecutor(usable_threads() if len(pattern.free) <= ONE_THREAD else 1) as pool:
                list(pool.map(solve, wanted))
    return jnp.asarray(solutions)


def _solved_traced(rhs, *leaves, structure):
    """Inside jit and vmap, by one callback for each state."""
    x, pressure, mu, problem = jax.tree.unflatten(structure, leaves)
    pattern = problem.pattern

    def on_host(x, rhs, pairs):
        return _solve_columns(pattern, np.asarray(x), rhs, pattern.matrix(pairs).__matmul__, lambda: pairs)

    def solution(rhs, x, pressure, mu):
        pairs = _pairs(problem, x, pressure, mu)
        return jax.pure_callback(on_host, jax.ShapeDtypeStruct(rhs.shape, rhs.dtype), x, rhs, pairs, vmap_method="sequential")

    def one(state):
        return lax.cond(jnp.any(state[0] != 0), solution, lambda rhs, *_: jnp.zeros_like(rhs), *state)

    return lax.map(one, (rhs, x, pressure, mu))


def _solve_columns(pattern, x, rhs, product, pairs):
    """Solutions as the right-hand sides (f,) or (f, r) by `solve_near`, each as accurate as if it were alone; 0 for 0."""
    rhs = np.asarray(rhs)
    columns = rhs.reshape(len(rhs), -1).T
    return np.stack([solve_near(pattern, x, b, product, pairs) if np.any(b != 0) else b for b in columns], axis=1).reshape(rhs.shape)


def _solved_batch(args, axes, *, structure):
    """Right-hand sides (b, k, f) for the same states are columns."""
    (rhs, *states), (axis, *others) = args, axes
    if any(other is not batching.not_mapped for other in others):
        return jax.vmap(functools.partial(_solved_traced, structure=structure), axes)(*args), 0
    columns = jnp.moveaxis(rhs, axis, -1)
    found = _solutions.bind(columns.reshape(*columns.shape[:2], -1), *states, structure=structure)
    return found.reshape(columns.shape), columns.ndim - 1


_solutions.def_abstract_eval(lambda rhs, *_, **__: rhs)
ad.primitive_jvps[_solutions] = _solutions_jvp
ad.primitive_transposes[_solutions] = _solutions_transpose
mlir.register_lowering(_solutions, mlir.lower_fun(_solved_traced, multiple_results=False))
batching.primitive_batchers[_solutions] = _solved_batch
