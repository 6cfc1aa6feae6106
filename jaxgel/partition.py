"""Partition of the dry gel into integration cells: background squares clipped by a fine polygon along the true hole outlines.

Everything here is host NumPy on the reference plate and is run once per cloud. Vertices carry how they move with the holes:
they lie on an outline, on a chord between two outline vertices (where a grid line cuts it), or follow the morph. A cell is a set
of triangles; its contour is what is left of their directed edges after opposite pairs cancel.
"""

import dataclasses
import functools

import numpy as np
import shapely
from scipy.spatial import cKDTree

SLIVER = 0.3  # pieces below this fraction of their background square join the neighbour with the longest common edge
SNAP = 1e-7  # points closer than this times the spacing are one vertex


@dataclasses.dataclass(frozen=True, eq=False)
class Partition:
    """Triangulated cells of the reference plate; all arrays NumPy."""

    vertices: np.ndarray
    """(v, 2) all vertices, background and outline vertices first, then cut points; mm."""
    cut_ends: np.ndarray
    """(n_cut, 2) vertex numbers of the two ends of the outline segment on which the last n_cut vertices lie."""
    cut_fractions: np.ndarray
    """(n_cut,) position of each cut point on its segment, 0 at the first end."""
    triangles: np.ndarray
    """(t, 3) vertex numbers, anticlockwise."""
    cell_of_triangle: np.ndarray
    """(t,) cell number of each triangle, 0 ... n_cells - 1."""

    @property
    def n_cells(self):
        """Number of cells (int)."""
        return int(self.cell_of_triangle.max()) + 1

    @functools.cached_property
    def contour_edges(self):
        """Directed edges of all cell contours, (e, 2) vertex numbers, with the gel on the left, and their cells (e,)."""
        return _contour_edges(self.triangles, self.cell_of_triangle)


def partition(background, squares, outline_loops, outline_vertices, gel):
    """Partition of the polygon ``gel`` (shapely) by the background squares.

    ``background`` (b, 2) are grid vertices, ``squares`` a list of vertex loops into it (anticlockwise, hanging vertices included),
    ``outline_vertices`` (o, 2) the fine outline vertices, ``outline_loops`` their segments (s, 2) as numbers into it.
    """
    known = np.concatenate([background, outline_vertices])
    size = np.sqrt(np.median([shapely.Polygon(background[loop]).area for loop in squares[:: max(1, len(squares) // 50)]]))
    pieces, squares_area = _clip(background, squares, gel)
    segments = np.asarray(outline_loops, dtype=int).reshape(-1, 2) + len(background)
    vertices, loops, cut_ends, cut_fractions = _number_vertices(pieces, known, segments, SNAP * size)
    triangles, piece_of_triangle = _triangulate(vertices, loops)
    cell_of_triangle = _merge_slivers(vertices, triangles, piece_of_triangle, squares_area)
    return Partition(vertices, cut_ends, cut_fractions, triangles, cell_of_triangle)


def _clip(background, squares, gel):
    """Pieces of gel in each square, as shapely polygons with all background vertices kept, and their squares' areas."""
    boxes = np.array([shapely.Polygon(background[loop]) for loop in squares])
    shapely.prepare(gel)
    whole = shapely.covers(gel, boxes)
    cut = ~whole & shapely.intersects(gel, boxes)
    shapely.prepare(boxes[cut])
    pieces, areas = list(boxes[whole]), list(shapely.area(boxes[whole]))
    for box, piece in zip(boxes[cut], shapely.intersection(boxes[cut], gel), strict=True):
        for part in shapely.get_parts(piece):
            if part.geom_type == "Polygon" and part.area > 1e-12 * box.area:
                pieces.append(part)
                areas.append(box.area)
    return pieces, np.array(areas)


def _number_vertices(pieces, known, segments, tolerance):
    """Give every piece's vertices global numbers: known vertices first, the rest are cuts of outline segments by grid lines."""
    rings = [[np.asarray(ring.coords)[:-1] for ring in (p.exterior, *p.interiors)] for p in pieces]
    coordinates = np.concatenate([ring for piece in rings for ring in piece])
    distance, number = cKDTree(known).query(coordinates)
    fresh = distance > tolerance
    cuts, inverse = _unique_points(coordinates[fresh], tolerance)
    number[fresh] = len(known) + inverse
    cut_ends, cut_fractions = _locate_on_segments(cuts, known, segments, tolerance)

    loops, start = [], 0
    for piece in rings:
        numbered = []
        for ring in piece:
            loop = number[start : start + len(ring)]
            start += len(ring)
            numbered.append(loop[loop != np.roll(loop, 1)])
        loops.append(numbered)
    return np.concatenate([known, cuts]), loops, cut_ends, cut_fractions


def _unique_points(points, tolerance):
    """Representatives (u, 2) of clusters of coinciding points and the cluster (n,) of each point."""
    if len(points) == 0:
        return np.zeros((0, 2)), np.zeros(0, dtype=int)
    first = np.arange(len(points))
    for i, j in cKDTree(points).query_pairs(10 * tolerance):
        first[max(i, j)] = min(first[max(i, j)], first[min(i, j)])
    representatives, inverse = np.unique(first, return_inverse=True)
    return points[representatives], inverse


def _locate_on_segments(cuts, known, segments, tolerance):
    """Outline segment (n, 2) and fraction (n,) of each cut point."""
    if len(cuts) == 0:
        return np.zeros((0, 2), dtype=int), np.zeros(0)
    lines = shapely.linestrings(known[segments])
    _, nearest = shapely.STRtree(lines).query_nearest(shapely.points(cuts), all_matches=False)
    ends = segments[nearest]
    along = known[ends[:, 1]] - known[ends[:, 0]]
    fraction = np.einsum("ni,ni->n", cuts - known[ends[:, 0]], along) / np.einsum("ni,ni->n", along, along)
    off = np.abs(known[ends[:, 0]] + fraction[:, None] * along - cuts).max()
    if off > 100 * tolerance:
        raise RuntimeError(f"partition: a clipped vertex lies {off:.1e} off every hole outline; please report this plate")
    return ends, fraction


def _triangulate(vertices, loops):
    """Constrained Delaunay triangles (t, 3) of every piece, anticlockwise, and their pieces (t,)."""
    polygons = np.array([shapely.Polygon(vertices[loop[0]], [vertices[hole] for hole in loop[1:]]) for loop in loops])
    triangles, owner = [], []
    for piece, (loop, polygon) in enumerate(zip(loops, polygons, strict=True)):
        if len(loop) == 1 and len(loop[0]) == 4 and polygon.area > 0.999 * polygon.minimum_rotated_rectangle.area:
            a, b, c, d = loop[0]
            found = [(a, b, c), (a, c, d)]
        else:
            number = {tuple(vertices[i]): i for ring in loop for i in ring}
            parts = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
            found = [tuple(number[tuple(xy)] for xy in np.asarray(t.exterior.coords)[:-1]) for t in parts]
        triangles += found
        owner += [piece] * len(found)
    triangles = np.array(triangles)
    negative = _signed_areas(vertices, triangles) < 0
    triangles[negative] = triangles[negative][:, ::-1]
    return triangles, np.array(owner)


def _merge_slivers(vertices, triangles, piece_of_triangle, square_area):
    """Cell numbers (t,) after small pieces joined the neighbour with the longest common edge, smallest piece first."""
    n_pieces = piece_of_triangle.max() + 1
    area = np.bincount(piece_of_triangle, _signed_areas(vertices, triangles), n_pieces)
    edges, owner = _contour_edges(triangles, piece_of_triangle)
    length = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    opposite = {tuple(edge): piece for edge, piece in zip(edges, owner, strict=True)}
    common = [{} for _ in range(n_pieces)]
    for (i, j), piece, size in zip(edges, owner, length, strict=True):
        other = opposite.get((j, i))
        if other is not None:
            common[piece][other] = common[piece].get(other, 0.0) + size

    root = np.arange(n_pieces)
    for piece in np.argsort(area):
        if area[piece] >= SLIVER * square_area[piece]:
            continue
        neighbours = {}
        for other, size in common[piece].items():
            if root[other] != root[piece]:
                neighbours[root[other]] = neighbours.get(root[other], 0.0) + size
        if neighbours:
            host = max(neighbours, key=neighbours.get)
            area[host] += area[root[piece]]
            root[root == root[piece]] = host
    return np.unique(root[piece_of_triangle], return_inverse=True)[1]


def _contour_edges(triangles, owner):
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    owners = np.tile(owner, 3)
    n = triangles.max() + 1
    key = (owners * n + edges[:, 0]) * n + edges[:, 1]
    reverse = (owners * n + edges[:, 1]) * n + edges[:, 0]
    outer = ~np.isin(reverse, key)
    order = np.argsort(owners[outer], kind="stable")
    return edges[outer][order], owners[outer][order]


def _signed_areas(vertices, triangles):
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return 0.5 * ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))
