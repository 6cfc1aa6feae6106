"""Precomputed operators of a model and the assembly of its condensed tangent."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..linalg import analyse
from ..materials import neo_hookean
from .contact import contact_tangents, layout
from .energy import all_volumes, by_block
from .mixed import ROTATION, TOGETHER, _crossed_matrix

CHUNK = 32  # cells whose tangents are added up together: few enough to stay in the cache


@functools.partial(jax.tree_util.register_dataclass, data_fields=["pairs", "slots", "laplacian", "crossed"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Constants:
    """What all tangents of a model have in common."""

    pairs: jax.Array
    """(p, 2) node pairs i <= j that share a cell, in ascending order."""
    slots: tuple
    """Per block (c, t) the pair of each entry a <= b of a cell's node list; one past the end for padding."""
    laplacian: jax.Array
    """(p,) sum of w dphi_i . dphi_j over all points."""
    crossed: tuple
    """Per block the matrices S_ab = sum_q w (dphi_a1 dphi_b2 - dphi_a2 dphi_b1) of the cells: (c, a, a), or where the points are few
    (c, 2 q, a) with the rows w dphi_1 and dphi_2 of their gradients, see ``_crossed_product``."""


def constants(model):
    """``Constants`` of a model."""
    return constants_of(model.lists, model.blocks, node_pairs(model.lists)[1])


def constants_of(lists, blocks, slots):
    """``Constants`` of the cells of ``blocks`` with their ``slots``."""
    pairs = node_pairs(lists)[0]
    blocks = tuple((block.dphi, block.weight) for block in blocks)
    laplacian, crossed = _constants(jnp.zeros(len(pairs)), blocks, slots)
    return Constants(jnp.asarray(pairs), tuple(map(jnp.asarray, slots)), laplacian, crossed)


@jax.jit
def _constants(total, blocks, slots):
    def laplacian(arrays):
        return jnp.einsum("q,qai,qbi->ab", arrays[1], arrays[0], arrays[0])

    def crossed(arrays):
        dphi, weight = arrays
        if 2 * len(weight) < dphi.shape[1]:
            return jnp.concatenate([weight[:, None] * dphi[:, :, 0], dphi[:, :, 1]])
        return jnp.einsum("q,qai,ij,qbj->ab", weight, dphi, ROTATION, dphi)

    for arrays, slot in zip(blocks, slots, strict=True):
        total = _add_cells(total, laplacian, arrays, slot, arrays[0].shape[2])
    return total, tuple(lax.map(crossed, arrays, batch_size=CHUNK) for arrays in blocks)


def node_pairs(lists):
    """Node pairs (p, 2), i <= j, that share a cell, and per block the slots (c, t) of ``Constants``; host, kept with the lists."""
    if "pairs" not in lists.cache:
        n, slots, parts = len(lists.topology.node_vertices), [], []
        for cells in lists.cells:
            a, b = np.triu_indices(int((lists.support[cells] > 0).sum(axis=1).max()))
            slots.append(np.empty((len(cells), len(a)), np.int32))
            for first in range(0, len(cells), TOGETHER):  # neighbours, most of whose pairs are the same: their list is short
                some, slot = cells[first : first + TOGETHER], slots[-1][first : first + TOGETHER]
                nodes, real = lists.nodes[some].astype(np.int64), lists.support[some] > 0
                own, place = np.unique(np.where(real[:, a] & real[:, b], nodes[:, a] * n + nodes[:, b], n * n), return_inverse=True)
                slot[:] = place.reshape(slot.shape)
                parts.append((own, slot))
        unique = np.unique(np.concatenate([own for own, _ in parts]))
        unique = unique[unique < n * n]
        for own, slot in parts:
            slot[:] = np.searchsorted(unique, own)[slot]
        lists.cache["pairs"] = np.stack([unique // n, unique % n], axis=1), tuple(slots)
    return lists.cache["pairs"]


def contact_pairs(lists):
    """Node pairs (e, 2), i <= j, that share a hole's outline but no cell, and for each of `contact.layout`'s groups the slots (h, t).

    The slots count the pairs that share a cell first; one past the end for padding. Host, kept with the lists.
    """
    if "contact pairs" not in lists.cache:
        n, known, keys = len(lists.topology.node_vertices), node_pairs(lists)[0] @ [len(lists.topology.node_vertices), 1], []
        for group in layout(lists):
            a, b = np.triu_indices(group.nodes.shape[1])
            i, j = group.nodes[:, a], group.nodes[:, b]
            keys.append(np.where((i < n) & (j < n), i * n + j, n * n))
        new = np.setdiff1d(np.concatenate([key.ravel() for key in keys]), [*known, n * n])
        every, end = np.concatenate([known, new]), len(known) + len(new)
        order = np.argsort(every)
        places = [np.append(order, end)[np.searchsorted(every[order], key)].astype(np.int32) for key in keys]
        lists.cache["contact pairs"] = np.stack([new // n, new % n], axis=1), places
    return lists.cache["contact pairs"]


def tangent_pattern(lists, free, contact=None, solver="auto"):
    """``linear_solve.Pattern`` of the tangent for the free degrees of freedom (f,), with or without ``contact``; kept with the lists."""
    key = ("pattern", free.tobytes(), contact is not None, solver)
    if key not in lists.cache:
        topology, pairs = lists.topology, node_pairs(lists)[0]
        points = topology.partition.vertices[topology.node_vertices]
        if contact is None:
            lists.cache[key] = analyse(pairs, points, free, solver)
        else:
            wider = analyse(np.concatenate([pairs, contact_pairs(lists)[0]]), points, free, solver)
            lists.cache[key] = dataclasses.replace(wider, narrower=tangent_pattern(lists, free, solver=solver))
    return lists.cache[key]


def tangent(x, p, basis, model, gel, fixed):
    """Condensed tangent K by node pairs (p, 2, 2), kT/v, about the linearisation ``basis`` at ``x`` (n, 2) and ``p`` (g,).

    With contact the pairs of `contact_pairs` follow.
    """
    quadratic = gel.network is neo_hookean
    total = jnp.zeros((len(fixed.pairs), 4))
    if quadratic:
        total += gel.Nv * fixed.laplacian[:, None] * jnp.eye(2).ravel()

    def cell(arrays):
        x, dphi, weight, p, k_over_V, S, G = arrays
        mixed = model.method == "mixed"
        S = p[0] * _crossed_matrix(S) if mixed else jnp.einsum("q,qai,ij,qbj->ab", weight * p, dphi, ROTATION, dphi)
        H = k_over_V[:, None, None] * G
        outer = [[jnp.sum(H[:, :, None, i] * G[:, None, :, k], axis=0) for k in range(2)] for i in range(2)]
        K = jnp.stack([outer[0][0], outer[0][1] + S, outer[1][0] - S, outer[1][1]], axis=-1)
        if not quadratic:
            A = jax.vmap(jax.hessian(lambda F: gel.network(F, gel)))(jnp.einsum("ai,qaj->qij", x, dphi))
            K += jnp.einsum("q,qijkl,qaj,qbl->abik", weight, A, dphi, dphi).reshape(K.shape)
        return K

    volumes = all_volumes(model)
    k_over_V = jnp.where(volumes > 0, basis.stiffness / jnp.where(volumes > 0, volumes, 1.0), 0.0)
    groups = by_block(p, model), by_block(k_over_V, model), fixed.crossed, basis.gradients, fixed.slots
    for block, pressure, k_over_V, S, G, slot in zip(model.blocks, *groups, strict=True):
        total = _add_cells(total, cell, (x[block.nodes], block.dphi, block.weight, pressure, k_over_V, S, G), slot, block.nodes.shape[1])
    total = total.reshape(-1, 2, 2)
    return total if model.contact is None else _add_contact(total, x, model)


def _add_contact(total, x, model):
    """The tangent with that of contact: blocks (p + e, 2, 2) of the pairs that share a cell and then of `contact_pairs`."""
    more, slots = contact_pairs(model.lists)
    total = jnp.concatenate([total, jnp.zeros((len(more), 2, 2))])
    for blocks, slot in zip(contact_tangents(x, model), slots, strict=True):
        a, b = np.triu_indices(blocks.shape[1])
        total = total.at[slot].add(blocks[:, a, b], mode="drop")
    return total


@jax.jit
def crossed_entries(fixed):
    """Per block the entries (c, t) of the cells' matrices S in the order of ``Constants.slots``."""
    return [jax.vmap(_crossed_matrix)(S)[:, *np.triu_indices(S.shape[2])] for S in fixed.crossed]


def _add_cells(total, cell, arrays, slots, n):
    """``total`` (p, ...) plus the upper entries of the cell matrices ``cell(arrays[c])`` (n, n, ...) at their ``slots`` (c, t)."""
    a, b = np.triu_indices(n)

    def add(total, first, size):  # slices, as `lax.scan` would copy all arrays
        part, at = jax.tree.map(lambda v: lax.dynamic_slice_in_dim(v, first, size), (arrays, slots))
        return total.at[at].add(jax.vmap(cell)(part)[:, a, b], mode="drop")

    whole, rest = divmod(len(slots), CHUNK)
    if whole:
        total = lax.fori_loop(0, whole, lambda k, total: add(total, k * CHUNK, CHUNK), total)
    return add(total, whole * CHUNK, rest)
