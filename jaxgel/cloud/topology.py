"""The topology of a cloud: its nodes, cells, outlines and interfaces on the reference plate, with what follows from them. Host NumPy."""

import dataclasses
import functools

import numpy as np
import scipy.sparse as sp
import shapely
from scipy.spatial import cKDTree

from .._types import Float, Int
from ..geometry import Frame, Plate, check_plate, edge_lines, frame_of, inside_holes, periods
from .cells import Partition, partition
from .checks import check_ligaments, check_sizes
from .clearance import with_clearance
from .curves import Curves, curves_of, interface_traces, interpolation_along, make_interfaces, middles
from .ligaments import across_regions, ligaments
from .morph import Morph, make_morph
from .outlines import OUTLINE_SEGMENTS, SNAP, Outline, fine_outlines, intervals, join, loop, on_lines, region_polygons, renumbered
from .quadrature import Quadrature, cell_quadrature
from .quadtree import Background, make_background, with_images

SQUARES_ACROSS = 2  # least number across a region: with the nodes on its outline three lines of nodes, for quadratic shape functions
GRADING = 0.75  # slope of the node spacing between large squares and small ones


@dataclasses.dataclass(frozen=True, eq=False)
class Topology:
    """What does not move with the holes; NumPy arrays, hashed by identity."""

    plate: Plate
    """The reference plate, in the ``frame`` that is computed."""
    given: Plate
    """The reference plate as given; the same unless an edge of a periodic cell was moved, see `geometry.frame_of`."""
    frame: Frame
    """Where the plate lies on the given one; all positions here are those in this frame."""
    spacing: float
    """Distance of the background nodes, mm."""
    nodes_per_hole: int
    """Nodes on the outline of each whole hole."""
    across: int | None
    """Nodes asked for across every ligament; None for no refinement."""
    background: Background
    """The background squares; their vertices come first, outline vertices follow them, cut points come last."""
    partition: Partition
    """Cells of the reference plate."""
    outlines: tuple[Outline, ...]
    """The ``Outline`` of every arc."""
    interfaces: tuple[Outline, ...]
    """The same of the outlines of regions; their vertices follow those of the holes."""
    node_regions: Int[np.ndarray, "n 2"]
    """The regions that each node belongs to, numbered as those of cells: two on an interface, otherwise twice the same."""
    node_vertices: Int[np.ndarray, " n"]
    """Vertex number of each node."""
    node_spacing: Float[np.ndarray, " n"]
    """Local distance of the nodes, mm; a node's support is dmax times this."""
    edge_nodes: dict[str, Int[np.ndarray, " _"]]
    """Edge of the plate -> numbers of the nodes on it, in order along it."""

    @property
    def n_background(self) -> int:
        """Number of background vertices."""
        return len(self.background.vertices)

    @functools.cached_property
    def free_edge_nodes(self) -> Int[np.ndarray, " e"]:
        """Numbers of the nodes on the plate's free edges, ascending."""
        free = [self.edge_nodes[edge] for edge, condition in self.plate.edges.items() if condition == "free"]
        return np.unique(np.concatenate([np.zeros(0, dtype=int), *free]))

    @functools.cached_property
    def quadrature(self) -> Quadrature:
        """Quadrature points of the cells, ``quadrature.Quadrature``."""
        return cell_quadrature(self.partition)

    @functools.cached_property
    def ligaments(self) -> tuple[np.ndarray, Float[np.ndarray, " m"]]:
        """Strips of gel (m,) between outlines or an edge, from node to node, and their widths (m,), mm; see ``ligaments``."""
        if not self.outlines:
            return np.empty(0, object), np.empty(0)
        points, n = self.partition.vertices[self.n_background :], self.n_background
        return with_images(self.plate, *ligaments(self.plate, self.outlines, points, n, OUTLINE_SEGMENTS))

    @functools.cached_property
    def curves(self) -> Curves:
        """The curved sides of cells, ``curves.Curves``."""
        return curves_of(self.outlines + self.interfaces)

    def middles(self, edges: Int[np.ndarray, "e 2"]) -> tuple[Int[np.ndarray, "e 3"], Float[np.ndarray, "e 3"]]:
        """Vertex numbers and weights that give the middle of every edge, see ``curves.middles``."""
        part, uncut = self.partition, len(self.partition.vertices) - len(self.partition.cut_segments)
        segments = np.concatenate([np.full(uncut, -1), part.cut_segments])
        return middles(edges, self.curves, segments, np.concatenate([np.zeros(uncut), part.cut_fractions]))

    @functools.cached_property
    def morph(self) -> Morph:
        """How the background follows the outlines, ``morph.Morph``."""
        n, lines, ends = self.n_background, self.outlines + self.interfaces, []
        for o in lines:
            ends += [(o.arc.start_edge, o.vertices[0] - n), (o.arc.end_edge, o.vertices[-1] - n)]
        nodes = np.concatenate([o.vertices[::OUTLINE_SEGMENTS] for o in lines]) - n
        n_outline = sum(len(o.vertices) for o in lines)
        return make_morph(self.plate, *np.split(self.partition.vertices, [n, n + n_outline])[:2], nodes, ends)

    @functools.cached_property
    def along_interfaces(self) -> tuple[Float[np.ndarray, "m k"], ...]:
        """Per interface the matrix (m, k) from its nodes to its fine vertices."""
        regions = self.plate.with_regions_as_holes
        return tuple(interpolation_along(o, regions).toarray() for o in self.interfaces)

    @functools.cached_property
    def traces(self) -> sp.csr_array:
        """Matrix (v, n) from nodal values to their traces at the vertices on interfaces, see ``interfaces``."""
        part = self.partition
        numbers = np.arange(len(part.vertices))[len(part.vertices) - len(part.cut_segments) :]
        cuts = numbers, *self.curves.points(part.cut_segments, part.cut_fractions)
        first = len(self.node_vertices) - sum(len(o.vertices[::OUTLINE_SEGMENTS]) for o in self.interfaces)
        regions = self.plate.with_regions_as_holes
        return interface_traces(regions, self.interfaces, first, len(self.node_vertices), cuts, len(part.vertices))

    @functools.cached_property
    def _region_polygons(self) -> list[shapely.Geometry]:
        offset = self.n_background
        polygons = region_polygons(self.plate, self.outlines, self.interfaces, self.partition.vertices[offset:], offset)
        for polygon in polygons:
            shapely.prepare(polygon)
        return polygons

    def regions_at(self, points: Float[np.ndarray, "p 2"]) -> Int[np.ndarray, " p"]:
        """The region (p,) of each point (p, 2) of the reference plate, numbered as those of cells; on an outline the one inside it."""
        found = np.zeros(len(points), dtype=int)
        for number in range(1, len(self.plate.regions) + 1):
            found[shapely.dwithin(self._region_polygons[number], shapely.points(points), SNAP * self.spacing)] = number
        return found


def make_topology(plate: Plate, spacing: float | None, nodes_per_hole: int | None, across: int | None) -> Topology:
    """``Topology`` of a concrete plate; arguments and errors as of ``make_cloud``."""
    check_plate(plate)
    given, frame = plate, frame_of(plate)
    plate = frame.of(plate)
    spacing, nodes_per_hole = check_sizes(plate, spacing, nodes_per_hole, across)
    background, refined = make_background(plate, spacing), []
    outlines, points = fine_outlines(plate, nodes_per_hole, background, len(background.vertices))
    if across is not None and across > 2 and outlines:
        strips, widths = ligaments(plate, outlines, points, len(background.vertices))
        refined.append((strips, widths / (across - 2)))
    if plate.regions:
        interfaces, own = make_interfaces(plate, background, len(background.vertices) + len(points))
        lines, widths = across_regions(plate, outlines, interfaces, np.concatenate([points, own]), len(background.vertices), spacing)
        refined.append((lines, widths / SQUARES_ACROSS))
    if refined:
        background = make_background(plate, spacing, refined)
        outlines, points = fine_outlines(plate, nodes_per_hole, background, len(background.vertices))
    n = len(background.vertices)
    interfaces, own = make_interfaces(plate, background, n + len(points))
    lines, points = outlines + interfaces, np.concatenate([points, own])
    refined += [intervals(points[loop(o)[::OUTLINE_SEGMENTS] - n]) for o in lines]
    halved = make_background(plate, spacing, refined)
    outlines, interfaces = (tuple(renumbered(o, len(halved.vertices) - n) for o in part) for part in (outlines, interfaces))
    halved = with_clearance(plate, halved, outlines, interfaces, points)
    topology = assemble(plate, spacing, halved, outlines, points, nodes_per_hole, across, interfaces, (given, frame))
    check_ligaments(topology)
    return topology


def assemble(
    plate: Plate,
    spacing: float,
    background: Background,
    outlines: tuple[Outline, ...],
    points: Float[np.ndarray, "o 2"],
    nodes_per_hole: int = 0,
    across: int | None = None,
    interfaces: tuple[Outline, ...] = (),
    source: tuple[Plate, Frame] | None = None,
) -> Topology:
    """``Topology`` of a background and the fine outlines and interfaces numbered after it, with their points (o, 2).

    ``source`` are the plate as given and the frame in which it is ``plate``, by default ``plate`` itself.
    """
    given, frame = source or (plate, frame_of(plate))
    n, lines = len(background.vertices), outlines + interfaces
    segments = [np.stack([loop(o)[:-1], loop(o)[1:]], axis=1) - n for o in lines]
    regions = region_polygons(plate, outlines, interfaces, points, n)
    part = _with_cuts_on_curves(partition(background.vertices, background.loops, join(segments, int), points, regions), lines)
    on_outlines = np.concatenate([np.empty(0, int), *(o.vertices[::OUTLINE_SEGMENTS] for o in lines)])
    taken = inside_holes(plate, background.vertices, 1e-9 * spacing)
    taken |= on_lines(interfaces, points, n, background.vertices, SNAP * spacing)
    node_vertices = np.concatenate([np.flatnonzero(~taken), on_outlines])
    nodes = part.vertices[node_vertices]
    return Topology(
        plate=plate,
        given=given,
        frame=frame,
        spacing=spacing,
        nodes_per_hole=nodes_per_hole,
        across=across,
        background=background,
        partition=part,
        outlines=outlines,
        interfaces=interfaces,
        node_regions=_node_regions(nodes, interfaces, regions),
        node_vertices=node_vertices,
        node_spacing=_graded(nodes, spacing / 2.0 ** background.fewest_halvings(nodes), periods(plate)),
        edge_nodes=_edge_nodes(plate, nodes, 1e-9 * spacing),
    )


def _node_regions(nodes, interfaces, regions):
    """The two regions (n, 2) of each node; those on ``interfaces`` come last."""
    found = np.zeros((len(nodes), 2), dtype=int)
    for number, polygon in enumerate(regions[1:], start=1):
        found[shapely.intersects(polygon, shapely.points(nodes))] = number
    start = len(nodes) - sum(len(o.vertices[::OUTLINE_SEGMENTS]) for o in interfaces)
    for interface in interfaces:
        stop = start + len(interface.vertices[::OUTLINE_SEGMENTS])
        found[start:stop] = 0, interface.arc.hole + 1
        start = stop
    return found


def _with_cuts_on_curves(part, outlines):
    """The partition with its cut points on the curves of the ``outlines`` instead of on their chords."""
    at, weights = curves_of(outlines).points(part.cut_segments, part.cut_fractions)
    vertices = part.vertices.copy()
    vertices[len(vertices) - len(at) :] = np.einsum("pk,pki->pi", weights, vertices[at])
    return dataclasses.replace(part, vertices=vertices)


def _graded(nodes, spacing, along):
    """Spacings (n,) of the nodes (n, 2), raised near larger ones so that none falls by more than ``GRADING`` times the distance.

    Distances are those to the nearest image for the periods ``along`` (2,), 0 for none.
    """
    graded, places = spacing.copy(), np.where(along > 0, nodes % np.where(along > 0, along, 1.0), nodes)
    for size in np.unique(spacing)[1:]:
        distance = cKDTree(places[spacing == size], boxsize=along if along.any() else None).query(places)[0]
        graded = np.maximum(graded, size - GRADING * distance)
    return graded


def _edge_nodes(plate, nodes, tolerance):
    """Node numbers on each edge of the plate, ordered along the edge."""
    found = {}
    for edge, (axis, coordinate) in edge_lines(plate).items():
        on = np.flatnonzero(np.abs(nodes[:, axis] - coordinate) < tolerance)
        found[edge] = on[np.argsort(nodes[on, 1 - axis])]
    return found
