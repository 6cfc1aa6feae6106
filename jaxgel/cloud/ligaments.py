"""Ligaments: strips of gel between two holes, or between a hole and an edge of the plate, and how wide they and regions are.

A periodic edge is no end of the gel: behind it are the images of holes and regions.
"""

import numpy as np
import shapely

from .._types import Float
from ..geometry import EDGES, Arc, Plate, image_offsets
from .outlines import OUTLINE_SEGMENTS, Outline, gel_polygon, loop, points_and_normals, region_polygons

REACH = 4.0  # spacings from an interface up to which the width of a region is of interest
NO_IMAGES = np.empty((0, 2))
CLOSE = 1e-2  # spacings: what is nearer begins on the interface; its corners have shorter lines


def ligaments(
    plate: Plate, outlines: tuple[Outline, ...], points: Float[np.ndarray, "o 2"], offset: int, every: int = 1
) -> tuple[np.ndarray, Float[np.ndarray, " m"]]:
    """`find_ligaments` of the ``outlines``, numbered from ``offset``, with ``points`` (o, 2), along ``every`` so many of these."""
    curves, gel = [points[loop(o)[::every] - offset] for o in outlines], gel_polygon(plate, outlines, points, offset)
    return find_ligaments(sides(plate), curves, [o.arc for o in outlines], _with_images(plate, gel), image_offsets(plate)[1:])


def find_ligaments(
    sides: list[shapely.LineString],
    curves: list[Float[np.ndarray, "_ 2"]],
    arcs: list[Arc],
    gel: shapely.Geometry,
    images: Float[np.ndarray, "i 2"] = NO_IMAGES,
) -> tuple[np.ndarray, Float[np.ndarray, " m"]]:
    """Strips of gel between an outline and the nearest other outline or edge of the plate: polygons (m,) and widths (m,), mm.

    ``curves`` are the fine outlines (k, 2) of the ``arcs``, closed ones with the first point repeated, ``sides`` the plate's
    ``EDGES``, empty if periodic, and ``images`` the translations (i, 2) to images of the outlines. An edge on which an arc ends is none of
    its neighbours: the wedge between them is no ligament.
    """
    lines = shapely.linestrings(np.concatenate(curves), indices=np.repeat(np.arange(len(curves)), [len(c) for c in curves]))
    beyond = [shapely.transform(lines, lambda at, by=by: at + by) for by in images]
    strips, widths = [], []
    for i, (curve, arc) in enumerate(zip(curves, arcs, strict=True)):
        met = [side for side, e in zip(sides, EDGES, strict=True) if not (side.is_empty or e in (arc.start_edge, arc.end_edge))]
        others = np.concatenate([np.delete(lines, i), met, *beyond])
        across = shapely.shortest_line(shapely.points(curve), shapely.multilinestrings(others))
        width = shapely.length(across)
        through_gel = shapely.length(shapely.intersection(across, gel)) > 0.9 * width
        both = np.flatnonzero(through_gel[:-1] & through_gel[1:])
        ends = shapely.get_coordinates(across).reshape(-1, 2, 2)
        strips.append(shapely.convex_hull(shapely.multipoints(np.concatenate([ends[both], ends[both + 1]], axis=1))))
        widths.append(np.minimum(width[both], width[both + 1]))
    return np.concatenate(strips), np.concatenate(widths)


def across_regions(
    plate: Plate,
    outlines: tuple[Outline, ...],
    interfaces: tuple[Outline, ...],
    points: Float[np.ndarray, "o 2"],
    offset: int,
    spacing: float,
) -> tuple[np.ndarray, Float[np.ndarray, " m"]]:
    """Lines (m,) across the gel on either side of the ``interfaces``, along their normals, and their lengths (m,), mm.

    They end where a region does, or ``REACH`` times the ``spacing`` away. ``points`` (o, 2) are those of outlines and interfaces.
    """
    regions, found = [_with_images(plate, gel) for gel in region_polygons(plate, outlines, interfaces, points, offset)], []
    for interface in interfaces:
        at, normals = points_and_normals(interface, points, offset, OUTLINE_SEGMENTS // 2)
        at, normals = (at, normals) if interface.closed else (at[1:-1], normals[1:-1])  # an end lies on an edge, as its normal may
        for sign, number in ((1.0, 0), (-1.0, interface.arc.hole + 1)):
            ends = np.stack([at, at + sign * REACH * spacing * normals], axis=1)
            inside = shapely.intersection(shapely.linestrings(ends), regions[number])
            parts, owner = shapely.get_parts(inside, return_index=True)
            near = shapely.distance(parts, shapely.points(at[owner])) < CLOSE * spacing
            found.append(parts[near & (shapely.length(parts) > CLOSE * spacing)])
    lines = np.concatenate(found)
    return lines, shapely.length(lines)


def sides(plate: Plate) -> list[shapely.LineString]:
    """The sides of the plate, shapely LineStrings in the order of ``geometry.EDGES``; an empty one for a periodic edge."""
    w, h = plate.width / 2, plate.height / 2
    left, right, bottom, top = [(-w, -h), (-w, h)], [(w, -h), (w, h)], [(-w, -h), (w, -h)], [(-w, h), (w, h)]
    ends = zip(EDGES, (left, right, bottom, top), strict=True)
    return [shapely.LineString() if plate.edges[edge] == "periodic" else shapely.LineString(side) for edge, side in ends]


def _with_images(plate, gel):
    """The polygon together with its images around a periodic plate."""
    offsets = image_offsets(plate)
    return gel if len(offsets) == 1 else shapely.union_all([shapely.transform(gel, lambda at, by=by: at + by) for by in offsets])
