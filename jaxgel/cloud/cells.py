"""Partition of the dry gel into integration cells: background squares clipped by the outlines.

Everything here is host NumPy on the reference plate and is run once per cloud. Vertices carry how
they move with the holes: they lie on an outline, on a segment between two outline vertices (where a
grid line cuts it), or follow the morph. A cell is a set of triangles; its contour is what is left
of their directed edges after opposite pairs cancel. If the vertices have symmetries of the square,
the cells have them too.
"""

import dataclasses
import functools
import itertools

import numpy as np
import shapely
from scipy.spatial import cKDTree

from .._types import Float, Int
from .edges import contour_edges, opposite_edges
from .images import symmetries_of
from .quadtree import Background
from .triangles import centroids, signed_areas, triangulate

# pieces below this fraction of their background square join the neighbour with the longest common
# edge
SLIVER = 0.3
SNAP = 1e-7  # points closer than this times the spacing are one vertex
EQUAL = 1e-6  # relative difference of two common edges that are equally long


@dataclasses.dataclass(frozen=True, eq=False)
class Partition:
    """Triangulated cells of the reference plate; all arrays NumPy."""

    vertices: Float[np.ndarray, "v 2"]
    """All vertices, background and outline vertices first, then cut points; mm."""
    cut_segments: Int[np.ndarray, " n_cut"]
    """Number of the outline segment on which each of the last n_cut vertices lies."""
    cut_fractions: Float[np.ndarray, " n_cut"]
    """Position of each cut point on its segment, 0 at the first end."""
    triangles: Int[np.ndarray, "t 3"]
    """Vertex numbers, anticlockwise."""
    cell_of_triangle: Int[np.ndarray, " t"]
    """Cell number of each triangle, 0 ... n_cells - 1."""
    region_of_cell: Int[np.ndarray, " c"]
    """Region of each cell: 0 outside the plate's regions, else the region's number plus one."""
    quadrilaterals: Int[np.ndarray, "k 2"]
    """Pairs of triangles integrated as one quadrilateral.

    They are halves of a parallelogram, or of what a mirror of its piece keeps.
    """

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return int(self.cell_of_triangle.max()) + 1

    @functools.cached_property
    def contour_edges(self) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, " e"]]:
        """Directed edges of all cell contours, gel on the left, and their cells."""
        return contour_edges(self.triangles, self.cell_of_triangle)


def partition(
    background: Background,
    outline_vertices: Float[np.ndarray, "o 2"],
    segments: Int[np.ndarray, "s 2"],
    regions: list[shapely.Geometry],
) -> Partition:
    """Partition of the polygons ``regions`` (shapely) by the background squares.

    The numbers of the fine ``outline_vertices`` (o, 2), between which the ``segments`` (s, 2) of
    all outlines lie, follow those of the background.
    """
    known, squares = np.concatenate([background.vertices, outline_vertices]), background.loops
    lines = shapely.STRtree(shapely.linestrings(known[segments]))
    # an array of arrays, also if all loops are equally long
    around = np.array([*squares, None], dtype=object)[:-1]
    corners = shapely.linearrings(
        known[np.concatenate(squares)],
        indices=np.repeat(np.arange(len(squares)), list(map(len, squares))),
    )
    boxes = shapely.polygons(corners)
    tolerance = SNAP * np.sqrt(np.median(shapely.area(boxes)))
    if len(regions) > 1:
        regions = [_on_grid_lines(gel, background.vertices, tolerance) for gel in regions]
    region = np.full(len(boxes), -1)  # of whole squares
    for number, gel in enumerate(regions):
        shapely.prepare(gel)
        region[shapely.covers(gel, boxes)] = number
    # a side may lie along an outline
    region[lines.query(boxes, predicate="dwithin", distance=tolerance)[0]] = -1
    whole, pieces = region >= 0, [_clip(boxes, np.flatnonzero(region < 0), gel) for gel in regions]
    square, owner = (
        np.concatenate([part[1] for part in pieces]),
        np.repeat(np.arange(len(regions)), [len(part[1]) for part in pieces]),
    )
    pieces = np.concatenate([part[0] for part in pieces])
    vertices, loops, cut_segments, cut_fractions = _number_vertices(
        pieces, known, segments, lines, tolerance
    )
    # others are thinner than the tolerance
    solid = np.array([len(np.unique(loop[0])) > 2 for loop in loops], dtype=bool)
    loops, square = (
        [[loop] for loop in around[whole]] + list(itertools.compress(loops, solid)),
        square[solid],
    )
    region = np.concatenate([region[whole], owner[solid]])  # of pieces
    used, images = np.unique(np.concatenate([ring for loop in loops for ring in loop])), []
    for _, image in symmetries_of(vertices[used], tolerance):
        images.append(np.zeros(len(vertices), dtype=int))
        images[-1][used] = used[image]
    triangles, piece_of_triangle, quadrilaterals = triangulate(vertices, loops, images)
    squares_area = shapely.area(np.concatenate([boxes[whole], boxes[square]]))
    cell_of_triangle = _merge_slivers(
        vertices, triangles, piece_of_triangle, squares_area, region, images
    )
    region_of_cell = np.zeros(cell_of_triangle.max() + 1, dtype=int)
    region_of_cell[cell_of_triangle] = region[piece_of_triangle]
    return Partition(
        vertices,
        cut_segments,
        cut_fractions,
        triangles,
        cell_of_triangle,
        region_of_cell,
        quadrilaterals,
    )


def _on_grid_lines(gel, background, tolerance):
    """The polygon snapped to grid coordinates within ``tolerance``.

    All pieces along a line then have one side.
    """

    def snapped(points):
        lines = [np.unique(along) for along in background.T]
        nearest = [
            line[cKDTree(line[:, None]).query(along[:, None])[1]]
            for line, along in zip(lines, points.T, strict=True)
        ]
        return np.where(np.abs(points.T - nearest) < tolerance, nearest, points.T).T

    return shapely.transform(gel, snapped)


def _clip(boxes, numbers, gel):
    """Pieces of gel in the boxes ``numbers``, shapely polygons, and the box (k,) of each."""
    numbers = numbers[shapely.intersects(gel, boxes[numbers])]
    parts, owner = shapely.get_parts(shapely.intersection(boxes[numbers], gel), return_index=True)
    square = numbers[owner]
    solid = (shapely.get_type_id(parts) == shapely.GeometryType.POLYGON) & (
        shapely.area(parts) > 1e-12 * shapely.area(boxes[square])
    )
    return parts[solid], square[solid]


def _number_vertices(pieces, known, segments, lines, tolerance):
    """Give every piece's vertices global numbers: known vertices first, then cuts by grid lines.

    Background vertices on an outline have no say: they would not follow it.
    """
    rings, owner = shapely.get_rings(pieces, return_index=True)
    coordinates, ring = shapely.get_coordinates(rings, return_index=True)
    on_outline = lines.query(shapely.points(known), predicate="dwithin", distance=tolerance)[0]
    usable = np.union1d(np.setdiff1d(np.arange(len(known)), on_outline), segments)
    distance, nearest = cKDTree(known[usable]).query(coordinates)
    number, fresh = usable[nearest], distance > tolerance
    first = np.arange(fresh.sum())  # of the points that coincide with each one
    for i, j in cKDTree(coordinates[fresh]).query_pairs(10 * tolerance):
        first[max(i, j)] = min(first[max(i, j)], first[min(i, j)])
    first, inverse = np.unique(first, return_inverse=True)
    cuts, number[fresh] = coordinates[fresh][first], len(known) + inverse
    cut_segments, cut_fractions = _locate_on_segments(cuts, known, segments, lines, tolerance)
    loops = [[] for _ in pieces]
    for piece, closed in zip(
        owner, np.split(number, np.flatnonzero(np.diff(ring)) + 1), strict=False
    ):
        loop = closed[:-1]
        loops[piece].append(loop[loop != np.roll(loop, 1)])
    return np.concatenate([known, cuts]), loops, cut_segments, cut_fractions


def _locate_on_segments(cuts, known, segments, lines, tolerance):
    """Number of the outline segment (n,) and fraction (n,) of each cut point."""
    _, nearest = lines.query_nearest(shapely.points(cuts), all_matches=False)
    ends = segments[nearest]
    along = known[ends[:, 1]] - known[ends[:, 0]]
    fraction = np.einsum("ni,ni->n", cuts - known[ends[:, 0]], along) / np.einsum(
        "ni,ni->n", along, along
    )
    off = np.abs(known[ends[:, 0]] + fraction[:, None] * along - cuts).max(initial=0.0)
    if off > 100 * tolerance:
        raise RuntimeError(
            f"partition: a clipped vertex lies {off:.1e} off every hole outline; please report "
            "this plate"
        )
    return nearest, fraction


def _merge_slivers(vertices, triangles, piece_of_triangle, square_area, region, images):
    """Cell numbers (t,) after small pieces joined a neighbour, smallest piece first.

    The neighbour is that of their region with the longest common edge. The images of a piece do as
    it does; between two neighbours that a mirror exchanges it joins none.
    """
    areas = signed_areas(vertices, triangles)
    area = np.bincount(piece_of_triangle, areas)
    small = area < SLIVER * square_area
    root = np.arange(len(area))
    edges, owner = contour_edges(triangles, piece_of_triangle)
    beyond, length = (
        opposite_edges(edges),
        np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1),
    )
    common = {}  # small piece -> [(neighbour, length of a common edge)]
    for edge in np.flatnonzero((beyond >= 0) & small[owner]):
        common.setdefault(owner[edge], []).append((owner[beyond[edge]], length[edge]))
    tree = cKDTree(centroids(vertices, triangles, areas, piece_of_triangle))
    moves = [
        tree.query(centroids(vertices, image[triangles], areas, piece_of_triangle))[1]
        for image in images
        if small.any()
    ]
    done = np.zeros(len(area), dtype=bool)
    for piece in np.flatnonzero(small)[np.argsort(area[small])]:
        if done[piece] or area[piece] >= SLIVER * square_area[piece]:
            continue  # an image of it has joined, or others joined it
        lengths = {}
        for other, length in common.get(piece, ()):
            if root[other] != root[piece] and region[other] == region[piece]:
                lengths[root[other]] = lengths.get(root[other], 0.0) + length
        if not lengths:
            continue
        host = max(lengths, key=lengths.get)
        rivals = [int(root[move[host]]) for move in moves if move[piece] == piece]
        if any(
            rival != host and lengths.get(rival, 0.0) > (1 - EQUAL) * lengths[host]
            for rival in rivals
        ):
            continue
        for move in [np.arange(len(area)), *moves]:
            done[move[piece]] = True
            one, two = root[move[piece]], root[move[host]]
            if one != two:
                area[two] += area[one]
                root[root == one] = two
    return np.unique(root[piece_of_triangle], return_inverse=True)[1]
