"""The node cloud: a topology built once for a reference plate, and its smooth placement on a plate whose holes have moved.

Nodes are the background grid points strictly outside the holes and points on the hole outlines. Every vertex of the integration
cells is placed by the plate: outline vertices by the hole's parametrisation, vertices cut by a grid line stay on their outline
segment, all others follow a thin-plate morph of the boundary's displacement. So positions are a pure function of the hole
parameters while all lists (neighbours, cells, edges) stay as they are.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from .._programs import release_programs_where_crowded
from .._types import Array, Float, Int
from ..geometry import (
    Plate,
    arc_points,
    check_plate,
    edge_lines,
    inside_holes,
    reference_plate,
)
from .cells import Partition, partition
from .checks import check_ligaments, check_sizes
from .clearance import with_clearance
from .curves import Curves, curves_of, middles
from .ligaments import ligaments
from .morph import Morph, make_morph
from .outlines import OUTLINE_SEGMENTS, Outline, fine_outlines, gel_polygon, intervals, join, loop, renumbered
from .quadrature import Quadrature, cell_quadrature
from .quadtree import Background, make_background

GRADING = 0.75  # slope of the node spacing between large squares and small ones


@dataclasses.dataclass(frozen=True, eq=False)
class Topology:
    """What does not move with the holes; NumPy arrays, hashed by identity."""

    plate: Plate
    """The reference plate."""
    spacing: float
    """Distance of the background nodes, mm."""
    nodes_per_hole: int
    """Nodes on the outline of each whole hole."""
    across: int | None
    """Nodes asked for across every ligament; None for no refinement."""
    follow_outlines: bool
    """Whether squares are halved where nodes of an outline are close, and grid points moved away from them."""
    background: Background
    """The background squares; their vertices come first, outline vertices follow them, cut points come last."""
    partition: Partition
    """Cells of the reference plate."""
    outlines: tuple[Outline, ...]
    """The ``Outline`` of every arc."""
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

    @property
    def wall_nodes(self) -> dict[str, Int[np.ndarray, " _"]]:
        """Former name of ``edge_nodes``."""
        return self.edge_nodes

    @functools.cached_property
    def quadrature(self) -> Quadrature:
        """Quadrature points of the cells, ``quadrature.Quadrature``."""
        return cell_quadrature(self.partition)

    @functools.cached_property
    def ligaments(self) -> tuple[np.ndarray, Float[np.ndarray, " m"]]:
        """Strips of gel (m,) between outlines or an edge, from node to node, and their widths (m,), mm; see ``ligaments``."""
        if not self.outlines:
            return np.empty(0, object), np.empty(0)
        return ligaments(self.plate, self.outlines, self.partition.vertices[self.n_background :], self.n_background, OUTLINE_SEGMENTS)

    @functools.cached_property
    def curves(self) -> Curves:
        """The curved sides of cells, ``curves.Curves``."""
        return curves_of(self.outlines)

    def middles(self, edges: Int[np.ndarray, "e 2"]) -> tuple[Int[np.ndarray, "e 3"], Float[np.ndarray, "e 3"]]:
        """Vertex numbers and weights that give the middle of every edge, see ``curves.middles``."""
        part, uncut = self.partition, len(self.partition.vertices) - len(self.partition.cut_segments)
        segments = np.concatenate([np.full(uncut, -1), part.cut_segments])
        return middles(edges, self.curves, segments, np.concatenate([np.zeros(uncut), part.cut_fractions]))

    @functools.cached_property
    def morph(self) -> Morph:
        """How the background follows the outlines, ``morph.Morph``."""
        n, ends = self.n_background, []
        for o in self.outlines:
            ends += [(o.arc.start_edge, o.vertices[0] - n), (o.arc.end_edge, o.vertices[-1] - n)]
        nodes = np.concatenate([o.vertices[::OUTLINE_SEGMENTS] for o in self.outlines]) - n
        n_outline = sum(len(o.vertices) for o in self.outlines)
        return make_morph(self.plate, *np.split(self.partition.vertices, [n, n + n_outline])[:2], nodes, ends)


@functools.partial(jax.tree_util.register_dataclass, data_fields=["plate", "vertices"], meta_fields=["topology"])
@dataclasses.dataclass(frozen=True)
class Cloud:
    """Nodes and cell vertices of one plate."""

    plate: Plate
    """The plate on which the cloud is placed."""
    vertices: Float[Array, "v 2"]
    """Positions of all cell vertices, mm."""
    topology: Topology
    """Lists and the reference, static."""

    @property
    def nodes(self) -> Float[Array, "n 2"]:
        """Node positions, mm."""
        return _nodes(self.vertices, self.topology.node_vertices)

    @property
    def spacing(self) -> float:
        """Distance of the background nodes, mm."""
        return self.topology.spacing

    @property
    def triangles(self) -> Int[np.ndarray, "t 3"]:
        """Vertex numbers of triangles that partition the dry gel."""
        return self.topology.partition.triangles

    @property
    def cell_of_triangle(self) -> Int[np.ndarray, " t"]:
        """Cell number of each triangle."""
        return self.topology.partition.cell_of_triangle

    def at(self, plate: Plate) -> "Cloud":
        """The same cloud placed on ``plate``, whose hole parameters may be traced; its holes correspond one to one."""
        return Cloud(plate, place(self.topology, plate), self.topology)


def make_cloud(
    plate: Plate,
    *,
    spacing: float | None = None,
    nodes_per_hole: int | None = None,
    across: int | None = None,
    follow_outlines: bool = True,
) -> Cloud:
    """Node cloud of a plate: grid points ``spacing`` apart (mm) outside the holes, and ``nodes_per_hole`` on each whole hole.

    Both default to the plate's own; a new spacing scales the number of nodes on the holes with it. ``across`` refines ligaments,
    between holes and between a hole and an edge of the plate, until at least that many nodes lie across, those on the two outlines
    (or on the edge) included: the spacing is halved, on the outlines too, until ``across`` - 2 grid lines cross the ligament. A plate
    made by ``Plate.at`` is given the topology of the plate it came from, so that its parameters may be traced. Squares are
    halved, too, where more than ``outlines.CROWDED`` outline nodes lie to a side, and grid points near an outline node are moved
    away from it (``clearance``); ``follow_outlines=False`` does neither, as before version 0.2. Raises ValueError for an unusable
    plate, a spacing that is not positive or leaves a ligament without a node, an ``across`` that is not at least 2, and where more than
    ``quadtree.MAX_HALVINGS`` halvings are needed.
    """
    release_programs_where_crowded()  # a new cloud needs new ones
    reference = reference_plate(plate)
    with jax.ensure_compile_time_eval():  # the topology is made of numbers, also inside jit
        topology = _make_topology(reference, spacing, nodes_per_hole, across, follow_outlines)
    cloud = Cloud(reference, jax.device_put(topology.partition.vertices), topology)
    return cloud if reference is plate else cloud.at(plate)


def place(topology: Topology, plate: Plate) -> Float[Array, "v 2"]:
    """Positions of all vertices for the holes of ``plate``; a pure function, smooth in every hole parameter."""
    part, n = topology.partition, topology.n_background
    on_outlines = [arc_points(plate, o.arc, o.s) for o in topology.outlines]
    cuts = topology.curves.points(part.cut_segments, part.cut_fractions)
    return _carried(on_outlines, part.vertices, topology.morph if on_outlines else None, *cuts, n)


@functools.partial(jax.jit, static_argnames="n")
def _carried(outlines, vertices, morph, cut_vertices, cut_weights, n):
    """Positions (v, 2) of all vertices for those of the ``outlines``; ``vertices`` (v, 2) on the reference, ``n`` of the background."""
    placed = jnp.asarray(vertices[:n])
    if outlines:
        outline = jnp.concatenate(outlines)
        placed = jnp.concatenate([placed + morph.displacement(outline - vertices[n : n + len(outline)]), outline])
    return jnp.concatenate([placed, jnp.einsum("pk,pki->pi", cut_weights, placed[cut_vertices])])


@jax.jit
def _nodes(vertices, numbers):
    return vertices[numbers]


def _make_topology(plate, spacing, nodes_per_hole, across, follow_outlines):
    check_plate(plate)
    spacing, nodes_per_hole = check_sizes(plate, spacing, nodes_per_hole, across)
    background, refined = make_background(plate, spacing), []
    outlines, points = fine_outlines(plate, nodes_per_hole, background)
    if across is not None and across > 2 and outlines:
        strips, widths = ligaments(plate, outlines, points, len(background.vertices))
        refined.append((strips, widths / (across - 2)))
        background = make_background(plate, spacing, refined)
        outlines, points = fine_outlines(plate, nodes_per_hole, background)
    if follow_outlines:
        refined += [intervals(points[loop(o)[::OUTLINE_SEGMENTS] - len(background.vertices)]) for o in outlines]
    halved = make_background(plate, spacing, refined)
    outlines = tuple(renumbered(o, len(halved.vertices) - len(background.vertices)) for o in outlines)
    if follow_outlines:
        halved = with_clearance(plate, halved, outlines, points)
    topology = assemble(plate, spacing, halved, outlines, points, nodes_per_hole, across, follow_outlines)
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
    follow_outlines: bool = True,
) -> Topology:
    """``Topology`` of a background and the fine outlines numbered after it, with their points (o, 2)."""
    n = len(background.vertices)
    segments = [np.stack([loop(o)[:-1], loop(o)[1:]], axis=1) - n for o in outlines]
    gel = gel_polygon(plate, outlines, points, n)
    part = _with_cuts_on_curves(partition(background.vertices, background.loops, join(segments, int), points, gel), outlines)
    on_outlines = np.concatenate([np.empty(0, int), *(o.vertices[::OUTLINE_SEGMENTS] for o in outlines)])
    free = np.flatnonzero(~inside_holes(plate, background.vertices, 1e-9 * spacing))
    node_vertices = np.concatenate([free, on_outlines])
    nodes = part.vertices[node_vertices]
    return Topology(
        plate=plate,
        spacing=spacing,
        nodes_per_hole=nodes_per_hole,
        across=across,
        follow_outlines=follow_outlines,
        background=background,
        partition=part,
        outlines=outlines,
        node_vertices=node_vertices,
        node_spacing=_graded(nodes, spacing / 2.0 ** background.fewest_halvings(nodes)),
        edge_nodes=_edge_nodes(plate, nodes, 1e-9 * spacing),
    )


def _with_cuts_on_curves(part, outlines):
    """The partition with its cut points on the curves of the ``outlines`` instead of on their chords."""
    at, weights = curves_of(outlines).points(part.cut_segments, part.cut_fractions)
    vertices = part.vertices.copy()
    vertices[len(vertices) - len(at) :] = np.einsum("pk,pki->pi", weights, vertices[at])
    return dataclasses.replace(part, vertices=vertices)


def _graded(nodes, spacing):
    """Spacings (n,) of the nodes (n, 2), raised near larger ones so that none falls by more than ``GRADING`` times the distance."""
    graded = spacing.copy()
    for size in np.unique(spacing)[1:]:
        distance = cKDTree(nodes[spacing == size]).query(nodes)[0]
        graded = np.maximum(graded, size - GRADING * distance)
    return graded


def _edge_nodes(plate, nodes, tolerance):
    """Node numbers on each edge of the plate, ordered along the edge."""
    found = {}
    for edge, (axis, coordinate) in edge_lines(plate).items():
        on = np.flatnonzero(np.abs(nodes[:, axis] - coordinate) < tolerance)
        found[edge] = on[np.argsort(nodes[on, 1 - axis])]
    return found
