"""Wetted parts of the boundary, and the chemical potential as a field between them.

It is interpolated like the pressures, and prescribed at wetted nodes. On a patch with a linear
pressure mu = m_0 + m_1 psi_1 + m_2 psi_2, see ``discretisation.pressures``, on others it is a
constant m_0. These m are the unknowns; they are kept as an array of the volume groups (g,), those
of a patch in its first groups, 0 in the others. What a volume group has of them is exact, and a
combination of values that moves no solvent does not exist.

Gradients of mu are those of interpolating moving least squares with a linear basis through
*places*: the volume groups that carry volume, and the wetted nodes. Places are numbered so, the
wetted nodes after all groups. A constant vector in every cell makes the gradients those whose mean
is the contour integral of the shape functions. Along wetted outlines and free edges these are
linear between the nodes: left to the groups nearby, the trace between them is not the bath's, and
an outline conducts a fifth less at any spacing. Index letters as in ``discretisation``, ``b`` place
of a patch's list, ``w`` wetted node, ``e`` volume group with a wetted side.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from .._compiled import compiled
from .._memo import once_per_owner
from .._sizes import joined, resized, room, step, taken
from .._tracing import is_traced
from .._types import Array, Bool, Float, Int
from .._validation import Inadmissible
from ..cloud import OUTLINE_SEGMENTS, opposite_edges
from ..discretisation import (
    NONE,
    SIGNS,
    Body,
    Connectivity,
    Model,
    consistent_gradients,
    pad_nodes,
    pairs_in_reach,
    plate_edge_ends,
)
from ..geometry import edge_lines
from .local_gel import group_positions, reference_groups

ROOM = 128  # times a power of 2 there is room for wetted nodes and for groups with wetted sides
PLACE_SUPPORT = 2.4  # radius of a place's weight function over the spacing of the nodes around it
FEWEST_PLACES = 4  # places that must reach a point: one more than a linear basis has monomials
WIDTHS = (24, 32, 48, 64, 96, 128)  # room for places of a patch
ON_LINE = 1e-9  # of the spacing: distance from an edge of the plate of what lies on it
MOMENTS = np.insert(SIGNS, 0, 1.0, axis=1)  # m to the mu of a linear patch's groups


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class SolventBlock:
    """The chemical potential on the patches of a block; a pytree."""

    places: Int[Array, "c b"]
    """Numbers of the places on which mu in a patch depends; padding has gradients 0."""
    dpsi: Float[Array, "c q b 2"]
    """Gradients of their shape functions at the quadrature points, 1/mm."""
    part: Int[Array, " c"]
    """The wetted part of the boundary nearest each patch."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Wetting:
    """What of the gel is wetted; a pytree.

    Parts of the boundary have numbers, each has its own bath.
    """

    node_parts: Int[Array, " w"]
    """Part of each wetted node."""
    groups: Int[Array, " e"]
    """The volume groups with wetted sides; one that no model has for padding."""
    group_parts: Int[Array, " e"]
    """Part of the longest wetted side of each."""
    linear: Bool[Array, " e"]
    """Whether the pressure of their patch is linear."""
    length: Float[Array, " e"]
    """Dry length of the wetted sides of each, mm; 0 for padding."""
    directions: Float[Array, "e 2 2"]
    """Mean of t t^T over them with their unit tangents t."""
    depth: Float[Array, " e"]
    """Mean distance of the group from them, mm."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Solvent:
    """The chemical potential on a model; a pytree."""

    blocks: tuple[SolventBlock, ...]
    """Of each block of patches."""
    wetting: Wetting
    """What is wetted."""

    def shared(self, body: Body, own: Body) -> "Solvent":
        """The same in the sizes of the ``shared`` body of its ``own`` one."""
        first, last, wet = len(own.carries), len(body.carries), self.wetting

        def padded(block, patches):
            c, b = len(patches.nodes), step(block.places.shape[1], WIDTHS)
            places = np.where(block.places < first, block.places, block.places - first + last)
            dpsi = resized(block.dpsi, (*block.dpsi.shape[:2], b, 2))
            dpsi = resized(dpsi, (c, patches.weight.shape[1], b, 2), edge=True)
            return SolventBlock(
                resized(places, (c, b), edge=True), dpsi, resized(block.part, (c,), edge=True)
            )

        groups = room(len(wet.groups), ROOM)
        numbers = np.full(groups, NONE)
        numbers[: len(wet.groups)] = wet.groups
        rest = (
            getattr(wet, name)
            for name in ("group_parts", "linear", "length", "directions", "depth")
        )
        rest = (resized(values, (groups, *values.shape[1:])) for values in rest)
        wetting = Wetting(
            resized(wet.node_parts, (room(len(wet.node_parts), ROOM),)), numbers, *rest
        )
        return Solvent(tuple(map(padded, self.blocks, body.blocks)), wetting)


def wetted_parts(lists: Connectivity) -> dict[str | int, Int[np.ndarray, " _"]]:
    """Wettable part of the boundary: number of a hole or name of a free edge, and its nodes."""
    return _boundary(lists)[0]


@once_per_owner
def _boundary(lists):
    """`wetted_parts`, and contour edges (k,) along them with the part of each.

    A number in their order.
    """
    topology = lists.topology
    number = np.full(len(topology.partition.vertices), -1)
    number[topology.node_vertices] = np.arange(len(topology.node_vertices))
    found = {}
    for outline in topology.outlines:
        found.setdefault(outline.arc.hole, []).append(number[outline.nodes])
    for edge, condition in topology.plate.edges.items():
        if condition == "free":
            found[edge] = [topology.edge_nodes[edge]]
    parts = {part: np.unique(np.concatenate(nodes)) for part, nodes in found.items()}
    contour, vertices = lists.contour, topology.partition.vertices
    rim = np.flatnonzero(opposite_edges(contour.ends) < 0)
    owner = np.full(len(rim), -1)
    for edge, (axis, coordinate) in edge_lines(topology.plate).items():
        on = (
            np.abs(vertices[contour.ends[rim]][:, :, axis] - coordinate)
            < ON_LINE * topology.spacing
        ).all(axis=1)
        owner[on] = list(parts).index(edge) if edge in parts else -2
    if topology.outlines:
        points = np.concatenate([outline.points for outline in topology.outlines])
        holes = np.concatenate(
            [np.full(len(o.points), list(parts).index(o.arc.hole)) for o in topology.outlines]
        )
        middles = vertices[contour.ends[rim]].mean(axis=1)
        owner = np.where(owner == -1, holes[cKDTree(points).query(middles)[1]], owner)
    return parts, rim[owner >= 0], owner[owner >= 0]


def solvent_of(model: Model, wetted: tuple[str | int, ...]) -> Solvent:
    """`Solvent` of a model whose boundary is ``wetted`` in these parts, see `wetted_parts`.

    Their places in it number the parts. ValueError if one of the parts has one node alone, or the
    cloud is too coarse for gradients.
    """
    lists, cloud = model.lists, model.cloud
    nodes, parts = wetted_nodes(lists, wetted)
    groups = group_positions(model.blocks)
    places = joined([groups, taken(cloud.nodes, nodes)])
    of_patches, edge_ends = places_of(lists, wetted)
    gradients = consistent_gradients(cloud, lists, places, of_patches, edge_ends)
    nearest = cKDTree(lists.topology.nodes[nodes]).query(
        reference_groups(lists)[0][reference_groups(lists)[1]]
    )[1]
    own = zip(lists.patches, gradients, strict=True)
    blocks = tuple(
        SolventBlock(of_patches[0][patches], dpsi, parts[nearest[patches]]) for patches, dpsi in own
    )
    edges, owner, wet_groups, linear, group_parts = _wetted_sides(lists, wetted)
    ends = taken(cloud.vertices, lists.contour.ends[edges])
    measured = _compiled_measured if is_traced(ends, groups) else _measured
    sides = measured(ends, taken(groups, wet_groups[owner]), owner, len(wet_groups))
    return Solvent(blocks, Wetting(parts, wet_groups, group_parts, linear, *sides))


def _measured(ends, groups, owner, count):
    """Length (e,), directions (e, 2, 2) and depth (e,) of ``Wetting`` from sides (k, 2, 2).

    These belong to their ``owner``.
    """
    along, away = ends[:, 1] - ends[:, 0], groups - (ends[:, 0] + ends[:, 1]) / 2
    xp = jnp if is_traced(along, away) else np
    length = xp.linalg.norm(along, axis=1)
    # times the length; the gel is on the left
    inward = along[:, 0] * away[:, 1] - along[:, 1] * away[:, 0]
    parts = xp.concatenate(
        [
            length[:, None],
            (along[:, :, None] * along[:, None]).reshape(-1, 4) / length[:, None],
            inward[:, None],
        ],
        axis=1,
    )
    total = np.zeros((count, 6))
    if xp is np:
        np.add.at(total, owner, parts)
    else:
        total = jnp.asarray(total).at[owner].add(parts)
    return total[:, 0], (total[:, 1:5] / total[:, :1]).reshape(-1, 2, 2), total[:, 5] / total[:, 0]


_compiled_measured = compiled(static=("count",))(_measured)


@once_per_owner
def wetted_nodes(
    lists: Connectivity, wetted: tuple[str | int, ...]
) -> tuple[Int[np.ndarray, " w"], Int[np.ndarray, " w"]]:
    """Ascending numbers (w,) of the wetted nodes, and the part of each, the first of two."""
    all_parts = wetted_parts(lists)
    found = {}
    for number, part in enumerate(wetted):
        if len(all_parts[part]) < 2:
            raise ValueError(
                f"bath: {part!r} has one node alone, what is wetted needs two at least; use a "
                "smaller spacing"
            )
        for node in all_parts[part].tolist():
            found.setdefault(node, number)
    nodes = np.array(sorted(found), dtype=int)
    return nodes, np.array([found[node] for node in nodes.tolist()], dtype=int)


@once_per_owner
def places_of(
    lists: Connectivity, wetted: tuple[str | int, ...]
) -> tuple[tuple[Int[np.ndarray, "c b"], Float[np.ndarray, "c b"]], Int[np.ndarray, "e 2"]]:
    """Lists (patches, b) of places and supports, and the two places along wetted boundary.

    These are, for each contour edge along wetted boundary, the places between which the trace is
    linear, as positions in the lists; -1 for others.
    """
    topology = lists.topology
    nodes, _ = wetted_nodes(lists, wetted)
    groups, first = reference_groups(lists)
    carries = np.zeros(len(groups), dtype=bool)
    carries[_carrying_of(first, lists.linear)] = True
    places = np.concatenate([groups, topology.nodes[nodes]])
    spacing = topology.node_spacing[cKDTree(topology.nodes).query(places)[1]]
    support = np.where(
        np.concatenate([carries, np.ones(len(nodes), bool)]), PLACE_SUPPORT * spacing, 0.0
    )
    part, contour = topology.partition, lists.contour
    points = np.concatenate(
        [topology.quadrature.points(part.vertices), contour.points(part.vertices).reshape(-1, 2)]
    )
    owner = np.concatenate([lists.owner, np.repeat(contour.owner, 2)])
    pairs = pairs_in_reach(points, places, support)
    few = np.bincount(pairs["i"], minlength=len(points)) < FEWEST_PLACES
    if few.any():
        x, y = points[np.argmax(few)]
        raise Inadmissible(
            f"spacing: the cloud is too coarse for the gradient of mu at ({x:.4g}, {y:.4g}); use "
            "a smaller spacing"
        )
    number = np.full(len(topology.node_vertices) + 1, -1)  # the last one stands for none
    number[nodes] = np.arange(len(nodes))
    ends = number[_ends_along(lists)]
    ends[(ends < 0).any(axis=1)] = -1
    at = np.flatnonzero(ends[:, 0] >= 0)
    also = np.repeat(contour.owner[at], 2), len(groups) + ends[at].ravel()
    key = np.unique(
        np.concatenate(
            [owner[pairs["i"]] * len(places) + pairs["j"], also[0] * len(places) + also[1]]
        )
    )
    listed, reach = pad_nodes(
        key % len(places), np.bincount(key // len(places), minlength=len(lists.linear)), support
    )
    edge_ends = np.full(contour.ends.shape, -1)
    for end in range(2):
        edge_ends[at, end] = (
            listed[contour.owner[at]] == (len(groups) + ends[at, end])[:, None]
        ).argmax(axis=1)
    return (listed, reach), edge_ends


def _ends_along(lists):
    """The two nodes around each contour edge (e, 2), on free edges of the plate and on outlines.

    -1 for others.
    """
    topology, contour = lists.topology, lists.contour
    ends = plate_edge_ends(topology, contour.ends, free=True)
    if topology.outlines:
        vertices = topology.partition.vertices
        number = np.full(len(vertices), -1)
        number[topology.node_vertices] = np.arange(len(topology.node_vertices))
        parts, edges, owner = _boundary(lists)
        edges = edges[np.isin(owner, [k for k, part in enumerate(parts) if isinstance(part, int)])]
        middles, around = [], []
        for outline in topology.outlines:
            nodes = number[outline.nodes]
            nodes = np.append(nodes, nodes[:1]) if outline.closed else nodes
            middles.append((outline.line[1:] + outline.line[:-1]) / 2)
            around.append(
                np.repeat(np.stack([nodes[:-1], nodes[1:]], axis=1), OUTLINE_SEGMENTS, axis=0)
            )
        nearest = cKDTree(np.concatenate(middles)).query(vertices[contour.ends[edges]].mean(axis=1))
        ends[edges] = np.concatenate(around)[nearest[1]]
    return ends


def wetted_groups(lists: Connectivity, wetted: tuple[str | int, ...]) -> Int[np.ndarray, " e"]:
    """Numbers of the volume groups with sides in these ``wetted`` parts."""
    return _wetted_sides(lists, wetted)[2]


@once_per_owner
def _wetted_sides(lists, wetted):
    """Wetted contour edges (k,), their groups, these (e,), linear pressures, and parts.

    The place of the group of each in the list of groups with wetted sides, that list (e,), whether
    each has a linear pressure, and its part. The group is the one nearest the point half a spacing
    below the edge: behind a cell that is thinner it is the next one.
    """
    topology, contour = lists.topology, lists.contour
    names, (_, edges, owner) = list(wetted_parts(lists)), _boundary(lists)
    number = np.array([wetted.index(name) if name in wetted else -1 for name in names], dtype=int)[
        owner
    ]
    edges, part = edges[number >= 0], number[number >= 0]
    groups, first = reference_groups(lists)
    carrying = _carrying_of(first, lists.linear)
    first_end, last_end = (
        topology.partition.vertices[contour.ends[edges, end]] for end in range(2)
    )
    length, middle = np.linalg.norm(last_end - first_end, axis=1), (first_end + last_end) / 2
    inward = (last_end - first_end)[:, ::-1] * [-1.0, 1.0] / length[:, None]
    spacing = topology.node_spacing[cKDTree(topology.nodes).query(middle)[1]]
    group = carrying[cKDTree(groups[carrying]).query(middle + inward * spacing[:, None] / 2)[1]]
    wet_groups, place = np.unique(group, return_inverse=True)
    shares = np.zeros((len(wet_groups), len(wetted)))
    np.add.at(shares, (place, part), length)
    linear = np.isin(
        wet_groups, _carrying_of(first[lists.linear], np.ones(int(lists.linear.sum()), dtype=bool))
    )
    return edges, place, wet_groups, linear, shares.argmax(axis=1)


def carrying_groups(lists: Connectivity) -> Int[np.ndarray, " _"]:
    """Numbers of the volume groups that carry volume."""
    return _carrying_of(reference_groups(lists)[1], lists.linear)


def _carrying_of(first, linear):
    """The groups that carry volume, of patches with these ``first`` groups."""
    return np.unique(first[:, None] + np.arange(len(MOMENTS)) * linear[:, None])
