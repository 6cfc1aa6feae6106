"""Derivatives by the arrays of a model, from those of one patch of each orbit.

What a symmetric state and a symmetric adjoint field say of one patch they say of its images too: points, nodes and contour edges change
places, gradients turn. So the derivative of the whole plate's work, by any array of any patch, follows from that of the region's patches,
whether or not what the arrays depend on has the symmetries. By the rows of shape functions it follows up to a constant for all nodes of a
patch, which no shape functions see, whose gradients add up to 0.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from .._memo import once_per_owner
from .._types import Array, Float, Int
from ..discretisation import Connectivity, Model, PatchBlock
from .groups import IDENTITY, images
from .regions import counted, group_shares, own_groups, patch_images, representatives

FAR = 10.0  # plate widths: distance of the contours of different patches where their edges are looked up


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["rows", "sizes", "there", "matrix", "points", "nodes", "edges", "shares"],
    meta_fields=[],
)
@dataclasses.dataclass(frozen=True)
class BlockOrbits:
    """The patches of a block as images of those that the region has; places past the end for padding."""

    rows: Int[Array, " r"]
    """The patches that the region has."""
    sizes: Float[Array, " r"]
    """The sizes of their orbits."""
    there: Int[Array, " c"]
    """Number among the region's patches of the one to which each patch is taken."""
    matrix: Float[Array, "c 2 2"]
    """Matrix of the symmetry that takes it there."""
    points: Int[Array, "c q"]
    """Place there of each quadrature point."""
    nodes: Int[Array, "c a"]
    """Place there of each node."""
    edges: Int[Array, "c e"] | None
    """Place there of each contour edge; None where volumes are those of the points."""
    shares: Float[Array, "c g g"] | None
    """Shares of the volume groups there that each group has, see `regions.group_shares`; None before they are known."""

    def part(self, block: PatchBlock) -> PatchBlock:
        """The block of the region's patches."""
        return counted(jax.tree.map(lambda values: values[self.rows], block), self.sizes)

    def spread(self, found: PatchBlock) -> PatchBlock:
        """Derivatives by the arrays of all patches, from those ``found`` by the arrays of `part`; 0 by positions."""

        def at(values, *places):
            count, there = len(places) + 1, [self.there, *places]
            index = [place.reshape(len(place), *(-1 if k == axis else 1 for k in range(1, count))) for axis, place in enumerate(there)]
            return values.at[tuple(index)].get(mode="fill", fill_value=0.0)

        def each(values):  # a sum over the orbit counts each of its patches
            return values / self.sizes.reshape(-1, *(1,) * (values.ndim - 1))

        group_weight = contour = None
        if found.group_weight is not None:
            group_weight = jnp.einsum("cij,cqj->cqi", self.shares, at(each(found.group_weight), self.points))
        if found.contour is not None:  # a mirror turns the edges round, which reverses the first of their two rows
            first, second = at(found.contour[:, 0], self.edges, self.nodes), at(each(found.contour[:, 1]), self.edges, self.nodes)
            contour = jnp.stack([jnp.linalg.det(self.matrix)[:, None, None] * first, second], axis=1)
        return dataclasses.replace(
            found,
            patches=self.there,
            nodes=self.nodes,
            position=jnp.zeros((*self.points.shape, 2)),
            dphi=jnp.einsum("cqai,cij->cqaj", at(each(found.dphi), self.points, self.nodes), self.matrix),
            weight=at(found.weight, self.points),
            group_weight=group_weight,
            contour=contour,
        )


@functools.partial(jax.tree_util.register_dataclass, data_fields=["blocks", "groups", "images", "matrices"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Orbits:
    """All patches of a model as images of those of a region."""

    blocks: tuple[BlockOrbits, ...]
    """Those of each block."""
    groups: Int[Array, " r"]
    """The volume groups of the region's patches."""
    images: Int[Array, "s n"]
    """The node to which each symmetry of the group takes each node, the identity included."""
    matrices: Float[Array, "s 2 2"]
    """The matrices of the symmetries."""

    def part(self, model: Model) -> Model:
        """The model of the region's patches alone, with all nodes."""
        return dataclasses.replace(model, blocks=tuple(own.part(block) for own, block in zip(self.blocks, model.blocks, strict=True)))

    def spread(self, found: Model) -> Model:
        """Derivatives by the arrays of the model, from those ``found`` by the arrays of `part`."""
        return dataclasses.replace(found, blocks=tuple(own.spread(block) for own, block in zip(self.blocks, found.blocks, strict=True)))

    def symmetrised(self, forces: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """Nodal forces (n, 2) of the whole plate from those of the region's patches."""
        return jnp.einsum("sni,sij->nj", forces[self.images], self.matrices) / len(self.images)


def orbits(model: Model, group: tuple[str, ...]) -> Orbits:
    """`Orbits` of a ``model`` under a ``group`` that its arrays have."""
    known, shares = _orbits(model.lists, group), group_shares(model, group)
    chosen = representatives(model.lists, group)[0]
    blocks = tuple(dataclasses.replace(own, shares=some) for own, some in zip(known.blocks, shares, strict=True))
    return dataclasses.replace(known, blocks=blocks, groups=own_groups(model.blocks, chosen))


@once_per_owner
def _orbits(lists: Connectivity, group: tuple[str, ...]) -> Orbits:
    """`Orbits` without what depends on a model's arrays."""
    found = images(lists)
    n = len(lists.topology.node_vertices)
    elements = {IDENTITY: (np.arange(n), np.eye(2)), **{name: (found[name].nodes, found[name].matrix) for name in group}}
    moves = [(np.arange(len(lists.cell_of_point)) if name == IDENTITY else found[name].points) for name in elements]
    nodes, matrices = (np.stack(parts) for parts in zip(*elements.values(), strict=True))
    rows, sizes = representatives(lists, group)
    by, to = patch_images(lists, group)
    blocks = []
    for number, (own, size) in enumerate(zip(rows, sizes, strict=True)):
        patches = lists.patches[number]
        place = np.full(len(lists.linear), -1)
        place[patches[own]] = np.arange(len(own))
        there = place[to[patches]]
        points = _places(np.stack(moves)[by[patches][:, None], lists.points[number]], lists.points[number], own, there)
        some = np.where(lists.support[patches] > 0, lists.nodes[patches], -1)
        some = some[:, : int((some >= 0).sum(axis=1).max())]
        listed = _places(nodes[by[patches][:, None], some], some, own, there)
        edges = _edge_places(lists, number, own, there, matrices[by[patches]]) if lists.contour.middles is not None else None
        blocks.append(BlockOrbits(own, size, there, matrices[by[patches]], points, listed, edges, None))
    return Orbits(tuple(blocks), np.zeros(0, int), nodes, matrices)


def _places(images, numbers, own, there):
    """Where the ``images`` (c, k) of the ``numbers`` (c, k), -1 for padding, are in the rows ``own`` (r,) of these, of number ``there``."""
    count = max(int(images.max()), int(numbers.max())) + 2
    r, k = np.nonzero(numbers[own] >= 0)
    keys = r * count + numbers[own][r, k]
    order = np.argsort(keys)
    wanted = there[:, None] * count + images
    found = order[np.minimum(np.searchsorted(keys, wanted, sorter=order), len(order) - 1)]
    return np.where((numbers >= 0) & (keys[found] == wanted), k[found], numbers.shape[1])


def _edge_places(lists, number, own, there, matrices):
    """The same for contour edges (c, e), by their middles on the reference."""
    topology, numbers = lists.topology, lists.contour.numbers[number]
    width = FAR * max(topology.plate.width, topology.plate.height)
    middles = np.asarray(lists.contour.points(topology.partition.vertices)).reshape(-1, 2, 2)[:, 1][numbers]
    r, k = np.nonzero(numbers[own] >= 0)
    tree = cKDTree(np.concatenate([middles[own][r, k], width * r[:, None]], axis=1))
    moved = np.einsum("cij,cej->cei", matrices, middles)
    away = np.broadcast_to(width * there[:, None, None], (*numbers.shape, 1))
    found = tree.query(np.concatenate([moved, away], axis=2))[1]
    return np.where(numbers >= 0, k[found], numbers.shape[1])
