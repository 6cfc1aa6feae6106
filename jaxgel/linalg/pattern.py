"""Where the blocks of node pairs go in the matrix of the free degrees of freedom."""

import copy
import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from .._types import Array, Float, Int
from .dissection import Tree, dissect

SOLVERS = ("auto", "direct", "iterative")
LARGE_BYTES = 2**31  # of a factor in double precision, above which "auto" is "iterative": 1.3e5 nodes of sample 1


class View(NamedTuple):
    """How the d = 2 n degrees of freedom follow the unknowns."""

    stands: Int[np.ndarray, " d"]
    """Which degree of freedom stands for each one, ~ that number where it moves the other way and 2 n where it is held."""
    strains: Float[np.ndarray, "m n 2"] | None = None
    """Nodal fields of m more unknowns, which most nodes do not follow."""


@dataclasses.dataclass(frozen=True, eq=False)
class Pattern:
    """Where the entries of node-pair blocks go in the free-free matrix; NumPy arrays, hashed by identity."""

    n_pairs: int
    """Number of node pairs i <= j."""
    free: Int[np.ndarray, "..."]
    """(b,) or (b, k) degrees of freedom of each unknown that has any of its own: of all f but strains."""
    structure: sp.csc_matrix
    """The free-free matrix (f, f) of a tangent with, in place of its values, ``source``."""
    tree: Tree
    """Order of elimination and its fronts."""
    joined: sp.csr_matrix | None = None
    """Takes the entries of the pair blocks (4 n_pairs,) to those of the pairs of nodes that stand for others; None where none does."""
    narrower: "Pattern | None" = None
    """``Pattern`` of the first pairs alone, for tangents whose other blocks are zero; None without."""
    solver: str = "auto"
    """``"direct"``, ``"iterative"``, or ``"auto"``: by the size of the factor."""

    @property
    def size(self) -> int:
        """Number f of unknowns."""
        return self.structure.shape[0]

    @property
    def precision(self) -> type:
        """Type of the numbers in which factors are kept."""
        large = 8 * self.tree.fill > LARGE_BYTES
        return np.float32 if self.solver == "iterative" or (self.solver == "auto" and large) else np.float64

    @property
    def source(self) -> Int[np.ndarray, " nnz"]:
        """Entry of the flattened pair blocks, joined where nodes move together, that each stored matrix entry takes."""
        return self.structure.data

    def fitting(self, pairs: Float[Array, "p 2 2"]) -> "Pattern":
        """The narrower pattern where it holds all of the pair blocks (n_pairs, 2, 2), otherwise this one."""
        return self.narrower if self.narrower is not None and not np.any(np.asarray(pairs)[self.narrower.n_pairs :]) else self

    def matrix(self, pairs: Float[Array, "p 2 2"]) -> sp.csc_matrix:
        """The free-free matrix (f, f), CSC, from pair blocks (n_pairs, 2, 2)."""
        return self.matrix_of(self.entries(pairs))

    def matrix_of(self, entries: Float[np.ndarray, " e"]) -> sp.csc_matrix:
        """The free-free matrix (f, f), CSC, from the `entries` of pair blocks."""
        matrix = copy.copy(self.structure)  # the constructor would check the indices once more
        matrix.data = entries[self.source]
        return matrix

    def entries(self, pairs: Float[Array, "p 2 2"]) -> Float[np.ndarray, " e"]:
        """Entries (e,) of the pair blocks (n_pairs, 2, 2), added up where nodes move together."""
        entries = np.asarray(pairs)[: self.n_pairs].reshape(-1)
        return entries if self.joined is None else self.joined @ entries


def analyse(
    pair_nodes: Int[np.ndarray, "p 2"],
    points: Float[np.ndarray, "n 2"],
    free: Int[np.ndarray, "..."],
    solver: str = "auto",
    views: Sequence[View] | None = None,
) -> Pattern:
    """``Pattern`` for node pairs (p, 2) with i <= j between nodes at ``points`` (n, 2) and free degrees of freedom (b,) or (b, k).

    The pairs include (i, i) for every node of theirs. Where degrees of freedom move together the ``views`` say how, by default as
    `standing` says of ``free``. The strains of the views are the last of all unknowns. Of several views the matrix is the mean.
    """
    n_pairs, joined, n, strains = len(pair_nodes), None, len(points), 0
    if free.ndim == 2:
        views = [View(standing(free, n))] if views is None else views
        strains = 0 if views[0].strains is None else len(views[0].strains)
        points = np.concatenate([points, np.zeros(((strains + 1) // 2, 2))])  # two strains are as it were the components of a node
        pair_nodes, joined = _join(pair_nodes, len(points), [_layers(view, n, 2 * len(points)) for view in views])
    own = free if joined is None else np.append(free[:, 0], 2 * n + np.arange(strains))
    local = np.full(2 * len(points), -1)
    local[own] = np.arange(len(own))
    structure = _sources(pair_nodes, len(points))[own][:, own]
    structure.sort_indices()
    nodes = np.unique(pair_nodes)
    tree = dissect(np.searchsorted(nodes, pair_nodes), local.reshape(-1, 2)[nodes], points[nodes], last=len(points) - n)
    return Pattern(n_pairs, free, structure.T, tree, joined, solver=solver)


def standing(free: Int[np.ndarray, "f k"], n: int) -> Int[np.ndarray, " d"]:
    """Which degree of freedom stands for each of the d = 2 n ones, see `View`; those that move together are rows of ``free`` (f, k)."""
    numbers, stands = np.where(free < 0, ~free, free), np.full(2 * n + 1, 2 * n)
    stands[numbers] = np.where(free < 0, ~free[:, :1], free[:, :1])
    return stands[:-1]


def _sources(pairs, n):
    """Transpose (2 n, 2 n) of the matrix that has, where node pairs (p, 2) put an entry, its number in their blocks (p, 2, 2)."""
    graph = _pair_graph(pairs, n)
    order = np.array([[[0, 1], [2, 3]], [[0, 2], [1, 3]]], dtype=np.int32)[(graph.data < 0).astype(np.int8)]
    blocks = 4 * (np.abs(graph.data) - 1)[:, None, None] + order
    return sp.bsr_matrix((blocks, graph.indices, graph.indptr), shape=(2 * n, 2 * n)).tocsr()


def _pair_graph(pairs, n):
    """Sparse matrix (n, n) with the number of each node pair (p, 2), i <= j, counted from 1: negative at (j, i), and where i = j."""
    i, j = pairs.T
    apart, number = i != j, np.arange(1, len(pairs) + 1, dtype=np.int32)
    ends = np.concatenate([i, j[apart]]), np.concatenate([j, i[apart]])
    return sp.csr_matrix((np.concatenate([np.where(apart, number, -number), -number[apart]]), ends), shape=(n, n))


def _layers(view, n, held):
    """What the degrees of freedom (d,) follow, layer by layer: the number of an unknown, ``held`` where there is none, and the weight."""
    stands = np.where(view.stands == 2 * n, held, view.stands)
    layers = [(np.where(stands < 0, ~stands, stands), np.where(stands < 0, -1.0, 1.0))]
    for number, field in enumerate(() if view.strains is None else view.strains):
        layers.append((np.where(field.ravel() != 0, 2 * n + number, held), field.ravel()))
    return layers


def _join(pair_nodes, n, views):
    """Pairs (q, 2) of nodes that stand for others, and the matrix (4 q, 4 p) that adds up the blocks of the pairs (p, 2) they stand for."""
    parts = [_entries_of_layers(pair_nodes, n, *both) for layers in views for both in itertools.product(layers, repeat=2)]
    key, entry, source, weight = (np.concatenate(column) for column in zip(*parts, strict=True))
    nodes = np.unique(np.concatenate([key // n, key % n]))
    known = np.union1d(key, nodes * (n + 1))
    rows = 4 * np.searchsorted(known, key) + entry
    joined = sp.csr_matrix((weight / len(views), (rows, source)), shape=(4 * len(known), 4 * len(pair_nodes)))
    return np.stack([known // n, known % n], axis=1), joined


def _entries_of_layers(pair_nodes, n, left, right):
    """Where the entries of the pair blocks go as one end follows the layer ``left`` and the other ``right``: keys of pairs and entries of
    their blocks, the entries' numbers and their weights.
    """
    dofs = 2 * pair_nodes[:, :, None] + np.arange(2)  # (p, end, component)
    some = np.flatnonzero((left[0][dofs[:, 0]] < 2 * n).any(axis=1) & (right[0][dofs[:, 1]] < 2 * n).any(axis=1))
    dofs, apart = dofs[some], (pair_nodes[:, 0] != pair_nodes[:, 1])[some, None, None]
    first, second = np.broadcast_arrays(left[0][dofs[:, 0], None], right[0][dofs[:, 1]][:, None])  # (p, 2, 2)
    weight, source = left[1][dofs[:, 0], None] * right[1][dofs[:, 1]][:, None], 4 * some[:, None, None] + np.array([[0, 1], [2, 3]])
    swapped = first // 2 > second // 2
    real = (first < 2 * n) & (second < 2 * n) & (apart | ~swapped)  # the block of a node with itself has every entry twice
    turned = real & (first // 2 == second // 2) & apart  # also the transpose counts
    first, second = np.where(swapped, second, first), np.where(swapped, first, second)
    found = []
    for a, b, where in ((first, second, real), (second, first, turned)):
        a, b = a[where], b[where]
        found.append((a // 2 * n + b // 2, 2 * (a % 2) + b % 2, source[where], weight[where]))
    return tuple(np.concatenate(column) for column in zip(*found, strict=True))
