"""Outlines of the holes, their areas and aspect ratios; lengths in mm."""

import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._memo import once_per_owner
from .._sizes import resized
from .._tracing import is_traced
from .._types import Array, Float, Int
from ..cloud import Topology, boundary_edges
from ..discretisation import Body, Model, make_probe
from ..geometry import edge_lines, inside_holes
from ..mechanics import Loops, loop_points, loops_of
from .states import States, of_path, outlines_of, over_outlines, positions_of

EDGE_SIDES = 8  # chords of a free edge between two vertices, as of an outline between two nodes
TINY = 1e-300  # mm^2: square of a side of an outline that has two equal points


@of_path
def area_reduction(path: States) -> Float[Array, " k"]:
    """Area reduction 1 - A/A0 (k,) of all holes together, dimensionless.

    Arguments:

    - `path`: the `Path` of k states.

    A is the area inside the deformed outlines. Returns nan for a plate without holes. In a rigid
    box the cells give the same, (<J> - 1)(1 - phi)/phi with the porosity phi: to 5e-4 of it, until
    the holes are closed.

    >>> import types, jaxgel
    >>> plate = jaxgel.Plate(2.0, 2.0, [jaxgel.Circle((0.0, 0.0), 0.5)])
    >>> model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.5))
    >>> states = types.SimpleNamespace(model=model, x=0.9 * model.nodes[None])  # a path has more
    >>> area_reduction(states).round(6)
    Array([0.19], dtype=float64)
    """
    return over_outlines(_area_reduction, path)


@of_path
def area_reduction_per_hole(path: States) -> Float[Array, "k holes"]:
    """Area reduction 1 - A/A0 (k, holes) of each hole, dimensionless.

    Arguments:

    - `path`: the `Path` of k states.

    Example: docs/howto/time.md.
    """
    return _of_holes(_area_reduction_per_hole, path)


@of_path
def aspect_ratio(path: States) -> Float[Array, "k holes"]:
    """Aspect ratio (k, holes) of each hole from its second moments; 2 for a 2:1 ellipse.

    Length over width: the root of the ratio of its principal moments of area.
    """
    return _of_holes(_aspect_ratio, path)


@of_path
def outlines(path: States) -> list[Float[Array, "k _ 2"]]:
    """Deformed outlines of the holes: a list of closed loops (k, m, 2), mm.

    Arguments:

    - `path`: the `Path` of k states.

    Returns one loop for each hole, in their order, without repeating the first point. A hole that
    the plate's edge cuts is closed along the deformed edge; one that it cuts into several parts has
    a loop for each. A corner of the plate inside a hole, which is no material point, follows the
    edges that prescribe its motion, and else continues the deformation at the two ends of the
    outline.

    >>> import types, jaxgel
    >>> plate = jaxgel.Plate(2.0, 2.0, [jaxgel.Circle((0.0, 0.0), 0.5)])
    >>> model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.5))
    >>> states = types.SimpleNamespace(model=model, x=0.9 * model.nodes[None])  # a path has more
    >>> [round(float(loop[..., 0].max()), 6) for loop in outlines(states)]
    [0.45]
    """
    points = points_on_loops(path)
    points = points if is_traced(points) else np.asarray(points)
    return [points[:, loop] for loop in loops_of(path.model)[1]]


def dry_outlines(model: Model) -> list[Float[Array, "_ 2"]]:
    """Outlines of the holes on the dry plate, closed loops (m, 2), mm, as in `outlines`."""
    points = dry_points_on_loops(model)
    points = points if is_traced(points) else np.asarray(points)
    return [points[loop] for loop in loops_of(model)[1]]


def points_on_loops(path: States) -> Float[Array, "k _ 2"]:
    """Positions, mm, of the points that `mechanics.loops_of` numbers."""
    return over_outlines(_points_on_loops, path)


def _points_on_loops(x, body, loops):
    return loop_points(x, body, loops.corners)


def dry_points_on_loops(model: Model) -> Float[Array, "_ 2"]:
    """Those on the dry plate."""
    return _dry_points(outlines_of(model.shared), loops_of(model)[0])


@compiled()
def _dry_points(body, loops):
    return _points_on_loops(body.nodes, body, loops)


def _of_holes(function, path):
    """Values (k, holes) of a ``function`` as of `over_outlines`."""
    return resized(
        over_outlines(function, path), (len(path.x), len(path.model.lists.topology.plate.holes))
    )


@of_path
def deformed_boundary(path: States) -> Float[np.ndarray, "k e 2 2"]:
    """Ends (k, e, 2, 2) of the straight sides of the deformed gel's boundary, mm, in no order.

    Host. Free edges, which bend between the vertices of the cells, are ``EDGE_SIDES`` times finer
    than those.
    """
    topology, vertices = path.model.cloud.topology, np.asarray(path.model.cloud.vertices)
    reference, edges = (
        topology.partition.vertices,
        boundary_edges(np.asarray(path.model.cloud.triangles)),
    )
    free = np.zeros(len(edges), dtype=bool)
    for edge, (axis, coordinate) in edge_lines(topology.plate).items():
        if topology.plate.edges[edge] == "free":
            free |= (
                np.abs(reference[edges][..., axis] - coordinate) < 1e-9 * topology.spacing
            ).all(axis=1)
    share = np.linspace(0.0, 1.0, EDGE_SIDES + 1)[:, None, None]
    dry, of_reference = (
        np.concatenate(
            [points[edges[~free]].reshape(-1, 2), ((1 - share) * a + share * b).reshape(-1, 2)]
        )
        for points in (vertices, reference)
        for a, b in [np.moveaxis(points[edges[free]], 1, 0)]
    )
    # sides that join have the same end
    _, first, number = np.unique(of_reference, axis=0, return_index=True, return_inverse=True)
    probe = make_probe(path.model, dry[first], of_reference[first])
    position = np.asarray(positions_of(probe, path))[:, number.ravel()]
    whole, fine = np.split(position, [2 * int((~free).sum())], axis=1)
    fine = fine.reshape(len(position), EDGE_SIDES + 1, -1, 2)
    sides = np.stack([fine[:, :-1], fine[:, 1:]], axis=3).reshape(len(position), -1, 2, 2)
    return np.concatenate([whole.reshape(len(position), -1, 2, 2), sides], axis=1)


@of_path
def free_edge_misfit(path: States, outline: Float[Array, "m 2"]) -> Float[Array, " k"]:
    """Mean square distance (k,), mm^2, of free edges from the line ``outline`` (m, 2), mm.

    It goes through these points. The mean is that over the dry length of the edges, by the
    trapezoidal rule between their nodes. The line is open unless its last point is its first one.
    ValueError for a plate without a free edge.
    """
    start, end = _free_sides(path.model.lists.topology)
    if not len(start):
        raise ValueError(
            "outline: the plate has no free edge that could follow it; free one in plate.edges"
        )
    line, nodes = jnp.asarray(outline), path.model.cloud.nodes
    first, along = line[:-1], jnp.diff(line, axis=0)

    def squared_distance(x):
        """Squared distance (k, s) of points (k, s, 2) from the line."""
        away = x[:, :, None] - first
        fraction = jnp.clip(
            jnp.sum(away * along, axis=-1) / jnp.maximum(jnp.sum(along**2, axis=-1), TINY), 0.0, 1.0
        )
        return jnp.min(jnp.sum((away - fraction[..., None] * along) ** 2, axis=-1), axis=2)

    length, x = jnp.linalg.norm(nodes[end] - nodes[start], axis=1), jnp.asarray(path.x)
    return (
        (squared_distance(x[:, start]) + squared_distance(x[:, end]))
        @ length
        / (2 * jnp.sum(length))
    )


@once_per_owner
def _free_sides(topology: Topology) -> Int[np.ndarray, "2 s"]:
    """First and last node (s,), (s,) of each free-edge interval with gel between them.

    The nodes are neighbours.
    """
    nodes, sides = (
        topology.partition.vertices[topology.node_vertices],
        [np.zeros((2, 0), dtype=int)],
    )
    for edge, (axis, _) in edge_lines(topology.plate).items():
        if topology.plate.edges[edge] == "free":
            along = topology.edge_nodes[edge][
                np.argsort(nodes[topology.edge_nodes[edge], 1 - axis])
            ]
            pairs = np.stack([along[:-1], along[1:]])
            sides.append(pairs[:, ~inside_holes(topology.plate, nodes[pairs].mean(axis=0))])
    return np.concatenate(sides, axis=1)


def _hole_areas(x: Float[Array, "n 2"], body: Body, loops: Loops) -> Float[Array, " h"]:
    """Area inside each hole's outline, mm^2: the polygon's and that of its segments.

    The polygon's is by the shoelace formula; segments lie between its sides and the outline. The
    outline between two vertices is the cubic arc with the outline's tangents F dX at both. The
    polygon alone misses 2e-4 of the dry holes of sample 4 where these close, at mu = -0.2678: a
    third of the difference between the areas by outlines and by cells.
    """
    y, F, X = (
        loop_points(x, body, loops.corners),
        body.outline.deformation_gradient(x),
        body.outline.points,
    )
    (start, end, hole), (first, last, of_arc) = loops.sides, loops.arcs
    tangents = [jnp.einsum("mij,mj->mi", F[at], X[last] - X[first]) for at in (first, last)]
    beyond = _cross(y[last] - y[first], tangents[1] - tangents[0]) / 10 - _cross(*tangents) / 60
    return loops.over_holes(_cross(y[start], y[end]) / 2, hole) + loops.over_holes(beyond, of_arc)


def _cross(a: Float[Array, "m 2"], b: Float[Array, "m 2"]) -> Float[Array, " m"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _area_reduction(x: Float[Array, "n 2"], body: Body, loops: Loops) -> Float[Array, ""]:
    return 1 - jnp.sum(_hole_areas(x, body, loops)) / jnp.sum(_hole_areas(body.nodes, body, loops))


def _area_reduction_per_hole(
    x: Float[Array, "n 2"], body: Body, loops: Loops
) -> Float[Array, " h"]:
    dry = _hole_areas(body.nodes, body, loops)
    return 1 - _hole_areas(x, body, loops) / jnp.where(dry == 0, 1.0, dry)


def _aspect_ratio(x: Float[Array, "n 2"], body: Body, loops: Loops) -> Float[Array, " h"]:
    """Aspect ratios (h,) of the moment ellipses of the holes' polygons, by Green's theorem.

    Side by side; 1 for padding.
    """
    y, (start, end, hole) = loop_points(x, body, loops.corners), loops.sides
    count = loops.over_holes(np.ones(len(hole)), hole)
    centre = (loops.over_holes(y[start], hole) / jnp.maximum(count, 1.0)[:, None])[hole]
    a, b = y[start] - centre, y[end] - centre
    twice, total = _cross(a, b), a + b
    products = sum(v[:, :, None] * v[:, None] for v in (total, a, b))
    area, first = (
        loops.over_holes(twice / 2, hole),
        loops.over_holes(twice[:, None] * total / 6, hole),
    )
    second = loops.over_holes(twice[:, None, None] * products / 24, hole)
    is_hole = area != 0
    second = (
        second - first[:, :, None] * first[:, None] / jnp.where(is_hole, area, 1.0)[:, None, None]
    )
    mean, spread = (
        (second[:, 0, 0] + second[:, 1, 1]) / 2,
        _hypot((second[:, 0, 0] - second[:, 1, 1]) / 2, second[:, 0, 1]),
    )
    return jnp.sqrt(jnp.where(is_hole, mean + spread, 1.0) / jnp.where(is_hole, mean - spread, 1.0))


def _hypot(a: Float[Array, " h"], b: Float[Array, " h"]) -> Float[Array, " h"]:
    """sqrt(a^2 + b^2) (h,), with derivative 0 at 0."""
    square = a**2 + b**2
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
