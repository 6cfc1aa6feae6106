"""A symmetric problem on a fundamental region of its plate, and the blocks of its tangent.

Of every orbit of patches, the images of one another, the region has one, which counts as often as
the orbit has patches. The unknowns are the symmetric fields: the degrees of freedom that a group
takes to each other move together. So the energy of the region at a symmetric state is that of the
plate, and so are its derivatives along symmetric fields. With the basis B of a representation's
block, g the elements of the group and K_P the tangent of a patch,

    B^T K B = sum over the region's patches P of (size of its orbit / number of turns) sum over the
    turns g of (R_g^T B)^T K_P (R_g^T B)

so that all blocks come from the tangent of the region's patches alone.
"""

import dataclasses
import functools

import jax
import numpy as np
import scipy.sparse as sp

from .._memo import once_per_owner
from .._sizes import taken
from .._types import Array, Float, Int
from ..discretisation import Connectivity, Model, PatchBlock, numbered
from ..linalg import BlockPattern, Pattern, analyse
from ..materials import LocalValues, with_parameters
from ..mechanics import Couplings, Free, Problem, all_pairs, constraints_of, node_pairs
from .fields import TOWARDS, turned, turned_fields, unknowns_of
from .groups import IDENTITY, images
from .irreducible import Representation, representations


@dataclasses.dataclass(frozen=True, eq=False)
class Basis:
    """The fields of one block; NumPy arrays."""

    representation: Representation
    """Its representation."""
    unknowns: Free
    """Its unknowns."""
    fields: tuple[sp.csr_matrix, ...]
    """Per copy of the block the matrix (f, b) from its unknowns to those of the plate.

    These are the free degrees of freedom.
    """
    pattern: Pattern
    """Where the entries of the region's tangent go in the block."""


@dataclasses.dataclass(frozen=True, eq=False)
class Region:
    """A symmetric problem on its region."""

    group: tuple[str, ...]
    """The symmetries that its states have."""
    problem: Problem
    """The region's problem: nodal fields of the whole plate, pressures of the region's patches."""
    own: Int[np.ndarray, " r"]
    """The volume groups of the plate that are the region's."""
    plate: Model
    """The model of the whole plate."""

    @functools.cached_property
    def spread(self) -> sp.csr_matrix:
        """The matrix (g, r) that takes the pressures of the region to those of the plate."""
        return spread(self.plate, self.group)


def region(problem: Problem, group: tuple[str, ...]) -> Region:
    """`Region` of a ``problem`` that has a ``group``; its numbers may be traced."""
    model, lists = problem.model, problem.model.lists
    chosen, sizes = representatives(lists, group)
    parts = [
        jax.tree.map(lambda v, own=own: taken(v, own), block)
        for block, own in zip(model.blocks, chosen, strict=True)
    ]
    blocks = [counted(block, size) for block, size in zip(parts, sizes, strict=True)]
    real = [len(rows) > 0 for rows in chosen]
    own = own_groups(model.blocks, chosen)

    def part(parameter):
        if not isinstance(parameter, LocalValues):
            return parameter
        points = [
            taken(values, rows)
            for values, rows in zip(parameter.points, chosen, strict=True)
            if len(rows)
        ]
        return LocalValues(tuple(points), taken(parameter.groups, own), parameter.outline)

    lists = _region_lists(lists, group)
    blocks = numbered(
        jax.device_put([block for block, some in zip(blocks, real, strict=True) if some])
    )
    model = dataclasses.replace(
        model, blocks=blocks, carries=taken(model.carries, own), lists=lists
    )
    constraints = constraints_of(lists, problem.changes.edges)
    reduced = problem.replace(
        model=model, gel=with_parameters(problem.gel, part), operators=None, constraints=constraints
    ).prepared
    return Region(group, reduced, own, problem.model)


def counted(block: PatchBlock, sizes: Float[Array, " r"]) -> PatchBlock:
    """The patches of a block, each of which counts ``sizes`` (r,) times."""
    one = np.array([1.0, 0.0])[:, None, None]  # an area is the product of two rows
    contour = block.contour * (1 + one * (sizes[:, None, None, None] - 1))
    return dataclasses.replace(block, weight=block.weight * sizes[:, None], contour=contour)


@once_per_owner
def representatives(lists: Connectivity, group: tuple[str, ...]) -> tuple[list, list]:
    """Per block the rows (r,) of the region's patches, and their orbit sizes (r,)."""
    found, (_, first) = images(lists), patch_images(lists, group)
    orbits = np.stack([np.arange(len(first)), *(found[name].patches for name in group)])
    size = np.array([len(set(column)) for column in orbits.T])
    rows = [np.flatnonzero(first[patches] == patches) for patches in lists.patches]
    return rows, [
        size[patches[r]].astype(float) for patches, r in zip(lists.patches, rows, strict=True)
    ]


@once_per_owner
def patch_images(
    lists: Connectivity, group: tuple[str, ...]
) -> tuple[Int[np.ndarray, " c"], Int[np.ndarray, " c"]]:
    """Element, identity first, that takes each patch to the region, and its image.

    The element's number, and the patch to which it takes it.
    """
    found, centres = images(lists), _patch_centres(lists)
    orbits = np.stack([np.arange(len(centres)), *(found[name].patches for name in group)])
    by = np.argmax(np.round(centres @ TOWARDS, 9)[orbits], axis=0)
    return by, orbits[by, np.arange(len(centres))]


def _patch_centres(lists):
    """Means (c, 2) of the quadrature points of all patches on the reference, over the spacing."""
    topology = lists.topology
    points = np.asarray(topology.quadrature.points(topology.partition.vertices)) / topology.spacing
    counts = np.bincount(lists.owner)
    return np.stack([np.bincount(lists.owner, points[:, i]) / counts for i in range(2)], axis=1)


@once_per_owner
def _region_lists(lists: Connectivity, group: tuple[str, ...]) -> Connectivity:
    """The lists of the region's patches, with the symmetric unknowns."""
    rows = representatives(lists, group)[0]
    parts = [
        (patches[r], points[r])
        for patches, points, r in zip(lists.patches, lists.points, rows, strict=True)
        if len(r)
    ]
    symmetric = representations(group)[0]
    return dataclasses.replace(
        lists,
        patches=tuple(patches for patches, _ in parts),
        points=tuple(points for _, points in parts),
        unknowns=unknowns_of(lists, symmetric),
    )


# --- unknowns -------------------------------------------------------------------------------------


@once_per_owner
def bases(
    lists: Connectivity, group: tuple[str, ...], coupled: Couplings | None = None
) -> tuple[Basis, ...]:
    """`Basis` of every representation's block, symmetric first, without empty blocks.

    That of the symmetric fields; empty blocks have no fields. Their patterns have the node pairs
    that contact ``coupled``.
    """
    own, found = _region_lists(lists, group), []
    points, pairs = (
        lists.topology.partition.vertices[lists.topology.node_vertices],
        all_pairs(own, coupled),
    )
    for representation in representations(group):
        unknowns = unknowns_of(lists, representation)
        if len(unknowns):
            at = (
                points,
                unknowns.masters,
                [turned_fields(unknowns, lists, turn) for turn in representation.turns],
            )
            pattern = analyse(pairs, *at)
            fields = tuple(
                turned(unknowns, lists, turn)
                for turn in representation.turns[: representation.copies]
            )
            found.append(Basis(representation, unknowns, fields, pattern))
    return tuple(found)


@once_per_owner
def blocks_of_plate(lists: Connectivity, group: tuple[str, ...]) -> BlockPattern:
    """The blocks of the whole plate's tangents at states with a ``group``, without contact."""
    points = lists.topology.partition.vertices[lists.topology.node_vertices]
    own = bases(lists, group)
    return BlockPattern(
        tuple(basis.fields for basis in own),
        tuple(
            analyse(node_pairs(lists)[0], points, basis.unknowns.masters, [basis.unknowns.matrix])
            for basis in own
        ),
    )


# --- pressures ------------------------------------------------------------------------------------


def own_groups(blocks: tuple[PatchBlock, ...], chosen: list) -> Int[np.ndarray, " r"]:
    """The volume groups (r,) of the plate that belong to the ``chosen`` rows of each block."""
    found, start = [], 0
    for block, rows in zip(blocks, chosen, strict=True):
        found.append(start + (rows[:, None] * block.n_groups + np.arange(block.n_groups)).ravel())
        start += len(block.patches) * block.n_groups
    return np.concatenate(found)


def spread(model: Model, group: tuple[str, ...]) -> sp.csr_matrix:
    """Matrix (g, r) from pressures of the region's groups to those of all groups of a plate."""
    _, to = patch_images(model.lists, group)
    own = own_groups(model.blocks, representatives(model.lists, group)[0])
    column = np.full(sum(len(block.patches) * block.n_groups for block in model.blocks), -1)
    column[own] = np.arange(len(own))
    rows, columns, values, start = [], [], [], 0
    for block, patches, shares in zip(
        model.blocks, model.lists.patches, group_shares(model, group), strict=True
    ):
        g, there = block.n_groups, _rows_of(model.lists)[to[patches]]
        c, i, j = np.nonzero(shares)
        rows.append(start + c * g + i)
        columns.append(column[start + there[c] * g + j])
        values.append(shares[c, i, j])
        start += len(patches) * g
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sp.csr_matrix(entries, shape=(len(column), len(own)))


def _rows_of(lists):
    """The row (c,) of each patch in its block."""
    row = np.zeros(len(lists.linear), dtype=int)
    for patches in lists.patches:
        row[patches] = np.arange(len(patches))
    return row


def group_shares(model: Model, group: tuple[str, ...]) -> list[Float[np.ndarray, "c g g"]]:
    """Per block shares (c, g, g) of each patch's groups in those of its image in the region.

    They are volume groups. Groups that carry volume change places; those that are held turn among
    themselves, as their moments do.
    """
    lists, found = model.lists, images(model.lists)
    by, to = patch_images(lists, group)
    row, slot = _rows_of(lists), np.zeros(len(lists.cell_of_point), dtype=int)
    for numbers in lists.points:
        where = np.nonzero(numbers >= 0)
        slot[numbers[where]] = where[1]
    shares = []
    for block, patches, numbers in zip(model.blocks, lists.patches, lists.points, strict=True):
        own = np.empty((len(patches), block.n_groups, block.n_groups))
        for k, name in enumerate([IDENTITY, *group]):
            here = np.flatnonzero(by[patches] == k)
            there = row[to[patches[here]]]
            own[here] = _shares(
                block, here, there, slot, numbers, None if name == IDENTITY else found[name].points
            )
        shares.append(own)
    return shares


def _shares(block, here, there, slot, numbers, image):
    """Shares (r, g, g) of pressures of the rows ``there`` in those of the rows ``here``.

    Rows are those of patches.
    """
    g = block.n_groups
    if image is None:
        return np.broadcast_to(np.eye(g), (len(here), g, g))
    real = numbers[here] >= 0
    at = np.where(real, slot[image[np.maximum(numbers[here], 0)]], 0)
    weights, own = np.asarray(block.group_weight), np.asarray(block.weight)[here]
    own = np.where(real, own / own.sum(axis=1, keepdims=True), 0.0)
    overlap = np.einsum(
        "cq,cqi,cqj->cij",
        own,
        weights[here],
        np.take_along_axis(weights[there], at[:, :, None], axis=1),
    )
    shares, m = overlap, block.carrying
    shares[:, :m, :] = shares[:, :, :m] = 0.0
    size = np.einsum(
        "cq,cqi,cqj->cij",
        own,
        weights[here][:, :, :m],
        np.take_along_axis(weights[there], at[:, :, None], axis=1)[:, :, :m],
    )
    shares[:, :m, :m] = size > 0.5 * size.max(axis=2, keepdims=True) if m > 1 else 1.0
    return shares
