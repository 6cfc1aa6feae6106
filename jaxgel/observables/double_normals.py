"""Double normals of an outline: lines through a hole, normal to it at both ends.

NumPy, on the host. A double normal is a critical point of the distance between two points of the
outline, whatever shape it has: the width of a slit, the minor axis of an ellipse, the neck of a
hole that closes. The sides of a corner have none. An outline is a polygon (m, 2), anticlockwise
with the hole inside; at its vertices all directions between the normals of both sides are normal,
which makes the shortest double normal of a convex hole its width: the smallest distance of two
parallel lines between which it lies. To the height of arcs over their chords, it does not depend on
how many vertices there are. A neck begins where two double normals arise together, so the shortest
one may jump there, a little earlier if the outline is coarse. Sides along the plate's edge are a
wall, as much a surface as the gel's, or open if the edge is free.
"""

from typing import NamedTuple

import numpy as np
import shapely

from .._types import Float, Int

GEL, WALL, OPEN = range(3)
"""Kinds of the sides of an outline."""
PERPENDICULAR = 1e-9  # cosine of a right angle to round-off
TRIM = 1e-6  # of a line's length, left out at both ends, where it touches the outline
BLOCK = 512  # vertices whose lines are examined together
ON_EDGE = 1e-9  # of the plate's size: distance from an edge of points on it


class Pair(NamedTuple):
    """The ends of a line across a hole: a vertex, and a point between two vertices."""

    vertices: Int[np.ndarray, " 3"]
    """(3,) number of the vertex, and of those before and after the other point."""
    fraction: float
    """Position of the point between its vertices, 0 ... 1."""
    length: float
    """Its length, mm."""


NO_PAIR = Pair(np.zeros(3, dtype=int), 0.0, np.inf)
CROSSING = Pair(np.zeros(3, dtype=int), 0.0, 0.0)
"""A point with itself, for an outline that crosses itself."""
UNKNOWN = Pair(np.zeros(3, dtype=int), 0.0, np.nan)
"""For an outline whose points are not all finite."""


def kinds_of_sides(
    dry: Float[np.ndarray, "m 2"], edges: Float[np.ndarray, "4 3"]
) -> Int[np.ndarray, " m"]:
    """Kind (m,) of the side after each vertex of a ``dry`` outline (m, 2).

    ``edges`` has axis, coordinate in mm and kind of each edge.
    """
    kinds, tolerance = np.full(len(dry), GEL), ON_EDGE * np.max(np.abs(edges[:, 1]))
    for axis, coordinate, kind in edges:
        lies = np.abs(dry[:, int(axis)] - coordinate) <= tolerance
        kinds[lies & np.roll(lies, -1)] = int(kind)
    return kinds


def shortest_double_normal(outline: Float[np.ndarray, "m 2"], kinds: Int[np.ndarray, " m"]) -> Pair:
    """The shortest double normal of an ``outline`` (m, 2) through its hole, with an end on gel.

    `NO_PAIR`, `CROSSING` or `UNKNOWN`.
    """
    if not np.all(np.isfinite(outline)):
        return UNKNOWN
    # two equal vertices have no side
    kept = np.flatnonzero(np.any(np.roll(outline, -1, axis=0) != outline, axis=1))
    points, kinds = outline[kept] - outline[0], kinds[kept]
    sides = shapely.linestrings(np.stack([points, np.roll(points, -1, axis=0)], axis=1))
    if not shapely.multilinestrings(sides[kinds != OPEN]).is_simple:
        return CROSSING
    # no line inside the plate crosses a wall, and one may lie along it
    surface = shapely.multilinestrings(sides[kinds == GEL])
    shapely.prepare(surface)
    length, start, end, fraction = _candidates(points @ [1, 1j], kinds)
    after = (end + 1) % len(points)
    for k in np.argsort(length, kind="stable"):
        p, q = points[start[k]], (1 - fraction[k]) * points[end[k]] + fraction[k] * points[after[k]]
        if not surface.intersects(shapely.LineString([p + TRIM * (q - p), q - TRIM * (q - p)])):
            return Pair(kept[[start[k], end[k], after[k]]], float(fraction[k]), float(length[k]))
    return NO_PAIR


def _candidates(points, kinds):
    """Lengths, vertices, sides and fractions (c,) of all double normals, also through gel.

    Fractions are along the sides. Points (m,) are complex numbers: conj(a) b has the component of b
    along a unit vector a, and that to its left.
    """
    side = np.roll(points, -1) - points
    length = np.abs(side)
    tangent = side / length
    before, after = _tangents(tangent, kinds)
    is_convex = (before.conj() * after).imag >= 0  # the hole, here
    on_gel = (kinds == GEL) | (np.roll(kinds, 1) == GEL)
    on_surface = on_gel | (kinds == WALL) | (np.roll(kinds, 1) == WALL)

    def is_normal(vertex, direction):
        """Whether directions (c,) lie between the normals at vertices (c,), and in the hole."""
        one, other = (ways[vertex].conj() * direction for ways in (before, after))
        inside = np.where(
            is_convex[vertex],
            np.minimum(one.imag, other.imag) >= -PERPENDICULAR,
            one.imag + other.imag > 0,
        )
        return (one.real * other.real <= PERPENDICULAR**2) & inside

    def of(holds, *of_pairs):
        return [values[holds] for values in of_pairs]

    found, round_off = [], PERPENDICULAR * np.max(length)
    homogeneous = np.column_stack([points.real, points.imag, np.ones(len(points))])
    # components along directions from a foot are products with (m, 3)
    across_middles, *ahead = (
        np.column_stack([way.real, way.imag, -(way.conj() * foot).real])
        for way, foot in ((tangent, points + side / 2), (before, points), (after, points))
    )
    # vertices from which the lines start
    for rows in np.array_split(np.arange(len(points)), -(-len(points) // BLOCK)):
        from_middle = homogeneous[rows] @ across_middles.T
        start, end = _where(np.abs(from_middle) <= length / 2 + round_off)
        vertex = rows[start]
        distance = (tangent[end].conj() * (points[vertex] - points[end])).imag
        fraction = np.clip(0.5 + from_middle[start, end] / length[end], 0.0, 1.0)
        holds = (
            (distance > 0)
            & (vertex != end)
            & (vertex != (end + 1) % len(points))
            & on_surface[vertex]
            & (kinds[end] != OPEN)
            & (on_gel[vertex] | (kinds[end] == GEL))
        )
        vertex, end, distance, fraction = of(holds, vertex, end, distance, fraction)
        holds = is_normal(vertex, -1j * tangent[end])
        found.append(of(holds, distance, vertex, end, fraction))

        slopes = [direction[rows] @ homogeneous.T for direction in ahead]
        start, end = _where(slopes[0] * slopes[1] <= round_off**2)
        vertex, way = rows[start], points[end] - points[rows[start]]
        holds = (
            (vertex < end)
            & (way != 0)
            & on_surface[vertex]
            & on_surface[end]
            & (on_gel[vertex] | on_gel[end])
        )
        vertex, end, way = of(holds, vertex, end, way)
        distance = np.abs(way)
        holds = is_normal(vertex, way / distance)
        vertex, end, way, distance = of(holds, vertex, end, way, distance)
        holds = is_normal(end, -way / distance)
        found.append(of(holds, distance, vertex, end, np.zeros(len(vertex))))
    return [np.concatenate(parts) for parts in zip(*found, strict=True)]


def _tangents(tangent, kinds):
    """Tangents (m,) of the surface before and after each vertex.

    At the end of the gel's surface the one goes on as its mirror image at a wall, and along a free
    edge away from the hole. There the other one is extrapolated by one side, so that half a circle
    has a mouth, whose surface just meets the free edge at a right angle.
    """
    kind_before, previous = np.roll(kinds, 1), np.roll(tangent, 1)
    before, after = previous.copy(), tangent.copy()
    first, last = (kinds == GEL) & (kind_before != GEL), (kinds != GEL) & (kind_before == GEL)
    before[first] = _beyond(tangent[first], previous[first], kind_before[first])
    after[last] = _beyond(previous[last], tangent[last], kinds[last])
    first, last = first & (kind_before == OPEN), last & (kinds == OPEN)
    after[first] = 2 * tangent[first] - np.roll(tangent, -1)[first]
    before[last] = 2 * previous[last] - np.roll(previous, 1)[last]
    return tuple(way / np.abs(way) for way in (before, after))


def _beyond(gel, edge, kind):
    """Tangents (e,) after the gel's surface at a plate's edge with tangents ``edge``.

    ``gel`` are the last ones of the surface.
    """
    return np.where(kind == WALL, gel - 2 * (gel.conj() * edge).real * edge, -edge)


def _where(holds):
    """Rows and columns (c,) where a matrix (a, b) ``holds``, sooner than by ``np.nonzero``."""
    return np.divmod(np.flatnonzero(holds), holds.shape[1])
