"""The discretised gel: cells, quadrature points and shape function gradients of a cloud.

Index letters: ``c`` cell, ``q`` quadrature point of a cell, ``p`` point, ``a b`` node of a cell's list, ``i j`` space. A cell's node list
holds all nodes whose support reaches the cell or its contour; padding has support 0. Cells of similar size share a ``CellBlock`` of
padded arrays.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from .._memo import once_per_owner
from .._types import Array, Float, Inexact, Int
from ..cloud import Cloud, Topology
from .checks import check_conditions, check_options, check_reproduction
from .connectivity import Connectivity, conforming_connectivity, paper_connectivity
from .consistency import corrected_gradients
from .interpolation import SKIN, Interpolation, evaluate_points, interpolate, neighbours_of_points
from .neighbours import is_moved

OUTLINE_ROOM = 1 / 400  # of the plate's width: further room in the neighbour lists of outline points, on a cloud that moves far
DMAX = 2.95  # support radius over spacing: nearly three grid lines to each side, and clear of the third, where round-off would decide
PAPER_DMAX = 3.5
PENALTY = 1e3  # kT/v per mm, the paper's


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class CellBlock:
    """Cells of similar size; a pytree."""

    cells: Int[Array, " c"]
    """Cell numbers."""
    nodes: Int[Array, "c a"]
    """Node numbers in ascending order, padded with the first one."""
    dphi: Inexact[Array, " c #q a 2"]
    """Shape function gradients, 1/mm, at each point or their mean over the cell; 0 for padded nodes."""
    weight: Float[Array, " c #q"]
    """Quadrature weights, mm^2; 0 for padded points."""


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["cloud", "blocks", "outline", "contact"],
    meta_fields=["lists", "basis", "dmax", "method", "quadrature", "kind", "conditions", "penalty", "solver"],
)
@dataclasses.dataclass(frozen=True)
class Model:
    """A cloud with its cells, quadrature points and shape functions: all that is needed to integrate an energy; a pytree."""

    cloud: Cloud
    """Nodes and cell vertices."""
    blocks: tuple[CellBlock, ...]
    """Cells, in blocks of similar size."""
    outline: Interpolation | None
    """Shape functions at all outline vertices, arc after arc; None where a derivative does not depend on them."""
    lists: Connectivity
    """Neighbours and layout of the quadrature points; static."""
    basis: str
    """``"linear"`` or ``"quadratic"``."""
    dmax: float
    """Support radius over node spacing."""
    method: str
    """``"mixed"``: one pressure per cell; ``"displacement"``: J at every quadrature point."""
    quadrature: str
    """``"conforming"`` or ``"paper"``."""
    kind: str
    """Kind of shape functions, see ``shape_functions``."""
    conditions: str = "nodes"
    """How essential conditions are imposed: at the ``"nodes"``, or weakly by ``"penalty"`` or ``"lagrange"`` multipliers."""
    penalty: float = 0.0
    """Penalty factor, kT/v per mm; 0 without."""
    solver: str = "auto"
    """How linear systems are solved: ``"auto"``, ``"direct"`` or ``"iterative"``, see ``linalg``."""
    contact: object = None
    """The ``mechanics.Contact`` of hole boundaries with themselves; None where they may overlap."""

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.lists.topology.node_vertices)

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return len(self.lists.nodes)

    @property
    def n_points(self) -> int:
        """Number of quadrature points."""
        return sum(int((numbers >= 0).sum()) for numbers in self.lists.points)


def discretise(
    cloud: Cloud,
    *,
    basis: str = "quadratic",
    dmax: float | None = None,
    method: str = "mixed",
    quadrature: str = "conforming",
    kind: str = "imls",
    conditions: str = "nodes",
    penalty: float = PENALTY,
    cells: int | None = None,
    skin: float | None = None,
    solver: str = "auto",
) -> Model:
    """``Model`` of a cloud: cells, quadrature points, shape function gradients.

    ``dmax`` is the support radius over the node spacing (2.95 by default, 3.5 for the paper's quadrature). ``quadrature="conforming"``
    partitions the gel exactly and corrects the gradients so that linear fields are integrated exactly (patch test);
    ``"paper"`` takes 4 x 4 Gauss points in each of ``cells`` x ``cells`` squares and drops the points in holes (Table 1).
    ``kind`` is that of ``shape_functions``. Those that do not interpolate, ``"icvmls"`` and ``"mls"``, need ``conditions="penalty"``, with
    the factor ``penalty`` in kT/v per mm, or ``"lagrange"`` instead of conditions at the ``"nodes"``.
    ``skin`` (mm) enlarges the neighbour lists by the distance that points of a moved cloud may have come closer; by default 0 on
    the reference cloud and a quarter of the spacing on a placed one. ``solver`` is ``"auto"``, ``"direct"`` or ``"iterative"``, see
    ``linalg``. Raises ValueError for unknown options and where a point has too few neighbours for the basis.
    """
    check_options(basis, method, quadrature, kind, solver)
    check_conditions(kind, conditions, penalty)
    dmax = (PAPER_DMAX if quadrature == "paper" else DMAX) if dmax is None else float(dmax)
    if not dmax > 1.0:
        raise ValueError(f"dmax: {dmax} is too small; the support must reach beyond the next node (dmax > 1)")
    topology = cloud.topology
    if quadrature == "paper":
        if is_moved(cloud):
            raise ValueError("quadrature: 'paper' drops points in holes and cannot follow moving holes; use 'conforming'")
        lists, points, weight = paper_connectivity(topology, basis, dmax, cells)
        _, dphi = evaluate_points(cloud.nodes, points, lists.nodes, lists.support, lists.owner, basis=basis, kind=kind)
    else:
        skin = (SKIN * cloud.spacing if is_moved(cloud) else 0.0) if skin is None else float(skin)
        lists = conforming_connectivity(topology, basis, dmax, skin)
        edge_ends = lists.edge_ends if conditions == "nodes" else np.full_like(lists.edge_ends, -1)
        dphi, weight = corrected_gradients(cloud.nodes, cloud.vertices, lists, basis, kind, edge_ends)
    outline = _outline_interpolation(cloud, dmax, basis, kind)
    weak = conditions, float(penalty) if conditions == "penalty" else 0.0
    model = Model(cloud, _blocks(lists, dphi, weight), outline, lists, basis, dmax, method, quadrature, kind, *weak, solver)
    check_reproduction(model)
    return model


def _outline_interpolation(cloud, dmax, basis, kind):
    """``Interpolation`` at all outline vertices of the cloud; of no points for a plate without holes."""
    if not cloud.topology.outlines:
        return Interpolation(jnp.zeros((0, 2)), np.zeros((0, 1), np.int32), *map(jnp.zeros, ((0, 1), (0, 1), (0, 1, 2))))
    numbers, neighbours = _outline(cloud.topology, dmax, is_moved(cloud))
    return interpolate(cloud, _points_of(cloud.vertices, numbers), neighbours, basis, kind)


@jax.jit
def _points_of(vertices, numbers):
    return vertices[numbers]


@once_per_owner
def _outline(topology: Topology, dmax: float, moved: bool):
    """Vertex numbers (p,) of all outlines, arc after arc, and their neighbour lists."""
    numbers = np.concatenate([outline.vertices for outline in topology.outlines])
    room = SKIN * topology.spacing * moved + OUTLINE_ROOM * topology.plate.width
    return numbers, neighbours_of_points(topology, dmax, topology.partition.vertices[numbers], room)


def _blocks(lists, dphi, weight):
    """``CellBlock``s from gradients (p, a, 2) and weights (p,) of all quadrature points."""
    widths = tuple(int((lists.support[cells] > 0).sum(axis=1).max()) for cells in lists.cells)
    values = _by_cell(dphi, weight, lists.points, widths)
    return tuple(CellBlock(c, lists.nodes[c, :n], *of_cells) for c, n, of_cells in zip(lists.cells, widths, values, strict=True))


@functools.partial(jax.jit, static_argnames="widths")
def _by_cell(dphi, weight, points, widths):
    """Per block the gradients (c, q, a, 2), with lists of the given width, and weights (c, q) of the numbered ``points`` (c, q)."""
    values = []
    for numbers, n in zip(points, widths, strict=True):
        at = jnp.where(numbers >= 0, numbers, numbers[:, :1])  # padding repeats a point of its own cell, where every energy is finite
        values.append((dphi[at, :n], jnp.where(numbers >= 0, weight[at], 0.0)))
    return values
