"""Connectivity of the patches: their nodes, quadrature points and contour edges.

NumPy arrays, built once on the reference plate.
"""

import dataclasses
import functools

import jax
import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from .._memo import once_per_owner
from .._tracing import outside_traces
from .._types import Array, Bool, Float, Int
from .._validation import Inadmissible
from ..cloud import EDGE_POINTS, Topology, find_rows, opposite_edges, refuse_ligament
from ..geometry import edge_lines
from .moving_least_squares import n_monomials
from .neighbours import pad_nodes, pad_rows, reaching_nodes
from .patches import patches

FEW = 16  # patches


@dataclasses.dataclass(frozen=True, eq=False)
class Connectivity:
    """What does not move with the holes: neighbours and the layout of the quadrature points.

    Hashed by identity.
    """

    topology: Topology
    """The cloud's topology."""
    nodes: Int[np.ndarray, "c a"]
    """Node numbers of each patch in ascending order, padded with the first one."""
    support: Float[np.ndarray, "c a"]
    """Support radius of each node, mm; 0 for padding."""
    patch_of_cell: Int[np.ndarray, " cells"]
    """Patch number of each integration cell."""
    linear: Bool[np.ndarray, " c"]
    """Whether the pressure is linear over the patch; constant otherwise."""
    cell_of_point: Int[np.ndarray, " p"]
    """Cell number of each quadrature point."""
    points: tuple[Int[np.ndarray, "..."], ...]
    """Per block (c, q) numbers of the patches' quadrature points, -1 for padding."""
    patches: tuple[Int[np.ndarray, " _"], ...]
    """Per block (c,) patch numbers."""
    contour: "Contour"
    """Contours of the patches."""
    unknowns: object | None = None
    """The unknowns, see `mechanics.dofs`, of a part of a symmetric plate; None for a whole one.

    ``patches`` are then those of the part.
    """

    @property
    def owner(self) -> Int[np.ndarray, " p"]:
        """Patch number of each quadrature point."""
        return self.patch_of_cell[self.cell_of_point]

    @functools.cached_property
    def region_of_patch(self) -> Int[np.ndarray, " c"]:
        """Region of each patch, numbered as in ``cloud.Partition``."""
        found = np.zeros(len(self.linear), dtype=int)
        found[self.patch_of_cell] = self.topology.partition.region_of_cell
        return found


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Contour:
    """Directed edges of the contours of all cells, the gel on the left; a pytree."""

    ends: Int[np.ndarray, "e 2"]
    """Vertex numbers."""
    middles: tuple[Int[np.ndarray, "e 3"], Float[np.ndarray, "e 3"]]
    """Vertex numbers and weights of the middle of every edge."""
    cell: Int[np.ndarray, " e"]
    """Cell numbers, ascending."""
    owner: Int[np.ndarray, " e"]
    """Patch numbers."""
    following: Int[np.ndarray, " e"]
    """Number of the edge of the same cell that starts where this one ends."""
    edge_ends: Int[np.ndarray, "e 2"]
    """Positions in the node list of the ends of a held plate edge around each edge; else -1.

    They are the two nodes of the plate's edge between which the edge lies, in the patch's node
    list; -1 if the edge of the plate is free or the edge lies inside the plate.
    """
    numbers: tuple[Int[np.ndarray, "..."], ...]
    """Per block (c, e) numbers of the edges on the patches' own contours, -1 for padding."""
    on_interfaces: tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k a"]] | None = None
    """Numbers of the `points` on interfaces, and trace weights of the nodes of the patches there.

    The nodes are those in the patches' lists, see ``cloud.curves``; None without interfaces.
    """

    def points(self, vertices: Float[Array, "v 2"]) -> Float[Array, "e 2 2"]:
        """Start and middle of every edge for these positions of the vertices.

        Without a program for numbers.
        """
        return _starts_and_middles(vertices, self.ends, *self.middles)


def _starts_and_middles(vertices, ends, at, weights):
    xp = vertices.__array_namespace__()
    return xp.stack([vertices[ends[:, 0]], xp.einsum("ek,eki->ei", weights, vertices[at])], axis=1)


@once_per_owner
@outside_traces()  # made of numbers, also inside jit
def make_connectivity(topology: Topology, basis: str, dmax: float) -> Connectivity:
    """``Connectivity`` of the patches of a cloud.

    Raises ValueError if a point has too few neighbours for the basis.
    """
    part, quadrature, support = (
        topology.partition,
        topology.quadrature,
        dmax * topology.node_spacing,
    )
    patch_of_cell, linear = patches(topology)
    ends, cell = part.contour_edges
    owner, middles = patch_of_cell[cell], topology.middles(ends)
    points = np.concatenate(
        [quadrature.points(part.vertices), *_starts_and_middles(part.vertices, ends, *middles)]
    )
    cells = np.concatenate([quadrature.owner, np.repeat(cell, 2)])
    regions = part.region_of_cell[cells]
    _check_support(topology, points, regions, support, basis)
    on_interfaces, traces = _traces(topology, ends, cell, middles)
    row, trace_node = traces.coords
    trace_owner = owner[on_interfaces // 2]
    also = trace_owner[row], trace_node
    nodes, supports = pad_nodes(
        *reaching_nodes(topology, points, patch_of_cell[cells], regions, support, also), support
    )
    trace_weights = np.zeros((len(trace_owner), nodes.shape[1]))
    trace_weights[row, (nodes[also[0]] == trace_node[:, None]).argmax(axis=1)] = traces.data

    end_nodes = plate_edge_ends(topology, ends)
    listed = (nodes[owner][:, None, :] == end_nodes[:, :, None]) & (supports[owner] > 0)[:, None, :]
    edge_ends = np.where(listed.any(axis=2), listed.argmax(axis=2), -1)
    if np.any((edge_ends < 0) != (end_nodes < 0)):
        raise Inadmissible(
            f"dmax: {dmax} is too small for the supports to reach along the plate's edges; use a "
            "larger one"
        )
    groups = _groups_of_similar_size(linear, quadrature.owner, patch_of_cell)
    # the others have a cell of the patch on either side
    outer = np.flatnonzero(opposite_edges(ends, owner) < 0)
    contour = Contour(
        ends=ends,
        middles=middles,
        cell=cell,
        owner=owner,
        following=find_rows(*(np.stack([cell, vertex], axis=1) for vertex in ends.T)),
        edge_ends=edge_ends,
        numbers=tuple(
            np.where(rows >= 0, outer[rows], -1)
            for rows in _rows_of(owner[outer], len(linear), groups)
        ),
        on_interfaces=(on_interfaces, trace_weights) if topology.interfaces else None,
    )
    numbers = _rows_of(patch_of_cell[quadrature.owner], len(linear), groups)
    # the cloud's own keeps these lists: neither waits for Python's collector
    topology = dataclasses.replace(topology)
    return Connectivity(
        topology, nodes, supports, patch_of_cell, linear, quadrature.owner, numbers, groups, contour
    )


def _traces(topology, ends, cell, middles):
    """Numbers (k,) of contour points on interfaces, and the trace matrix (k, n) there.

    These are starts of edges at their vertices and all points of edges along them; the matrix takes
    nodal values to the traces.
    """
    region, traces, other, (at, weights) = (
        topology.partition.region_of_cell[cell],
        topology.traces,
        opposite_edges(ends),
        middles,
    )
    along = np.flatnonzero((other >= 0) & (region != region[other]))
    starts = np.flatnonzero(np.diff(traces.indptr)[ends[:, 0]])
    middle = sum(traces[at[along, k]].multiply(weights[along, k, None]) for k in range(3))
    return np.concatenate([2 * starts, 2 * along + 1]), sp.vstack(
        [traces[ends[starts, 0]], middle]
    ).tocoo()


def _rows_of(owner, count, groups):
    """Per group of owners the numbers of what each owns, padded with -1."""
    order, counts = np.argsort(owner, kind="stable"), np.bincount(owner, minlength=count)
    return tuple(pad_rows(order, counts, group) for group in groups)


def _groups_of_similar_size(linear, owner, patch_of_cell):
    """Patch numbers in groups: linear pressures without and with cut cells, constant pressures.

    Every group is a part of each compiled program. Fewer than ``FEW`` patches without cut cells do
    not pay for that and join the others.
    """
    is_cut = np.bincount(owner) > len(EDGE_POINTS) ** 2
    cut = np.bincount(patch_of_cell, is_cut) > 0
    cut |= linear & (np.sum(linear & ~cut) < FEW)
    kinds = [linear & ~cut, linear & cut, ~linear]
    return tuple(group for group in map(np.flatnonzero, kinds) if len(group))


def plate_edge_ends(
    topology: Topology, edges: Int[np.ndarray, "e 2"], *, free: bool = False
) -> Int[np.ndarray, "e 2"]:
    """The two nodes around each contour edge on a held or ``free`` edge of the plate; else -1."""
    plate, nodes, vertices = topology.plate, topology.nodes, topology.partition.vertices
    ends = np.full((len(edges), 2), -1)
    for edge, (axis, coordinate) in edge_lines(plate).items():
        if (plate.edges[edge] == "free") != free:
            continue
        on = (np.abs(vertices[edges][:, :, axis] - coordinate) < 1e-9 * topology.spacing).all(
            axis=1
        )
        on_edge = topology.edge_nodes[edge]
        middle = vertices[edges[on]][:, :, 1 - axis].mean(axis=1)
        k = np.clip(np.searchsorted(nodes[on_edge, 1 - axis], middle) - 1, 0, len(on_edge) - 2)
        ends[on] = np.stack([on_edge[k], on_edge[k + 1]], axis=1)
    return ends


def _check_support(topology, points, regions, support, basis):
    """ValueError with the first point that has too few nodes of its region in reach.

    Fewer than the basis needs.
    """
    need = n_monomials(basis) + 1
    for region in np.unique(regions):
        own = (topology.node_regions == region).any(axis=1)
        nodes, reach, inside = topology.nodes[own], support[own], points[regions == region]
        distance, index = cKDTree(nodes).query(inside, k=need)
        index = np.minimum(index, len(nodes) - 1)  # a missing neighbour is infinitely far
        for place in inside[(distance >= reach[index]).any(axis=1)]:
            # farther nodes may reach
            if np.sum(np.linalg.norm(nodes - place, axis=1) < reach) < need:
                refuse_ligament(topology, topology.spacing, place, reach.max())
                raise Inadmissible(
                    f"dmax: a support of {reach.max():.3g} mm reaches fewer than {need} nodes at "
                    f"the point ({place[0]:.4g}, "
                    f"{place[1]:.4g}), too few for the {basis} basis; use a larger dmax or a "
                    "smaller spacing"
                )
