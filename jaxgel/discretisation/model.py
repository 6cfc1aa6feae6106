"""The discretised gel: patches, quadrature points and shape function gradients of a cloud.

Index letters: ``c`` patch, ``q`` quadrature point of a patch, ``g`` volume group, ``p`` point, ``a b`` node of a patch's list, ``i j``
space, ``r`` row of an area form. A patch is a group of integration cells with one pressure field; see `patches` and `pressures`. Its node
list holds all nodes whose support reaches the patch or its contour; padding has support 0. Patches of similar size share a ``PatchBlock``
of padded arrays.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from .._memo import once_per_owner
from .._types import Array, Float, Inexact, Int, Scalar
from .._validation import check_kind
from ..cloud import Cloud, Topology
from .checks import check_conditions, check_options, check_reproduction
from .connectivity import Connectivity, conforming_connectivity, paper_connectivity
from .consistency import consistent_gradients
from .interpolation import Interpolation, evaluate_points, interpolate
from .neighbours import SKIN, is_moved, neighbours_of_points
from .pressures import group_weights, n_carrying

OUTLINE_ROOM = 1 / 400  # of the plate's width: further room in the neighbour lists of outline points, on a cloud that moves far
DMAX = 2.95  # support radius over spacing: nearly three grid lines to each side, and clear of the third, where round-off would decide
PAPER_DMAX = 3.5
PENALTY = 1e3  # kT/v per mm, the paper's


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["patches", "nodes", "position", "dphi", "weight", "group_weight", "contour"],
    meta_fields=["carrying"],
)
@dataclasses.dataclass(frozen=True)
class PatchBlock:
    """Patches of similar size; a pytree."""

    patches: Int[Array, " c"]
    """Patch numbers."""
    nodes: Int[Array, "c a"]
    """Node numbers in ascending order, padded with the first one."""
    position: Float[Array, " c #q 2"]
    """Dry positions of the quadrature points, mm; padding repeats a point."""
    dphi: Inexact[Array, " c #q a 2"]
    """Shape function gradients, 1/mm, at each point or their mean over the cell; 0 for padded nodes."""
    weight: Float[Array, " c #q"]
    """Quadrature weights, mm^2; 0 for padded points."""
    group_weight: Float[Array, "c _ g"] | None
    """Weights of J at the points in each volume group, see `pressures`; None where J is the mean over a cell, or that of a point."""
    contour: Inexact[Array, "c 2 r a"] | None
    """Rows of the area form of the contour, see `consistency.area_rows`; None where volumes are those of the points."""
    carrying: int
    """Number of the groups of a patch that carry its volume, in equal shares; the others are held. 0 where every point is a group."""

    @property
    def has_mean(self) -> bool:
        """Whether each patch has one volume ratio, the mean over its quadrature points."""
        return self.carrying == 1 and self.group_weight is None

    @property
    def n_groups(self) -> int:
        """Number of volume groups of a patch."""
        if self.group_weight is not None:
            return self.group_weight.shape[2]
        return 1 if self.has_mean else self.weight.shape[1]


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
    blocks: tuple[PatchBlock, ...]
    """Patches, in blocks of similar size."""
    outline: Interpolation | None
    """Shape functions at all outline vertices, arc after arc; None where a derivative does not depend on them."""
    lists: Connectivity
    """Neighbours and layout of the quadrature points; static."""
    basis: str
    """``"linear"`` or ``"quadratic"``."""
    dmax: float
    """Support radius over node spacing."""
    method: str
    """``"mixed"``: pressures linear over patches; ``"cells"``: one per cell; ``"displacement"``: J at every quadrature point."""
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

    def __repr__(self) -> str:
        """Sizes of the model."""
        return f"Model of {self.n_nodes} nodes, {self.basis}, {sum(len(block.patches) for block in self.blocks)} patches"

    def at_axial_stretch(self, axial: Scalar) -> "Model":
        """The same model held at another axial stretch, which may be traced; ValueError for other than generalised plane strain."""
        plate = dataclasses.replace(self.cloud.plate, axial_stretch=axial)
        return dataclasses.replace(self, cloud=dataclasses.replace(self.cloud, plate=plate))

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.lists.topology.node_vertices)

    @property
    def n_cells(self) -> int:
        """Number of integration cells."""
        return len(self.lists.patch_of_cell)

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

    ``method="mixed"`` has pressures linear over patches of 2 x 2 squares and constant over single cells along outlines and in narrow
    ligaments, and holds what they do not see of the volume ratio J. ``"cells"`` has one pressure per cell. ``"displacement"`` takes J at
    every quadrature point. ``dmax`` is the support radius over the node spacing (2.95 by default, 3.5 for the paper's quadrature).
    ``quadrature="conforming"`` partitions the gel into cells with curved sides along the outlines and corrects weights and gradients so
    that linear fields are integrated exactly (patch test); ``"paper"`` takes 4 x 4 Gauss points in each of ``cells`` x ``cells`` squares
    and drops the points in holes (Table 1); it has no patches, and ``"mixed"`` is ``"cells"`` with it.
    ``kind`` is that of ``shape_functions``. Those that do not interpolate, ``"icvmls"`` and ``"mls"``, need ``conditions="penalty"``, with
    the factor ``penalty`` in kT/v per mm, or ``"lagrange"`` instead of conditions at the ``"nodes"``.
    ``skin`` (mm) enlarges the neighbour lists by the distance that points of a moved cloud may have come closer; by default 0 on
    the reference cloud and a quarter of the spacing on a placed one. ``solver`` is ``"auto"``, ``"direct"`` or ``"iterative"``, see
    ``linalg``. Raises ValueError for unknown options and where a point has too few neighbours for the basis.
    """
    check_kind("cloud", cloud, Cloud, "a Cloud, as make_cloud(plate) makes it")
    check_options(basis, method, quadrature, kind, solver)
    check_conditions(kind, conditions, penalty)
    dmax = (PAPER_DMAX if quadrature == "paper" else DMAX) if dmax is None else float(dmax)
    if not dmax > 1.0:
        raise ValueError(f"dmax: {dmax} is too small; the support must reach beyond the next node (dmax > 1)")
    topology = cloud.topology
    if quadrature == "paper":
        if topology.plate.regions:
            raise ValueError("quadrature: 'paper' has no cells along the outlines of regions; use 'conforming'")
        if topology.plate.kinematics != "plane strain":
            raise ValueError(f"quadrature: 'paper' knows plane strain only, not {topology.plate.kinematics!r}; use 'conforming'")
        if is_moved(cloud):
            raise ValueError("quadrature: 'paper' drops points in holes and cannot follow moving holes; use 'conforming'")
        if method == "mixed":
            method = "cells"
        lists, points, weight = paper_connectivity(topology, basis, dmax, cells)
        rows = None
        _, dphi = evaluate_points(cloud.nodes, points, lists.nodes, lists.support, lists.owner, basis=basis, kind=kind)
    else:
        skin = (SKIN * cloud.spacing if is_moved(cloud) else 0.0) if skin is None else float(skin)
        lists = conforming_connectivity(topology, method, basis, dmax, skin)
        edge_ends = lists.contour.edge_ends if conditions == "nodes" else np.full_like(lists.contour.edge_ends, -1)
        dphi, weight, rows = consistent_gradients(cloud.nodes, cloud.vertices, lists, basis, kind, edge_ends)
        points = topology.quadrature.points(cloud.vertices)
    outline = _outline_interpolation(cloud, dmax, basis, kind)
    weak = conditions, float(penalty) if conditions == "penalty" else 0.0
    model = Model(
        cloud, _blocks(lists, method, points, dphi, weight, rows), outline, lists, basis, dmax, method, quadrature, kind, *weak, solver
    )
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


def _blocks(lists, method, points, dphi, weight, rows):
    """``PatchBlock``s from positions (p, 2), gradients (p, a, 2) and weights (p,) of all quadrature points and the `area_rows`."""
    widths = tuple(int((lists.support[patches] > 0).sum(axis=1).max()) for patches in lists.patches)
    numbers = lists.contour.numbers if rows is not None else (None,) * len(lists.points)
    linear = tuple(bool(lists.linear[patches[0]]) for patches in lists.patches)
    values = _by_patch(points, dphi, weight, rows, lists.points, numbers, widths=widths, linear=linear, method=method)
    carrying = [n_carrying(of) if method != "displacement" else 0 for of in linear]
    parts = zip(lists.patches, widths, values, carrying, strict=True)
    return tuple(PatchBlock(patches, lists.nodes[patches, :n], *of_patches, many) for patches, n, of_patches, many in parts)


@functools.partial(jax.jit, static_argnames=("widths", "linear", "method"))
def _by_patch(points, dphi, weight, rows, point_numbers, edge_numbers, *, widths, linear, method):
    """Per block positions (c, q, 2), gradients (c, q, a, 2) with lists of the given width, weights (c, q), those of groups, area forms."""
    values = []
    for numbers, edges, n, of in zip(point_numbers, edge_numbers, widths, linear, strict=True):
        at = jnp.where(numbers >= 0, numbers, numbers[:, :1])  # padding repeats a point of its own patch, where every energy is finite
        w = jnp.where(numbers >= 0, weight[at], 0.0)
        groups = contour = None
        if method == "mixed":
            groups = group_weights(points[at], w, of)
            contour = jnp.where((edges >= 0)[:, None, :, None], jnp.swapaxes(rows[edges][..., :n], 1, 2), 0.0)
        values.append((points[at], dphi[at, :n], w, groups, contour))
    return values
