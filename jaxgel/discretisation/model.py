"""The discretised gel: patches, quadrature points and shape function gradients of a cloud."""

import dataclasses
import functools

import jax
import numpy as np

from .._deprecated import old_arguments
from .._memo import once_per_owner
from .._tracing import is_traced, numbers_of
from .._types import Scalar
from .._validation import Inadmissible, check_kind, one_of
from ..cloud import Cloud, Topology, refuse_ligament
from .body import Body, PatchBlock, carrying_groups, numbered, shared_body
from .connectivity import Connectivity, make_connectivity
from .consistency import consistent_patches
from .interpolation import Interpolation, interpolate
from .moving_least_squares import BASES
from .neighbours import neighbours_of_points
from .pressures import n_carrying

# largest gradient of a shape function, over 1 / spacing; 1 to 15 is usual
STEEPEST_ACCEPTED = 100.0
# largest error with which the gradients of an accepted model reproduce the coordinates
REPRODUCTION = 1e-7
# support radius over spacing: nearly three grid lines to each side, and clear of the third, where
# round-off would decide
DMAX = 2.95


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, kw_only=True)
class Model(Body):
    """A cloud with its cells, quadrature points and shape functions, of `discretise`. A pytree."""

    cloud: Cloud
    """Nodes and cell vertices."""
    lists: Connectivity = dataclasses.field(metadata={"static": True})
    """Neighbour lists and layout of the quadrature points; static."""
    basis: str = dataclasses.field(metadata={"static": True})
    """Polynomial basis, "linear" or "quadratic"."""
    dmax: float = dataclasses.field(metadata={"static": True})
    """Support radius over the node spacing, dimensionless."""

    def __repr__(self) -> str:
        """Sizes of the model."""
        return (
            f"Model of {self.n_nodes} nodes, {self.basis}, "
            f"{sum(len(block.patches) for block in self.blocks)} patches"
        )

    def at_axial_stretch(self, axial: Scalar) -> "Model":
        """The same model held at another axial stretch, which may be traced.

        ValueError for other than generalised plane strain.
        """
        plate = dataclasses.replace(self.cloud.plate, axial_stretch=axial)
        return dataclasses.replace(
            self, cloud=dataclasses.replace(self.cloud, plate=plate), axial_stretch=axial
        )

    @functools.cached_property
    def shared(self) -> Body:
        """The arrays alone, of sizes that similar models share, see `layout`."""
        return shared_body(self)

    @property
    def lengths(self) -> dict[str, int]:
        """Numbers of nodes, volume groups, cells and points of the outlines, by letter."""
        return {
            **super().lengths,
            "c": self.n_cells,
            "p": 0 if self.outline is None else len(self.outline.points),
        }

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


@old_arguments
def discretise(cloud: Cloud, *, basis: str = "quadratic", dmax: float | None = None) -> Model:
    """`Model` of a cloud: integration cells, quadrature points, gradients of the shape functions.

    Arguments:

    - `cloud`: the `Cloud`, of `make_cloud`. A moved cloud keeps its neighbour lists; see `quality`
      for the admissible distance.
    - `basis`: "quadratic" or "linear", the complete polynomials that are reproduced.
    - `dmax`: support radius over the node spacing, above 1; 2.95 by default.

    The cells partition the gel, with curved sides along the outlines. Weights and gradients are
    corrected so that linear fields are integrated exactly (patch test). Pressures are linear over
    patches of 2 x 2 squares, and constant over single cells along outlines and in narrow ligaments;
    modes of the volume ratio J without a pressure are stabilised.

    Raises `ValueError` for an unknown basis, an unusable `dmax`, and if a point has too few
    neighbours for the basis.

    >>> import jaxgel
    >>> cloud = jaxgel.make_cloud(jaxgel.Plate(2.0, 2.0), spacing=0.5)
    >>> discretise(cloud).n_nodes
    25
    """
    check_kind("cloud", cloud, Cloud, "a Cloud, as make_cloud(plate) makes it")
    one_of("basis", basis, BASES)
    dmax = DMAX if dmax is None else float(dmax)
    if not dmax > 1.0:
        raise ValueError(
            f"dmax: {dmax} is too small; the support must reach beyond the next node (dmax > 1)"
        )
    with numbers_of(cloud.vertices):  # the model of a cloud of numbers is numbers, also inside jit
        return _discretised(cloud, basis, dmax)


def _discretised(cloud, basis, dmax):
    lists = make_connectivity(cloud.topology, basis, dmax)
    blocks = numbered(
        PatchBlock(
            patches,
            np.zeros((len(patches), values[3].shape[2]), int),
            lists.nodes[patches, : values[1].shape[2]],
            *values,
            n_carrying(bool(lists.linear[patches[0]])),
        )
        for patches, values in zip(
            lists.patches, consistent_patches(cloud, lists, basis), strict=True
        )
    )
    outline = Interpolation(
        np.zeros((0, 2)), np.zeros((0, 1), np.int32), *map(np.zeros, ((0, 1), (0, 1), (0, 1, 2)))
    )
    if cloud.topology.outlines:
        numbers, neighbours = _outline(cloud.topology, dmax)
        outline = interpolate(cloud, cloud.positions(numbers), neighbours, basis)
    plate = cloud.topology.plate
    model = Model(
        nodes=cloud.nodes,
        blocks=blocks,
        carries=carrying_groups(blocks),
        outline=outline,
        axial_stretch=cloud.plate.axial_stretch,
        across=max(plate.width, plate.height) / float(cloud.topology.node_spacing.min()),
        film=plate.kinematics == "plane stress",
        cloud=cloud,
        lists=lists,
        basis=basis,
        dmax=dmax,
    )
    _check_reproduction(model)
    return model


@once_per_owner
def _outline(topology: Topology, dmax: float):
    """Vertex numbers (p,) of all outlines, arc after arc, and their neighbour lists."""
    numbers = np.concatenate([outline.vertices for outline in topology.outlines])
    return numbers, neighbours_of_points(topology, dmax, topology.partition.vertices[numbers])


def _check_reproduction(model):
    """ValueError, outside traces, for gradients that do not reproduce the coordinates.

    The neighbours lie on too few lines.
    """
    cloud, topology = model.cloud, model.cloud.topology
    if is_traced(cloud.vertices):
        return
    nodes, steepest = np.asarray(cloud.nodes), STEEPEST_ACCEPTED / topology.node_spacing.min()
    for block in model.blocks:
        dphi = np.asarray(block.dphi)
        F = np.einsum("cai,cqaj->cqij", nodes[block.nodes], dphi)
        error = np.abs(F - np.eye(2)).max(axis=(2, 3))
        poor = ~(error < REPRODUCTION) | ~(np.abs(dphi).max(axis=(2, 3)) < steepest)
        bad = np.argwhere(poor & (np.asarray(block.weight) > 0))
        if len(bad):
            x, y = nodes[block.nodes[bad[0, 0], 0]]
            stencil = nodes[np.unique(block.nodes[bad[0, 0]])]
            refuse_ligament(
                topology, topology.spacing, stencil.mean(axis=0), np.ptp(stencil, axis=0).max() / 2
            )
            raise Inadmissible(
                f"dmax: {model.dmax} is too small for the {model.basis} basis near the point "
                f"({x:.4g}, {y:.4g}): its neighbours lie on "
                "too few lines; use a larger dmax or a smaller spacing"
            )
