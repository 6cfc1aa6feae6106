"""Node pairs of a model's cells and contact, and the pattern of its tangent; host NumPy."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp

from .._memo import once_per_owner
from .._types import Array, Bool, Float, Int
from ..discretisation import Connectivity, Model
from ..linalg import Pattern, analyse
from .contact import has_pairs, pair_hessians
from .dofs import unknowns
from .surfaces import Surfaces, surface_rows, surfaces_of

ROWS_TOGETHER = 1024  # whose pairs are listed together
# points along an outline over which contact may spread before its couplings are found anew
SPREAD = 2
KEPT = 4  # couplings that are kept for later states


def pair_slots(
    lists: Sequence[tuple[Int[np.ndarray, "..."], Bool[np.ndarray, "..."]]], n: int
) -> tuple[Int[np.ndarray, "p 2"], tuple[Int[np.ndarray, "..."], ...]]:
    """Pairs (p, 2), i <= j, of numbers below ``n`` in one row of arrays (c, a), and slots (c, t).

    Slots are per array, by two columns. Beside each array stands where its numbers count; the slot
    of others is p.
    """
    slots, parts = [], []
    for numbers, real in lists:
        a, b = np.triu_indices(numbers.shape[1])
        slots.append(np.empty((len(numbers), len(a)), np.int32))
        # neighbouring rows share most of their pairs, so their list is short
        for first in range(0, len(numbers), ROWS_TOGETHER):
            rows = slice(first, first + ROWS_TOGETHER)
            i, j, on = (
                numbers[rows, a].astype(np.int64),
                numbers[rows, b],
                real[rows, a] & real[rows, b],
            )
            keys, index = np.unique(
                np.where(on, np.minimum(i, j) * n + np.maximum(i, j), n * n), return_inverse=True
            )
            slots[-1][rows] = index.reshape(i.shape)
            parts.append((keys, slots[-1][rows]))
    unique = np.unique(np.concatenate([keys for keys, _ in parts]))
    unique = unique[unique < n * n]
    for keys, slot in parts:
        slot[:] = np.searchsorted(unique, keys)[slot]
    return np.stack([unique // n, unique % n], axis=1), tuple(slots)


@once_per_owner
def node_pairs(lists: Connectivity) -> tuple[Int[Array, "p 2"], tuple[Any, ...]]:
    """Node pairs (p, 2), i <= j, of shared cells, and per block their slots (c, t).

    They are those of `operators.Operators`. ``lists`` are the model's ``lists``.
    """
    sizes = [int((lists.support[cells] > 0).sum(axis=1).max()) for cells in lists.patches]
    blocks = [
        (lists.nodes[cells, :size], lists.support[cells, :size] > 0)
        for cells, size in zip(lists.patches, sizes, strict=True)
    ]
    return pair_slots(blocks, len(lists.topology.node_vertices))


@dataclasses.dataclass(frozen=True, eq=False)
class Couplings:
    """Node pairs that contact couples; hashed by identity."""

    points: sp.csr_array
    """Which outline points (p, p) they belong to."""
    pairs: Int[np.ndarray, "e 2"]
    """Those i <= j that share no cell, in ascending order."""


def couplings(model: Model) -> Couplings | None:
    """`Couplings` of the contact pairs of a ``model``, with room to spread; None without any.

    Contact spreads along the surfaces. An obstacle couples only nodes that share a cell. Earlier
    ones serve if they hold these pairs, so that the pattern of the tangent changes seldom.
    """
    if not has_pairs(model) or not len(model.contact.pairs.multiplicity):
        return None
    known = model.contact.pairs.__dict__.setdefault("_couplings", {})
    if model.lists not in known:
        known[model.lists] = _couplings(model)
    return known[model.lists]


def _couplings(model):
    lists = model.lists
    points, recent = _coupled_points(model), lists.__dict__.setdefault("_couplings", [])
    for known in recent:
        if (points - points.multiply(known.points)).nnz == 0:
            return known
    along = _along_surfaces(surfaces_of(model), points.shape[0] - model.n_nodes, model.n_nodes)
    spread = sp.csr_array((along @ points @ along.T) > 0, dtype=float)
    supports = sp.csr_array(_rows(model) != 0, dtype=float)
    i, j = sp.triu(supports.T @ spread @ supports).nonzero()
    n = model.n_nodes
    new = np.setdiff1d(i.astype(np.int64) * n + j, node_pairs(lists)[0] @ [n, 1])
    found = Couplings(spread, np.stack([new // n, new % n], axis=1))
    recent[:] = [found, *recent[: KEPT - 1]]
    return found


def _coupled_points(model):
    """The surface points (p, p) of which two belong to one pair, symmetric, 1 for each."""
    pairs, points = model.contact.pairs, sum(rows.shape[0] for rows in surface_rows(model))
    ends, p = (
        _ends_and_shares(pairs, np.flatnonzero(pairs.multiplicity), points)[0],
        points + model.n_nodes,
    )
    i, j = np.repeat(ends, ends.shape[1], axis=1).ravel(), np.tile(ends, ends.shape[1]).ravel()
    return sp.csr_array(sp.csr_array((np.ones(len(i)), (i, j)), shape=(p, p)) > 0, dtype=float)


def _ends_and_shares(pairs, rows, points):
    """Surface points (r, 6) of the separations of pairs, and shares (r, 6, 2).

    Nodes are numbered after all ``points``. The anchors of mirror images, which lie on walls, do
    not move: in their place stands the first point, without a share.
    """
    ends, fraction, sign = (
        np.asarray(part)[rows] for part in (pairs.pair.ends, pairs.pair.fraction, pairs.sign)
    )
    of_points = (
        np.stack([1 - fraction, fraction], axis=2)[..., None]
        * np.stack([np.ones_like(sign), -sign], axis=1)[:, :, None]
    )
    repeated = np.any(pairs.coefficient[rows] != 0, axis=(1, 2)) & np.all(sign > 0, axis=1)
    ends = ends % points
    anchors = np.where(repeated[:, None], points + np.asarray(pairs.anchors)[rows], ends[:, :1, 0])
    of_anchors = np.where(repeated[:, None, None], -np.asarray(pairs.coefficient)[rows], 0.0)
    return np.concatenate([ends.reshape(-1, 4), anchors], axis=1), np.concatenate(
        [of_points.reshape(-1, 4, 2), of_anchors], axis=1
    )


@once_per_owner
def _along_surfaces(surfaces: Surfaces, p: int, n: int) -> sp.csr_array:
    """Matrix (p + n, p + n): 1 for surface points at most ``SPREAD`` apart, and for nodes.

    They are apart along a surface, in points.
    """
    i, j = surfaces.points.ends[surfaces.points.share[:, 1] > 0].T % p
    step = sp.eye_array(p + n) + sp.csr_array((np.ones(len(i)), (i, j)), shape=(p + n, p + n))
    step = sp.csr_array(step + step.T)
    return sp.csr_array(functools.reduce(lambda so_far, _: so_far @ step, range(SPREAD - 1), step))


def _rows(model):
    """Matrix (p + n, n) of shape functions at surface points, then of the nodes themselves."""
    return sp.csr_array(sp.vstack([*surface_rows(model), sp.eye_array(model.n_nodes)]))


@once_per_owner
def tangent_pattern(lists: Connectivity, coupled: Couplings | None = None) -> Pattern:
    """`linalg.Pattern` of the tangent, with the node pairs that contact couples.

    It is on the free degrees of freedom.
    """
    topology, free = lists.topology, unknowns(lists)
    at = topology.partition.vertices[topology.node_vertices], free.masters, [free.matrix]
    return analyse(all_pairs(lists, coupled), *at)


def all_pairs(lists: Connectivity, coupled: Couplings | None) -> Int[np.ndarray, "p 2"]:
    """The node pairs that share a cell and, after them, those that contact couples."""
    return (
        node_pairs(lists)[0]
        if coupled is None
        else np.concatenate([node_pairs(lists)[0], coupled.pairs])
    )


def contact_blocks(
    x: Float[Array, "n 2"], model: Model, coupled: Couplings | None
) -> Float[np.ndarray, "p 2 2"]:
    """Second derivative of the energy of contact by the node pairs of `all_pairs`, kT/v.

    The Hessian of each pair in its separation is taken to the outline points and from there to the
    nodes.
    """
    pairs, lists, n = model.contact.pairs, model.lists, model.n_nodes
    of_pairs, of_points = (np.asarray(H) for H in pair_hessians(x, model))
    both = sp.csr_array(sp.kron(_rows(model), sp.eye_array(2)))
    rows = [np.flatnonzero(np.any(H != 0, axis=(1, 2))) for H in (of_pairs, of_points)]
    fraction = np.asarray(pairs.point.fraction)[rows[1]]
    points = both.shape[0] // 2 - n
    single = (
        np.asarray(pairs.point.ends)[rows[1]] % points,
        np.stack([1 - fraction, fraction], axis=1)[..., None] * np.ones(2),
    )
    parts = zip(
        (of_pairs[rows[0]], of_points[rows[1]]),
        (_ends_and_shares(pairs, rows[0], points), single),
        strict=True,
    )
    at_points = sum(
        (_at_points(H, *where, both.shape[0]) for H, where in parts),
        sp.csr_array((both.shape[0],) * 2),
    )
    at_nodes = sp.bsr_array(both.T @ at_points @ both, blocksize=(2, 2))
    i, j = np.repeat(np.arange(n), np.diff(at_nodes.indptr)), at_nodes.indices
    every, keys = all_pairs(lists, coupled) @ [n, 1], i.astype(np.int64) * n + j
    order = np.argsort(every, kind="stable")
    place = order[np.minimum(np.searchsorted(every[order], keys), len(every) - 1)]
    upper = (i <= j) & (every[place] == keys)  # nodes on walls may be coupled without an effect
    found = np.zeros((len(every), 2, 2))
    found[place[upper]] = at_nodes.data[upper]
    return found


def _at_points(H, ends, shares, size):
    """Hessians H (q, 2, 2) as a matrix of surface point components, numbered like ``ends``."""
    blocks = np.einsum("qai,qij,qbj->qaibj", shares, H, shares)
    number = 2 * ends[:, :, None] + np.arange(2)
    i, j = (
        np.broadcast_to(part, blocks.shape).ravel()
        for part in (number[:, :, :, None, None], number[:, None, None])
    )
    return sp.csr_array((blocks.ravel(), (i, j)), shape=(size, size))
