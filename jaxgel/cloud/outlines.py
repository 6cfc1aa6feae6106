"""Outlines of holes and regions in a plate, sampled: along them nodes and cell vertices lie.

Host NumPy on the reference plate. Interfaces are the outlines of regions with a material of their
own. The gradient of the displacement jumps across them, so that either side has shape functions of
its own nodes, and of those on the interface, which belong to both. Between these nodes an interface
is a curve of third degree through four of them, two on either side if no corner is nearer. Its
points are sums of node positions, and the same sums of nodal values are the one trace that fields
have from both sides.
"""

import dataclasses
import itertools

import numpy as np
import scipy.sparse as sp
import shapely

from .._sizes import at_numbers
from .._types import Bool, Float, Int
from ..geometry import (
    Arc,
    Hole,
    Plate,
    arc_points,
    arcs,
    corners_between,
    equal_arc_length,
    outline_points,
)
from .quadtree import Background

OUTLINE_SEGMENTS = 8  # fine outline segments between two neighbouring outline nodes
# outline nodes to a side of a square beyond which no pressure holds their motions; the paper's
# clouds have up to 1.11
CROWDED = 1.15
STENCIL = 4  # nodes of a curve of third degree
SAME = 1e-9  # difference of two shares of an arc that are the same


@dataclasses.dataclass(frozen=True, eq=False)
class Outline:
    """One arc of the outline of a hole or region in the cloud; hashed by identity."""

    arc: Arc
    """The arc."""
    hole: Hole
    """The hole, or the region, on the reference plate."""
    s: Float[np.ndarray, " m"]
    """Position of the fine outline vertices along the arc, 0 ... 1.

    Every ``OUTLINE_SEGMENTS``-th one is a node.
    """
    points: Float[np.ndarray, "m 2"]
    """The fine outline vertices on the reference plate, mm."""
    trace: sp.csr_array | None = None
    """Matrix (m, k) from values at the nodes of an interface to its fine vertices.

    None for the outline of a hole.
    """
    first: int = 0
    """Number of its first vertex."""

    @property
    def closed(self) -> bool:
        """Whether the arc is a whole hole."""
        return self.arc.closed

    @property
    def vertices(self) -> Int[np.ndarray, " m"]:
        """Numbers of the fine outline vertices."""
        return self.first + np.arange(len(self.s))

    @property
    def nodes(self) -> Int[np.ndarray, " k"]:
        """Numbers of the vertices that are nodes."""
        return self.vertices[::OUTLINE_SEGMENTS]

    @property
    def line(self) -> Float[np.ndarray, "_ 2"]:
        """The points along the outline; the first one again at the end of a closed one."""
        return np.concatenate([self.points, self.points[:1]]) if self.closed else self.points

    def normals(self, every: int) -> Float[np.ndarray, "k 2"]:
        """Unit normals (k, 2) out of the hole at every so many points."""
        fine = self.points
        tangents = (
            (np.roll(fine, -1, axis=0) - np.roll(fine, 1, axis=0))
            if self.closed
            else np.gradient(fine, axis=0)
        )
        tangents = tangents[::every]
        return np.stack([tangents[:, 1], -tangents[:, 0]], axis=1) / np.linalg.norm(
            tangents, axis=1, keepdims=True
        )


def loop(outline: Outline) -> Int[np.ndarray, " m"]:
    """Vertex numbers along the outline; the first one again at the end of a closed one."""
    return np.append(outline.vertices, outline.first) if outline.closed else outline.vertices


@dataclasses.dataclass(frozen=True, eq=False)
class Lines:
    """All sampled outlines of a plate."""

    plate: Plate
    """The reference plate, in the frame that is computed."""
    outlines: tuple[Outline, ...]
    """The ``Outline`` of every arc of a hole, hole by hole."""
    interfaces: tuple[Outline, ...]
    """The same of the regions; their vertices follow those of the holes."""
    gel: shapely.Geometry
    """The dry gel as a shapely polygon: the plate less each hole's fine polygon."""
    regions: list[shapely.Geometry]
    """The dry gel of every region as shapely polygons, first that outside all of them."""

    @property
    def both(self) -> tuple[Outline, ...]:
        """Outlines and interfaces."""
        return self.outlines + self.interfaces

    def halved(self, background: Background) -> "Lines":
        """The lines with intervals between nodes halved as the squares around them are."""
        inner = self.plate.with_regions_as_holes
        outlines = [(o.arc, _halved(self.plate, o, background)) for o in self.outlines]
        return _lines(
            self.plate, outlines, [(o.arc, _halved(inner, o, background)) for o in self.interfaces]
        )

    def numbered(self, first: int) -> "Lines":
        """The lines with their vertices numbered from ``first`` on."""
        starts, k = (
            np.cumsum([first, *(len(line.s) for line in self.both)]).tolist(),
            len(self.outlines),
        )
        lines = tuple(
            dataclasses.replace(line, first=start)
            for line, start in zip(self.both, starts[:-1], strict=True)
        )
        return dataclasses.replace(self, outlines=lines[:k], interfaces=lines[k:])


def sample_lines(plate: Plate, nodes_per_hole: int, side: float) -> Lines:
    """The ``Lines`` of a plate with ``nodes_per_hole`` on each whole hole.

    Nodes on interfaces are about a ``side`` of a square (mm) apart. A side between two corners has
    at least one interval.
    """
    inner = plate.with_regions_as_holes
    outlines = [
        (arc, _ends(plate, arc, _intervals_of_hole(nodes_per_hole, plate, arc)))
        for arc in arcs(plate)
    ]
    return _lines(
        plate,
        outlines,
        [(arc, _ends(inner, arc, _intervals_of_length(side, inner, arc))) for arc in arcs(inner)],
    )


def _lines(plate, outlines, interfaces):
    """``Lines`` from pairs of an arc and the shares of it at which intervals between nodes end."""
    inner, box = (
        plate.with_regions_as_holes,
        shapely.box(-plate.width / 2, -plate.height / 2, plate.width / 2, plate.height / 2),
    )
    outlines, interfaces = (
        tuple(_outline(plate, *each) for each in outlines),
        tuple(_interface(inner, *each) for each in interfaces),
    )
    gel, own = (
        shapely.difference(box, shapely.union_all(_polygons(outlines))),
        _polygons(interfaces),
    )
    regions = [
        shapely.difference(gel, shapely.union_all(own)),
        *(shapely.intersection(gel, polygon) for polygon in own),
    ]
    shapely.prepare(regions)
    return Lines(plate, outlines, interfaces, gel, regions)


@dataclasses.dataclass(frozen=True, eq=False)
class Curves:
    """The fine segments of outlines, two to a parabola, which are curved sides of cells.

    Its points are sums of its three vertices.
    """

    ends: Int[np.ndarray, "s 2"]
    """Vertex numbers of the ends of each segment."""
    vertices: Int[np.ndarray, "s 3"]
    """Vertex numbers of its parabola."""
    start: Float[np.ndarray, " s"]
    """Parameter of its first end on the parabola: 0 or 1/2."""

    def points(
        self, segment: Int[np.ndarray, " p"], fraction: Float[np.ndarray, " p"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Vertex numbers, weights (p, 3) of the points at a ``fraction`` of their ``segment``."""
        t = self.start[segment] + fraction / 2
        return self.vertices[segment], np.stack(
            [(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)], axis=-1
        )


def curves_of(outlines: tuple[Outline, ...]) -> Curves:
    """``Curves`` of all outlines."""
    lines = [loop(outline) for outline in outlines]
    first = [np.arange(len(line) - 1) // 2 * 2 for line in lines]
    ends = np.concatenate(
        [np.zeros((0, 2), int), *(np.stack([line[:-1], line[1:]], axis=1) for line in lines)]
    )
    vertices = np.concatenate(
        [
            np.zeros((0, 3), int),
            *(line[k[:, None] + np.arange(3)] for line, k in zip(lines, first, strict=True)),
        ]
    )
    return Curves(
        ends, vertices, np.concatenate([np.zeros(0), *(np.arange(len(k)) % 2 / 2 for k in first)])
    )


def on_lines(
    lines: tuple[Outline, ...], where: Float[np.ndarray, "p 2"], tolerance: float
) -> Bool[np.ndarray, " p"]:
    """Whether each place (p, 2) is within ``tolerance`` mm of one of the lines."""
    if not lines:
        return np.zeros(len(where), dtype=bool)
    own = shapely.multilinestrings([shapely.LineString(line.line) for line in lines])
    shapely.prepare(own)
    return shapely.dwithin(own, shapely.points(where), tolerance)


def intervals(line: Outline) -> tuple[np.ndarray, Float[np.ndarray, " _"]]:
    """Intervals between a line's nodes, LineStrings, and the largest squares around them, mm.

    That is the side of the squares.
    """
    nodes = line.line[::OUTLINE_SEGMENTS]
    ends = np.stack([nodes[:-1], nodes[1:]], axis=1)
    return shapely.linestrings(ends), CROWDED * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


def _ends(plate, arc, count):
    """The ends of ``count`` intervals of equal length along an arc.

    The last one of a closed arc is the first, a turn on.
    """
    ends = equal_arc_length(plate, arc, count)
    return np.append(ends, ends[0] + 1.0) if arc.closed else ends


def _halved(plate, line, background):
    """The ends of the intervals of a line, halved as the squares are."""
    ends = line.s[::OUTLINE_SEGMENTS]
    ends = np.append(ends, ends[0] + 1.0) if line.closed else ends
    for halvings in range(len(background.halved)):
        at = np.linspace(ends[:-1], ends[1:], OUTLINE_SEGMENTS + 1)
        depth = (
            background.halvings(np.asarray(arc_points(plate, line.arc, at.ravel())))
            .reshape(at.shape)
            .max(axis=0)
        )
        ends = np.sort(np.append(ends, at[OUTLINE_SEGMENTS // 2, depth > halvings]))
    return ends


def _outline(plate, arc, ends):
    """The ``Outline`` of an arc with nodes at the shares ``ends``."""
    fine = (
        ends[:-1, None] + np.arange(OUTLINE_SEGMENTS) / OUTLINE_SEGMENTS * np.diff(ends)[:, None]
    ).ravel()
    fine = fine if arc.closed else np.append(fine, ends[-1])
    return Outline(arc, plate.holes[arc.hole], fine, np.asarray(arc_points(plate, arc, fine)))


def _interface(regions, arc, ends):
    """The ``Outline`` of an arc of a region with the points of the curves through its nodes."""
    line = _outline(regions, arc, ends)
    trace = _trace(line)
    return dataclasses.replace(
        line,
        points=trace @ np.asarray(arc_points(regions, arc, line.s[::OUTLINE_SEGMENTS])),
        trace=trace,
    )


def _intervals_of_hole(nodes_per_hole, plate, arc):
    """Number of intervals of an arc of a hole that has ``nodes_per_hole`` as a whole."""
    hole = plate.holes[arc.hole]
    share = _length(hole, arc.start, arc.end) / _length(hole, 0.0, 1.0)
    return max(2, round(nodes_per_hole * share), len(corners_between(hole, arc.start, arc.end)) + 1)


def _intervals_of_length(length, plate, arc):
    """Number of intervals of about this ``length`` on an arc; a multiple of four if closed."""
    hole = plate.holes[arc.hole]
    along = _length(hole, arc.start, arc.end)
    sides = sum(
        arc.start - 1e-9 < corner + turn < arc.end + 1e-9
        for corner in hole.corners
        for turn in (0, 1)
    )
    return (
        max(2 * sides, 4 * max(2, round(along / length / 4)))
        if arc.closed
        else max(2, 2 * sides, round(along / length))
    )


def _length(hole, start, end):
    """Length of an outline from t = ``start`` to ``end``, mm, by chords."""
    return np.linalg.norm(
        np.diff(at_numbers(outline_points, hole, np.linspace(start, end, 4001)), axis=0), axis=1
    ).sum()


def _polygons(lines):
    """The fine polygon of every hole, continued outside the plate for cut holes."""
    found = []
    for _, of_hole in itertools.groupby(lines, key=lambda line: line.arc.hole):
        own, ring = list(of_hole), []
        for this, following in zip(own, own[1:] + own[:1], strict=True):
            ring.append(this.points)
            if not this.closed:
                stop = following.arc.start + (
                    following.arc.start <= this.arc.end - 1e-12 or len(own) == 1
                )
                outside = np.union1d(
                    np.linspace(this.arc.end, stop, 66)[1:-1],
                    corners_between(this.hole, this.arc.end, stop),
                )
                ring.append(at_numbers(outline_points, this.hole, outside % 1.0))
        found.append(shapely.Polygon(np.concatenate(ring)))
    return found


def _trace(line):
    """The ``trace`` of an interface."""
    turns = np.add.outer(np.asarray(line.hole.corners), [0.0, 1.0]).ravel()
    shares = (turns - line.arc.start) / (line.arc.end - line.arc.start)
    nodes = line.s[::OUTLINE_SEGMENTS]
    count, period = len(nodes), 1.0 if line.closed else np.inf
    kinks = np.flatnonzero([np.any(np.abs(shares - s) < SAME) for s in nodes])
    rows, columns, values = [], [], []
    for k, s in enumerate(line.s):
        first = k // OUTLINE_SEGMENTS
        own = [first] if k % OUTLINE_SEGMENTS == 0 else _stencil(first, count, line.closed, kinks)
        at = nodes[np.mod(own, count)] + np.floor_divide(own, count) * (
            period if line.closed else 0.0
        )
        rows += [k] * len(own)
        columns += list(np.mod(own, count))
        apart = at[:, None] - at[None, :]  # the weights are those of Lagrange's polynomials
        values += list(
            np.where(apart == 0, 1.0, (s - at)[None, :] / np.where(apart == 0, 1.0, apart)).prod(
                axis=1
            )
        )
    return sp.csr_array((values, (rows, columns)), shape=(len(line.s), count))


def _stencil(first, count, closed, kinks):
    """Numbers of up to ``STENCIL`` nodes around the interval at ``first``, none beyond a corner.

    On a closed line they may be negative, or ``count`` and more.
    """
    low, high = (-np.inf, np.inf) if closed else (0, count - 1)
    around = np.concatenate([kinks - count, kinks, kinks + count]) if closed else kinks
    low = max([low, *around[around <= first]])
    high = min([high, *around[around > first]])
    size = int(min(STENCIL, high - low + 1, count))
    start = int(min(max(first - (size - 2) // 2, low), high - size + 1))
    return list(range(start, start + size))
