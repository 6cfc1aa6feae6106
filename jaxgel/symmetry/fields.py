"""Fields that a subgroup keeps or reverses: their unknowns, and their images on other parts.

A symmetry takes every unknown of the plate to one, itself or another, with either sign: its matrix
has one entry in each row.
"""

import numpy as np
import scipy.sparse as sp

from ..discretisation import Connectivity
from ..mechanics import Free, free_dofs
from .groups import IDENTITY, images
from .irreducible import Representation

# the region lies in this direction from the plate's middle, on no mirror
TOWARDS = np.array([1.0, np.sqrt(2) - 1])


def unknowns_of(lists: Connectivity, representation: Representation) -> Free:
    """The unknowns of a block, b of them."""
    topology, free = lists.topology, free_dofs(lists.topology)
    nodes = topology.partition.vertices[topology.node_vertices] / topology.spacing
    towards = np.append(
        np.repeat(np.round(nodes @ TOWARDS, 9), 2), np.full(free.n_macroscopic, -np.inf)
    )
    rank = np.argsort(np.lexsort((free.masters, -towards[free.masters])))
    to, signs = (
        np.stack(part)
        for part in zip(*(_image(lists, name) for name, _ in representation.signs), strict=True)
    )
    # of the field at the image over that here
    signs = signs * np.array([[sign] for _, sign in representation.signs])
    chosen, size = np.argmin(rank[to], axis=0), len(rank)
    leader, sign = to[chosen, np.arange(size)], signs[chosen, np.arange(size)]
    # a symmetry that keeps the place reverses the field there
    zero = np.any((to == leader) & (signs != sign), axis=0)
    leaders = np.unique(leader[~zero])
    column = np.searchsorted(leaders, leader[~zero])
    basis = sp.csr_matrix(
        (sign[~zero], (np.flatnonzero(~zero), column)), shape=(size, len(leaders))
    )
    return free.reduced(basis, leaders)


def _image(lists, name):
    """Image (f,) of each unknown of the plate under a symmetry, and its sign (f,)."""
    matrix = turned(free_dofs(lists.topology), lists, name)
    return matrix.indices, matrix.data


def turned(free: Free, lists: Connectivity, turn: str) -> sp.csr_matrix:
    """Fields R^T x of the unknowns ``free`` (b,), as a matrix (f, b) to the plate's unknowns."""
    matrix = free_dofs(lists.topology).left_inverse @ turned_fields(free, lists, turn)
    matrix.data = np.round(matrix.data)  # 1, -1, and 0 if macroscopic parts cancel
    matrix.eliminate_zeros()
    return matrix


def turned_fields(free: Free, lists: Connectivity, turn: str) -> sp.csr_matrix:
    """Fields R^T x of the unknowns ``free`` (b,), as a matrix (2n, b) to all displacements.

    That is, to the degrees of freedom.
    """
    if turn == IDENTITY:
        return free.matrix
    to = images(lists)[turn].dofs
    return sp.csr_matrix(
        free.matrix[np.where(to < 0, ~to, to)].multiply(np.where(to < 0, -1.0, 1.0)[:, None])
    )
