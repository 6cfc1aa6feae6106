"""Derivatives of equilibrium states with respect to everything they depend on.

Invariant: the residual r(x; model, gel, mu, loads) vanishes on the free degrees of freedom. Differentiated, K dx = -dr at fixed x, with
the tangent K of the state itself. Written as a rule for tangents, it gives forward, reverse and second derivatives alike; the linear
solves run on the host with the factors that the sweep left behind (``linear_solve.solve_near``), and a state that nothing asks about
costs none. Outside ``jax.jit`` the solves lie between compiled programs, not in one: JAX's compilation cache on disk keeps no program
that calls the host, and would leave the whole of the rule to be compiled by every process.
"""

import dataclasses
import functools
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from scipy.spatial import cKDTree

from .._parallel import Tangent, over_parts
from .._threads import ONE_THREAD, few_threads, usable_threads
from ..linalg import solve_near
from ..mechanics import Products, carried, crossed_entries, deformation_gradients, has_products, picked, reduced, residual, spread
from .newton import linearised, tangent_at

TOGETHER = 4  # states that are differentiated together: per cell that is one product of small matrices, and more leave the cache
TOGETHER_BYTES = 2**28  # most that their positions gathered cell by cell may fill


def state_tangents(x, pressure, inputs, inputs_dot, pattern, fixed):
    """Tangents (k, n, 2) of the equilibria ``x`` (k, n, 2) with ``pressure`` (k, g) for tangents of their ``inputs``.

    These are (model, gel, mu (k,), loads). Constrained degrees of freedom move with the nodes of the dry plate. ``fixed`` are the
    ``mixed.Constants`` of the model, whose own derivatives are not needed. nan where a tangent is singular.
    """
    crossed = crossed_entries(fixed) if _is_small(pattern) and has_products(*inputs[:2]) else None  # runs while the rest is traced
    carried, rhs = _imbalances(x, pressure, inputs, inputs_dot, pattern)
    leaves, structure = jax.tree.flatten((x, pressure, inputs, fixed, crossed))
    return _moved(carried, _solutions.bind(rhs, *leaves, structure=structure, pattern=pattern), pattern)


def _imbalances(x, pressure, inputs, inputs_dot, pattern):
    """Motions (k, n, 2) that the states are carried with, and -dr (k, f) left by them and the tangents of the inputs."""
    (model, gel, mu, loads), (model_dot, gel_dot, mu_dot, loads_dot) = inputs, inputs_dot
    model, model_dot = map(_without_probes, (model, model_dot))
    leaves, structure = jax.tree.flatten((model, gel, loads))
    dots = jax.tree.leaves((model_dot, gel_dot, loads_dot))
    floating = tuple(jnp.issubdtype(leaf.dtype, jnp.floating) for leaf in leaves)
    count, size = len(x), _together(len(x), model)

    def grouped(values):
        return _in_groups(values, -(-count // size), size)

    rows, linear = (grouped(x), grouped(pressure), grouped(mu)), (grouped(mu_dot),)
    dots = [dot for dot, f in zip(dots, floating, strict=True) if f]
    found = over_parts(_Imbalances(structure, floating, pattern), rows, leaves, linear=linear, shared_linear=dots)
    return _ungrouped(found, count)


def _without_probes(model):
    """The model without the points at which states are only looked at: no residual depends on them."""
    return dataclasses.replace(model, midline=None, core=None, outline=model.outline if model.contact is not None else None)


@functools.partial(jax.jit, static_argnames=("number", "size"))
def _in_groups(values, number, size):
    """The values (k, ...) in groups (number, size, ...), padded with the last one."""
    rest = number * size - len(values)
    return jnp.concatenate([values, jnp.broadcast_to(values[-1:], (rest, *values.shape[1:]))]).reshape(number, size, *values.shape[1:])


@functools.partial(jax.jit, static_argnames="count")
def _ungrouped(values, count):
    return [value.reshape(-1, *value.shape[2:])[:count] for value in values]


@dataclasses.dataclass(frozen=True)
class _Imbalances:
    """`_imbalances` of states ``x`` (k, n, 2) with ``pressure`` (k, g) at ``mu`` (k,).

    Nodes are carried by F times the motion of the dry ones, which leaves the volume ratios nearly as they are: what these change by is
    multiplied by the bulk stiffness, and its round-off by that over the stiffness of the softest mode. F itself needs no derivative: the
    tangents of the states do not depend on what carries them.
    """

    structure: object
    """Tree structure of (model, gel, loads), the leaves of which follow the states; then tangents of mu and of the leaves."""
    floating: tuple
    """Which leaves are of floating type and have a tangent."""
    pattern: object
    """``linear_solve.Pattern`` of the tangent."""

    def __call__(self, x, pressure, mu, *args):
        leaves, mu_dot, dots = args[: len(self.floating)], args[len(self.floating)], iter(args[len(self.floating) + 1 :])
        pairs = zip(leaves, self.floating, strict=True)
        dots = [next(dots) if f else np.zeros(leaf.shape, jax.dtypes.float0) for leaf, f in pairs]
        model, gel, loads = jax.tree.unflatten(self.structure, leaves)
        model_dot, gel_dot, loads_dot = jax.tree.unflatten(self.structure, dots)
        free, plate = self.pattern.free, model.lists.topology.plate
        moved = jax.jvp(lambda cloud: cloud.nodes, (model.cloud,), (model_dot.cloud,))[1]
        prescribed = carried(moved, plate, free)

        def one(state):
            x, pressure, mu, mu_dot = state
            along = jnp.einsum("nij,nj->ni", lax.stop_gradient(_nodal_gradients(x, model)), moved)
            carried = prescribed + spread(picked(along, free), along.shape, free)
            forces = functools.partial(residual, pressure=pressure)
            change = jax.jvp(forces, (x, model, gel, mu, loads), (carried, model_dot, gel_dot, mu_dot, loads_dot))[1]
            return [carried, -reduced(change, free)]

        return jax.vmap(one)((x, pressure, mu, mu_dot))


def _nodal_gradients(x, model):
    """Deformation gradients (n, 2, 2) at the nodes: of each the mean in the cell nearest it."""
    means = []
    for block in model.blocks:
        share = block.weight / jnp.sum(block.weight, axis=1, keepdims=True)
        means.append(deformation_gradients(x, dataclasses.replace(block, dphi=jnp.einsum("cq,cqai->cai", share, block.dphi)[:, None])))
    return jnp.concatenate(means)[_nearest_cells(model.lists), 0]


def _nearest_cells(lists):
    """The cell (n,), counted block after block, nearest each node of the reference cloud; host, kept with the lists."""
    if "nearest cells" not in lists.cache:
        points = lists.topology.partition.vertices[lists.topology.node_vertices]
        cells = np.concatenate(lists.cells)
        real = lists.support[cells, :, None] > 0
        centres = np.sum(np.where(real, points[lists.nodes[cells]], 0.0), axis=1) / real.sum(axis=1)
        lists.cache["nearest cells"] = cKDTree(centres).query(points)[1]
    return lists.cache["nearest cells"]


@functools.partial(jax.jit, static_argnames="pattern")
def _moved(carried, correction, pattern):
    """Nodal motions (k, n, 2): those carried and the corrections (k, f) of the free degrees of freedom."""
    return carried + jax.vmap(lambda dx: spread(dx, carried.shape[1:], pattern.free))(correction)


@functools.partial(jax.custom_jvp, nondiff_argnums=(1,))
def only_first(values, what):  # noqa: ARG001
    """The ``values`` of ``what``; used in a rule for tangents, ValueError where that is differentiated once more."""
    return values


@only_first.defjvp
def _refuse(what, *_):
    raise ValueError(f"{what}: has first derivatives only")


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def known(function, values, *inputs):  # noqa: ARG001
    """The ``values`` of ``function(*inputs)``, found otherwise; what their derivatives need is computed where these are asked for."""
    return values


@functools.partial(known.defjvp, symbolic_zeros=True)
def _known_jvp(function, primals, tangents):
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
    return min(count, TOGETHER, max(1, TOGETHER_BYTES // (16 * sum(block.nodes.size for block in model.blocks))))


_solutions = Primitive("equilibrium_solutions")
"""Solutions as the right-hand sides (k, f) or (k, f, r) for the tangents of the states that the other arguments describe: the leaves of
(x (k, n, 2), pressure (k, g), inputs, ``mixed.Constants``, entries for ``Products`` or None) with the tree ``structure``."""


@dataclasses.dataclass(frozen=True)
class _Products:
    """Products like ``v`` (k, f) or (k, f, r) of the free-free tangents with ``v``, of the leaves that `_solutions` has."""

    structure: object
    """Tree structure of the leaves."""
    pattern: object
    """``linear_solve.Pattern`` of the tangents."""

    def __call__(self, v, *leaves):
        x, pressure, (model, gel, mu, loads), *_ = jax.tree.unflatten(self.structure, leaves)

        def product(state):
            v, x, pressure, mu = state
            direction = spread(v, x.shape, self.pattern.free)
            return reduced(jax.jvp(lambda x: residual(x, model, gel, mu, loads, pressure), (x,), (direction,))[1], self.pattern.free)

        def of_all(v):
            return lax.map(product, (v, x, pressure, mu), batch_size=_together(len(x), model))

        return of_all(v) if v.ndim == 2 else jax.vmap(of_all, 2, 2)(v)


def _pairs(x, pressure, mu, model, gel, loads, fixed, pattern):
    """The tangent (p, 2, 2) at the state ``x`` (n, 2) with ``pressure`` (g,), by the programs of the sweep."""
    now = linearised(x, pressure, model, gel, mu, loads, fixed, pattern.free)[0]
    return tangent_at(x, pressure, now, model, gel, fixed)


def _solutions_jvp(primals, tangents, *, structure, pattern):
    """K x = b gives K dx = db - dK x, the latter by the energy: the leaves know more of it than the constants."""
    (rhs, *leaves), (change, *dots) = primals, tangents
    solution = _solutions.bind(rhs, *leaves, structure=structure, pattern=pattern)
    moving = tuple(i + 1 for i, dot in enumerate(dots) if type(dot) is not ad.Zero)
    if moving:
        moved = _remade(Tangent(_Products(structure, pattern), moving), solution, *leaves, *(dots[i - 1] for i in moving))
        change = -moved if type(change) is ad.Zero else change - moved
    return solution, change if type(change) is ad.Zero else _solutions.bind(change, *leaves, structure=structure, pattern=pattern)


def _solutions_transpose(cotangent, rhs, *leaves, **static):  # noqa: ARG001
    """Tangents are symmetric."""
    found = cotangent if type(cotangent) is ad.Zero else _solutions.bind(cotangent, *leaves, **static)
    return [found, *(None for _ in leaves)]


@_solutions.def_impl
def _solved(rhs, *leaves, structure, pattern):
    """On the host, with values; 0 for 0 at no cost.

    Small tangents of the default kind are not assembled, unless no known factor will do; other small ones side by side in threads.
    """
    x, pressure, (model, gel, mu, loads), fixed, crossed = jax.tree.unflatten(structure, leaves)
    rhs, x, pressure, mu = map(np.asarray, (rhs, x, pressure, mu))
    wanted, solutions = np.flatnonzero(np.any(rhs != 0, axis=tuple(range(1, rhs.ndim)))), np.zeros(rhs.shape)

    def solve(k, product=None):
        pairs = functools.cache(lambda: _pairs(x[k], pressure[k], mu[k], model, gel, loads, fixed, pattern))
        solutions[k] = _solve_columns(pattern, x[k], rhs[k], product or pattern.matrix(pairs()).__matmul__, pairs)

    with few_threads(len(pattern.free)):
        if crossed is not None and len(wanted):
            products = Products(model, gel, fixed, crossed, pattern.free)
            for k, product in zip(wanted, products.at(x[wanted], pressure[wanted]), strict=True):
                solve(k, product)
        else:
            with ThreadPoolExecutor(usable_threads() if _is_small(pattern) else 1) as pool:
                list(pool.map(solve, wanted))
    return jnp.asarray(solutions)


def _is_small(pattern):
    return len(pattern.free) <= ONE_THREAD


def _solved_traced(rhs, *leaves, structure, pattern):
    """Inside jit and vmap, by one callback for each state."""
    x, pressure, (model, gel, mu, loads), fixed, _ = jax.tree.unflatten(structure, leaves)

    def on_host(x, rhs, pairs):
        return _solve_columns(pattern, np.asarray(x), rhs, pattern.matrix(pairs).__matmul__, lambda: pairs)

    def solution(rhs, x, pressure, mu):
        pairs = _pairs(x, pressure, mu, model, gel, loads, fixed, pattern)
        return jax.pure_callback(on_host, jax.ShapeDtypeStruct(rhs.shape, rhs.dtype), x, rhs, pairs, vmap_method="sequential")

    def one(state):
        return lax.cond(jnp.any(state[0] != 0), solution, lambda rhs, *_: jnp.zeros_like(rhs), *state)

    return lax.map(one, (rhs, x, pressure, mu))


def _solve_columns(pattern, x, rhs, product, pairs):
    """Solutions as the right-hand sides (f,) or (f, r) by `solve_near`, each as accurate as if it were alone; 0 for 0."""
    rhs = np.asarray(rhs)
    columns = rhs.reshape(len(rhs), -1).T
    return np.stack([solve_near(pattern, x, b, product, pairs) if np.any(b != 0) else b for b in columns], axis=1).reshape(rhs.shape)


def _solved_batch(args, axes, *, structure, pattern):
    """Right-hand sides (b, k, f) for the same states are columns."""
    (rhs, *states), (axis, *others) = args, axes
    if any(other is not batching.not_mapped for other in others):
        return jax.vmap(functools.partial(_solved_traced, structure=structure, pattern=pattern), axes)(*args), 0
    columns = jnp.moveaxis(rhs, axis, -1)
    found = _solutions.bind(columns.reshape(*columns.shape[:2], -1), *states, structure=structure, pattern=pattern)
    return found.reshape(columns.shape), columns.ndim - 1


_solutions.def_abstract_eval(lambda rhs, *_, **__: rhs)
ad.primitive_jvps[_solutions] = _solutions_jvp
ad.primitive_transposes[_solutions] = _solutions_transpose
mlir.register_lowering(_solutions, mlir.lower_fun(_solved_traced, multiple_results=False))
batching.primitive_batchers[_solutions] = _solved_batch
