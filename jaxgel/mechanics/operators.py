"""Precomputed operators of a model: what its tangents have in common at every state.

In the plane the volume V J of a cell with one volume ratio, the mean, is the quadratic form x_1^T S x_2 with the antisymmetric area form
S_ab = sum_q w (dphi_a1 dphi_b2 - dphi_a2 dphi_b1), and the network of a neo-Hookean gel is Nv/2 times the Laplacian: both are constant, so
that a Newton step needs no quadrature points.
"""

import dataclasses
import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._types import Array, Float, Int
from ..discretisation import Model
from .dofs import free_dofs
from .pairs import node_pairs
from .volumes import local_positions

CELLS_IN_CACHE = 32  # cells whose matrices are added up together: few enough to stay in the processor's cache
CELLS_PER_PRODUCT = 1024  # cells whose volume gradients are computed together, for the same reason


@functools.partial(jax.tree_util.register_dataclass, data_fields=["pairs", "slots", "laplacian", "area_forms", "free"], meta_fields=[])
@dataclasses.dataclass(frozen=True, eq=False)
class Operators:
    """What all tangents of a model have in common."""

    pairs: Int[Array, "p 2"]
    """Node pairs i <= j that share a cell, in ascending order."""
    slots: tuple
    """Per block (c, t) the pair of each entry a <= b of a cell's node list; one past the end for padding."""
    laplacian: Float[Array, " p"]
    """Sum of w dphi_i . dphi_j over all quadrature points."""
    area_forms: tuple
    """Per block the area forms S of the cells, where each has one volume ratio, the mean; None elsewhere. They are (c, a, a), or where the
    quadrature points are few (c, 2 q, a) with the rows w dphi_1 and dphi_2 of their gradients, see `area_form_product`."""
    free: Int[Array, "f ..."]
    """Free degrees of freedom, see `dofs`."""


def precomputed_operators(model: Model) -> Operators:
    """`Operators` of a model."""
    pairs, slots = node_pairs(model.lists)
    means = tuple(block.has_mean for block in model.blocks)
    arrays = tuple((block.dphi, block.weight) for block in model.blocks)
    laplacian, area_forms = _integrated(jnp.zeros(len(pairs)), arrays, slots, means)
    return Operators(jnp.asarray(pairs), tuple(map(jnp.asarray, slots)), laplacian, area_forms, free_dofs(model.lists.topology))


@functools.partial(jax.jit, static_argnames="means")
def _integrated(total, blocks, slots, means):
    """Laplacian (p,) and area forms per block."""

    def laplacian(arrays):
        return jnp.einsum("q,qai,qbi->ab", arrays[1], arrays[0], arrays[0])

    def area_form(arrays):
        dphi, weight = arrays
        if 2 * len(weight) < dphi.shape[1]:
            return jnp.concatenate([weight[:, None] * dphi[:, :, 0], dphi[:, :, 1]])
        half = jnp.einsum("q,qa,qb->ab", weight, dphi[..., 0], dphi[..., 1])
        return half - half.T

    for arrays, slot in zip(blocks, slots, strict=True):
        total = add_cell_matrices(total, laplacian, arrays, slot, arrays[0].shape[2])
    forms = (lax.map(area_form, arrays, batch_size=CELLS_IN_CACHE) if mean else None for arrays, mean in zip(blocks, means, strict=True))
    return total, tuple(forms)


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


def area_gradients(S: Float[Array, "c r a"], x: Float[Array, "n 2"], nodes: Int[Array, "c a"]) -> tuple[jax.Array, jax.Array]:
    """Gradients (c, a, 2) of the cells' volumes V J at their ``nodes``, mm, and V J (c,), mm^2, from their area forms ``S``."""

    def of(S, nodes):
        local = local_positions(x, nodes)  # S annihilates translations
        G = jnp.stack([area_form_product(S, local[..., 1]), -area_form_product(S, local[..., 0])], axis=-1)
        return G, 0.5 * jnp.sum(G * local, axis=(1, 2))  # V J is quadratic in x

    def add(k, total):  # the last chunk overlaps the one before
        first = jnp.minimum(k * CELLS_PER_PRODUCT, len(S) - CELLS_PER_PRODUCT)
        parts = of(*(lax.dynamic_slice_in_dim(v, first, CELLS_PER_PRODUCT) for v in (S, jnp.asarray(nodes))))
        return tuple(lax.dynamic_update_slice_in_dim(t, part, first, 0) for t, part in zip(total, parts, strict=True))

    if len(S) <= CELLS_PER_PRODUCT:
        return of(S, nodes)
    empty = jnp.zeros((*nodes.shape, 2), x.dtype), jnp.zeros(len(S), x.dtype)
    return lax.fori_loop(0, -(-len(S) // CELLS_PER_PRODUCT), add, empty)


def area_form_product(S: Float[Array, "c r a"], v: Float[Array, "c a"]) -> Float[Array, "c a"]:
    """Products of the cells' area forms, in either form of ``Operators.area_forms``, with ``v``; sums of rows, which XLA vectorises."""
    halves = jnp.sum(S * v[:, None], axis=2)
    if S.shape[1] == S.shape[2]:
        return halves
    first, second = jnp.split(halves, 2, axis=1)
    return jnp.sum(S * jnp.concatenate([second, -first], axis=1)[:, :, None], axis=1)


def area_form_matrix(S: Float[Array, "r a"]) -> Float[Array, "a a"]:
    """The area form of one cell as a matrix, from either form of ``Operators.area_forms``."""
    if S.shape[0] == S.shape[1]:
        return S
    first, second = jnp.split(S, 2)
    return first.T @ second - second.T @ first
