"""Sparsity pattern: positions of node-pair blocks in the matrix of the free degrees of freedom."""

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from .._types import Array, Float, Int
from .dissection import Tree, dissect


@dataclasses.dataclass(frozen=True, eq=False)
class Pattern:
    """Where the entries of node-pair blocks go in the free-free matrix.

    NumPy arrays, hashed by identity.
    """

    n_pairs: int
    """Number of node pairs i <= j."""
    free: Int[np.ndarray, " f"]
    """Degree of freedom that stands for each unknown; 2n and on if none does."""
    structure: sp.csc_matrix
    """The free-free matrix (f, f) of a tangent with, in place of its values, ``source``."""
    tree: Tree
    """Order of elimination and its fronts."""
    joined: sp.csr_matrix | None = None
    """Matrix from pair blocks (4 n_pairs,) to pairs of master nodes; None if there is no slave."""

    @property
    def size(self) -> int:
        """Number f of unknowns."""
        return self.structure.shape[0]

    @property
    def source(self) -> Int[np.ndarray, " nnz"]:
        """Entry of the flattened pair blocks of each stored entry, condensed to master nodes.

        They are joined if nodes move together.
        """
        return self.structure.data

    def matrix(self, pairs: Float[Array, "p 2 2"]) -> sp.csc_matrix:
        """The free-free matrix (f, f), CSC, from pair blocks (n_pairs, 2, 2)."""
        return self.matrix_of(self.entries(pairs))

    def matrix_of(self, entries: Float[np.ndarray, " e"]) -> sp.csc_matrix:
        """The free-free matrix (f, f), CSC, from the `entries` of pair blocks."""
        matrix = copy.copy(self.structure)  # the constructor would check the indices once more
        matrix.data = entries[self.source]
        return matrix

    def entries(self, pairs: Float[Array, "p 2 2"]) -> Float[np.ndarray, " e"]:
        """Entries (e,) of the pair blocks (n_pairs, 2, 2), added up if nodes move together."""
        entries = np.asarray(pairs)[: self.n_pairs].reshape(-1)
        return entries if self.joined is None else self.joined @ entries


def analyse(
    pair_nodes: Int[np.ndarray, "p 2"],
    points: Float[np.ndarray, "n 2"],
    masters: Int[np.ndarray, " f"],
    fields: Sequence[sp.csr_matrix] | None = None,
    late: int | None = None,
) -> Pattern:
    """``Pattern`` of C^T K C for node pairs (p, 2), i <= j, ``points`` (n, 2), and C (2n, f).

    K is between nodes at the points; the mean over the C. The pairs include (i, i) for every node
    of theirs. ``masters`` are degrees of freedom that stand for the unknowns, ascending, 2n and on
    for unknowns that may move all nodes. Without ``fields`` C selects these degrees of freedom.
    Nodes from the number ``late`` on have the negative pivots of a quasi-definite matrix.
    """
    n_pairs, joined, n = len(pair_nodes), None, len(points)
    # else an unknown is one degree of freedom
    if fields is not None and (len(fields) > 1 or fields[0].nnz > len(masters)):
        # nodes whose components are as it were two of the unknowns that may move all
        more = max(int(masters[-1]) // 2 + 1 - n, 0)
        points = np.concatenate([points, np.zeros((more, 2))])
        pair_nodes, joined = _join(pair_nodes, len(points), masters, fields)
    local = np.full(2 * len(points), -1)
    local[masters] = np.arange(len(masters))
    structure = _sources(pair_nodes, len(points))[masters][:, masters]
    structure.sort_indices()
    nodes = np.unique(pair_nodes)
    tree = dissect(
        np.searchsorted(nodes, pair_nodes),
        local.reshape(-1, 2)[nodes],
        points[nodes],
        last=len(points) - n,
        late=None if late is None else nodes >= late,
    )
    return Pattern(n_pairs, masters, structure.T, tree, joined)


def _sources(pairs, n):
    """Transpose (2 n, 2 n) of the matrix of entry numbers in the blocks (p, 2, 2) of pairs.

    The node pairs (p, 2) put the entries.
    """
    graph = _pair_graph(pairs, n)
    order = np.array([[[0, 1], [2, 3]], [[0, 2], [1, 3]]], dtype=np.int32)[
        (graph.data < 0).astype(np.int8)
    ]
    blocks = 4 * (np.abs(graph.data) - 1)[:, None, None] + order
    return sp.bsr_matrix((blocks, graph.indices, graph.indptr), shape=(2 * n, 2 * n)).tocsr()


def _pair_graph(pairs, n):
    """Sparse matrix (n, n) of the numbers of node pairs (p, 2), i <= j, from 1.

    Negative at (j, i), and if i = j.
    """
    i, j = pairs.T
    apart, number = i != j, np.arange(1, len(pairs) + 1, dtype=np.int32)
    ends = np.concatenate([i, j[apart]]), np.concatenate([j, i[apart]])
    return sp.csr_matrix(
        (np.concatenate([np.where(apart, number, -number), -number[apart]]), ends), shape=(n, n)
    )


def _join(pair_nodes, n, masters, fields):
    """Pairs (q, 2) of ``masters``, and the matrix (4 q, 4 p) from K's blocks to C^T K C's."""
    parts = [_products(pair_nodes, masters, C) for C in fields]
    first, second, source, weight = (np.concatenate(column) for column in zip(*parts, strict=True))
    key, entry = first // 2 * n + second // 2, 2 * (first % 2) + second % 2
    nodes = np.unique(np.concatenate([key // n, key % n]))
    known = np.union1d(key, nodes * (n + 1))
    rows = 4 * np.searchsorted(known, key) + entry
    joined = sp.csr_matrix(
        (weight / len(fields), (rows, source)), shape=(4 * len(known), 4 * len(pair_nodes))
    )
    return np.stack([known // n, known % n], axis=1), joined


def _products(pair_nodes, masters, C):
    """Products of the rows of C (2n, f) at both ends of every entry of the pair blocks.

    The blocks are (p, 2, 2); the products are the masters that they couple, that of the earlier
    node first, the entries' numbers and the weights.
    """
    ends = (2 * pair_nodes[:, :, None] + np.arange(2))[:, :, [[0, 0, 1, 1], [0, 1, 0, 1]]]
    i, j = ends[:, 0, 0].ravel(), ends[:, 1, 1].ravel()
    counts = np.diff(C.indptr)
    several = counts[i] * counts[j]
    source = np.repeat(np.arange(len(i)), several)
    place = np.arange(len(source)) - np.repeat(np.cumsum(several) - several, several)
    at = (
        C.indptr[i][source] + place // counts[j][source],
        C.indptr[j][source] + place % counts[j][source],
    )
    first, second = (masters[C.indices[k]] for k in at)
    weight, apart = (
        C.data[at[0]] * C.data[at[1]],
        (pair_nodes[:, 0] != pair_nodes[:, 1])[source // 4],
    )
    # the block of a node with itself has every entry twice
    real = apart | (first // 2 <= second // 2)
    first, second, source, weight, apart = (
        part[real] for part in (first, second, source, weight, apart)
    )
    # also the transpose counts
    swapped, turned = first // 2 > second // 2, (first // 2 == second // 2) & apart
    first, second = np.where(swapped, second, first), np.where(swapped, first, second)
    return tuple(
        np.append(a, b[turned])
        for a, b in ((first, second), (second, first), (source, source), (weight, weight))
    )
