"""Derivatives of equilibrium states with respect to everything they depend on.

Invariant: the residual r(x; model, gel, mu, loads) vanishes on the free degrees of freedom. Differentiated, K dx = -dr at fixed x, with
the tangent K of the state itself. Written as a rule for tangents, it gives forward, reverse and second derivatives alike; a state that
nothing asks about costs no linear solve.
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
from ..mechanics import (
    Problem,
    deformation_gradients,
    free_dofs,
    gather,
    prescribed_motion,
    residual,
    restrict,
    scatter,
)
from .solutions import solutions, states_together


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
    return _moved(motion, solutions.bind(rhs, *leaves, structure=structure), problem.free)


def _residual_changes(x, pressure, problem, mu, problem_dot, mu_dot):
    """Prescribed motions (k, n, 2) of the states, and -dr (k, f) left by them and the tangents of the inputs."""
    inputs, dots = ((_without_observation_points(q.model), q.gel, q.loads) for q in (problem, problem_dot))
    leaves, structure = jax.tree.flatten(inputs)
    dots = jax.tree.leaves(dots)
    floating = tuple(jnp.issubdtype(leaf.dtype, jnp.floating) for leaf in leaves)
    count, size = len(x), states_together(len(x), problem.model)

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
