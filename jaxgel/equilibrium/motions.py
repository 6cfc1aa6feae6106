"""Motion of the nodes if the problem changes: prescribed displacements, and unknowns."""

import dataclasses

import jax
import jax.numpy as jnp
from jax import lax

from .._compiled import compiled
from .._types import Array, Float
from ..mechanics import Equations, Free, constrained_part, deformation_gradients, restrict, scatter


class Motions:
    """Prescribed motions (k, n, 2) at positions (k, n, 2) and values (k,) by the dry nodes (n, 2).

    The values are those of the control.
    """

    def __init__(self, problem: Equations) -> None:
        self._problem, model = problem, problem.model
        sizes = [jnp.sum(block.weight, axis=1, keepdims=True) for block in model.blocks]
        share = [
            block.weight / jnp.where(size > 0, size, 1.0)
            for block, size in zip(model.blocks, sizes, strict=True)
        ]
        means = [
            jnp.einsum("cq,cqai->cai", some, block.dphi)[:, None]
            for some, block in zip(share, model.blocks, strict=True)
        ]
        self._cells = [
            dataclasses.replace(block, dphi=mean)
            for block, mean in zip(model.blocks, means, strict=True)
        ]

    def __call__(
        self, x: Float[Array, "k n 2"], values: Float[Array, " k"], dry_motion: Float[Array, "n 2"]
    ) -> Float[Array, "k n 2"]:
        """The motions (k, n, 2); those of the unknowns are with the material next to them."""
        problem = lax.stop_gradient(self._problem)
        free = problem.free

        def one(x, value):
            F = jnp.concatenate([deformation_gradients(x, block) for block in self._cells])[
                problem.constraints.nearest, 0
            ]
            along = jnp.einsum("nij,nj->ni", lax.stop_gradient(F), dry_motion)
            return problem.carried(dry_motion, value) + scatter(restrict(along, free), free)

        # one state at a time: the positions of all nodes of all patches are many times the states
        return lax.map(lambda state: one(*state), (x, values))


def edge_motions(
    problem: Equations,
    problem_dot: Equations,
    values: Float[Array, " k"],
    values_dot: Float[Array, " k"],
) -> Float[Array, "k n 2"] | float:
    """Contribution of a control of the edges to the prescribed motions (k, n, 2).

    It belongs to tangents of the problem and of the values.
    """
    if not problem.moves_edges:
        return 0.0

    def positions(control, value):
        return problem.replace(control=control).dry_positions(value)

    def motion(value, value_dot):
        return constrained_part(
            jax.jvp(positions, (problem.control, value), (problem_dot.control, value_dot))[1],
            problem.free,
        )

    return jax.vmap(motion)(values, values_dot)


def edge_cotangents(
    problem: Equations, values: Float[Array, " k"], forces: Float[Array, "k n 2"]
) -> tuple[object, Float[Array, " k"]]:
    """Cotangents of the control and its values (k,) by those (k, n, 2) of prescribed motions."""

    def work(control, values):
        moving = problem.replace(control=control)
        positions = jax.vmap(
            lambda value: constrained_part(moving.dry_positions(value), problem.free)
        )(values)
        return jnp.sum(positions * forces)

    return jax.grad(work, (0, 1))(problem.control, values)


@compiled()
def moved(
    motion: Float[Array, "k n 2"], correction: Float[Array, "k f"], free: Free
) -> Float[Array, "k n 2"]:
    """Nodal motions (k, n, 2): prescribed ones plus corrections (k, f) of the free ones.

    These are the free degrees of freedom.
    """
    return motion + jax.vmap(lambda dx: scatter(dx, free))(correction)
