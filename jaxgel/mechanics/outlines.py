"""Deformed outlines of the holes: surface arcs, and closed loops around hole areas.

A hole that the plate's edge cuts is closed along the deformed edge, which is straight between the
ends of the outline and the corners of the plate inside the hole. Such a corner is no material
point. If an edge prescribes a component of the displacement the corner follows that edge; other
components are extrapolated from both ends of the outline with the deformation gradients there,
weighted with the inverse of the dry distance. So a loop is exact along held edges and in every
affine motion, and continuous where a corner enters a hole.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
import shapely

from .._memo import once_per_owner
from .._sizes import rung
from .._types import Array, Bool, Float, Int
from ..cloud import Topology
from ..discretisation import Body, Interpolation, Model
from ..geometry import edge_lines, held_components

WALL_CROSSING = 1e-9  # of a wall's length: distance beyond it at which an outline crosses it


@dataclasses.dataclass(frozen=True)
class _Arc:
    """An arc of a hole's outline and the plate corners between its end and start, anticlockwise."""

    points: slice
    """Its points among those of ``model.outline``."""
    closed: bool
    """Whether it is a whole hole."""
    corners: Float[Array, "j 2"]
    """Dry corners of the plate inside the hole, mm."""
    edges: list[dict[int, str]]
    """Per corner: displacement component -> edge of the plate that prescribes it."""


class Corners(NamedTuple):
    """Corners of the plate inside holes, and what their deformed positions follow from.

    Index letters: ``j`` corner, ``e`` end of its arc, ``i`` component.
    """

    dry: Float[Array, "j 2"]
    """Dry positions, mm."""
    ends: Int[Array, "j e"]
    """First and last point of the arc, by their numbers in ``model.outline``."""
    edges: Int[Array, "j i 2"]
    """First and last node of the edge of the plate that prescribes a component."""
    along: Int[Array, "j i"]
    """Axis along that edge."""
    prescribed: Bool[Array, "j i"]
    """Whether there is such an edge."""


class Loops(NamedTuple):
    """Closed loops around what the holes take of the plate, as programs take them.

    Padding has no length and no hole.
    """

    corners: Corners
    """Corners of the plate on loops."""
    sides: Int[Array, "3 s"]
    """First and last point of each side, by their numbers in `loop_points`, and its hole."""
    arcs: Int[Array, "3 m"]
    """Those along the surfaces of the holes."""
    holes: Int[Array, " h"]
    """Numbers of the holes, with room for more."""

    def over_holes(
        self, values: Float[Array, "s ..."], holes: Int[Array, " s"]
    ) -> Float[Array, "h ..."]:
        """Sums of values over the ``holes`` to which they belong."""
        return jax.ops.segment_sum(values, holes, len(self.holes))


def loop_points(x: Float[Array, "n 2"], model: Body, corners: Corners) -> Float[Array, "_ 2"]:
    """Positions, mm, of outline points, then ``corners`` of the plate, at nodal ``x`` (n, 2)."""
    points = model.outline.position(x)
    return (
        jnp.concatenate([points, _deformed_corners(x, points, model, corners)])
        if len(corners.dry)
        else points
    )


def loops_of(model: Model) -> tuple[Loops, list[Int[Array, " m"]]]:
    """The ``Loops`` of a model for its shared body, and the `loop_points` of each loop.

    There is a loop for each hole, in their order; one for each part of a hole that the plate's edge
    cuts into several, see `holes_of_loops`.
    """
    return _loops(model.lists.topology, len(model.shared.outline.points))


@once_per_owner
def _loops(topology: Topology, first_corner: int) -> tuple[Loops, list[Int[Array, " m"]]]:
    found, sides, of_arcs, of_holes = (
        [],
        [np.zeros((3, 0), int)],
        [np.zeros((3, 0), int)],
        holes_of_loops(topology),
    )
    arcs, holes = _arcs(topology), rung(len(topology.plate.holes))
    for arc, hole in zip(arcs, of_holes, strict=True):
        numbers = np.arange(arc.points.start, arc.points.stop)
        loop = np.concatenate([numbers, first_corner + np.arange(len(arc.corners))])
        first_corner += len(arc.corners)
        found.append(loop)
        sides.append(np.stack([loop, np.roll(loop, -1), np.full(len(loop), hole)]))
        of_arcs.append(
            sides[-1]
            if arc.closed
            else np.stack([numbers[:-1], numbers[1:], np.full(len(numbers) - 1, hole)])
        )

    def with_room(parts):
        values = np.concatenate(parts, axis=1)
        count = values.shape[1]
        return np.append(values, np.tile([[0], [0], [holes]], rung(count) - count), axis=1)

    return Loops(
        _corners(topology, arcs), with_room(sides), with_room(of_arcs), np.arange(holes)
    ), found


def _corners(topology, arcs):
    """The ``Corners`` of all arcs."""
    lines = edge_lines(topology.plate)
    corners = [
        (arc, corner, edges)
        for arc in arcs
        for corner, edges in zip(arc.corners, arc.edges, strict=True)
    ]
    dry, ends = (
        np.array([corner for _, corner, _ in corners]),
        [(arc.points.start, arc.points.stop - 1) for arc, *_ in corners],
    )
    nodes, along = np.zeros((len(corners), 2, 2), int), np.zeros((len(corners), 2), int)
    prescribed = np.zeros((len(corners), 2), bool)
    for number, (_, _, edges) in enumerate(corners):
        for component, edge in edges.items():
            nodes[number, component] = topology.edge_nodes[edge][[0, -1]]
            along[number, component], prescribed[number, component] = 1 - lines[edge][0], True
    return Corners(dry.reshape(-1, 2), np.array(ends, int).reshape(-1, 2), nodes, along, prescribed)


def outline_arcs(x: Float[Array, "n 2"], model: Model) -> list[Float[Array, "m 2"]]:
    """Surfaces of the holes at nodal ``x`` (n, 2): lines (m, 2), mm, without plate edges; host.

    The line of a whole hole ends at its first point.
    """
    points = outline_points(x, model)
    lines = [(points[arc.points], arc.closed) for arc in _arcs(model.lists.topology)]
    return [np.concatenate([line, line[:1]]) if closed else line for line, closed in lines]


def outline_points(x: Float[Array, "n 2"], model: Model) -> Float[np.ndarray, "p 2"]:
    """Positions (p, 2) of the points of all outlines, mm, at nodal positions ``x`` (n, 2); host."""
    return outline_rows(model.outline, model.n_nodes) @ np.asarray(x)


@once_per_owner
def outline_rows(outline: Interpolation, n: int) -> sp.csr_array:
    """Matrix (p, n) of the shape functions at the outline points."""
    nodes, phi = np.asarray(outline.nodes), np.asarray(outline.phi)
    numbers = np.broadcast_to(np.arange(len(nodes))[:, None], nodes.shape)
    return sp.csr_array((phi.ravel(), (numbers.ravel(), nodes.ravel())), shape=(len(nodes), n))


def holes_of_loops(topology: Topology) -> Int[Array, " l"]:
    """Number of the hole (l,) of each loop of `loops_of`."""
    return np.array([outline.arc.hole for outline in topology.outlines], dtype=int)


@once_per_owner
def _arcs(topology: Topology) -> list[_Arc]:
    stops = np.cumsum([0] + [len(o.s) for o in topology.outlines])
    return [
        _Arc(slice(int(first), int(last)), o.closed, *_corners_inside(topology, o))
        for o, first, last in zip(topology.outlines, stops, stops[1:], strict=False)
    ]


def _corners_inside(topology, outline):
    """The ``corners`` and ``edges`` of an `_Arc`.

    The gel is connected, so that the edge from its end to its start closes each arc.
    """
    plate = topology.plate
    if outline.closed:
        return np.zeros((0, 2)), []
    w, h = plate.width / 2, plate.height / 2
    # each edge and the corner after it
    corners, edges = (
        np.array([(w, -h), (w, h), (-w, h), (-w, -h)]),
        ("bottom", "right", "top", "left"),
    )

    def turns(edge, vertex):
        """Way to a point of an edge anticlockwise round the plate, 1 for each edge."""
        number, (x, y) = edges.index(edge), topology.partition.vertices[vertex]
        return (
            number
            + 0.5
            + {"bottom": x / w, "right": y / h, "top": -x / w, "left": -y / h}[edge] / 2
        )

    end, start = (
        turns(outline.arc.end_edge, outline.vertices[-1]),
        turns(outline.arc.start_edge, outline.vertices[0]),
    )
    # numbers of the edges after the corners
    passed = np.arange(np.ceil(end), np.ceil(start if start > end else start + 4)).astype(int)
    around = [(edges[(k - 1) % 4], edges[k % 4]) for k in passed]
    prescribed = [
        {
            component: edge
            for edge in pair
            if len(topology.edge_nodes[edge]) > 1
            for component in held_components(plate.edges, edge)
        }
        for pair in around
    ]
    return corners[(passed - 1) % 4], prescribed


def _deformed_corners(
    x: Float[Array, "n 2"], points: Float[Array, "p 2"], model: Body, corners: Corners
) -> Float[Array, "j 2"]:
    """Deformed plate corners (j, 2) inside holes, mm, from the deformed outline ``points``."""
    away = corners.dry[:, None] - model.outline.points[corners.ends]
    distance = jnp.sqrt(jnp.sum(away**2, axis=2))
    weight = distance[:, ::-1] / jnp.sum(distance, axis=1, keepdims=True)
    F = model.outline.deformation_gradient(x)[corners.ends]
    free = jnp.einsum(
        "je,jei->ji", weight, points[corners.ends] + jnp.einsum("jeik,jek->jei", F, away)
    )
    (first, last), component = np.moveaxis(corners.edges, 2, 0), np.arange(2)
    before, after = model.nodes[first, corners.along], model.nodes[last, corners.along]
    span = jnp.where(corners.prescribed, after - before, 1.0)
    share = (jnp.take_along_axis(corners.dry, corners.along, axis=1) - before) / span
    on_edges = x[first, component] + (x[last, component] - x[first, component]) * share
    return jnp.where(corners.prescribed, on_edges, free)


def walls(x: Float[Array, "n 2"], topology: Topology) -> Float[Array, "e 2 2"]:
    """Ends (e, 2, 2), mm, of the edges that are held, at nodal positions ``x`` (n, 2).

    The plate lies to the left of each.
    """
    nodes, ends = topology.partition.vertices[topology.node_vertices], []
    for edge, (axis, coordinate) in edge_lines(topology.plate).items():
        wall = topology.edge_nodes[edge]
        if held_components(topology.plate.edges, edge) and len(wall) > 1:
            along = np.argsort(nodes[wall, 1 - axis])[[0, -1]]
            ends.append(wall[along if (coordinate > 0) == (axis == 0) else along[::-1]])
    return x[np.array(ends, dtype=int).reshape(-1, 2)]


def crosses(arcs: list[np.ndarray], held: Float[Array, "e 2 2"]) -> bool:
    """Whether a hole's deformed outline crosses itself, another one or a wall; host.

    Outlines are `outline_arcs` (m, 2), walls `walls`.
    """
    lines = [shapely.LineString(arc) for arc in arcs]
    if not all(line.is_simple for line in lines):
        return True
    for start, end in np.asarray(held):
        (dx, dy), length = end - start, np.linalg.norm(end - start)
        if any(np.max((arc - start) @ [dy, -dx]) > WALL_CROSSING * length**2 for arc in arcs):
            return True
    if len(lines) < 2:
        return False
    first, second = shapely.STRtree(lines).query(lines, predicate="intersects")
    return bool(np.any(first != second))


def overlaps(x: Float[Array, "n 2"], model: Model) -> bool:
    """Whether a hole's outline crosses itself, another one or an edge of the plate."""
    return crosses(outline_arcs(x, model), np.asarray(walls(x, model.lists.topology)))
