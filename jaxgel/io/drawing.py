"""Drawings that were read: closed outlines, entities left out, and the joining of open lines."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .._types import Float

FLATNESS = 1e-4  # of an outline's size: distance of a curve's chords when a drawing is read
# of the size of the smaller line: distance of ends that meet, less than a pixel on a screen
JOINT = 1e-3
# of an outline's size: distance of outlines that are one on a screen; more than the chords of two
# readings of one curve
TWIN = 5e-4
# of an outline's size: distance of neighbouring points that are one, round-off of written
# coordinates
REPEATED = 1e-6
THIN = 1e-9  # of the square of its size: area of the hull of a line without an inside


class Omission(NamedTuple):
    """Why an entity of a drawing is none of its outlines."""

    kind: str
    """Name of the entity or element in its format, such as "LINE" or "text"."""
    layer: str
    """Layer of a DXF entity; label or id of the group of an SVG element; name of a column.

    Else empty.
    """
    reason: str
    """Reason in a few words, such as "layer off"."""


@dataclass(frozen=True)
class Drawing:
    """Closed outlines of a drawing and what was left out."""

    outlines: list[Float[np.ndarray, "_ 2"]]
    """Closed outlines, mm, y axis up; the first point may be repeated at the end."""
    omissions: Counter[Omission] = field(default_factory=Counter)
    """Number of entities left out, by kind, layer and reason."""


def size_of(line: Float[np.ndarray, "m 2"]) -> float:
    """The longer side of the box around the points (m, 2), mm."""
    return float(np.max(np.ptp(line, axis=0)))


def ends_meet(line: Float[np.ndarray, "m 2"]) -> bool:
    """Whether first and last point of a line (m, 2) coincide to relative round-off."""
    return len(line) > 2 and bool(np.linalg.norm(line[0] - line[-1]) <= JOINT * size_of(line))


def without_repeats(line: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "_ 2"]:
    """The closed outline (m, 2) without points that the next one repeats.

    Empty if it is not finite or has no inside.
    """
    if len(line) < 3 or not np.isfinite(line).all():
        return np.empty((0, 2))
    size = size_of(line)
    line = line[np.linalg.norm(line - np.roll(line, -1, axis=0), axis=1) > REPEATED * size]
    if len(line) < 3:
        return np.empty((0, 2))
    shape = shapely.Polygon(line)
    # a figure of eight may have no area
    has_inside = shape.area > THIN * size**2 or shape.convex_hull.area > THIN * size**2
    return line if has_inside else np.empty((0, 2))


def distinct(outlines: Sequence[Float[np.ndarray, "_ 2"]]) -> list[Float[np.ndarray, "_ 2"]]:
    """The closed outlines without duplicates, as of a hatch's border or a circle drawn twice."""
    if len(outlines) < 2:
        return list(outlines)
    shapes = np.array([shapely.Polygon(line) for line in outlines])
    sizes, bounds, areas = (
        np.array([size_of(line) for line in outlines]),
        shapely.bounds(shapes),
        shapely.area(shapes),
    )
    pairs = cKDTree(bounds).query_pairs(2 * TWIN * sizes.max(), output_type="ndarray")
    near = TWIN * sizes[pairs].min(axis=1)
    alike = (np.abs(np.diff(bounds[pairs], axis=1)).max(axis=(1, 2)) <= near) & (
        np.abs(np.diff(areas[pairs]))[:, 0] <= 4 * near * sizes[pairs].min(axis=1)
    )
    repeated = set()
    for (i, j), distance in sorted(
        zip(map(tuple, pairs[alike].tolist()), near[alike], strict=True)
    ):
        # of thousands of points
        rings = [
            shapely.simplify(shapes[k].exterior, distance / 8, preserve_topology=False)
            for k in (i, j)
        ]
        if i not in repeated and shapely.hausdorff_distance(*rings) <= distance:
            repeated.add(j)
    return [line for k, line in enumerate(outlines) if k not in repeated]


def join(
    lines: Sequence[Float[np.ndarray, "_ 2"]],
) -> list[tuple[Float[np.ndarray, "_ 2"], set[int]]]:
    """The closed outlines that open lines form whose ends meet, each with the indices of its lines.

    If more than two ends meet, these are the faces between the lines; loose ends are left over. A
    line drawn twice counts once.
    """
    if not lines:
        return []
    ends = np.array([line[[0, -1]] for line in lines]).reshape(-1, 2)
    reach = JOINT * np.repeat([size_of(line) for line in lines], 2)
    pairs = cKDTree(ends).query_pairs(reach.max(), output_type="ndarray")
    pairs = pairs[
        np.linalg.norm(np.diff(ends[pairs], axis=1)[:, 0], axis=1) <= reach[pairs].min(axis=1)
    ]
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(ends), len(ends)))
    _, first, node = np.unique(
        connected_components(links, directed=False)[1], return_index=True, return_inverse=True
    )
    ends, node = ends[first][node].reshape(-1, 2, 2), node.reshape(-1, 2)
    curves = {
        k: shapely.LineString([ends[k, 0], *line[1:-1], ends[k, 1]])
        for k, line in enumerate(lines)
        if len(line) > 2 or node[k, 0] != node[k, 1]
    }
    twins = _twins(curves, node)
    owner = {_segment(*curve.coords[:2]): k for k, curve in curves.items() if twins[k] == k}
    outlines = []
    faces, _, _, crossing = map(
        shapely.get_parts, shapely.polygonize_full([curves[k] for k in owner.values()])
    )
    for ring in [*shapely.get_exterior_ring(faces), *crossing]:
        corners = list(ring.coords)
        parts = {owner[part] for part in map(_segment, corners, corners[1:]) if part in owner}
        outlines.append((np.array(corners[:-1]), {k for k, twin in twins.items() if twin in parts}))
    return outlines


def _twins(curves, node):
    """Index of the first of the curves that are one, for each curve."""
    twins, between = {}, {}
    for k, curve in curves.items():
        others = between.setdefault(tuple(sorted(node[k])), [])
        near = TWIN * max(np.ptp(curve.xy, axis=1))
        twins[k] = next(
            (i for i in others if shapely.hausdorff_distance(curve, curves[i]) <= near), k
        )
        if twins[k] == k:
            others.append(k)
    return twins


def _segment(start, end):
    return (start, end) if start < end else (end, start)
