"""Fields that a subgroup keeps or reverses: which unknowns they are, and how they look from other parts of the plate.

Of the macroscopic unknowns of a cell, see ``mechanics.Strained``, a symmetry makes others, or reverses them, as of degrees of freedom:
its matrix has one entry in each row.
"""

import numpy as np
import scipy.sparse as sp

from ..discretisation import Connectivity
from ..linalg import View, standing
from ..mechanics import Free, Strained, free_dofs
from .groups import IDENTITY, images
from .irreducible import Representation

TOWARDS = np.array([1.0, np.sqrt(2) - 1])  # the region lies in this direction from the plate's middle, on no mirror


def unknowns_of(lists: Connectivity, representation: Representation) -> tuple[Free, sp.csr_matrix]:
    """The unknowns of a block, b of them, and the matrix (f, b) to those of the plate."""
    topology, rows, strains = lists.topology, *_parts(free_dofs(lists.topology))
    n, first = len(topology.node_vertices), rows[:, 0]
    nodes = topology.partition.vertices[topology.node_vertices] / topology.spacing
    rank = np.argsort(np.lexsort((first, -np.round(nodes @ TOWARDS, 9)[first // 2])))
    rank = np.append(rank, np.arange(len(rank), len(rank) + len(strains)))
    to, signs = (np.stack(part) for part in zip(*(_image(lists, name) for name, _ in representation.signs), strict=True))
    signs = signs * np.array([[sign] for _, sign in representation.signs])  # of the field at the image over that here
    chosen, size = np.argmin(rank[to], axis=0), len(rank)
    leader, sign = to[chosen, np.arange(size)], signs[chosen, np.arange(size)]
    zero = np.any((to == leader) & (signs != sign), axis=0)  # a symmetry that keeps the place reverses the field there
    leaders = np.unique(leader[~zero])
    column = np.searchsorted(leaders, leader[~zero])
    matrix = sp.csr_matrix((sign[~zero].astype(float), (np.flatnonzero(~zero), column)), shape=(size, len(leaders)))
    own = int(np.sum(leaders < len(rows)))
    together = _together(matrix[: len(rows), :own].tocoo(), rows, rank, 2 * n)
    if not len(strains):
        return together, matrix
    mixed = matrix[len(rows) :, own:]
    free = free_dofs(topology)
    fields = np.einsum("sm,sni->mni", mixed.toarray(), free.strains)
    return Strained(together, fields, free.ends[leaders[own:] - len(rows)]), matrix


def _parts(free):
    """Rows (r, k) of degrees of freedom that move together, and the fields (m, n, 2) of macroscopic unknowns."""
    if isinstance(free, Strained):
        return np.asarray(free.rows), np.asarray(free.strains)
    free = np.asarray(free)
    return free[:, None] if free.ndim == 1 else free, np.zeros((0, 0, 2))


def _together(entries, rows, rank, padding):
    """The degrees of freedom (b, k) that move together in the columns of a matrix (r, b) with these ``entries``, the leader first."""
    order = np.lexsort((rank[entries.row], entries.col))
    row, owner, sign = entries.row[order], entries.col[order], entries.data[order]
    place, count = np.arange(len(owner)) - np.searchsorted(owner, owner), entries.shape[1]
    together = np.full((count, place.max(initial=0) + 1, rows.shape[1]), padding)
    together[owner, place] = np.where((sign[:, None] < 0) & (rows[row] < padding), ~rows[row], rows[row])
    return together.reshape(count, -1)


def _image(lists, name):
    """The unknown (f,) of the plate to which a symmetry takes each one, and the sign (f,) with which it does."""
    topology, rows, strains = lists.topology, *_parts(free_dofs(lists.topology))
    number = np.full(2 * len(topology.node_vertices) + 1, -1)
    number[rows] = np.arange(len(rows))[:, None]
    number[-1] = -1
    if name == IDENTITY:
        return np.arange(len(rows) + len(strains)), np.ones(len(rows) + len(strains), dtype=int)
    image = images(lists)[name].dofs[rows[:, 0]]
    to, signs = number[np.where(image < 0, ~image, image)], np.where(image < 0, -1, 1)
    components = topology.plate.free_strains
    axis = np.abs(images(lists)[name].matrix).argmax(axis=0)  # where a unit vector along each axis goes
    sign = images(lists)[name].matrix[axis, [0, 1]].astype(int)
    moved = [components.index((min(axis[i], axis[j]), max(axis[i], axis[j]))) for i, j in components]
    turned = [sign[i] * sign[j] for i, j in components]
    return np.append(to, len(rows) + np.array(moved, dtype=int)), np.append(signs, np.array(turned, dtype=int))


def view_of(free: Free, lists: Connectivity, turn: str) -> View:
    """`linalg.View` of the unknowns in the fields R^T x, from those of the fields x."""
    n = len(lists.topology.node_vertices)
    rows, strains = _parts(free)
    stands, strains = standing(rows, n), strains if len(strains) else None
    if turn == IDENTITY:
        return View(stands, strains)
    own = images(lists)[turn]
    found = stands[np.where(own.dofs < 0, ~own.dofs, own.dofs)]
    return View(np.where((own.dofs < 0) & (found != 2 * n), ~found, found), None if strains is None else strains[:, own.nodes] @ own.matrix)


def turned(matrix: sp.csr_matrix, lists: Connectivity, turn: str) -> sp.csr_matrix:
    """The fields R^T x (f, b) of the fields x, the columns of a ``matrix`` (f, b)."""
    if turn == IDENTITY:
        return matrix
    to, signs = _image(lists, turn)
    return sp.csr_matrix(matrix[to].multiply(signs[:, None].astype(float)))
