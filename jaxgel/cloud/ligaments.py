"""Ligaments: strips of gel between two holes or a hole and an edge, and their widths.

A periodic edge is no end of the gel: behind it are the images of holes and regions.
"""

from collections.abc import Iterator

import numpy as np
import shapely

from .._types import Float
from ..geometry import EDGES, Plate
from .images import translated
from .outlines import OUTLINE_SEGMENTS, Lines

REACH = 4.0  # spacings from an interface up to which the width of a region is of interest
CLOSE = 1e-2  # spacings: what is nearer begins on the interface; its corners have shorter lines


def find_ligaments(lines: Lines, every: int = 1) -> tuple[np.ndarray, Float[np.ndarray, " m"]]:
    """Strips of gel from an outline to the nearest outline or edge: polygons, widths (m,), mm.

    They join ``every`` so many points of the outlines. An edge on which an arc ends is none of its
    neighbours: the wedge between them is no ligament.
    """
    curves, gel, sides = (
        [o.line[::every] for o in lines.outlines],
        _with_images(lines.plate, lines.gel),
        sides_of(lines.plate),
    )
    drawn = shapely.linestrings(
        np.concatenate(curves), indices=np.repeat(np.arange(len(curves)), [len(c) for c in curves])
    )
    beyond, strips, widths = translated(lines.plate, drawn), [], []
    for i, (curve, outline) in enumerate(zip(curves, lines.outlines, strict=True)):
        ends_on = outline.arc.start_edge, outline.arc.end_edge
        met = [
            side
            for side, edge in zip(sides, EDGES, strict=True)
            if not (side.is_empty or edge in ends_on)
        ]
        others = np.concatenate([np.delete(drawn, i), met, *beyond])
        across = shapely.shortest_line(shapely.points(curve), shapely.multilinestrings(others))
        width = shapely.length(across)
        through_gel = shapely.length(shapely.intersection(across, gel)) > 0.9 * width
        both = np.flatnonzero(through_gel[:-1] & through_gel[1:])
        ends = shapely.get_coordinates(across).reshape(-1, 2, 2)
        strips.append(
            shapely.convex_hull(
                shapely.multipoints(np.concatenate([ends[both], ends[both + 1]], axis=1))
            )
        )
        widths.append(np.minimum(width[both], width[both + 1]))
    return np.concatenate(strips), np.concatenate(widths)


def across_regions(lines: Lines, spacing: float) -> tuple[np.ndarray, Float[np.ndarray, " m"]]:
    """Normal lines (m,) across the gel on either side of the interfaces, and lengths (m,), mm.

    They end where a region does, or ``REACH`` times the ``spacing`` away.
    """
    regions, found, every = (
        [_with_images(lines.plate, gel) for gel in lines.regions],
        [],
        OUTLINE_SEGMENTS // 2,
    )
    for interface in lines.interfaces:
        # an end lies on an edge, as its normal may
        inner = slice(None) if interface.closed else slice(1, -1)
        at, normals = interface.points[::every][inner], interface.normals(every)[inner]
        for sign, number in ((1.0, 0), (-1.0, interface.arc.hole + 1)):
            ends = np.stack([at, at + sign * REACH * spacing * normals], axis=1)
            inside = shapely.intersection(shapely.linestrings(ends), regions[number])
            parts, owner = shapely.get_parts(inside, return_index=True)
            near = shapely.distance(parts, shapely.points(at[owner])) < CLOSE * spacing
            found.append(parts[near & (shapely.length(parts) > CLOSE * spacing)])
    parts = np.concatenate(found)
    return parts, shapely.length(parts)


def shortest_lines(lines: Lines) -> Iterator[tuple[str, str, shapely.LineString]]:
    """(hole, hole or edge, line) of the shortest line across every ligament.

    Lines within one hole, and from a cut hole to an edge, are left out. Of a periodic cell images
    of the holes count, those of a hole itself too.
    """
    outlines = [
        (f"holes[{o.arc.hole}]", o.closed, shapely.LineString(o.line)) for o in lines.outlines
    ]
    edges = [
        (f"the {edge} edge", line)
        for edge, line in zip(EDGES, sides_of(lines.plate), strict=True)
        if not line.is_empty
    ]
    images = [
        (f"an image of {name}", image)
        for name, _, curve in outlines
        for image in translated(lines.plate, curve)
    ]
    for k, (name, closed, curve) in enumerate(outlines):
        others = (
            [(other, line) for other, _, line in outlines[k + 1 :] if other != name]
            + (edges if closed else [])
            + images
        )
        yield from ((name, other, shapely.shortest_line(curve, line)) for other, line in others)


def sides_of(plate: Plate) -> list[shapely.LineString]:
    """The sides of the plate, shapely LineStrings in the order of ``geometry.EDGES``.

    An empty one for a periodic edge.
    """
    w, h = plate.width / 2, plate.height / 2
    ends = {
        "left": [(-w, -h), (-w, h)],
        "right": [(w, -h), (w, h)],
        "bottom": [(-w, -h), (w, -h)],
        "top": [(-w, h), (w, h)],
    }
    return [
        shapely.LineString([] if plate.edges[edge] == "periodic" else ends[edge]) for edge in EDGES
    ]


def _with_images(plate, gel):
    """The polygon together with its images around a periodic plate."""
    images = translated(plate, gel)
    return shapely.union_all([gel, *images]) if images else gel
