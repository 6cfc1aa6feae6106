"""Voids of contact: holes, and the outside of free edges; host NumPy.

Contact keeps their surfaces from crossing themselves.
"""

import dataclasses
import itertools

import numpy as np

from .._memo import once_per_owner
from .._sizes import joined
from .._types import Array, Float, Int
from .._validation import Inadmissible
from ..cloud import OUTLINE_SEGMENTS, Topology
from ..geometry import EDGES, FRAME_EDGES, edge_lines, inside_holes

# at the ends
NEXT = {
    "bottom": ("left", "right"),
    "top": ("left", "right"),
    "left": ("bottom", "top"),
    "right": ("bottom", "top"),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Line:
    """A piece of surface."""

    numbers: Int[np.ndarray, " m"]
    """Its points, by their numbers in `contact.surface_points`."""
    points: Float[np.ndarray, "m 2"]
    """Their places on the reference plate, mm."""
    closed: bool
    """Whether the last one is joined to the first."""
    void: int
    """The void that it bounds."""


@dataclasses.dataclass(frozen=True, eq=False)
class Image:
    """How the surfaces of some voids appear to themselves, see `contact.ContactPairs`."""

    voids: Int[np.ndarray, " v"]
    """Their numbers."""
    sign: Float[np.ndarray, " 2"]
    """Of the components."""
    anchors: Int[np.ndarray, " 2"]
    """Nodes on the plate's edges."""
    coefficient: Float[np.ndarray, "2 2"]
    """Of the anchors' positions, for each anchor and component."""
    twice: bool
    """Whether it has every pair twice, with its points exchanged."""


def lines_of_voids(topology: Topology) -> tuple[list[Line], tuple[Image, ...]]:
    """The `Line`s of all surfaces, and the `Image`s, the identity first."""
    # meets: void -> the edges on which its surface ends
    plate, lines, meets, first = topology.plate, [], {}, 0
    of_arcs = {
        edge
        for outline in topology.outlines
        for edge in (outline.arc.start_edge, outline.arc.end_edge)
    }
    free = [edge for edge in EDGES if plate.edges[edge] == "free"]
    void = {edge: len(plate.holes) + k for k, edge in enumerate(free)}
    for edge, other in itertools.permutations(free, 2):
        if other in NEXT[edge]:
            void = {
                one: void[edge] if number == void[other] else number for one, number in void.items()
            }
    of_hole = list(range(len(plate.holes)))
    for outline in topology.outlines:
        ends = {outline.arc.start_edge, outline.arc.end_edge} - {None}
        joined = [void[edge] for edge in sorted(ends) if edge in void]
        of_hole[outline.arc.hole] = min(
            [of_hole[outline.arc.hole], *joined],
            key=lambda number: (number < len(plate.holes), number),
        )
        void = {
            one: of_hole[outline.arc.hole] if number in joined else number
            for one, number in void.items()
        }
    for outline in topology.outlines:
        number = of_hole[outline.arc.hole]
        lines.append(
            Line(first + np.arange(len(outline.s)), outline.points, outline.closed, number)
        )
        meets.setdefault(number, set()).update(
            {outline.arc.start_edge, outline.arc.end_edge} - {None}
        )
        first += len(outline.s)
    edge_points, first = free_edge_points(topology), 0
    for edge, (ends, fraction) in edge_points.pieces:
        start, end = topology.nodes[ends.T]
        numbers = first + np.arange(len(ends)) - edge_points.count
        lines.append(Line(numbers, start + fraction[:, None] * (end - start), False, void[edge]))
        meets.setdefault(void[edge], set()).update(NEXT[edge])
        first += len(ends)
    return lines, _images(topology, meets, of_arcs)


@dataclasses.dataclass(frozen=True, eq=False)
class EdgePoints:
    """Points on the free edges of a plate, at nodes and between them."""

    pieces: list
    """For each piece of an edge between open holes the edge, nodes (m, 2) and places (m,)."""

    @property
    def count(self) -> int:
        """Number of all points."""
        return sum(len(ends) for _, (ends, _) in self.pieces)

    def on(self, nodes: Float[Array, "n 2"]) -> Float[Array, "e 2"]:
        """All points (e, 2) for nodes (n, 2) of the dry plate."""
        parts = [
            nodes[ends[:, 0]] + fraction[:, None] * (nodes[ends[:, 1]] - nodes[ends[:, 0]])
            for _, (ends, fraction) in self.pieces
        ]
        return joined(parts)


@once_per_owner
def free_edge_points(topology: Topology) -> EdgePoints:
    """The `EdgePoints` of a plate."""
    found = []
    for edge in (edge for edge in EDGES if topology.plate.edges[edge] == "free"):
        nodes = topology.edge_nodes[edge]
        places = topology.nodes[nodes]
        taken = inside_holes(topology.plate, 0.5 * (places[1:] + places[:-1]), 0.0)
        for piece in np.split(nodes, np.flatnonzero(taken) + 1):
            if len(piece) > 1:
                place = np.arange((len(piece) - 1) * OUTLINE_SEGMENTS + 1) / OUTLINE_SEGMENTS
                first = np.minimum(place.astype(int), len(piece) - 2)
                found.append(
                    (edge, (np.stack([piece[first], piece[first + 1]], axis=1), place - first))
                )
    return EdgePoints(found)


def _images(topology, meets, of_arcs):
    """The `Image`s of voids at walls, corners and periodic edges.

    Walls are those on which their surfaces end; a corner has an image behind both.
    """
    plate, lines, found = topology.plate, edge_lines(topology.plate), {(None, None): list(meets)}
    for void, edges in meets.items():
        held = [edge for edge in sorted(edges) if plate.edges[edge] in ("roller", "fixed")]
        walls = [
            edge for edge in held if plate.deformation[lines[edge][0]][1 - lines[edge][0]] == 0
        ]
        for edge in held:
            if edge in of_arcs and edge not in walls:
                raise Inadmissible(
                    f"deformation: it turns the {edge} edge, to which a hole is open; contact "
                    "there must be 'off'"
                )
        by_axis = [[None, *(edge for edge in walls if lines[edge][0] == axis)] for axis in range(2)]
        for pair in itertools.product(*by_axis):
            if any(pair):
                found.setdefault(pair, []).append(void)
        for axis, (edge, _) in enumerate(FRAME_EDGES):
            if edge in edges and plate.edges[edge] == "periodic":
                found.setdefault(axis, []).append(void)
    return tuple(_image(topology, key, np.array(voids, int)) for key, voids in found.items())


def _image(topology, key, voids):
    sign, anchors, coefficient = np.ones(2), np.zeros(2, int), np.zeros((2, 2))
    if isinstance(key, int):  # the next cell
        anchors[:] = [topology.edge_nodes[edge][0] for edge in FRAME_EDGES[key]]
        coefficient[:] = [[-1.0], [1.0]]
        return Image(voids, sign, anchors, coefficient, False)
    for axis, edge in enumerate(key):
        if edge is not None:
            sign[axis], anchors[axis], coefficient[axis, axis] = (
                -1.0,
                topology.edge_nodes[edge][0],
                2.0,
            )
    return Image(voids, sign, anchors, coefficient, any(key))
