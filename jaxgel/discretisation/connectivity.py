"""Which nodes reach which integration cells, and which quadrature points a cell has: NumPy arrays found once on the reference plate."""

import dataclasses

import jax
import numpy as np

from .._memo import once_per_owner
from .._types import Array, Float, Int
from ..cloud import EDGE_POINTS, Topology, edge_points, square_cells
from ..geometry import edge_lines, inside_holes
from .checks import check_support
from .neighbours import pad_nodes, pad_rows, reaching_nodes


@dataclasses.dataclass(frozen=True, eq=False)
class Connectivity:
    """What does not move with the holes: neighbours and the layout of the quadrature points; hashed by identity."""

    topology: Topology
    """The cloud's topology."""
    nodes: Int[np.ndarray, "c a"]
    """Node numbers of each cell in ascending order, padded with the first one."""
    support: Float[np.ndarray, "c a"]
    """Support radius of each node, mm; 0 for padding."""
    points: tuple[Int[np.ndarray, "..."], ...]
    """Per block (c, q) numbers of the cells' quadrature points, -1 for padding."""
    cells: tuple[Int[np.ndarray, " _"], ...]
    """Per block (c,) cell numbers."""
    edge_ends: Int[np.ndarray, "e 2"]
    """Positions in the cell's node list of the two nodes of the plate's edge between which each contour edge lies; -1 where the edge is
    free or the contour edge lies inside the plate."""

    @property
    def owner(self) -> Int[np.ndarray, " p"]:
        """Cell number of each quadrature point."""
        return np.concatenate([np.repeat(c, (n >= 0).sum(axis=1)) for c, n in zip(self.cells, self.points, strict=True)])


@once_per_owner
def conforming_connectivity(topology: Topology, basis: str, dmax: float, skin: float) -> Connectivity:
    """``Connectivity`` of the cells that partition the gel; nodes that come closer by ``skin`` (mm) are listed too.

    Raises ValueError where a point has too few neighbours for the basis.
    """
    with jax.ensure_compile_time_eval():  # made of numbers, also inside jit
        return _conforming(topology, basis, dmax, skin)


def _conforming(topology, basis, dmax, skin):
    part, quadrature = topology.partition, topology.quadrature
    edges, edge_owner = part.contour_edges
    inner, on_edge = np.asarray(quadrature.points(part.vertices)), edge_points(part.vertices, edges)
    support = dmax * topology.node_spacing
    points = np.concatenate([inner, on_edge])
    check_support(topology, points, support, basis)
    owner = np.concatenate([quadrature.owner, np.repeat(edge_owner, len(EDGE_POINTS))])
    nodes, supports = pad_nodes(*reaching_nodes(topology, points, owner, support, skin), support)

    counts = np.bincount(quadrature.owner)
    groups = _groups_of_similar_size(counts)
    numbers = tuple(pad_rows(np.arange(len(inner)), counts, group) for group in groups)
    end_nodes = plate_edge_ends(topology, edges)
    listed = (nodes[edge_owner][:, None, :] == end_nodes[:, :, None]) & (supports[edge_owner] > 0)[:, None, :]
    edge_ends = np.where(listed.any(axis=2), listed.argmax(axis=2), -1)
    if np.any((edge_ends < 0) != (end_nodes < 0)):
        raise ValueError(f"dmax: {dmax} is too small for the supports to reach along the plate's edges; use a larger one")
    return Connectivity(topology, nodes, supports, numbers, groups, edge_ends)


def _groups_of_similar_size(counts):
    """Cell numbers in groups of similar numbers of points: whole squares and cut cells."""
    cut = counts > len(EDGE_POINTS) ** 2
    return tuple(group for group in (np.flatnonzero(~cut), np.flatnonzero(cut)) if len(group))


@once_per_owner
def paper_connectivity(
    topology: Topology, basis: str, dmax: float, cells: int | None
) -> tuple[Connectivity, Float[Array, "p 2"], Float[Array, " p"]]:
    """``Connectivity``, points and weights of square cells with 4 x 4 Gauss points each, points in holes dropped (Table 1).

    ``cells`` is the number of cells per side; None takes the plate's own at its own spacing, else one cell per node.
    """
    plate = topology.plate
    own = plate.cells if plate.cells and topology.spacing == plate.spacing else round(min(plate.width, plate.height) / topology.spacing)
    points, weight = square_cells(plate, own if cells is None else cells)
    outside = ~inside_holes(plate, points.reshape(-1, 2)).reshape(weight.shape)
    counts = outside.sum(axis=1)
    counts = counts[counts > 0]
    points, weight = points[outside], weight[outside]
    support = dmax * topology.node_spacing
    check_support(topology, points, support, basis)
    members = np.arange(len(counts))
    nodes, supports = pad_nodes(*reaching_nodes(topology, points, np.repeat(members, counts), support, 0.0), support)
    numbers = pad_rows(np.arange(len(points)), counts, members)
    return Connectivity(topology, nodes, supports, (numbers,), (members,), np.full((0, 2), -1)), points, weight


def plate_edge_ends(topology: Topology, edges: Int[np.ndarray, "e 2"]) -> Int[np.ndarray, "e 2"]:
    """The two nodes between which each contour edge on an edge of the plate lies; -1 for free edges and inside the plate."""
    plate, vertices = topology.plate, topology.partition.vertices
    nodes = vertices[topology.node_vertices]
    ends = np.full((len(edges), 2), -1)
    for edge, (axis, coordinate) in edge_lines(plate).items():
        if plate.edges[edge] == "free":
            continue
        on = (np.abs(vertices[edges][:, :, axis] - coordinate) < 1e-9 * topology.spacing).all(axis=1)
        on_edge = topology.edge_nodes[edge]
        middle = vertices[edges[on]][:, :, 1 - axis].mean(axis=1)
        k = np.clip(np.searchsorted(nodes[on_edge, 1 - axis], middle) - 1, 0, len(on_edge) - 2)
        ends[on] = np.stack([on_edge[k], on_edge[k + 1]], axis=1)
    return ends
