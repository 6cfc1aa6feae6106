"""The node cloud: a topology built once for a reference plate, and its smooth placement on a plate whose holes have moved.

Nodes are the background grid points strictly outside the holes and points on the hole outlines. Every vertex of the integration
cells is placed by the plate: outline vertices by the hole's parametrisation, vertices cut by a grid line stay on their outline
segment, all others follow a thin-plate morph of the boundary's displacement. So positions are a pure function of the hole
parameters while all lists (neighbours, cells, edges) stay as they are.
"""

import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from scipy.spatial import cKDTree

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
from .curves import Curves, curves_of, middles
from .morph import Morph, make_morph
from .outlines import OUTLINE_SEGMENTS, Outline, fine_outlines, gel_polygon, join, loop, warn_if_crowded
from .quadrature import Quadrature, cell_quadrature
from .quadtree import Background, find_ligaments, make_background

MAX_NODES = 1_000_000  # of a cloud: a model of a million nodes takes tens of gigabytes
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
        return cell_quadrature(self.partition, self.n_background)

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


def make_cloud(plate: Plate, *, spacing: float | None = None, nodes_per_hole: int | None = None, across: int | None = None) -> Cloud:
    """Node cloud of a plate: grid points ``spacing`` apart (mm) outside the holes, and ``nodes_per_hole`` on each whole hole.

    Both default to the plate's own; a new spacing scales the number of nodes on the holes with it. ``across`` refines ligaments,
    between holes and between a hole and an edge of the plate, until at least that many nodes lie across, those on the two outlines
    (or on the edge) included: the spacing is halved, on the outlines too, until ``across`` - 2 grid lines cross the ligament. A plate
    made by ``Plate.at`` is given the topology of the plate it came from, so that its parameters may be traced. Raises ValueError for
    an unusable plate, a spacing that is not positive or leaves a ligament without a node, and an ``across`` that is not at least 2
    or takes more than ``quadtree.MAX_HALVINGS`` halvings. Warns (UserWarning) of outline nodes too close for the squares around.
    """
    reference = reference_plate(plate)
    with jax.ensure_compile_time_eval():  # the topology is made of numbers, also inside jit
        topology = _make_topology(reference, spacing, nodes_per_hole, across)
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


def _make_topology(plate, spacing, nodes_per_hole, across):
    check_plate(plate)
    spacing, nodes_per_hole = _check_sizes(plate, spacing, nodes_per_hole, across)
    background = make_background(plate, spacing)
    outlines, points = fine_outlines(plate, nodes_per_hole, background)
    if across is not None and outlines:
        curves = [points[loop(o) - len(background.vertices)] for o in outlines]
        gel = gel_polygon(plate, outlines, points, len(background.vertices))
        ligaments = find_ligaments(_edge_lines_of(plate), curves, [o.arc for o in outlines], gel)
        background = make_background(plate, spacing, ligaments, across - 2)
        outlines, points = fine_outlines(plate, nodes_per_hole, background)
    topology = assemble(plate, spacing, background, outlines, points, nodes_per_hole, across)
    _check_ligaments(topology)
    warn_if_crowded(outlines, topology.partition.vertices, background)
    return topology


def assemble(
    plate: Plate,
    spacing: float,
    background: Background,
    outlines: tuple[Outline, ...],
    points: Float[np.ndarray, "o 2"],
    nodes_per_hole: int = 0,
    across: int | None = None,
) -> Topology:
    """``Topology`` of a background and the fine outlines numbered after it, with their points (o, 2)."""
    n = len(background.vertices)
    segments = [np.stack([loop(o)[:-1], loop(o)[1:]], axis=1) - n for o in outlines]
    gel = gel_polygon(plate, outlines, points, n)
    part = _with_cuts_on_curves(partition(background.vertices, background.loops, join(segments, int), points, gel), outlines)
    free = np.flatnonzero(~inside_holes(plate, background.vertices, 1e-9 * spacing))
    node_vertices = np.concatenate([free, *(o.vertices[::OUTLINE_SEGMENTS] for o in outlines)])
    nodes = part.vertices[node_vertices]
    return Topology(
        plate=plate,
        spacing=spacing,
        nodes_per_hole=nodes_per_hole,
        across=across,
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


def _check_sizes(plate, spacing, nodes_per_hole, across):
    """Spacing in mm and nodes per hole, the plate's own where they are None; ValueError for unusable ones."""
    own, shorter = plate.spacing or min(plate.width, plate.height) / 40, min(plate.width, plate.height)
    spacing = own if spacing is None else float(spacing)
    if not (np.isfinite(spacing) and 0 < spacing <= shorter / 2):
        raise ValueError(f"spacing: {spacing} is not in (0, {shorter / 2:g}], half the plate's shorter side")
    if across is not None and not (isinstance(across, int | np.integer) and not isinstance(across, bool) and across >= 2):
        raise ValueError(f"across: {across!r} is not a whole number of at least 2, the two nodes on the outlines included")
    if nodes_per_hole is not None and not (isinstance(nodes_per_hole, int | np.integer) and 3 <= nodes_per_hole <= MAX_NODES):
        raise ValueError(f"nodes_per_hole: {nodes_per_hole!r} is not a whole number of 3 to {MAX_NODES}")
    background = plate.width / spacing * plate.height / spacing
    if not background <= MAX_NODES:
        raise ValueError(f"spacing: {spacing:g} mm makes about {background:.2g} nodes, {MAX_NODES} are accepted at most; use a larger one")
    per_hole = max(8, round(plate.nodes_per_hole * own / spacing)) if nodes_per_hole is None else nodes_per_hole
    if per_hole * len(plate.holes) > MAX_NODES // OUTLINE_SEGMENTS:
        raise ValueError(
            f"nodes_per_hole: {per_hole} on each of {len(plate.holes)} holes are more than the {MAX_NODES // OUTLINE_SEGMENTS} accepted; "
            "use fewer, or a larger spacing"
        )
    return spacing, per_hole


def _edge_nodes(plate, nodes, tolerance):
    """Node numbers on each edge of the plate, ordered along the edge."""
    found = {}
    for edge, (axis, coordinate) in edge_lines(plate).items():
        on = np.flatnonzero(np.abs(nodes[:, axis] - coordinate) < tolerance)
        found[edge] = on[np.argsort(nodes[on, 1 - axis])]
    return found


def _check_ligaments(topology):
    """Refuse a cloud with a ligament narrower than the spacing and no node in it."""
    part, n = topology.partition, topology.n_background
    free = topology.node_vertices[topology.node_vertices < n]
    tree = cKDTree(part.vertices[free]) if len(free) else None
    boundaries = [(f"holes[{o.arc.hole}]", o.closed, shapely.LineString(part.vertices[loop(o)])) for o in topology.outlines]
    boundaries += [("the plate's edge", False, line) for line in _edge_lines_of(topology.plate)]
    for (name, closed, curve), (other_name, _, other) in itertools.combinations(boundaries, 2):
        cut = not closed and other_name == "the plate's edge"
        line = shapely.shortest_line(curve, other)
        if name == other_name or cut or line.length >= topology.spacing:
            continue  # arcs of one hole, a hole that the edge cuts, a wide ligament
        middle = np.asarray(line.centroid.coords)[0]
        if tree is None or tree.query(middle)[0] > topology.spacing:
            raise ValueError(
                f"spacing: {topology.spacing:g} mm leaves no node in the {line.length:.3g} mm ligament between {name} and {other_name}; "
                f"use a spacing below {line.length:.3g}"
            )


def _edge_lines_of(plate):
    """The sides of the plate, shapely LineStrings in the order of ``geometry.EDGES``."""
    w, h = plate.width / 2, plate.height / 2
    left, right, bottom, top = [(-w, -h), (-w, h)], [(w, -h), (w, h)], [(-w, -h), (w, -h)], [(-w, h), (w, h)]
    return [shapely.LineString(side) for side in (left, right, bottom, top)]
