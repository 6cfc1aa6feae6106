"""Assembly of the condensed tangent of a state by node pairs, and its factor.

With nodal fields as complex numbers z = v_1 + i v_2 the condensed tangent of `mixed` is, for a
neo-Hookean network,

    K z = (N - i P) z + sum_g (k_g / V_g) G_g Re(conj(G_g) . z),    P = sum_g p_g S_g

with the Laplacian N of the network, the area forms S_g of the volume groups and the gradients G_g
of their volumes.
"""

import jax
import jax.numpy as jnp
import numpy as np

from .._programs import program
from .._types import Array, Float, Int
from ..linalg import Factor, factor
from ..materials import elementwise, gel_at_points, neo_hookean, network_at
from .contact import has_pairs
from .equations import Equations
from .mixed import Linearisation
from .operators import add_matrices, area_form_sum
from .pairs import contact_blocks, couplings, node_pairs
from .patchwise import added_over_patches
from .problem import Problem
from .volumes import all_volumes, bare, by_block, deformation_gradients


def tangent(
    problem: Problem, x: Float[Array, "n 2"], p: Float[Array, " g"], linearisation: Linearisation
) -> Float[np.ndarray, "p 2 2"]:
    """Condensed tangent K by node pairs, kT/v, about the ``linearisation`` at ``x`` and ``p``.

    See `mixed`; NumPy. The pairs are those of the problem's ``pattern``, see `pairs.all_pairs`.
    """
    model, gel = problem.model, problem.without_pairs
    blocks = np.asarray(tangent_blocks(gel, x, p, linearisation))[: len(node_pairs(model.lists)[0])]
    if not has_pairs(model):
        return blocks
    total = contact_blocks(x, model, couplings(model))
    total[: len(blocks)] += blocks
    return total


@program(x="n", p="g", inside=True)
def tangent_blocks(
    problem: Equations, x: Float[Array, "n 2"], p: Float[Array, " g"], linearisation: Linearisation
) -> Float[Array, "p 2 2"]:
    """The `tangent` without contact, with room for more pairs after those that share a cell."""
    model, gel, operators = problem.model, problem.gel, problem.operators
    quadratic, network = gel.network is neo_hookean, network_at(gel, model.axial_stretch)
    total = jnp.zeros((len(operators.pairs), 4))
    if quadratic:
        total += operators.network[:, None] * jnp.eye(2).ravel()

    def add(total, block, p, forms, k_over_V, G, gel, slot):
        S = area_form_sum(p, forms)
        H = k_over_V[:, :, None, None] * G
        outer, zero = jnp.einsum("cgia,cgkb->cabik", H, G), jnp.zeros_like(S)
        K = outer.reshape(*S.shape, 4) + jnp.stack([zero, S, -S, zero], axis=-1)
        if not quadratic:
            A = elementwise(
                jax.hessian(network),
                deformation_gradients(x, block),
                gel,
                signature="(i,j)->(i,j,k,l)",
            )
            K += jnp.einsum(
                "cq,cqijkl,cqaj,cqbl->cabik", block.weight, A, block.dphi, block.dphi
            ).reshape(K.shape)
        return add_matrices(total, K, slot)

    volumes = all_volumes(model)
    k_over_V = jnp.where(
        volumes > 0, linearisation.stiffness / jnp.where(volumes > 0, volumes, 1.0), 0.0
    )
    groups = (
        by_block(p, model),
        by_block(k_over_V, model),
        operators.area_forms,
        linearisation.gradients,
        operators.slots,
    )
    for number, (block, pressure, k_over_V, forms, G, slot) in enumerate(
        zip(model.blocks, *groups, strict=True)
    ):
        shape = block.weight.shape
        there = (
            None
            if quadratic
            else jax.tree.map(
                lambda v, shape=shape: jnp.broadcast_to(v, shape), gel_at_points(gel, number)
            )
        )
        arrays = bare(block), pressure, forms, k_over_V, G, there, slot
        total = added_over_patches(total, add, arrays, block.count)
    return total.reshape(-1, 2, 2)


def pair_product(
    blocks: Float[Array, "p 2 2"], pairs: Int[Array, "p 2"], v: Float[Array, "n 2"]
) -> Float[Array, "n 2"]:
    """Product (n, 2) of the matrix of pair ``blocks`` with a nodal field ``v`` (n, 2)."""
    i, j = pairs.T
    transposed = jnp.where((i != j)[:, None], jnp.einsum("pab,pa->pb", blocks, v[i]), 0.0)
    return jnp.zeros_like(v).at[i].add(jnp.einsum("pab,pb->pa", blocks, v[j])).at[j].add(transposed)


def factorised_tangent(
    problem: Problem, x: Float[Array, "n 2"], p: Float[Array, " g"], linearisation: Linearisation
) -> Factor:
    """Factor of the `tangent`; raises `linalg.SingularTangent`."""
    return factor(problem.pattern, tangent(problem, x, p, linearisation))
