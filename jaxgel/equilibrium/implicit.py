"""Derivatives of equilibrium states with respect to everything they depend on.

Invariant: the residual r(x; model, gel, mu, loads) vanishes on the free degrees of freedom. Differentiated, K dx = -dr at fixed x, with
the tangent K of the state itself. Written as a rule for tangents, it gives forward, reverse and second derivatives alike; a state that
nothing asks about costs no linear solve, and outside of JAX's transformations nothing in reverse.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from scipy.spatial import cKDTree

from .._memo import once_per_owner
from .._types import Array, Float
from ..materials import varies
from ..mechanics import Problem, deformation_gradients, free_dofs, gather, prescribed_motion, residual, restrict, scatter, total_energy
from ..symmetry import Orbits, orbits, symmetries_of_field
from .derivatives import Tangent, remade
from .primitives import primitive
from .solutions import solutions, states_together

ALIKE = 1e-11  # of a field: how far an adjoint field may be from its image; what that leaves out of a derivative is as small


def state_tangents(
    x: Float[Array, "k n 2"],
    pressure: Float[Array, "k g"],
    problem: Problem,
    mu: Float[Array, " k"],
    problem_dot: Problem,
    mu_dot: Float[Array, " k"],
    groups: tuple[tuple[str, ...], ...],
) -> Float[Array, "k n 2"]:
    """Tangents of the equilibria ``x`` with ``pressure`` at ``mu`` for tangents of the ``problem`` and of mu.

    Constrained degrees of freedom move with the nodes of the dry plate. The ``operators`` of the problem need no tangents: they follow from
    the model. nan where a tangent is singular. ``groups`` are symmetries that the problem and each state without contact have: where the
    cotangent of a state has them too, its reverse visits one patch of each orbit; inside ``jit`` and ``vmap`` all patches.
    """
    inputs, dots = ((_without_observation_points(q.model), q.gel, q.loads) for q in (problem, problem_dot))
    leaves, structure = jax.tree.flatten(inputs)
    map_ = _Changes(structure, tuple(bool(jnp.issubdtype(jnp.result_type(leaf), jnp.floating)) for leaf in leaves))
    groups = ((),) * len(groups) if varies(problem.gel) else groups
    motion, rhs = changes.bind(mu_dot, *map_.floats(dots), x, pressure, mu, *leaves, map_=map_, groups=groups)
    leaves, structure = jax.tree.flatten((x, pressure, mu, problem))
    return _moved(motion, solutions.bind(rhs, *leaves, structure=structure), problem.free)


def _without_observation_points(model):
    """The model without the outline where only contact would need it: no residual depends on points at which states are observed."""
    return model if model.contact is not None else dataclasses.replace(model, outline=None)


@jax.jit
def _moved(motion, correction, free):
    """Nodal motions (k, n, 2): the prescribed ones and the corrections (k, f) of the free degrees of freedom."""
    return motion + jax.vmap(lambda dx: scatter(dx, motion.shape[1:], free))(correction)


# --- the linear map from tangents of the inputs ------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Changes:
    """Prescribed motions (k, n, 2) of the states, and -dr (k, f) left by them and the tangents of the inputs.

    Nodes move by F times the motion of the dry ones, which leaves the volume ratios nearly as they are: their change is multiplied by the
    bulk stiffness, and its round-off by that over the stiffness of the softest mode. F itself needs no derivative: the tangents of the
    states do not depend on the motion that is prescribed.
    """

    structure: object
    """Tree structure of (model, gel, loads)."""
    floating: tuple
    """Which of its leaves are of floating type and have a tangent."""

    def __call__(self, *args):
        """Arguments: the tangents of mu (k,) and of the floating leaves; then x (k, n, 2), pressure (k, g), mu (k,) and the leaves."""
        (mu_dot, *dots), (x, pressure, mu, *leaves) = self.split(args)
        count, size = len(x), states_together(len(x), jax.tree.unflatten(self.structure, leaves)[0])
        states = [_in_groups(values, -(-count // size), size) for values in (x, pressure, mu, mu_dot)]
        return _ungrouped(_mapped(self, states, leaves, dots), count)

    def of_group(self, x, pressure, mu, leaves, mu_dot, dots):
        """The changes of a few states, all at once."""
        model, gel, loads = jax.tree.unflatten(self.structure, leaves)
        zeros = [np.zeros(leaf.shape, jax.dtypes.float0) for leaf in leaves]
        model_dot, gel_dot, loads_dot = self.with_floats(zeros, dots)
        motions = _Motions(model)(x, jax.jvp(lambda cloud: cloud.nodes, (model.cloud,), (model_dot.cloud,))[1])

        def change(x, pressure, mu, mu_dot, motion):
            forces = functools.partial(residual, pressure=pressure)
            dots = motion, model_dot, gel_dot, mu_dot, loads_dot
            return -gather(jax.jvp(forces, (x, model, gel, mu, loads), dots)[1], free_dofs(model.lists.topology))

        return [motions, jax.vmap(change)(x, pressure, mu, mu_dot, motions)]

    def split(self, args):
        """The arguments in which it is linear, and the others."""
        count = 1 + sum(self.floating)
        return args[:count], args[count:]

    def floats(self, tree):
        """The floating leaves of a (model, gel, loads)."""
        return [leaf for leaf, f in zip(jax.tree.leaves(tree), self.floating, strict=True) if f]

    def with_floats(self, leaves, floats):
        """(model, gel, loads) of the ``leaves``, with ``floats`` in place of the floating ones."""
        floats = iter(floats)
        return jax.tree.unflatten(self.structure, [next(floats) if f else leaf for leaf, f in zip(leaves, self.floating, strict=True)])


class _Motions:
    """Prescribed motions (k, n, 2) at nodal positions (k, n, 2) from those of the dry nodes (n, 2)."""

    def __init__(self, model):
        self._topology, self._nearest = model.lists.topology, _nearest_cells(model.lists)
        share = [block.weight / jnp.sum(block.weight, axis=1, keepdims=True) for block in model.blocks]
        means = [jnp.einsum("cq,cqai->cai", some, block.dphi)[:, None] for some, block in zip(share, model.blocks, strict=True)]
        self._cells = [dataclasses.replace(block, dphi=mean) for block, mean in zip(model.blocks, means, strict=True)]

    def __call__(self, x, dry_motion):
        free = free_dofs(self._topology)
        prescribed = prescribed_motion(dry_motion, self._topology.plate, free)

        def one(x):
            F = jnp.concatenate([deformation_gradients(x, block) for block in self._cells])[self._nearest, 0]
            along = jnp.einsum("nij,nj->ni", lax.stop_gradient(F), dry_motion)
            return prescribed + scatter(restrict(along, free), along.shape, free)

        return jax.vmap(one)(x)


@functools.partial(jax.jit, static_argnums=0)
def _mapped(map_, states, leaves, dots):
    """Values of ``map_`` for one group of states after the other; only its arguments are kept for the reverse."""
    one = jax.checkpoint(lambda x, pressure, mu, mu_dot: map_.of_group(x, pressure, mu, leaves, mu_dot, dots))
    return lax.map(lambda state: one(*state), states)


@functools.partial(jax.jit, static_argnames=("number", "size"))
def _in_groups(values, number, size):
    """The values (k, ...) in groups (number, size, ...), padded with the last one."""
    rest = number * size - len(values)
    return jnp.concatenate([values, jnp.broadcast_to(values[-1:], (rest, *values.shape[1:]))]).reshape(number, size, *values.shape[1:])


@functools.partial(jax.jit, static_argnames="count")
def _ungrouped(values, count):
    return [value.reshape(-1, *value.shape[2:])[:count] for value in values]


@once_per_owner
def _nearest_cells(lists):
    """The cell (n,), counted block after block, nearest each node of the reference cloud; host."""
    points = lists.topology.partition.vertices[lists.topology.node_vertices]
    cells = np.concatenate(lists.patches)
    real = lists.support[cells, :, None] > 0
    centres = np.sum(np.where(real, points[lists.nodes[cells]], 0.0), axis=1) / real.sum(axis=1)
    return cKDTree(centres).query(points)[1]


# --- its reverse -------------------------------------------------------------------------------------------------------------


def _transposed(cotangents, args, *, map_, groups):
    """Cotangents of what the map is linear in: with values state by state, those that nothing asks about left out."""
    linear, (x, pressure, mu, *leaves) = map_.split(args)
    others, wanted = (x, pressure, mu, *leaves), tuple(arg is None for arg in linear)
    free = free_dofs(jax.tree.unflatten(map_.structure, leaves)[0].lists.topology)
    shapes = x.shape, (len(x), len(free))
    given = [jnp.zeros(shape) if one is None else one for one, shape in zip(cotangents, shapes, strict=True)]
    if any(isinstance(leaf, jax.core.Tracer) for leaf in (*given, *others)):
        found = _reversed(map_, given, others)
    else:
        found = _by_orbits(map_, given, others, groups, wanted)
    return [*(value if asked else None for value, asked in zip(found, wanted, strict=True)), *(None for _ in others)]


@functools.partial(jax.jit, static_argnums=0)
def _reversed(map_, cotangents, others):
    """The same by JAX."""
    leaves = others[3:]
    zeros = [jnp.zeros(len(others[2])), *(jnp.zeros_like(leaf) for leaf in map_.floats(jax.tree.unflatten(map_.structure, leaves)))]
    return jax.vjp(lambda *linear: map_(*linear, *others), *zeros)[1](list(cotangents))


def _by_orbits(map_, cotangents, others, groups, wanted):
    """The same for the states of each group of symmetries in turn."""
    x, pressure, mu, *leaves = others
    model = jax.tree.unflatten(map_.structure, leaves)[0]
    motion, fields = cotangents[0], _fields(cotangents[1], free_dofs(model.lists.topology), x.shape)
    asked = np.any(np.asarray(motion) != 0, axis=(1, 2)) | np.any(np.asarray(fields) != 0, axis=(1, 2))
    by_group = {(): []}
    for k in np.flatnonzero(asked):
        by_group.setdefault(symmetries_of_field(fields[k], model, groups[k], ALIKE), []).append(k)
    size, found = states_together(len(x), model), None
    for group, states in by_group.items():
        if states or len(by_group) == 1:
            padded = np.full(-(-len(x) // size) * size, len(x))
            padded[: len(states)] = states
            own = orbits(model, group) if group else None
            steps = -(-len(states) // size)
            more = _over_states(map_, (x, pressure, mu, motion, fields), padded, steps, leaves, own, wanted=wanted, size=size)
            found = more if found is None else [a + b for a, b in zip(found, more, strict=True)]
    found = iter(found)
    return [next(found) if asked else None for asked in wanted]


@functools.partial(jax.jit, static_argnames="shape")
def _fields(cotangents, free, shape):
    """The nodal fields (k, n, 2) whose work is differentiated, of cotangents (k, f) of -dr."""
    return -jax.vmap(lambda one: scatter(one, shape[1:], free))(cotangents)


@functools.partial(jax.jit, static_argnums=0, static_argnames=("wanted", "size"))
def _over_states(map_, states, chosen, steps, leaves, own: Orbits | None, *, wanted, size):
    """The wanted cotangents, summed over the ``chosen`` states, ``size`` of them in each of so many ``steps``.

    With f = -K^-1 c of a cotangent c of the state, the work f . r(x) is differentiated by all that r depends on: of a region's patches
    where there are ``own`` orbits, of all otherwise. Past the end states are padding.
    """
    x, pressure, mu, motion, fields = states
    model, gel, loads = jax.tree.unflatten(map_.structure, leaves)
    cloud, motions, dry = model.cloud, _Motions(model), jax.ShapeDtypeStruct(x.shape[1:], x.dtype)
    if own is not None:
        model, pressure = own.part(model), pressure[:, own.groups]
    parts = jax.tree.leaves((model, gel, loads))

    def work(floats, x, mu, pressure, fields):
        model, gel, loads = map_.with_floats(parts, floats)
        model = model if own is None else dataclasses.replace(model, contact=None)

        def one(x, mu, pressure, field):
            return jax.jvp(lambda x: total_energy(x, model, gel, mu, loads, pressure), (x,), (field,))[1]

        return jnp.sum(jax.vmap(one)(x, mu, pressure, fields))

    def add(step, total):
        number = lax.dynamic_slice_in_dim(chosen, step * size, size)
        real = (number < len(x))[:, None, None]
        at = jnp.where(real[:, 0, 0], number, chosen[0])
        moved, field = (jnp.where(real, values[at], 0.0) for values in (motion, fields))
        floats, forces, by_mu = jax.grad(work, (0, 1, 2))(map_.floats((model, gel, loads)), x[at], mu[at], pressure[at], field)
        forces = moved + (forces if own is None else jax.vmap(own.symmetrised)(forces))
        (by_dry,) = jax.linear_transpose(lambda dry: motions(x[at], dry), dry)(forces)
        sums = jax.tree.map(jnp.add, total[1:], (floats, by_dry))
        return total[0].at[number].set(by_mu, mode="drop"), *sums

    zeros = jnp.zeros(len(x)), [jnp.zeros_like(leaf) for leaf in map_.floats((model, gel, loads))], jnp.zeros(dry.shape)
    by_mu, floats, by_dry = lax.fori_loop(0, steps, add, zeros)
    model, gel, loads = map_.with_floats(parts, floats)
    model = model if own is None else own.spread(model)
    (by_vertices,) = jax.vjp(lambda vertices: dataclasses.replace(cloud, vertices=vertices).nodes, cloud.vertices)[1](by_dry)
    model = dataclasses.replace(model, cloud=dataclasses.replace(model.cloud, vertices=model.cloud.vertices + by_vertices))
    return [value for value, asked in zip((by_mu, *map_.floats((model, gel, loads))), wanted, strict=True) if asked]


# --- the primitive -----------------------------------------------------------------------------------------------------------


def _value(*args, map_, **_):
    return map_(*args)


def _shapes(*args, map_, **_):
    x, _, _, *leaves = map_.split(args)[1]
    free = free_dofs(jax.tree.unflatten(map_.structure, leaves)[0].lists.topology)
    return [x, x.update(shape=(x.shape[0], len(free)))]


def _jvp(args, tangents, *, map_, groups):
    """The map of the tangents of what it is linear in, and the derivative by the others."""
    found, parts = changes.bind(*args, map_=map_, groups=groups), []
    linear, others = map_.split(args)
    dots, _ = map_.split(tangents)
    if any(dot is not None for dot in dots):
        dots = [jnp.zeros_like(arg) if dot is None else dot for arg, dot in zip(linear, dots, strict=True)]
        parts.append(changes.bind(*dots, *others, map_=map_, groups=groups))
    moving = tuple(i for i in range(len(linear), len(args)) if tangents[i] is not None)
    if moving:
        parts.append(remade(Tangent(map_, moving), *args, *(tangents[i] for i in moving)))
    return found, [sum(of) if of else None for of in zip(*parts, strict=True)] if parts else [None] * len(found)


def _batched(args, axes, *, map_, **_):
    return jax.vmap(map_, axes)(*args), [0, 0]


changes = primitive(
    "equilibrium_changes", value=_value, traced=_value, shapes=_shapes, jvp=_jvp, transpose=_transposed, batch=_batched, several=True
)
"""`_Changes` of their arguments; ``groups`` as in `state_tangents`."""
