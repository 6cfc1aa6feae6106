"""Deformed outlines of the holes: arcs, which are surfaces of the gel, and closed loops around what the holes take of the plate.

A hole that the plate's edge cuts is closed along the deformed edge, which is straight between the ends of the outline and the corners of
the plate inside the hole. Such a corner is no material point. Where an edge prescribes a component of the displacement the corner
follows that edge; other components are extrapolated from both ends of the outline with the deformation gradients there, weighted with the
inverse of the dry distance. So a loop is exact along held edges and in every affine motion, and continuous where a corner enters a hole.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import shapely

from .._compiled import compiled
from .._memo import once_per_owner
from .._types import Array, Float, Int
from ..cloud import Topology
from ..discretisation import Model
from ..geometry import edge_lines, held_components

WALL_CROSSING = 1e-9  # of a wall's length: distance beyond it at which an outline crosses it


@dataclasses.dataclass(frozen=True)
class _Arc:
    """An arc of a hole's outline and the corners of the plate between its end and its start, anticlockwise."""

    points: slice
    """Its points among those of ``model.outline``."""
    closed: bool
    """Whether it is a whole hole."""
    corners: Float[np.ndarray, "j 2"]
    """Dry corners of the plate inside the hole, mm."""
    edges: list[dict[int, str]]
    """Per corner: component of the displacement -> edge of the plate through it that prescribes it."""


def outline_loops(x: Float[Array, "n 2"], model: Model) -> list[Array]:
    """Closed loops (m, 2), mm, of the holes at nodal positions ``x`` (n, 2), along the plate's edge where it cuts a hole.

    One for each hole, in their order; one for each part of a hole that the plate's edge cuts into several, see `holes_of_loops`.
    """
    points, loops = model.outline.position(x), []
    for arc in _arcs(model.lists.topology):
        loops.append(jnp.concatenate([points[arc.points], _deformed_corners(x, model, arc)]) if len(arc.corners) else points[arc.points])
    return loops


def outline_arcs(x: Float[Array, "n 2"], model: Model) -> list[Array]:
    """Surfaces of the holes at nodal positions ``x`` (n, 2): lines (m, 2), mm, without the plate's edge.

    The line of a whole hole ends at its first point.
    """
    points = model.outline.position(x)
    lines = [(points[arc.points], arc.closed) for arc in _arcs(model.lists.topology)]
    return [jnp.concatenate([line, line[:1]]) if closed else line for line, closed in lines]


def holes_of_loops(topology: Topology) -> Int[np.ndarray, " l"]:
    """Number of the hole (l,) of each loop of `outline_loops`."""
    return np.array([outline.arc.hole for outline in topology.outlines], dtype=int)


@once_per_owner
def _arcs(topology: Topology) -> list[_Arc]:
    stops = np.cumsum([0] + [len(o.s) for o in topology.outlines])
    return [
        _Arc(slice(int(first), int(last)), o.closed, *_corners_inside(topology, o))
        for o, first, last in zip(topology.outlines, stops, stops[1:], strict=False)
    ]


def _corners_inside(topology, outline):
    """The ``corners`` and ``edges`` of an `_Arc`. The gel is connected, so that the edge from its end to its start closes each arc."""
    plate = topology.plate
    if outline.closed:
        return np.zeros((0, 2)), []
    w, h = plate.width / 2, plate.height / 2
    corners, edges = np.array([(w, -h), (w, h), (-w, h), (-w, -h)]), ("bottom", "right", "top", "left")  # each edge and the corner after it

    def turns(edge, vertex):
        """Way to a point of an edge anticlockwise round the plate, 1 for each edge."""
        number, (x, y) = edges.index(edge), topology.partition.vertices[vertex]
        return number + 0.5 + {"bottom": x / w, "right": y / h, "top": -x / w, "left": -y / h}[edge] / 2

    end, start = turns(outline.arc.end_edge, outline.vertices[-1]), turns(outline.arc.start_edge, outline.vertices[0])
    passed = np.arange(np.ceil(end), np.ceil(start if start > end else start + 4)).astype(int)  # numbers of the edges after the corners
    around = [(edges[(k - 1) % 4], edges[k % 4]) for k in passed]
    prescribed = [
        {component: edge for edge in pair if len(topology.edge_nodes[edge]) > 1 for component in held_components(plate.edges, edge)}
        for pair in around
    ]
    return corners[(passed - 1) % 4], prescribed


def _deformed_corners(x: Float[Array, "n 2"], model: Model, arc: _Arc) -> Float[Array, "j 2"]:
    """Deformed positions (j, 2) of the corners of the plate inside a hole, mm."""
    ends = jax.tree.map(lambda part: part[np.array([arc.points.start, arc.points.stop - 1])], model.outline)
    position, F = ends.position(x), ends.deformation_gradient(x)
    found = []
    for corner, edges in zip(arc.corners, arc.edges, strict=True):
        away = corner - ends.points
        distance = jnp.sqrt(jnp.sum(away**2, axis=1))
        weight = distance[::-1] / jnp.sum(distance)
        free = weight @ (position + jnp.einsum("eij,ej->ei", F, away))
        components = [_along_edge(x, model, edges[i], corner)[i] if i in edges else free[i] for i in range(2)]
        found.append(jnp.stack(components))
    return jnp.stack(found)


def _along_edge(x, model, edge, corner):
    """Where an edge that moves as a straight line takes a ``corner`` (2,) of the dry plate, (2,) mm."""
    nodes, along = model.lists.topology.edge_nodes[edge], 1 - edge_lines(model.lists.topology.plate)[edge][0]
    first, last = nodes[0], nodes[-1]
    dry = model.cloud.nodes
    return x[first] + (x[last] - x[first]) * (corner[along] - dry[first, along]) / (dry[last, along] - dry[first, along])


def walls(x: Float[Array, "n 2"], topology: Topology) -> Float[Array, "e 2 2"]:
    """Ends (e, 2, 2), mm, of the edges that are held, at nodal positions ``x`` (n, 2); the plate lies to the left of each."""
    nodes, ends = topology.partition.vertices[topology.node_vertices], []
    for edge, (axis, coordinate) in edge_lines(topology.plate).items():
        wall = topology.edge_nodes[edge]
        if held_components(topology.plate.edges, edge) and len(wall) > 1:
            along = np.argsort(nodes[wall, 1 - axis])[[0, -1]]
            ends.append(wall[along if (coordinate > 0) == (axis == 0) else along[::-1]])
    return x[np.array(ends, dtype=int).reshape(-1, 2)]


def crosses(arcs: list[np.ndarray], held: Float[np.ndarray, "e 2 2"]) -> bool:
    """Whether a hole's deformed outline, one of the `outline_arcs` (m, 2), crosses itself, another one or one of the `walls`; host."""
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


_compiled_arcs = compiled()(outline_arcs)


def overlaps(x: Float[Array, "n 2"], model: Model) -> bool:
    """Whether a hole's outline crosses itself, another one or an edge of the plate."""
    return crosses([np.asarray(arc) for arc in _compiled_arcs(x, model)], np.asarray(walls(x, model.lists.topology)))
