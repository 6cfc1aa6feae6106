"""Precomputed operators of a model: what its tangents have in common at every state.

In the plane the volume V J of a group is the quadratic form x_1^T S x_2 with an antisymmetric area form S; that of the mean J of a cell
is S_ab = sum_q w (dphi_a1 dphi_b2 - dphi_a2 dphi_b1). The network of a neo-Hookean gel is Nv/2 times the Laplacian. Both are constant, so
that a Newton step needs no deformation gradients.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from .._programs import program
from .._sizes import resized
from .._types import Array, Float, Int
from ..discretisation import PAIRS, Model, PatchBlock, room
from ..materials import LocalGel, gel_at_points
from .pairs import contact_pairs, node_pairs
from .patchwise import added_over_patches, over_patches
from .volumes import bare, contour_shares, local_positions


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["count", "pairs", "slots", "contact_slots", "network", "area_forms"],
    meta_fields=["contact_room"],
)
@dataclasses.dataclass(frozen=True, eq=False)
class Operators:
    """What all tangents of a model with one gel have in common, in the sizes of its ``shared`` body."""

    count: Int[Array, ""]
    """Number of the node pairs that share a cell."""
    pairs: Int[Array, "p 2"]
    """These node pairs i <= j in ascending order, and room for more."""
    slots: tuple
    """Per block (c, t) the pair of each entry a <= b of a patch's node list; one past the end for padding."""
    contact_slots: tuple
    """For each group of holes, see `contact`, the same (h, t), counted on for the pairs that share no cell; none without contact."""
    contact_room: int
    """Room for pairs that share no cell."""
    network: Float[Array, " p"]
    """Sum of w Nv dphi_i . dphi_j over all quadrature points, kT/v: the stiffness of the dry network, in each direction."""
    area_forms: tuple
    """Per block the `AreaForms` of its volume groups."""


def precomputed_operators(model: Model, gel: LocalGel) -> Operators:
    """`Operators` of a model with a gel, both in their own sizes."""
    pairs, slots = node_pairs(model.lists)
    count, size = len(pairs), room(len(pairs), PAIRS)
    slots = tuple(_padded_slots(*some, count, size) for some in zip(slots, model.blocks, model.shared.blocks, strict=True))
    contact_slots, contact_room = (), 0
    if model.contact is not None:
        more, contact_slots = contact_pairs(model.lists, model.dmax)
        contact_room = sum(some.size for some in contact_slots)  # a slot each: no size of its own for programs to depend on
        contact_slots = tuple(_moved_slots(some, count, size, count + len(more), size + contact_room) for some in contact_slots)
    network, area_forms = _integrated(np.zeros(size), model, gel, slots)
    host = jax.device_put((np.asarray(count, np.int32), resized(pairs, (size, 2)), slots, contact_slots))
    return Operators(*host, contact_room, network, area_forms)


def _padded_slots(slots, block, shared, count, size):
    """Slots (c, t) of the patches of a block as those of its shared form."""
    a, wide = block.nodes.shape[1], shared.nodes.shape[1]
    first, second = np.triu_indices(a)
    moved = np.full((len(shared.nodes), wide * (wide + 1) // 2), size, np.int32)
    moved[: len(slots), first * wide - first * (first - 1) // 2 + second - first] = np.where(slots < count, slots, size)
    return moved


def _moved_slots(slots, count, size, end, last):
    """Slots that count pairs with a cell in common first, with room for these; those past the ``end`` are past the ``last``."""
    return np.where(slots < count, slots, np.where(slots < end, slots - count + size, last)).astype(np.int32)


@program()
def _integrated(total, model, gel, slots):
    """Stiffness (p,) of the network and area forms per block."""

    def add(total, block, weight, slot):
        return add_matrices(total, jnp.einsum("cq,cqai,cqbi->cab", weight, block.dphi, block.dphi), slot)

    for number, (block, slot) in enumerate(zip(model.blocks, slots, strict=True)):
        weight = block.weight * gel_at_points(gel, number).Nv
        total = added_over_patches(total, add, (bare(block), weight, slot), block.count)
    return total, tuple(map(area_forms, model.blocks))


def add_matrices(total: Float[Array, "p ..."], matrices: Float[Array, "c a a ..."], slots: Int[Array, "c t"]) -> Float[Array, "p ..."]:
    """``total`` (p, ...) plus the upper entries of the ``matrices`` (c, a, a, ...) of patches at their ``slots`` (c, t)."""
    a, b = np.triu_indices(matrices.shape[1])
    return total.at[slots].add(matrices[:, a, b], mode="drop")


# --- area forms --------------------------------------------------------------------------------------------------------------


@functools.partial(jax.tree_util.register_dataclass, data_fields=["rows", "weights"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class AreaForms:
    """The antisymmetric forms S_g of the volume groups of a block's patches, the shorter of two ways; a pytree.

    As matrices, or as products of rows: x_1 . S_g x_2 = sum_r w_rg [(A_r x_1) (B_r x_2) - (B_r x_1) (A_r x_2)] with the derivatives of the
    shape functions at the quadrature points, or the rows of the contours, as A and B.
    """

    rows: Float[Array, "*c s a"]
    """The matrices S_g one after the other, s = g a; or the rows A and then B, s = 2 r."""
    weights: Float[Array, "*c g r"] | None
    """The weights w; None for matrices."""


def area_forms(block: PatchBlock) -> AreaForms:
    """The `AreaForms` of a block."""
    first, second = (jnp.concatenate([block.dphi[..., k], block.contour[:, k]], axis=1) for k in range(2))
    inside = jnp.broadcast_to(contour_shares(block), (*block.contour.shape[:1], block.contour.shape[2], block.n_groups))
    weights = jnp.concatenate([block.weight[..., None] * block.group_weight, inside], axis=1).swapaxes(1, 2)
    if 4 * weights.shape[2] < block.n_groups * first.shape[2]:
        return AreaForms(jnp.concatenate([first, second], axis=1), weights)

    def matrices(weights, first, second):
        half = jnp.einsum("cgr,cra,crb->cgab", weights, first, second)
        return (half - half.swapaxes(2, 3)).reshape(len(half), -1, half.shape[3])

    return AreaForms(over_patches(matrices, (weights, first, second), block.count, reverse=False), None)


def area_gradients(forms: AreaForms, x: Float[Array, "n 2"], block: PatchBlock) -> tuple[Array, Array]:
    """Gradients (c, g, 2, a) of the groups' volumes V J at the patches' nodes, mm, and V J (c, g), mm^2. Linear in ``x``."""

    def of(forms, nodes):
        local = jnp.moveaxis(local_positions(x, nodes), 2, 0)  # S annihilates translations
        first, second = (jnp.einsum("csa,ca->cs", forms.rows, component) for component in local)  # a vector each: XLA's fastest products
        turned = jnp.stack([second, -first], axis=1)
        if forms.weights is None:
            G = turned.reshape(len(nodes), 2, -1, nodes.shape[1]).swapaxes(1, 2)
        else:
            along, across = jnp.split(turned[:, None], 2, axis=3)
            factors = jnp.concatenate([forms.weights[:, :, None] * part for part in (across, -along)], axis=3)
            G = jnp.einsum("cks,csa->cka", factors.reshape(len(nodes), -1, turned.shape[2]), forms.rows)
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
