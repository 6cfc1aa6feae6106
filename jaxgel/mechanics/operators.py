"""Precomputed operators of a model: what its tangents have in common at every state.

In the plane the volume V J of a group is the quadratic form x_1^T S x_2 with an antisymmetric area
form S; that of the mean J of a cell is S_ab = sum_q w (dphi_a1 dphi_b2 - dphi_a2 dphi_b1). The
network of a neo-Hookean gel is Nv/2 times the Laplacian. Both are constant, so that a Newton step
needs no deformation gradients.
"""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._sizes import resized, room
from .._types import Array, Float, Int
from ..discretisation import PAIRS, Model, PatchBlock
from ..materials import LocalGel, gel_at_points
from .pairs import node_pairs
from .patchwise import added_over_patches, over_patches
from .volumes import bare, contour_shares, local_positions


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["count", "pairs", "slots", "network", "area_forms"],
    meta_fields=[],
)
@dataclasses.dataclass(frozen=True, eq=False)
class Operators:
    """Common part of all tangents of a model with one gel, in sizes of its ``shared`` body."""

    count: Int[Array, ""]
    """Number of the node pairs that share a cell."""
    pairs: Int[Array, "p 2"]
    """These node pairs i <= j in ascending order, and room for more."""
    slots: tuple
    """Per block (c, t) the pair of each entry a <= b of a patch's node list.

    One past the end for padding.
    """
    network: Float[Array, " p"]
    """Sum of w Nv dphi_i . dphi_j, kT/v: stiffness of the dry network in each direction.

    The sum is over all quadrature points.
    """
    area_forms: tuple
    """Per block the `AreaForms` of its volume groups."""


def precomputed_operators(model: Model, gel: LocalGel) -> Operators:
    """`Operators` of a model with a gel, both in their own sizes."""
    pairs, slots = node_pairs(model.lists)
    count, size = len(pairs), room(len(pairs), PAIRS)
    slots = tuple(
        _padded_slots(*some, count, size) for some in zip(slots, model.shared.blocks, strict=True)
    )
    inside = dataclasses.replace(model.shared, outline=None, contact=None)
    network, area_forms = _integrated(np.zeros(size), inside, gel, slots)
    host = jax.device_put((np.asarray(count, np.int32), resized(pairs, (size, 2)), slots))
    return Operators(*host, network, area_forms)


def _padded_slots(slots, shared, count, size):
    """Slots (c, t) of a block's patches as in its shared form, with longer node lists."""
    wide = shared.nodes.shape[1]
    first, second = np.triu_indices((math.isqrt(8 * slots.shape[1] + 1) - 1) // 2)
    moved = np.full((len(shared.nodes), wide * (wide + 1) // 2), size, np.int32)
    moved[: len(slots), first * wide - first * (first - 1) // 2 + second - first] = np.where(
        slots < count, slots, size
    )
    return moved


@compiled()
def _integrated(total, model, gel, slots):
    """Stiffness (p,) of the network and area forms per block."""

    def add(total, block, weight, slot):
        return add_matrices(
            total, jnp.einsum("cq,cqai,cqbi->cab", weight, block.dphi, block.dphi), slot
        )

    for number, (block, slot) in enumerate(zip(model.blocks, slots, strict=True)):
        weight = block.weight * gel_at_points(gel, number).Nv
        total = added_over_patches(total, add, (bare(block), weight, slot), block.count)
    return total, tuple(map(area_forms, model.blocks))


def add_matrices(
    total: Float[Array, "p ..."], matrices: Float[Array, "c a a ..."], slots: Int[Array, "c t"]
) -> Float[Array, "p ..."]:
    """``total`` (p, ...) plus the upper entries of ``matrices`` (c, a, a, ...) at ``slots`` (c, t).

    They are matrices of patches.
    """
    a, b = np.triu_indices(matrices.shape[1])
    return total.at[slots].add(matrices[:, a, b], mode="drop")


# --- area forms -----------------------------------------------------------------------------------


@functools.partial(
    jax.tree_util.register_dataclass, data_fields=["rows", "weights"], meta_fields=[]
)
@dataclasses.dataclass(frozen=True)
class AreaForms:
    """Antisymmetric forms S_g of the volume groups of a block, by the shorter way; a pytree.

    There are two ways. As matrices, or as products of rows: x_1 . S_g x_2 = sum_r w_rg [(A_r x_1)
    (B_r x_2) - (B_r x_1) (A_r x_2)] with the derivatives of the shape functions at the quadrature
    points, or the rows of the contours, as A and B.
    """

    rows: Float[Array, "*c s a"]
    """The matrices S_g one after the other, s = g a; or the rows A and then B, s = 2 r."""
    weights: Float[Array, "*c g r"] | None
    """The weights w; None for matrices."""


def area_forms(block: PatchBlock) -> AreaForms:
    """The `AreaForms` of a block."""
    first, second = (
        jnp.concatenate([block.dphi[..., k], block.contour[:, k]], axis=1) for k in range(2)
    )
    inside = jnp.broadcast_to(
        contour_shares(block), (*block.contour.shape[:1], block.contour.shape[2], block.n_groups)
    )
    weights = jnp.concatenate(
        [block.weight[..., None] * block.group_weight, inside], axis=1
    ).swapaxes(1, 2)
    if 4 * weights.shape[2] < block.n_groups * first.shape[2]:
        return AreaForms(jnp.concatenate([first, second], axis=1), weights)

    def matrices(weights, first, second):
        half = jnp.einsum("cgr,cra,crb->cgab", weights, first, second)
        return (half - half.swapaxes(2, 3)).reshape(len(half), -1, half.shape[3])

    return AreaForms(
        over_patches(matrices, (weights, first, second), block.count, reverse=False), None
    )


def area_gradients(
    forms: AreaForms, x: Float[Array, "n 2"], block: PatchBlock
) -> tuple[Array, Array]:
    """Gradients (c, g, 2, a) of volumes V J by nodes, mm, and V J (c, g), mm^2.

    Linear in ``x``.
    """

    def of(forms, nodes):
        local = jnp.moveaxis(local_positions(x, nodes), 2, 0)  # S annihilates translations
        # a vector each: XLA's fastest products
        first, second = (jnp.einsum("csa,ca->cs", forms.rows, component) for component in local)
        turned = jnp.stack([second, -first], axis=1)
        if forms.weights is None:
            G = turned.reshape(len(nodes), 2, -1, nodes.shape[1]).swapaxes(1, 2)
        else:
            along, across = jnp.split(turned[:, None], 2, axis=3)
            factors = jnp.concatenate(
                [forms.weights[:, :, None] * part for part in (across, -along)], axis=3
            )
            G = jnp.einsum(
                "cks,csa->cka", factors.reshape(len(nodes), -1, turned.shape[2]), forms.rows
            )
            G = G.reshape(*factors.shape[:3], -1)
        return G, 0.5 * jnp.einsum("cgia,ica->cg", G, local)  # V J is quadratic in x

    return over_patches(of, (forms, block.nodes), block.count, reverse=False)


def area_form_sum(p: Float[Array, "c g"], forms: AreaForms) -> Float[Array, "c a a"]:
    """Sums of p S over the groups of each patch."""
    if forms.weights is None:
        n = forms.rows.shape[2]
        return jnp.einsum("cg,cgab->cab", p, forms.rows.reshape(len(p), -1, n, n))
    first, second = jnp.split(forms.rows, 2, axis=1)
    weighted = jnp.einsum("cg,cgr->cr", p, forms.weights)[:, :, None] * first
    half = jnp.einsum("cra,crb->cab", weighted, second)
    return half - half.swapaxes(1, 2)
