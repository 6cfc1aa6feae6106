"""The node cloud: topology of a reference plate, and its smooth placement on a moved plate.

Nodes are the background grid points strictly outside the holes and points on the hole outlines.
Every vertex of the integration cells is placed by the plate: outline vertices by the hole's
parametrisation, vertices cut by a grid line stay on their outline segment, all others follow a
thin-plate morph of the boundary's displacement. So positions are a pure function of the hole
parameters while all lists (neighbours, cells, edges) stay as they are.
"""

import dataclasses

import jax
import numpy as np

from .._deprecated import old_arguments
from .._programs import release_programs_if_crowded
from .._sizes import NODES, joined, multiplied, padded, resized, room, taken
from .._tracing import is_traced, numbers_of, outside_traces
from .._types import Array, Float, Int
from .._validation import check_kind
from ..geometry import Plate, arc_points, check_plate, reference_plate
from .checks import check_ligaments, check_sizes
from .clearance import with_clearance
from .ligaments import across_regions, find_ligaments
from .outlines import OUTLINE_SEGMENTS, intervals, sample_lines
from .quadtree import make_background, squares
from .topology import Topology, assemble

# least number across a region: with the nodes on its outline three lines of nodes, for quadratic
# shape functions
SQUARES_ACROSS = 2


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Cloud:
    """Nodes and cell vertices of one plate; `make_cloud` makes it. A pytree."""

    plate: Plate
    """The plate on which the cloud is placed, as given."""
    placed: Float[Array, "r 2"]
    """Positions of all cell vertices, mm, in the frame of the topology, with room for more."""
    topology: Topology = dataclasses.field(metadata={"static": True})
    """Connectivity and reference positions; static."""

    def __repr__(self) -> str:
        """Sizes of the cloud."""
        return (
            f"Cloud of {len(self.topology.node_vertices)} nodes, {self.spacing:.4g} "
            f"{self.plate.unit} apart, of {self.plate!r}"
        )

    @property
    def vertices(self) -> Float[Array, "v 2"]:
        """Positions of all cell vertices, mm, in the frame of the topology."""
        return resized(self.placed, self.topology.partition.vertices.shape)

    @property
    def nodes(self) -> Float[Array, "n 2"]:
        """Node positions, mm."""
        return self.positions(self.topology.node_vertices)

    def positions(self, numbers: Int[np.ndarray, " p"]) -> Float[Array, "p 2"]:
        """Positions of the vertices with these ``numbers``, mm."""
        rows = taken(self.placed, numbers)
        if is_traced(rows):
            return rows
        with outside_traces():
            return jax.device_put(rows)

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
        """The same cloud placed on ``plate``, whose hole parameters may be traced.

        Its holes correspond one to one.
        """
        # of a plate made of numbers it is numbers, also inside jit
        with numbers_of(plate):
            return Cloud(plate, _with_room(place(self.topology, plate)), self.topology)


@old_arguments
def make_cloud(
    plate: Plate,
    *,
    spacing: float | None = None,
    nodes_per_hole: int | None = None,
    across: int | None = None,
) -> Cloud:
    """Node `Cloud` of a plate: background grid outside the holes, and nodes on the outlines.

    Arguments:

    - `plate`: the `Plate`. One made by `Plate.at` is given the topology of the plate it came from,
      so that its parameters may be traced.
    - `spacing`: distance of the grid points, mm; the plate's own by default.
    - `nodes_per_hole`: number of nodes on each whole hole. By default the plate's own; a new
      `spacing` scales it.
    - `across`: number of nodes across each ligament, between holes and between a hole and an edge,
      those on the outlines (or on the edge) included: the spacing is halved until it is reached, on
      the outlines too. By default no ligament is refined.

    Squares are also halved if more than `outlines.CROWDED` outline nodes lie on a side, and grid
    points near an outline node are moved away from it (`clearance`). The frame of a periodic plate
    is arbitrary: edges that cross a hole are moved, see `cloud.topology.frame`.

    Raises `ValueError` for an unusable plate, for an unusable spacing or one that leaves a ligament
    without a node, for `across` below 2, and if more than `quadtree.MAX_HALVINGS` halvings are
    needed.

    >>> cloud = make_cloud(Plate(2.0, 2.0), spacing=0.5)
    >>> cloud.nodes.shape
    (25, 2)
    """
    check_kind("plate", plate, Plate, "a Plate, such as Plate(4, 4, [Circle((0, 0), 1)])")
    release_programs_if_crowded()  # a new cloud needs new ones
    reference = reference_plate(plate)
    with outside_traces():  # the topology is made of numbers, also inside jit
        topology = _topology(reference, spacing, nodes_per_hole, across)
    cloud = Cloud(reference, _with_room(topology.partition.vertices), topology)
    return cloud if reference is plate else cloud.at(plate)


def _topology(given, spacing, nodes_per_hole, across):
    """``Topology`` of a concrete plate; arguments and errors as of ``make_cloud``."""
    frame = check_plate(given)
    plate = frame.of(given)
    spacing, nodes_per_hole = check_sizes(plate, spacing, nodes_per_hole, across)
    lines, refined = sample_lines(plate, nodes_per_hole, squares(plate, spacing)[1].max()), []
    if across is not None and across > 2 and lines.outlines:
        strips, widths = find_ligaments(lines)
        refined.append((strips, widths / (across - 2)))
    if lines.interfaces:
        strips, widths = across_regions(lines, spacing)
        refined.append((strips, widths / SQUARES_ACROSS))
    if refined:
        lines = lines.halved(make_background(plate, spacing, refined))
    background = make_background(plate, spacing, refined + [intervals(line) for line in lines.both])
    background = with_clearance(background, lines)
    topology = assemble(given, frame, lines, background, spacing, nodes_per_hole, across)
    on_grid = topology.node_vertices[topology.node_vertices < topology.n_background]
    check_ligaments(lines, spacing, background.vertices[on_grid])
    return topology


def _with_room(vertices):
    """Positions (v, 2), and the last again, as many as similar clouds have."""
    return padded(vertices, room(len(vertices), NODES))


def place(topology: Topology, plate: Plate) -> Float[Array, "v 2"]:
    """Positions of all vertices in the topology's ``frame`` for the holes of ``plate``.

    Pure, smooth in every hole parameter.
    """
    plate = topology.frame.of(plate)
    regions = plate.with_regions_as_holes
    points = [arc_points(plate, o.arc, o.s) for o in topology.outlines]
    points += [arc_points(regions, o.arc, o.s[::OUTLINE_SEGMENTS]) for o in topology.interfaces]
    return multiplied(joined([*points, np.ones((1, 2))]), topology.placement)
