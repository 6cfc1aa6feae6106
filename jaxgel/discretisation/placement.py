"""Quality of a cloud that follows moving holes, and its renewal.

The topology of a cloud, its cells and neighbour lists, belongs to the plate it was made for. On a
plate whose holes have moved a little it serves as well; the farther they move, the flatter its
cells become and the more nodes reach points that do not list them.
"""

import dataclasses

import jax
import numpy as np
from scipy.spatial import cKDTree

from .._validation import Inadmissible
from ..cloud import Cloud, make_cloud
from ..geometry import Plate, reference_plate
from .model import DMAX, Model, discretise

SMALLEST_CELL = 0.4  # least quadrature weight over its value when the cloud was made
SPENT = 0.2  # the same for a cloud that may yet serve a single trial design
# largest area of a cell over its area when the cloud was made: beyond, its nodes are too far apart
LARGEST_CELL = 1.25
# most that a node without a place in a point's list may reach beyond the point, in units of its
# spacing: 4e-4 of an area
DEEPEST_GAP = 0.4
# largest gradient of a shape function, over 1 / spacing; 1 to 15 is usual on a new cloud
STEEPEST_KEPT = 25.0


@dataclasses.dataclass(frozen=True)
class Quality:
    """What is left of a cloud's quality on a plate it was not made for; dimensionless."""

    smallest_cell: float
    """Least quadrature weight over its original one: 1 when made, <= 0 for an inverted cell."""
    largest_cell: float
    """Largest area of a cell over its area when the cloud was made."""
    deepest_gap: float | None = None
    """Largest reach of a support, over the spacing, beyond a point that does not list its node.

    0 if none does, None if a cell is inside out.
    """
    steepest: float | None = None
    """Largest shape function gradient over 1 / spacing; None for an inverted cell.

    It grows if a point's neighbours come to lie on too few lines. None if a cell is inside out, and
    if the cloud is ``refused``.
    """
    refused: str = ""
    """Why the cloud cannot be discretised, in one line; empty if it can."""

    @property
    def fault(self) -> str:
        """What is too poor about it, in one line; empty if nothing is."""
        if not self.smallest_cell > SMALLEST_CELL:
            return f"a cell has shrunk to {self.smallest_cell:.2f} of its area"
        if not self.largest_cell < LARGEST_CELL:
            return f"a cell has grown to {self.largest_cell:.2f} of its area"
        if self.deepest_gap is not None and not self.deepest_gap < DEEPEST_GAP:
            return f"a support reaches {self.deepest_gap:.2f} spacings beyond its neighbour lists"
        if self.steepest is not None and not self.steepest < STEEPEST_KEPT:
            return (
                f"the neighbours of a point lie on too few lines: gradients of {self.steepest:.0f}"
            )
        return self.refused


def cell_sizes(cloud: Cloud) -> tuple[float, float]:
    """``smallest_cell`` and ``largest_cell`` of a cloud's `Quality`, the inexpensive part of it."""
    quadrature, before, now = (
        cloud.topology.quadrature,
        cloud.topology.partition.vertices,
        np.asarray(cloud.vertices),
    )
    weights = [np.asarray(quadrature.weights(vertices)) for vertices in (before, now)]
    areas = [np.bincount(quadrature.owner, weight) for weight in weights]
    return float((weights[1] / weights[0]).min()), float((areas[1] / areas[0]).max())


def quality(cloud: Cloud, *, basis: str = "quadratic", dmax: float | None = None) -> Quality:
    """``Quality`` of a cloud where it is placed now, for supports of ``dmax`` spacings (2.95).

    It needs concrete positions.
    """
    return _graded(cloud, basis, dmax)[0]


def _graded(cloud, basis, dmax):
    """The `quality`, and the model by which it was found, None without."""
    topology, sizes, dmax = cloud.topology, cell_sizes(cloud), DMAX if dmax is None else dmax
    if not sizes[0] > 0:
        return Quality(*sizes), None
    quadrature, before, now = (
        topology.quadrature,
        topology.partition.vertices,
        np.asarray(cloud.vertices),
    )
    support, points = (
        dmax * topology.node_spacing,
        (np.asarray(quadrature.points(before)), np.asarray(quadrature.points(now))),
    )
    nodes = topology.nodes, now[topology.node_vertices]
    near = cKDTree(points[1]).sparse_distance_matrix(
        cKDTree(nodes[1]), support.max(), output_type="ndarray"
    )
    regions = topology.partition.region_of_cell[quadrature.owner]
    near = near[(topology.node_regions[near["j"]] == regions[near["i"], None]).any(axis=1)]
    i, j = near["i"], near["j"]
    listed = np.linalg.norm(points[0][i] - nodes[0][j], axis=1) < support[j]
    depth = np.where(listed, 0.0, (support[j] - near["v"]) / topology.node_spacing[j])
    try:
        model = discretise(cloud, basis=basis, dmax=dmax)
    except Inadmissible as problem:
        return Quality(*sizes, float(depth.max(initial=0.0)), refused=str(problem)), None
    steepest = max(float(np.abs(np.asarray(block.dphi)).max()) for block in model.blocks) * float(
        topology.node_spacing.min()
    )
    return Quality(*sizes, float(depth.max(initial=0.0)), steepest), model


def refreshed(
    cloud: Cloud, plate: Plate, *, basis: str = "quadratic", dmax: float | None = None
) -> tuple[Cloud, str]:
    """The cloud for ``plate``, and why it is new: ``cloud`` placed there and "", or a reason.

    The new cloud has the spacing and numbers of nodes with which the old one was made. ``basis``
    and ``dmax`` are those of the model that is to be made of it. Values of differentiated
    parameters are used; inside ``jax.jit`` there are none, and ValueError is raised.
    """
    values = jax.tree.map(jax.lax.stop_gradient, plate)
    # refuses a plate without values
    own = reference_plate(dataclasses.replace(values, reference=None))
    fault = quality(cloud.at(values), basis=basis, dmax=dmax).fault
    return (_renewed(cloud, own) if fault else cloud).at(plate), fault


def _renewed(cloud, plate):
    """A new cloud for the plate, made as the other one was."""
    asked = ("spacing", "nodes_per_hole", "across")
    return make_cloud(plate, **{name: getattr(cloud.topology, name) for name in asked})


def placed(
    cloud: Cloud, plate: Plate, *, basis: str = "quadratic", dmax: float | None = None
) -> Model:
    """The model of ``plate``, of numbers, on the cloud that `refreshed` gives.

    It costs no more than the quality alone, which is that of the model.
    """
    own = reference_plate(dataclasses.replace(plate, reference=None))
    found, model = _graded(cloud.at(plate), basis, dmax)
    if model is None or found.fault:
        return discretise(_renewed(cloud, own).at(plate), basis=basis, dmax=dmax)
    return model
