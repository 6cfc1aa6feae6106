"""Precomputed operators of a model: what its tangents have in common at every state.

In the plane the volume V J of a group is the quadratic form x_1^T S x_2 with an antisymmetric area form S; that of the mean J of a cell
is S_ab = sum_q w (dphi_a1 dphi_b2 - dphi_a2 dphi_b1). The network of a neo-Hookean gel is Nv/2 times the Laplacian. Both are constant, so
that a Newton step needs no deformation gradients.
"""

import dataclasses
import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._types import Array, Float, Int
from ..discretisation import Model, PatchBlock
from ..materials import LocalGel, gel_at_points
from .conditions import Free
from .dofs import unknowns
from .pairs import node_pairs
from .volumes import contour_shares, local_positions

CELLS_IN_CACHE = 32  # cells whose matrices are added up together: few enough to stay in the processor's cache
CELLS_PER_PRODUCT = 1024  # cells whose volume gradients are computed together, for the same reason


@functools.partial(jax.tree_util.register_dataclass, data_fields=["pairs", "slots", "network", "area_forms", "free"], meta_fields=[])
@dataclasses.dataclass(frozen=True, eq=False)
class Operators:
    """What all tangents of a model with one gel have in common."""

    pairs: Int[Array, "p 2"]
    """Node pairs i <= j that share a cell, in ascending order."""
    slots: tuple
    """Per block (c, t) the pair of each entry a <= b of a cell's node list; one past the end for padding."""
    network: Float[Array, " p"]
    """Sum of w Nv dphi_i . dphi_j over all quadrature points, kT/v: the stiffness of the dry network, in each direction."""
    area_forms: tuple
    """Per block the `AreaForms` of its volume groups."""
    free: Free
    """Free degrees of freedom."""


def precomputed_operators(model: Model, gel: LocalGel) -> Operators:
    """`Operators` of a model with a gel."""
    pairs, slots = node_pairs(model.lists)
    network, area_forms = _integrated(np.zeros(len(pairs)), model.blocks, gel, slots)
    pairs, slots, free = jax.device_put((pairs, tuple(slots), unknowns(model.lists)))
    return Operators(pairs, slots, network, area_forms, free)


@jax.jit
def _integrated(total, blocks, gel, slots):
    """Stiffness (p,) of the network and area forms per block."""

    def laplacian(arrays):
        return jnp.einsum("q,qai,qbi->ab", arrays[1], arrays[0], arrays[0])

    for number, (block, slot) in enumerate(zip(blocks, slots, strict=True)):
        weight = block.weight * gel_at_points(gel, number).Nv
        total = add_cell_matrices(total, laplacian, (block.dphi, weight), slot, block.nodes.shape[1])
    return total, tuple(map(area_forms, blocks))


def add_cell_matrices(
    total: Float[Array, "p ..."], cell: Callable, arrays: tuple, slots: Int[Array, "c t"], n: int
) -> Float[Array, "p ..."]:
    """``total`` (p, ...) plus the upper entries of the cell matrices ``cell(arrays[c])`` (n, n, ...) at their ``slots`` (c, t)."""
    a, b = np.triu_indices(n)

    def add(total, first, size):  # slices, as `lax.scan` would copy all arrays
        part, at = jax.tree.map(lambda v: lax.dynamic_slice_in_dim(v, first, size), (arrays, slots))
        return total.at[at].add(jax.vmap(cell)(part)[:, a, b], mode="drop")

    whole, rest = divmod(len(slots), CELLS_IN_CACHE)
    if whole:
        total = lax.fori_loop(0, whole, lambda k, total: add(total, k * CELLS_IN_CACHE, CELLS_IN_CACHE), total)
    return add(total, whole * CELLS_IN_CACHE, rest)


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

    def matrices(arrays):
        half = jnp.einsum("gr,ra,rb->gab", *arrays)
        return (half - half.swapaxes(1, 2)).reshape(-1, half.shape[2])

    return AreaForms(lax.map(matrices, (weights, first, second), batch_size=CELLS_IN_CACHE), None)


def area_gradients(forms: AreaForms, x: Float[Array, "n 2"], nodes: Int[Array, "c a"]) -> tuple[jax.Array, jax.Array]:
    """Gradients (c, g, 2, a) of the groups' volumes V J at the patches' ``nodes``, mm, and V J (c, g), mm^2. Linear in ``x``."""

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

    def add(k, total):  # the last chunk overlaps the one before
        first = jnp.minimum(k * CELLS_PER_PRODUCT, len(nodes) - CELLS_PER_PRODUCT)
        parts = of(*jax.tree.map(lambda v: lax.dynamic_slice_in_dim(v, first, CELLS_PER_PRODUCT), (forms, jnp.asarray(nodes))))
        return tuple(lax.dynamic_update_slice_in_dim(t, part, first, 0) for t, part in zip(total, parts, strict=True))

    if len(nodes) <= CELLS_PER_PRODUCT:
        return of(forms, nodes)
    groups = (len(nodes), forms.weights.shape[1] if forms.weights is not None else forms.rows.shape[1] // nodes.shape[1])
    empty = jnp.zeros((*groups, 2, nodes.shape[1]), x.dtype), jnp.zeros(groups, x.dtype)
    return lax.fori_loop(0, -(-len(nodes) // CELLS_PER_PRODUCT), add, empty)


def area_form_sum(p: Float[Array, " g"], forms: AreaForms) -> Float[Array, "a a"]:
    """Sum of p S over the groups of one patch."""
    if forms.weights is None:
        n = forms.rows.shape[1]
        return jnp.einsum("g,gab->ab", p, forms.rows.reshape(-1, n, n))
    first, second = jnp.split(forms.rows, 2)
    half = ((p @ forms.weights)[:, None] * first).T @ second
    return half - half.T
