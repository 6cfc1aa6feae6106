"""Which nodes interact: the node pairs of a model's cells and hole outlines, and the pattern of its tangent; NumPy on the host."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from .._memo import once_per_owner
from .._types import Array, Bool, Int
from ..discretisation import Connectivity
from ..linalg import Pattern, analyse
from .contact import contact_groups
from .dofs import unknowns

ROWS_TOGETHER = 1024  # whose pairs are listed together


def pair_slots(
    lists: Sequence[tuple[Int[np.ndarray, "..."], Bool[np.ndarray, "..."]]], n: int
) -> tuple[Int[np.ndarray, "p 2"], tuple[Int[np.ndarray, "..."], ...]]:
    """Pairs (p, 2), i <= j, of numbers below ``n`` that share a row of an array (c, a), and per array their slots (c, t) by two columns.

    Beside each array stands where its numbers count; the slot of others is p.
    """
    slots, parts = [], []
    for numbers, real in lists:
        a, b = np.triu_indices(numbers.shape[1])
        slots.append(np.empty((len(numbers), len(a)), np.int32))
        for first in range(0, len(numbers), ROWS_TOGETHER):  # neighbouring rows share most of their pairs, so their list is short
            rows = slice(first, first + ROWS_TOGETHER)
            i, j, on = numbers[rows, a].astype(np.int64), numbers[rows, b], real[rows, a] & real[rows, b]
            keys, index = np.unique(np.where(on, np.minimum(i, j) * n + np.maximum(i, j), n * n), return_inverse=True)
            slots[-1][rows] = index.reshape(i.shape)
            parts.append((keys, slots[-1][rows]))
    unique = np.unique(np.concatenate([keys for keys, _ in parts]))
    unique = unique[unique < n * n]
    for keys, slot in parts:
        slot[:] = np.searchsorted(unique, keys)[slot]
    return np.stack([unique // n, unique % n], axis=1), tuple(slots)


@once_per_owner
def node_pairs(lists: Connectivity) -> tuple[Int[Array, "p 2"], tuple[Any, ...]]:
    """Node pairs (p, 2), i <= j, that share a cell, and per block of cells the slots (c, t) of `operators.Operators`.

    ``lists`` are the model's ``lists``.
    """
    sizes = [int((lists.support[cells] > 0).sum(axis=1).max()) for cells in lists.patches]
    blocks = [(lists.nodes[cells, :size], lists.support[cells, :size] > 0) for cells, size in zip(lists.patches, sizes, strict=True)]
    return pair_slots(blocks, len(lists.topology.node_vertices))


@once_per_owner
def contact_pairs(lists: Connectivity, dmax: float) -> tuple[Int[Array, "e 2"], list[Any]]:
    """Node pairs (e, 2), i <= j, that share a hole's outline but no cell, and for each of `contact.contact_groups` the slots (h, t).

    The slots count the pairs that share a cell first; padding has the number after the last pair.
    """
    n = len(lists.topology.node_vertices)
    cell_keys, keys = node_pairs(lists)[0] @ [n, 1], []
    for group in contact_groups(lists.topology, dmax):
        a, b = np.triu_indices(group.nodes.shape[1])
        i, j = group.nodes[:, a], group.nodes[:, b]
        keys.append(np.where((i < n) & (j < n), i * n + j, n * n))
    new = np.setdiff1d(np.concatenate([key.ravel() for key in keys]), [*cell_keys, n * n])
    every, end = np.concatenate([cell_keys, new]), len(cell_keys) + len(new)
    order = np.argsort(every)
    slots = [np.append(order, end)[np.searchsorted(every[order], key)].astype(np.int32) for key in keys]
    return np.stack([new // n, new % n], axis=1), slots


@once_per_owner
def tangent_pattern(lists: Connectivity, contact_dmax: float | None = None) -> Pattern:
    """`linalg.Pattern` of the tangent on the free degrees of freedom; with the pairs of self-contact where ``contact_dmax``, the model's
    ``dmax``, is given.
    """
    topology, pairs = lists.topology, node_pairs(lists)[0]
    free = unknowns(lists)
    at = topology.partition.vertices[topology.node_vertices], free.masters, [free.matrix]
    if contact_dmax is None:
        return analyse(pairs, *at)
    wider = analyse(np.concatenate([pairs, contact_pairs(lists, contact_dmax)[0]]), *at)
    return dataclasses.replace(wider, narrower=tangent_pattern(lists))
