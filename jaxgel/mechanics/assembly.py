"""The condensed tangent of a state: assembled, and as products with vectors."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float
from ..linalg import Factor, factor
from ..materials import neo_hookean
from .contact import contact_force, contact_tangents
from .dofs import gather, scatter
from .mixed import Linearisation, network_force, nodal_sum, pressure_step, volume_gradients
from .operators import AreaForms, add_cell_matrices, area_form_sum
from .pairs import contact_pairs
from .problem import Problem
from .volumes import all_volumes, by_block


@jax.jit
def tangent(problem: Problem, x: Float[Array, "n 2"], p: Float[Array, " g"], linearisation: Linearisation) -> Float[Array, "p 2 2"]:
    """Condensed tangent K by node pairs, kT/v, about the ``linearisation`` at ``x`` and ``p``, see `mixed`.

    With contact the pairs of `contact_pairs` follow.
    """
    model, gel, operators = problem.model, problem.gel, problem.operators
    quadratic = gel.network is neo_hookean
    total = jnp.zeros((len(operators.pairs), 4))
    if quadratic:
        total += gel.Nv * operators.laplacian[:, None] * jnp.eye(2).ravel()

    def patch(arrays):
        x, dphi, weight, p, forms, k_over_V, G = arrays
        S = coupling(p, forms, dphi, weight)
        H = k_over_V[:, None, None] * G
        outer = [[jnp.sum(H[:, i, :, None] * G[:, k, None], axis=0) for k in range(2)] for i in range(2)]
        K = jnp.stack([outer[0][0], outer[0][1] + S, outer[1][0] - S, outer[1][1]], axis=-1)
        if not quadratic:
            A = jax.vmap(jax.hessian(lambda F: gel.network(F, gel)))(jnp.einsum("ai,qaj->qij", x, dphi))
            K += jnp.einsum("q,qijkl,qaj,qbl->abik", weight, A, dphi, dphi).reshape(K.shape)
        return K

    volumes = all_volumes(model)
    k_over_V = jnp.where(volumes > 0, linearisation.stiffness / jnp.where(volumes > 0, volumes, 1.0), 0.0)
    groups = by_block(p, model), by_block(k_over_V, model), operators.area_forms, linearisation.gradients, operators.slots
    for block, pressure, k_over_V, forms, G, slot in zip(model.blocks, *groups, strict=True):
        arrays = x[block.nodes], block.dphi, block.weight, pressure, forms, k_over_V, G
        total = add_cell_matrices(total, patch, arrays, slot, block.nodes.shape[1])
    total = total.reshape(-1, 2, 2)
    return total if model.contact is None else _add_contact(total, x, model)


@jax.jit
def tangent_product(
    problem: Problem, x: Float[Array, "n 2"], p: Float[Array, " g"], linearisation: Linearisation, v: Float[Array, " f"]
) -> Float[Array, " f"]:
    """Product (f,) of the `tangent` with a vector ``v`` of the free degrees of freedom, which costs as much as a linearisation.

    The gradients of the volumes are linear in the positions, so that S_g v is that of the field v.
    """
    model, field = problem.model, scatter(v, x.shape, problem.free)
    moved, _ = volume_gradients(field, model, problem.operators)
    p_step = pressure_step(field, dataclasses.replace(linearisation, error=0.0), linearisation, model)
    forces = jax.jvp(lambda x: network_force(x, model, problem.gel, problem.operators), (x,), (field,))[1]
    forces += nodal_sum(moved, p, model) + nodal_sum(linearisation.gradients, p_step, model)
    if model.contact is not None:
        forces += jax.jvp(lambda x: contact_force(x, model), (x,), (field,))[1]
    return gather(forces, problem.free)


def coupling(
    p: Float[Array, " g"], forms: AreaForms | None, dphi: Float[Array, "q a 2"], weight: Float[Array, " q"]
) -> Float[Array, "a a"]:
    """Sum over the groups of a patch of p S: the antisymmetric form whose values x_1 . S x_2 are the sum of p V J."""
    if forms is not None:
        return area_form_sum(p, forms)
    half = jnp.einsum("q,qa,qb->ab", p * weight, dphi[..., 0], dphi[..., 1])
    return half - half.T


def factorised_tangent(problem: Problem, x: Float[Array, "n 2"], p: Float[Array, " g"], linearisation: Linearisation) -> Factor:
    """Factor of the `tangent`; raises `linalg.SingularTangent`."""
    return factor(problem.pattern, tangent(problem, x, p, linearisation))


def _add_contact(total, x, model):
    """The tangent with that of contact: blocks (p + e, 2, 2) of the pairs that share a cell and then of `contact_pairs`."""
    more, slots = contact_pairs(model.lists, model.dmax)
    total = jnp.concatenate([total, jnp.zeros((len(more), 2, 2))])
    for blocks, slot in zip(contact_tangents(x, model), slots, strict=True):
        a, b = np.triu_indices(blocks.shape[1])
        total = total.at[slot].add(blocks[:, a, b], mode="drop")
    return total
