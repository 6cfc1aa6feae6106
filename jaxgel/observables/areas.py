"""Outlines of the holes, their areas and aspect ratios; lengths in mm."""

import jax
import jax.numpy as jnp
import numpy as np

from .._memo import once_per_owner
from .._types import Array, Float, Int
from ..cloud import Topology, boundary_edges
from ..discretisation import Model, make_probe
from ..geometry import edge_lines, inside_holes
from ..mechanics import holes_of_loops, outline_loops
from .states import States, of_path, over_states

EDGE_SIDES = 8  # chords of a free edge between two vertices, as of an outline between two nodes
TINY = 1e-300  # mm^2: square of a side of an outline that has two equal points


@of_path
def area_reduction(path: States) -> Float[Array, " k"]:
    """Area reduction 1 - A/A0 (k,) of all holes together, measured on their deformed outlines; nan for a plate without holes.

    In a rigid box the cells give the same, (<J> - 1)(1 - phi)/phi with the porosity phi: to 5e-4 of it, until the holes are closed.
    """
    return over_states(_area_reduction, path)


@of_path
def area_reduction_per_hole(path: States) -> Float[Array, "k holes"]:
    """Area reduction 1 - A/A0 (k, holes) of each hole."""
    return over_states(_area_reduction_per_hole, path)


@of_path
def aspect_ratio(path: States) -> Float[Array, "k holes"]:
    """Length over width (k, holes) of each hole: the root of the ratio of its principal second moments of area; 2 for a 2:1 ellipse."""
    return over_states(_aspect_ratio, path)


@of_path
def outlines(path: States) -> list[Float[Array, "k _ 2"]]:
    """Deformed outlines of the holes: a list over holes of closed loops (k, m, 2), mm, without repeating the first point.

    A hole that the plate's edge cuts is closed along the deformed edge. Its corner inside a hole, which is no material point, follows the
    edges that prescribe its motion and else continues the deformation at the two ends of the outline. A hole that the edge cuts into
    several parts has a loop for each.
    """
    return over_states(outline_loops, path)


def dry_outlines(model: Model) -> list[Float[Array, "_ 2"]]:
    """Outlines of the holes on the dry plate, closed loops (m, 2), mm, in the order of `outlines`."""
    return outline_loops(model.cloud.nodes, model)


@of_path
def deformed_boundary(path: States) -> Float[np.ndarray, "k e 2 2"]:
    """Ends (k, e, 2, 2) of the straight sides of the deformed gel's boundary, mm, in no order; host.

    Free edges, which bend between the vertices of the cells, are ``EDGE_SIDES`` times finer than those.
    """
    topology, vertices = path.model.cloud.topology, np.asarray(path.model.cloud.vertices)
    reference, edges = topology.partition.vertices, boundary_edges(np.asarray(path.model.cloud.triangles))
    free = np.zeros(len(edges), dtype=bool)
    for edge, (axis, coordinate) in edge_lines(topology.plate).items():
        if topology.plate.edges[edge] == "free":
            free |= (np.abs(reference[edges][..., axis] - coordinate) < 1e-9 * topology.spacing).all(axis=1)
    share = np.linspace(0.0, 1.0, EDGE_SIDES + 1)[:, None, None]
    dry, of_reference = (
        np.concatenate([points[edges[~free]].reshape(-1, 2), ((1 - share) * a + share * b).reshape(-1, 2)])
        for points in (vertices, reference)
        for a, b in [np.moveaxis(points[edges[free]], 1, 0)]
    )
    _, first, number = np.unique(of_reference, axis=0, return_index=True, return_inverse=True)  # sides that join have the same end
    probe = make_probe(path.model, dry[first], of_reference[first])
    position = np.asarray(jax.vmap(probe.position)(jnp.asarray(path.x)))[:, number.ravel()]
    whole, fine = np.split(position, [2 * int((~free).sum())], axis=1)
    fine = fine.reshape(len(position), EDGE_SIDES + 1, -1, 2)
    sides = np.stack([fine[:, :-1], fine[:, 1:]], axis=3).reshape(len(position), -1, 2, 2)
    return np.concatenate([whole.reshape(len(position), -1, 2, 2), sides], axis=1)


@of_path
def free_edge_misfit(path: States, outline: Float[Array, "m 2"]) -> Float[Array, " k"]:
    """Mean square distance (k,), mm^2, of the plate's free edges from the line through the points ``outline`` (m, 2), mm.

    The mean is that over the dry length of the edges, by the trapezoidal rule between their nodes. The line is open unless its last point
    is its first one. ValueError for a plate without a free edge.
    """
    start, end = _free_sides(path.model.lists.topology)
    if not len(start):
        raise ValueError("outline: the plate has no free edge that could follow it; free one in plate.edges")
    line, nodes = jnp.asarray(outline), path.model.cloud.nodes
    first, along = line[:-1], jnp.diff(line, axis=0)

    def squared_distance(x):
        """Squared distance (k, s) of points (k, s, 2) from the line."""
        away = x[:, :, None] - first
        fraction = jnp.clip(jnp.sum(away * along, axis=-1) / jnp.maximum(jnp.sum(along**2, axis=-1), TINY), 0.0, 1.0)
        return jnp.min(jnp.sum((away - fraction[..., None] * along) ** 2, axis=-1), axis=2)

    length, x = jnp.linalg.norm(nodes[end] - nodes[start], axis=1), jnp.asarray(path.x)
    return (squared_distance(x[:, start]) + squared_distance(x[:, end])) @ length / (2 * jnp.sum(length))


@once_per_owner
def _free_sides(topology: Topology) -> Int[np.ndarray, "2 s"]:
    """First and last node (s,), (s,) of each interval of the free edges between neighbouring nodes with gel between them."""
    nodes, sides = topology.partition.vertices[topology.node_vertices], [np.zeros((2, 0), dtype=int)]
    for edge, (axis, _) in edge_lines(topology.plate).items():
        if topology.plate.edges[edge] == "free":
            along = topology.edge_nodes[edge][np.argsort(nodes[topology.edge_nodes[edge], 1 - axis])]
            pairs = np.stack([along[:-1], along[1:]])
            sides.append(pairs[:, ~inside_holes(topology.plate, nodes[pairs].mean(axis=0))])
    return np.concatenate(sides, axis=1)


def _hole_areas(x: Float[Array, "n 2"], model: Model) -> Float[Array, " holes"]:
    """Area inside each hole's outline, mm^2: that of a polygon by the shoelace formula, and that between its sides and the outline.

    The outline between two vertices is the cubic arc with the outline's tangents F dX at both. The polygon alone misses 2e-4 of the dry
    holes of sample 4 where these close, at mu = -0.2678: a third of the difference between the areas by outlines and by cells.
    """
    loops, (start, end, hole) = outline_loops(x, model), _sides(model.lists.topology)
    if not loops:
        return jnp.zeros(0)
    polygons = jnp.stack([0.5 * jnp.sum(_cross(loop, jnp.roll(loop, -1, axis=0))) for loop in loops])
    y, F, dX = model.outline.position(x), model.outline.deformation_gradient(x), model.outline.points[end] - model.outline.points[start]
    first, last = (jnp.einsum("mij,mj->mi", F[at], dX) for at in (start, end))
    beyond = _cross(y[end] - y[start], last - first) / 10 - _cross(first, last) / 60
    of_loops, holes = holes_of_loops(model.lists.topology), len(model.lists.topology.plate.holes)
    return jax.ops.segment_sum(polygons, of_loops, holes) + jax.ops.segment_sum(beyond, hole, holes)


def _cross(a: Float[Array, "m 2"], b: Float[Array, "m 2"]) -> Float[Array, " m"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


@once_per_owner
def _sides(topology: Topology) -> Int[np.ndarray, "3 m"]:
    """First and last vertex (m,), (m,) of each side of the outlines, in the numbering of ``model.outline``, and its hole (m,)."""
    first, sides = 0, [np.zeros((3, 0), dtype=int)]
    for outline in topology.outlines:
        number = first + np.arange(len(outline.s))
        first += len(outline.s)
        start, end = (number, np.roll(number, -1)) if outline.closed else (number[:-1], number[1:])
        sides.append(np.stack([start, end, np.full(len(start), outline.arc.hole)]))
    return np.concatenate(sides, axis=1)


def _area_reduction(x: Float[Array, "n 2"], model: Model) -> Float[Array, ""]:
    return 1 - jnp.sum(_hole_areas(x, model)) / jnp.sum(_hole_areas(model.cloud.nodes, model))


def _area_reduction_per_hole(x: Float[Array, "n 2"], model: Model) -> Float[Array, " holes"]:
    return 1 - _hole_areas(x, model) / _hole_areas(model.cloud.nodes, model)


def _aspect_ratio(x: Float[Array, "n 2"], model: Model) -> Float[Array, " holes"]:
    loops, of_loops = outline_loops(x, model), holes_of_loops(model.lists.topology)
    if not loops:
        return jnp.zeros(0)
    return jnp.stack([_length_over_width([loops[i] for i in np.flatnonzero(of_loops == k)]) for k in np.unique(of_loops)])


def _length_over_width(loops: list[Array]) -> Float[Array, ""]:
    """Aspect ratio () of the ellipse with the second moments of polygons (m, 2) together, by Green's theorem edge by edge."""
    centre = jnp.mean(jnp.concatenate(loops), axis=0)
    a, b = (jnp.concatenate([jnp.roll(loop, -turn, axis=0) for loop in loops]) - centre for turn in (0, 1))
    twice = _cross(a, b)
    area, first = jnp.sum(twice) / 2, twice @ (a + b) / 6
    total = a + b
    second = (
        jnp.einsum("m,mi,mj->ij", twice, total, total) + jnp.einsum("m,mi,mj->ij", twice, a, a) + jnp.einsum("m,mi,mj->ij", twice, b, b)
    ) / 24
    second = second - jnp.outer(first, first) / area
    mean, spread = (second[0, 0] + second[1, 1]) / 2, _hypot((second[0, 0] - second[1, 1]) / 2, second[0, 1])
    return jnp.sqrt((mean + spread) / (mean - spread))


def _hypot(a: Float[Array, ""], b: Float[Array, ""]) -> Float[Array, ""]:
    """sqrt(a^2 + b^2) (), with derivative 0 at 0."""
    square = a**2 + b**2
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
