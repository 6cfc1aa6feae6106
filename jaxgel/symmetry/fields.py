"""Fields that a subgroup keeps or reverses: which unknowns they are, and how they look from other parts of the plate.

A symmetry takes every unknown of the plate to one, itself or another, with either sign: its matrix has one entry in each row.
"""

import numpy as np
import scipy.sparse as sp

from ..discretisation import Connectivity
from ..mechanics import Free, free_dofs
from .groups import IDENTITY, images
from .irreducible import Representation

TOWARDS = np.array([1.0, np.sqrt(2) - 1])  # the region lies in this direction from the plate's middle, on no mirror


def unknowns_of(lists: Connectivity, representation: Representation) -> Free:
    """The unknowns of a block, b of them."""
    topology, free = lists.topology, free_dofs(lists.topology)
    nodes = topology.partition.vertices[topology.node_vertices] / topology.spacing
    towards = np.append(np.repeat(np.round(nodes @ TOWARDS, 9), 2), np.full(free.n_macroscopic, -np.inf))
    rank = np.argsort(np.lexsort((free.masters, -towards[free.masters])))
    to, signs = (np.stack(part) for part in zip(*(_image(lists, name) for name, _ in representation.signs), strict=True))
    signs = signs * np.array([[sign] for _, sign in representation.signs])  # of the field at the image over that here
    chosen, size = np.argmin(rank[to], axis=0), len(rank)
    leader, sign = to[chosen, np.arange(size)], signs[chosen, np.arange(size)]
    zero = np.any((to == leader) & (signs != sign), axis=0)  # a symmetry that keeps the place reverses the field there
    leaders = np.unique(leader[~zero])
    column = np.searchsorted(leaders, leader[~zero])
    basis = sp.csr_matrix((sign[~zero], (np.flatnonzero(~zero), column)), shape=(size, len(leaders)))
    return free.reduced(basis, leaders)


def _image(lists, name):
    """The unknown (f,) of the plate to which a symmetry takes each one, and the sign (f,) with which it does."""
    matrix = turned(free_dofs(lists.topology), lists, name)
    return matrix.indices, matrix.data


def turned(free: Free, lists: Connectivity, turn: str) -> sp.csr_matrix:
    """The fields R^T x of the fields x that the unknowns ``free`` (b,) move, as a matrix (f, b) to the unknowns of the plate."""
    matrix = free_dofs(lists.topology).left_inverse @ turned_fields(free, lists, turn)
    matrix.data = np.round(matrix.data)  # 1, -1, and 0 where macroscopic parts cancel
    matrix.eliminate_zeros()
    return matrix


def turned_fields(free: Free, lists: Connectivity, turn: str) -> sp.csr_matrix:
    """The fields R^T x of the fields x that the unknowns ``free`` (b,) move, as a matrix (2n, b) to the degrees of freedom."""
    if turn == IDENTITY:
        return free.matrix
    to = images(lists)[turn].dofs
    return sp.csr_matrix(free.matrix[np.where(to < 0, ~to, to)].multiply(np.where(to < 0, -1.0, 1.0)[:, None]))
