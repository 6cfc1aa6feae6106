"""Fine outlines of the holes, along which nodes and cell vertices lie; host NumPy on the reference plate."""

import dataclasses
import functools

import numpy as np
import shapely

from .._types import Bool, Float, Int
from ..geometry import Arc, Plate, arc_points, arcs, equal_arc_length, outline_points, stretches
from .quadtree import Background

OUTLINE_SEGMENTS = 8  # fine outline segments between two neighbouring outline nodes
SNAP = 1e-7  # points closer than this times the spacing are one vertex
CROWDED = 1.15  # outline nodes to a side of a square beyond which no pressure holds their motions; the paper's clouds have up to 1.11


@dataclasses.dataclass(frozen=True, eq=False)
class Outline:
    """One arc of a hole's boundary in the cloud; hashed by identity."""

    arc: Arc
    """The arc."""
    s: Float[np.ndarray, " m"]
    """Position of the fine outline vertices along the arc, 0 ... 1."""
    vertices: Int[np.ndarray, " m"]
    """Their vertex numbers; every ``OUTLINE_SEGMENTS``-th one is a node."""

    @property
    def closed(self) -> bool:
        """Whether the arc is a whole hole."""
        return self.arc.closed


def fine_outlines(
    plate: Plate, nodes_per_hole: int | None, background: Background, offset: int
) -> tuple[tuple[Outline, ...], Float[np.ndarray, "o 2"]]:
    """The fine outline of every arc, its vertices numbered from ``offset``, and its points (o, 2).

    Intervals between nodes are halved as the squares are. Without ``nodes_per_hole`` they are about as long as the sides of the squares.
    A side between two corners has at least one.
    """
    found, lines, side = [], [], background.side.max()
    for arc in arcs(plate):
        points = functools.partial(arc_points, plate, arc)
        if nodes_per_hole is None:
            intervals = _intervals_of_length(side, plate, arc)
        else:
            intervals = max(2, round(nodes_per_hole * _fraction_of_hole(plate, arc)), stretches(plate, arc))
        ends = equal_arc_length(plate, arc, intervals)
        ends = np.append(ends, ends[0] + 1.0) if arc.closed else ends
        for halvings in range(len(background.halved)):
            at = np.linspace(ends[:-1], ends[1:], OUTLINE_SEGMENTS + 1)
            depth = background.halvings(np.asarray(points(at.ravel()))).reshape(at.shape).max(axis=0)
            ends = np.sort(np.append(ends, at[OUTLINE_SEGMENTS // 2, depth > halvings]))
        steps = np.arange(OUTLINE_SEGMENTS) / OUTLINE_SEGMENTS
        fine = (ends[:-1, None] + steps * np.diff(ends)[:, None]).ravel()
        fine = fine if arc.closed else np.append(fine, ends[-1])
        found.append(Outline(arc, fine, offset + np.arange(len(fine))))
        lines.append(np.asarray(points(fine)))
        offset += len(fine)
    return tuple(found), join(lines, float)


def join(parts: list[np.ndarray], dtype: type) -> np.ndarray:
    """Arrays (k, 2) one after the other; (0, 2) for none."""
    return np.concatenate([np.zeros((0, 2), dtype), *parts])


def loop(outline: Outline) -> Int[np.ndarray, " m"]:
    """Vertex numbers along the outline; the first one again at the end of a closed one."""
    return np.append(outline.vertices, outline.vertices[0]) if outline.closed else outline.vertices


def points_and_normals(
    line: Outline, points: Float[np.ndarray, "o 2"], offset: int, every: int
) -> tuple[Float[np.ndarray, "k 2"], Float[np.ndarray, "k 2"]]:
    """Every so many points (k, 2) of a line, numbered from ``offset`` among ``points``, and the unit normals (k, 2) out of its hole."""
    fine = points[line.vertices - offset]
    tangents = (np.roll(fine, -1, axis=0) - np.roll(fine, 1, axis=0)) if line.closed else np.gradient(fine, axis=0)
    tangents = tangents[::every]
    return fine[::every], np.stack([tangents[:, 1], -tangents[:, 0]], axis=1) / np.linalg.norm(tangents, axis=1, keepdims=True)


def on_lines(
    lines: tuple[Outline, ...],
    points: Float[np.ndarray, "o 2"],
    offset: int,
    where: Float[np.ndarray, "p 2"],
    tolerance: float,
) -> Bool[np.ndarray, " p"]:
    """Whether each place (p, 2) is within ``tolerance`` mm of one of the lines, whose ``points`` (o, 2) are numbered from ``offset``."""
    if not lines:
        return np.zeros(len(where), dtype=bool)
    own = shapely.multilinestrings([shapely.LineString(points[loop(line) - offset]) for line in lines])
    shapely.prepare(own)
    return shapely.dwithin(own, shapely.points(where), tolerance)


def renumbered(outline: Outline, by: int) -> Outline:
    """The outline with ``by`` added to its vertex numbers."""
    return dataclasses.replace(outline, vertices=outline.vertices + by)


def _intervals_of_length(length, plate, arc):
    """Number of intervals of about this ``length`` on an arc, four or a multiple of it on a closed one."""
    hole = plate.holes[arc.hole]
    along = _length(np.asarray(outline_points(hole, np.linspace(arc.start, arc.end, 4001))))
    sides = sum(arc.start - 1e-9 < corner + turn < arc.end + 1e-9 for corner in hole.corners for turn in (0, 1))
    return max(2 * sides, 4 * max(2, round(along / length / 4))) if arc.closed else max(2, 2 * sides, round(along / length))


def _fraction_of_hole(plate, arc):
    """Length of the arc over the length of its whole hole's outline."""
    hole = plate.holes[arc.hole]
    whole = np.asarray(outline_points(hole, np.linspace(0.0, 1.0, 4001)))
    part = np.asarray(outline_points(hole, np.linspace(arc.start, arc.end, 4001)))
    return _length(part) / _length(whole)


def _length(line):
    return np.linalg.norm(np.diff(line, axis=0), axis=1).sum()


def gel_polygon(plate: Plate, outlines: tuple[Outline, ...], outline_vertices: Float[np.ndarray, "o 2"], offset: int) -> shapely.Geometry:
    """The dry gel as a shapely polygon: the plate less each hole's fine polygon, continued outside the plate for cut holes."""
    return shapely.difference(_box(plate), shapely.union_all(_polygons(plate, outlines, outline_vertices, offset)))


def region_polygons(
    plate: Plate, outlines: tuple[Outline, ...], interfaces: tuple[Outline, ...], vertices: Float[np.ndarray, "o 2"], offset: int
) -> list[shapely.Geometry]:
    """The dry gel of every region as shapely polygons, first that outside all of them; ``vertices`` (o, 2) are those of both."""
    gel = gel_polygon(plate, outlines, vertices, offset)
    own = _polygons(plate.with_regions_as_holes, interfaces, vertices, offset)
    return [shapely.difference(gel, shapely.union_all(own)), *(shapely.intersection(gel, polygon) for polygon in own)]


def _box(plate):
    return shapely.box(-plate.width / 2, -plate.height / 2, plate.width / 2, plate.height / 2)


def _polygons(plate, outlines, outline_vertices, offset):
    """The fine polygon of every hole."""
    rings = []
    for k, hole in enumerate(plate.holes):
        own = [o for o in outlines if o.arc.hole == k]
        if own and own[0].closed:
            rings.append(shapely.Polygon(outline_vertices[own[0].vertices - offset]))
            continue
        ring = []
        for this, following in zip(own, own[1:] + own[:1], strict=True):
            ring.append(outline_vertices[this.vertices - offset])
            stop = following.arc.start + (following.arc.start <= this.arc.end - 1e-12 or len(own) == 1)
            outside = np.union1d(np.linspace(this.arc.end, stop, 66)[1:-1], _between(hole.corners, this.arc.end, stop))
            ring.append(np.asarray(outline_points(hole, outside % 1.0)))
        rings.append(shapely.Polygon(np.concatenate(ring)))
    return rings


def _between(corners, start, end):
    """The parameters of the corners between ``start`` and ``end``, which may be above 1."""
    return [corner + turn for corner in corners for turn in (0, 1) if start + 1e-9 < corner + turn < end - 1e-9]


def intervals(nodes: Float[np.ndarray, "m 2"]) -> tuple[np.ndarray, Float[np.ndarray, " m-1"]]:
    """The intervals between the ``nodes`` along an outline, shapely LineStrings, and the largest side of the squares around them, mm."""
    ends = np.stack([nodes[:-1], nodes[1:]], axis=1)
    return shapely.linestrings(ends), CROWDED * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
