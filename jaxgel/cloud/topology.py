"""Topology of a cloud: nodes, cells, outlines and interfaces on the reference plate.

Host NumPy.
"""

import dataclasses
import functools

import numpy as np
import scipy.sparse as sp
import shapely
from scipy.spatial import cKDTree

from .._deprecated import OldAttribute
from .._sizes import Matrices
from .._types import Float, Int
from ..geometry import Frame, Plate, edge_lines, inside_holes, periods
from .cells import SNAP, Partition, partition
from .edges import find_rows
from .ligaments import find_ligaments
from .morph import morph_matrices
from .outlines import OUTLINE_SEGMENTS, Curves, Lines, curves_of, on_lines
from .quadrature import Quadrature, cell_quadrature
from .quadtree import Background, with_images

GRADING = 0.75  # slope of the node spacing between large squares and small ones


@dataclasses.dataclass(frozen=True, eq=False)
class Topology(Lines):
    """The sampled outlines with what is made of them, all that does not move with the holes.

    NumPy arrays, hashed by identity.
    """

    given: Plate
    """The reference plate as given.

    The same unless an edge of a periodic cell was moved, see `geometry.frame_of`.
    """
    frame: Frame
    """Where the plate lies on the given one; all positions here are those in this frame."""
    spacing: float
    """Distance of the background nodes, mm."""
    nodes_per_hole: int
    """Nodes on the outline of each whole hole."""
    across: int | None
    """Requested nodes across every ligament; None for no refinement."""
    background: Background
    """The background squares.

    Their vertices come first, outline vertices follow them, cut points come last.
    """
    partition: Partition
    """Cells of the reference plate."""
    curves: Curves
    """The curved sides of cells."""
    nodes: Float[np.ndarray, "n 2"]
    """Node positions on the reference plate, mm."""
    node_regions: Int[np.ndarray, "n 2"]
    """The regions of each node, numbered as those of cells: two on an interface, else equal."""
    node_vertices: Int[np.ndarray, " n"]
    """Vertex number of each node."""
    node_spacing: Float[np.ndarray, " n"]
    """Local distance of the nodes, mm; a node's support is dmax times this."""
    edge_nodes: dict[str, Int[np.ndarray, " _"]]
    """Edge of the plate -> numbers of the nodes on it, in order along it."""

    wall_nodes = OldAttribute("edge_nodes")

    @property
    def n_background(self) -> int:
        """Number of background vertices."""
        return len(self.background.vertices)

    @functools.cached_property
    def free_edge_nodes(self) -> Int[np.ndarray, " e"]:
        """Numbers of the nodes on the plate's free edges, ascending."""
        free = [
            self.edge_nodes[edge]
            for edge, condition in self.plate.edges.items()
            if condition == "free"
        ]
        return np.unique(np.concatenate([np.zeros(0, dtype=int), *free]))

    @functools.cached_property
    def quadrature(self) -> Quadrature:
        """Quadrature points of the cells, ``quadrature.Quadrature``."""
        return cell_quadrature(self.partition)

    @functools.cached_property
    def ligaments(self) -> tuple[np.ndarray, Float[np.ndarray, " m"]]:
        """Strips of gel (m,) between outlines or an edge, and widths (m,), mm; see ``ligaments``.

        They go from node to node.
        """
        if not self.outlines:
            return np.empty(0, object), np.empty(0)
        return with_images(self.plate, *find_ligaments(self, OUTLINE_SEGMENTS))

    def middles(
        self, edges: Int[np.ndarray, "e 2"]
    ) -> tuple[Int[np.ndarray, "e 3"], Float[np.ndarray, "e 3"]]:
        """Vertex numbers and weights of the middle of every edge, on the parabola of outline edges.

        Half-way on other edges.
        """
        part, curves = self.partition, self.curves
        numbers, weights = edges[:, [0, 1, 1]], np.tile([0.5, 0.5, 0.0], (len(edges), 1))
        if len(curves.ends) == 0:
            return numbers, weights
        uncut = len(part.vertices) - len(part.cut_segments)
        segment_of = np.concatenate([np.full(uncut, -1), part.cut_segments])
        fraction_of = np.concatenate([np.zeros(uncut), part.cut_fractions])
        segment = segment_of[edges].max(axis=1)
        # the segment that is the edge, if any
        segment = np.where(segment >= 0, segment, find_rows(np.sort(curves.ends), np.sort(edges)))
        own, cut = (
            curves.ends[segment, :, None] == edges[:, None],
            segment_of[edges] == segment[:, None],
        )
        at_ends = np.where(own[:, 0], 0.0, np.where(own[:, 1], 1.0, np.nan))
        middle = np.where(cut, fraction_of[edges], at_ends).mean(axis=1)
        on = (segment >= 0) & np.isfinite(middle)
        numbers[on], weights[on] = curves.points(segment[on], middle[on])
        return numbers, weights

    @functools.cached_property
    def placement(self) -> Matrices:
        """Matrices (v, o + 1) from outline points, interface nodes and 1 to all vertices.

        The last matrix is (1, 1). The background follows the outlines, see ``morph``, cut points
        lie on them, and the last point stands for what rests.
        """
        part, n, lines = self.partition, self.n_background, self.both
        outline = np.concatenate([np.zeros((0, 2)), *(line.points for line in lines)])
        traces = sp.block_diag(
            [
                sp.csr_array((0, 0)),
                *(sp.eye_array(len(o.s)) for o in self.outlines),
                *(o.trace for o in self.interfaces),
            ]
        )
        at, weights = self.curves.points(part.cut_segments, part.cut_fractions)
        cut = sp.csr_array(
            (weights.ravel(), (np.repeat(np.arange(len(at)), 3), at.ravel())),
            (len(at), n + len(outline)),
        )
        morphs = (
            morph_matrices(self.background.vertices, self) if lines else 2 * (sp.csr_array((n, 0)),)
        )
        columns = []
        for axis, morph in enumerate(morphs):
            rest = np.append(
                part.vertices[:n, axis] - morph @ outline[:, axis], np.zeros(len(outline))
            )
            placed = sp.hstack([sp.vstack([morph @ traces, traces]), sp.csr_array(rest[:, None])])
            columns.append(sp.csr_array(sp.vstack([placed, cut @ placed])))
        return Matrices(tuple(columns))

    @functools.cached_property
    def traces(self) -> sp.csr_array:
        """Matrix (v, n) from nodal values to traces at vertices on interfaces, see ``outlines``.

        The other rows are empty.
        """
        part, shape = self.partition, (len(self.partition.vertices), len(self.node_vertices))
        traces, number = sp.csr_array(shape), np.full(shape[0], -1)
        number[self.node_vertices] = np.arange(shape[1])
        for interface in self.interfaces:
            own = interface.trace.tocoo()
            traces = traces + sp.csr_array(
                (
                    own.data,
                    (interface.vertices[own.coords[0]], number[interface.nodes[own.coords[1]]]),
                ),
                shape,
            )
        at, weights = self.curves.points(part.cut_segments, part.cut_fractions)
        cut = np.repeat(np.arange(shape[0] - len(at), shape[0]), 3)
        return sp.csr_array(
            traces
            + sp.csr_array((weights.ravel(), (cut, at.ravel())), shape=(shape[0], shape[0]))
            @ traces
        )

    def regions_at(self, points: Float[np.ndarray, "p 2"]) -> Int[np.ndarray, " p"]:
        """The region (p,) of each point (p, 2) of the reference plate, numbered as those of cells.

        On an outline the one inside it.
        """
        found = np.zeros(len(points), dtype=int)
        for number in range(1, len(self.plate.regions) + 1):
            found[
                shapely.dwithin(self.regions[number], shapely.points(points), SNAP * self.spacing)
            ] = number
        return found


def assemble(
    given: Plate,
    frame: Frame,
    lines: Lines,
    background: Background,
    spacing: float,
    nodes_per_hole: int,
    across: int | None,
) -> Topology:
    """``Topology`` of a background and sampled ``lines`` of a plate, by its ``frame``.

    The plate is ``given`` in that; arguments are as its fields.
    """
    plate, lines = lines.plate, lines.numbered(len(background.vertices))
    curves, points = (
        curves_of(lines.both),
        np.concatenate([np.zeros((0, 2)), *(line.points for line in lines.both)]),
    )
    part = partition(background, points, curves.ends, lines.regions)
    at, weights = curves.points(part.cut_segments, part.cut_fractions)
    # from chords to the curves
    part.vertices[len(part.vertices) - len(at) :] = np.einsum(
        "pk,pki->pi", weights, part.vertices[at]
    )
    taken = inside_holes(plate, background.vertices, 1e-9 * spacing)
    taken |= on_lines(lines.interfaces, background.vertices, SNAP * spacing)
    node_vertices = np.concatenate([np.flatnonzero(~taken), *(line.nodes for line in lines.both)])
    nodes, edge_nodes = part.vertices[node_vertices], {}
    node_regions = np.zeros((len(nodes), 2), dtype=int)
    for number, polygon in enumerate(lines.regions[1:], start=1):
        node_regions[shapely.intersects(polygon, shapely.points(nodes))] = number
    # their nodes come last
    on_interfaces = [(0, line.arc.hole + 1) for line in lines.interfaces for _ in line.nodes]
    node_regions[len(nodes) - len(on_interfaces) :] = np.reshape(on_interfaces, (-1, 2))
    for edge, (axis, coordinate) in edge_lines(plate).items():
        on = np.flatnonzero(np.abs(nodes[:, axis] - coordinate) < 1e-9 * spacing)
        edge_nodes[edge] = on[np.argsort(nodes[on, 1 - axis])]
    return Topology(
        **vars(lines),
        given=given,
        frame=frame,
        spacing=spacing,
        nodes_per_hole=nodes_per_hole,
        across=across,
        background=background,
        partition=part,
        curves=curves,
        nodes=nodes,
        node_regions=node_regions,
        node_vertices=node_vertices,
        node_spacing=_graded(
            nodes, spacing / 2.0 ** background.fewest_halvings(nodes), periods(plate)
        ),
        edge_nodes=edge_nodes,
    )


def _graded(nodes, spacing, along):
    """Spacings (n,) of the nodes (n, 2), raised near larger ones to a gradient of ``GRADING``.

    Distances are those to the nearest image for the periods ``along`` (2,), 0 for none.
    """
    graded, places = (
        spacing.copy(),
        np.where(along > 0, nodes % np.where(along > 0, along, 1.0), nodes),
    )
    for size in np.unique(spacing)[1:]:
        distance = cKDTree(places[spacing == size], boxsize=along if along.any() else None).query(
            places
        )[0]
        graded = np.maximum(graded, size - GRADING * distance)
    return graded
