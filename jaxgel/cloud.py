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

from .geometry import arc_points, arcs, check_plate, edge_lines, equal_arc_length, inside_holes, outline_points, reference_plate
from .partition import partition

OUTLINE_SEGMENTS = 8  # fine outline segments between two neighbouring outline nodes


@dataclasses.dataclass(frozen=True, eq=False)
class Outline:
    """One arc of a hole's boundary in the cloud; hashed by identity."""

    arc: object
    """The ``geometry.Arc``."""
    s: np.ndarray
    """(m,) position of the fine outline vertices along the arc, 0 ... 1."""
    vertices: np.ndarray
    """(m,) their vertex numbers; every ``OUTLINE_SEGMENTS``-th one is a node."""

    @property
    def closed(self):
        """Whether the arc is a whole hole."""
        return self.arc.closed


@dataclasses.dataclass(frozen=True, eq=False)
class Topology:
    """What does not move with the holes; NumPy arrays, hashed by identity."""

    plate: object
    """The reference plate."""
    spacing: float
    """Distance of the background nodes, mm."""
    n_background: int
    """Number of background vertices; outline vertices follow them, cut points come last."""
    partition: object
    """Cells of the reference plate, ``partition.Partition``."""
    outlines: tuple
    """The ``Outline`` of every arc."""
    node_vertices: np.ndarray
    """(n,) vertex number of each node."""
    node_spacing: np.ndarray
    """(n,) local distance of the nodes, mm; a node's support is dmax times this."""
    wall_nodes: dict
    """Edge name -> (k,) node numbers on that edge of the plate, in order along it."""
    cache: dict = dataclasses.field(default_factory=dict)
    """Neighbour lists and the like, filled by later stages."""

    @functools.cached_property
    def morph(self):
        """Thin-plate interpolation (n_background, controls) of the controls' displacement, and the controls' vertex numbers."""
        return _thin_plate_morph(self)


@functools.partial(jax.tree_util.register_dataclass, data_fields=["plate", "vertices"], meta_fields=["topology"])
@dataclasses.dataclass(frozen=True)
class Cloud:
    """Nodes and cell vertices of one plate."""

    plate: object
    """The plate on which the cloud is placed."""
    vertices: jax.Array
    """(v, 2) positions of all cell vertices, mm."""
    topology: Topology
    """Lists and the reference, static."""

    @property
    def nodes(self):
        """(n, 2) node positions, mm."""
        return self.vertices[self.topology.node_vertices]

    @property
    def spacing(self):
        """Distance of the background nodes (float), mm."""
        return self.topology.spacing

    @property
    def triangles(self):
        """(t, 3) vertex numbers of triangles that partition the dry gel."""
        return self.topology.partition.triangles

    @property
    def cell_of_triangle(self):
        """(t,) cell number of each triangle."""
        return self.topology.partition.cell_of_triangle

    def at(self, plate):
        """The same cloud placed on ``plate``, whose hole parameters may be traced; its holes correspond one to one."""
        return Cloud(plate, place(self.topology, plate), self.topology)


def make_cloud(plate, *, spacing=None, nodes_per_hole=None):
    """Node cloud of a plate: grid points ``spacing`` apart (mm) outside the holes, and ``nodes_per_hole`` on each whole hole.

    Both default to the plate's own; a new spacing scales the number of nodes on the holes with it. A plate made by ``Plate.at``
    is given the topology of the plate it came from, so that its parameters may be traced. Raises ValueError for an unusable
    plate, a spacing that is not positive, or one that leaves a ligament without a node.
    """
    reference = reference_plate(plate)
    with jax.ensure_compile_time_eval():  # the topology is made of numbers, also inside jit
        topology = _make_topology(reference, spacing, nodes_per_hole)
    cloud = Cloud(reference, jnp.asarray(topology.partition.vertices), topology)
    return cloud if reference is plate else cloud.at(plate)


def place(topology, plate):
    """Positions (v, 2) of all vertices for the holes of ``plate``; a pure function, smooth in every hole parameter."""
    part, n = topology.partition, topology.n_background
    on_outlines = [arc_points(plate, o.arc, o.s) for o in topology.outlines]
    outline = jnp.concatenate(on_outlines) if on_outlines else jnp.zeros((0, 2))
    background = jnp.asarray(part.vertices[:n])
    if on_outlines:
        matrix, controls, wall_source = topology.morph
        displacement = outline - part.vertices[n : n + len(outline)]
        background = background + matrix @ _control_displacement(displacement, controls, wall_source, n)
    placed = jnp.concatenate([background, outline])
    ends, f = placed[part.cut_ends], part.cut_fractions[:, None]
    return jnp.concatenate([placed, (1 - f) * ends[:, 0] + f * ends[:, 1]])


def _make_topology(plate, spacing, nodes_per_hole):
    check_plate(plate)
    own = plate.spacing or min(plate.width, plate.height) / 40
    spacing = own if spacing is None else float(spacing)
    if not (np.isfinite(spacing) and 0 < spacing <= min(plate.width, plate.height) / 2):
        raise ValueError(f"spacing: {spacing} is not in (0, {min(plate.width, plate.height) / 2:g}], half the plate's shorter side")
    if nodes_per_hole is None:
        nodes_per_hole = max(8, round(plate.nodes_per_hole * own / spacing))
    background, squares = _background(plate, spacing)
    outlines = _outlines(plate, nodes_per_hole, len(background))
    outline_vertices = [np.asarray(arc_points(plate, o.arc, o.s)) for o in outlines]
    outline_vertices = np.concatenate(outline_vertices) if outlines else np.zeros((0, 2))
    segments = np.concatenate([_segments(o) - len(background) for o in outlines]) if outlines else np.zeros((0, 2), dtype=int)
    gel = _gel_polygon(plate, outlines, outline_vertices, len(background))
    part = partition(background, squares, segments, outline_vertices, gel)

    free = np.flatnonzero(~inside_holes(plate, background, 1e-9 * spacing)) if outlines else np.arange(len(background))
    node_vertices = np.concatenate([free, *(o.vertices[::OUTLINE_SEGMENTS] for o in outlines)])
    topology = Topology(
        plate=plate,
        spacing=spacing,
        n_background=len(background),
        partition=part,
        outlines=outlines,
        node_vertices=node_vertices,
        node_spacing=np.full(len(node_vertices), spacing),
        wall_nodes=_wall_nodes(plate, part.vertices[node_vertices], 1e-9 * spacing),
    )
    _check_ligaments(topology)
    return topology


def _background(plate, spacing):
    """Grid vertices (b, 2) and the squares between them, as loops of four vertex numbers."""
    nx, ny = max(1, round(plate.width / spacing)), max(1, round(plate.height / spacing))
    x = np.linspace(-plate.width / 2, plate.width / 2, nx + 1)
    y = np.linspace(-plate.height / 2, plate.height / 2, ny + 1)
    vertices = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    first = (np.arange(nx)[:, None] * (ny + 1) + np.arange(ny)[None, :]).ravel()
    return vertices, list(np.stack([first, first + ny + 1, first + ny + 2, first + 1], axis=1))


def _outlines(plate, nodes_per_hole, offset):
    """The fine outline of every arc, numbered from ``offset`` on."""
    found = []
    for arc in arcs(plate):
        closed = arc.closed
        intervals = max(2, round(nodes_per_hole * _fraction_of_hole(plate, arc)))
        s = np.asarray(equal_arc_length(plate, arc, intervals))
        ends = np.append(s, s[0] + 1.0) if closed else s
        steps = np.arange(OUTLINE_SEGMENTS) / OUTLINE_SEGMENTS
        fine = (ends[:-1, None] + steps * np.diff(ends)[:, None]).ravel()
        fine = fine if closed else np.append(fine, ends[-1])
        found.append(Outline(arc, fine, offset + np.arange(len(fine))))
        offset += len(fine)
    return tuple(found)


def _fraction_of_hole(plate, arc):
    """Length of the arc over the length of its whole hole's outline."""
    hole = plate.holes[arc.hole]
    whole = np.asarray(outline_points(hole, np.linspace(0.0, 1.0, 4001)))
    part = np.asarray(outline_points(hole, np.linspace(arc.start, arc.end, 4001)))
    return _length(part) / _length(whole)


def _length(line):
    return np.linalg.norm(np.diff(line, axis=0), axis=1).sum()


def _segments(outline):
    """(s, 2) vertex numbers of the fine outline's segments."""
    v = outline.vertices
    return np.stack([v, np.roll(v, -1)], axis=1) if outline.closed else np.stack([v[:-1], v[1:]], axis=1)


def _gel_polygon(plate, outlines, outline_vertices, offset):
    """The dry gel as a shapely polygon: the plate less each hole's fine polygon, continued outside the plate for cut holes."""
    box = shapely.box(-plate.width / 2, -plate.height / 2, plate.width / 2, plate.height / 2)
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
            outside = np.linspace(this.arc.end, stop, 66)[1:-1]
            ring.append(np.asarray(outline_points(hole, outside % 1.0)))
        rings.append(shapely.Polygon(np.concatenate(ring)))
    return shapely.difference(box, shapely.union_all(rings))


def _wall_nodes(plate, nodes, tolerance):
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
    boundaries = [(f"holes[{o.arc.hole}]", o.closed, _curve(part.vertices[o.vertices], o.closed)) for o in topology.outlines]
    boundaries += [("the plate's edge", False, shapely.LineString(line)) for line in _wall_segments(topology.plate)]
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


def _curve(points, closed):
    return shapely.LineString(points[np.r_[: len(points), 0]] if closed else points)


def _wall_segments(plate):
    w, h = plate.width / 2, plate.height / 2
    corners = [(-w, -h), (w, -h), (w, h), (-w, h)]
    return [(corners[i], corners[(i + 1) % 4]) for i in range(4)]


def _control_displacement(outline_displacement, controls, wall_source, n):
    """Displacement (controls, 2) of the morph's control points: outline nodes as given, wall points slide along their wall."""
    outline, (first, second, fraction, axis) = controls, wall_source
    moved = outline_displacement[outline - n]
    padded = jnp.concatenate([outline_displacement, jnp.zeros((1, 2))])  # number -1: a corner of the plate, at rest
    slide = (1 - fraction)[:, None] * padded[first] + fraction[:, None] * padded[second]
    return jnp.concatenate([moved, slide * jax.nn.one_hot(axis, 2)])


def _thin_plate_morph(topology):
    """Interpolation matrix (n_background, controls), the outline controls' vertex numbers, and the sources of the wall controls."""
    part, n, plate = topology.partition, topology.n_background, topology.plate
    background = part.vertices[:n]
    outline = np.concatenate([o.vertices[::OUTLINE_SEGMENTS] for o in topology.outlines])
    on_wall = {edge: [] for edge in edge_lines(plate)}
    for o in topology.outlines:
        for edge, vertex in ((o.arc.start_edge, o.vertices[0]), (o.arc.end_edge, o.vertices[-1])):
            if edge is not None:
                on_wall[edge].append(vertex)
    walls, sources = [], []
    for edge, (axis, coordinate) in edge_lines(plate).items():
        along = np.flatnonzero(np.abs(background[:, axis] - coordinate) < 1e-9 * topology.spacing)
        t = part.vertices[:, 1 - axis]
        stops = [(-np.inf, -1)] + sorted((t[v], v - n) for v in on_wall[edge]) + [(np.inf, -1)]
        half = (plate.height if axis == 0 else plate.width) / 2
        for vertex in along:
            k = np.searchsorted([s for s, _ in stops], t[vertex]) - 1
            (a, first), (b, second) = stops[k], stops[k + 1]
            a, b = max(a, -half), min(b, half)
            walls.append(vertex)
            sources.append((first, second, (t[vertex] - a) / (b - a), 1 - axis))
    walls, unique = np.unique(walls, return_index=True)
    first, second, fraction, axis = (np.array(column)[unique] for column in zip(*sources, strict=True))
    corner = np.isin(np.abs(background[walls]) @ [1.0, 1.0], [plate.width / 2 + plate.height / 2])
    fraction, first, second = np.where(corner, 0.0, fraction), np.where(corner, -1, first), np.where(corner, -1, second)

    points = np.concatenate([part.vertices[outline], background[walls]])
    matrix = _thin_plate_matrix(points, background, max(plate.width, plate.height))
    matrix[walls] = np.eye(len(points))[len(outline) :]
    return matrix, outline, (first, second, fraction, axis)


def _thin_plate_matrix(controls, points, length):
    """Matrix (p, c) of the thin-plate spline that takes values at ``controls`` (c, 2) to ``points`` (p, 2), exact for linear fields."""

    def kernel(a, b):
        r2 = np.sum((a[:, None] - b[None]) ** 2, axis=-1) / length**2
        return 0.5 * r2 * np.log(np.where(r2 > 0, r2, 1.0))

    def linear(a):
        return np.concatenate([np.ones((len(a), 1)), a / length], axis=1)

    tail = linear(controls)
    system = np.block([[kernel(controls, controls), tail], [tail.T, np.zeros((3, 3))]])
    evaluate = np.concatenate([kernel(points, controls), linear(points)], axis=1)
    return np.linalg.solve(system, evaluate.T)[: len(controls)].T
