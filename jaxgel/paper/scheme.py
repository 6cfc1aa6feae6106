"""The scheme of Deng et al. (2020) as printed, and the variants that it is compared with.

Square cells have 4 x 4 Gauss points each, points in holes are dropped. J is taken at every point,
or, for comparison, as the mean over each cell. Essential conditions are imposed at the nodes, or,
for shape functions that do not interpolate, weakly. With the wall's normal displacement u_n(x) =
sum_a phi_a (x_a - X_a) . n the energy is then extended by

    penalty:    alpha/2 int u_n^2 ds
    lagrange:   int lambda u_n ds, lambda linear between the wall nodes of each edge

(Belytschko, Lu & Gu 1994) and every nodal value is unknown. Complex shape functions act on x_1 + i
x_2: F depends on both components of a node through each of its own. Index letters: ``c`` cell,
``q`` Gauss point, ``g`` volume group of a cell, ``a b`` node of a cell's list, ``i j`` space.
"""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.sparse as sp
from jax import lax

from .._types import Array, Float, Inexact, Int, Scalar
from .._validation import one_of
from ..cloud import Cloud
from ..discretisation import (
    BASES,
    Model,
    discretise,
    pad_nodes,
    reaching_nodes,
    shape_functions_and_gradients,
)
from ..geometry import Plate, edge_lines, held_components, inside_holes
from ..materials import Gel
from ..mechanics import free_dofs
from .least_squares import INTERPOLATING, KINDS, shape_functions

CELLS = {"lattice": 20}
"""Cells per side of a case of the paper.

The others have one for each square of their background.
"""
METHODS = ("displacement", "cells")
CONDITIONS = ("nodes", "penalty", "lagrange")
DMAX = 3.5  # support radius over spacing, the paper's
PENALTY = 1e3  # kT/v per mm, the paper's
# in each direction of a cell, and on each stretch of wall between two nodes
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(4)
BATCH = 64  # points whose shape functions are evaluated together
TURN = np.array([[0.0, -1.0], [1.0, 0.0]])  # multiplication by i
MINORS = np.kron(np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[0.0, 1.0], [-1.0, 0.0]]))
"""Second derivative (4, 4) of det F by F_11, F_12, F_21, F_22."""


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["nodes", "dphi", "weight"],
    meta_fields=["method"],
)
@dataclasses.dataclass(frozen=True)
class Cells:
    """The cells with their Gauss points; a pytree."""

    nodes: Int[Array, "c a"]
    """Node numbers, padded with the first one."""
    dphi: Inexact[Array, "c q a 2"]
    """Shape function gradients, 1/mm; 0 for padding."""
    weight: Float[Array, "c q"]
    """Quadrature weights, mm^2; 0 for dropped points."""
    method: str
    """``"displacement"``: J at every point; ``"cells"``: its mean over every cell."""

    @property
    def volumes(self) -> Float[Array, "c g"]:
        """Dry volumes of the volume groups, mm^2; 0 for dropped points."""
        return (
            self.weight
            if self.method == "displacement"
            else jnp.sum(self.weight, axis=1, keepdims=True)
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Scheme:
    """Cloud, cells and conditions of one variant; n nodes, N = 2 n unknowns, m multipliers.

    These are degrees of freedom.
    """

    cloud: Cloud
    """Nodes; cells of its own are not used."""
    cells: Cells
    """Cells, Gauss points, gradients."""
    basis: str
    """Basis of the shape functions."""
    dmax: float
    """Support radius over node spacing."""
    kind: str
    """Kind of shape functions, see ``shape_functions``."""
    conditions: str
    """How essential conditions are imposed."""
    free: Int[np.ndarray, " f"]
    """Unknown degrees of freedom: all of them if conditions are weak."""
    stiffness: sp.csr_array
    """Of the penalty (N, N), kT/v; zero without."""
    rows: Float[np.ndarray, "m N"]
    """int lambda_i u_n ds of the multipliers, mm; none without."""

    @property
    def n_points(self) -> int:
        """Number of Gauss points in the gel."""
        return int(jnp.sum(self.cells.weight > 0))

    @property
    def n_constraints(self) -> int:
        """Number of volume ratios: of points, or of cells."""
        return int(jnp.sum(self.cells.volumes > 0))

    @functools.cached_property
    def model(self) -> Model:
        """``Model`` with the same interpolating shape functions, for observables.

        These read the nodal positions by it.
        """
        if self.kind not in INTERPOLATING:
            raise ValueError(
                f"kind: {self.kind!r} does not interpolate; observables need "
                f"{' or '.join(map(repr, INTERPOLATING))}"
            )
        return discretise(self.cloud, basis=self.basis, dmax=self.dmax)

    def positions(
        self, x: Float[Array, "n 2"], points: Float[Array, "p 2"]
    ) -> Float[np.ndarray, "p 2"]:
        """Deformed positions of ``points`` of the dry plate for nodal values ``x``, mm."""
        return (self.rows_at(points) @ np.ravel(x)).reshape(-1, 2)

    def rows_at(self, points: Float[Array, "p 2"]) -> Float[np.ndarray, "p 2 N"]:
        """The rows that take nodal values to positions at ``points``.

        Of all nodes: for a few points.
        """
        support = self.dmax * self.cloud.topology.node_spacing
        phi = np.asarray(
            _values(
                jnp.asarray(points), self.cloud.nodes, support, basis=self.basis, kind=self.kind
            )
        )
        rows = np.einsum("pa,ik->piak", phi.real, np.eye(2)) + np.einsum(
            "pa,ik->piak", phi.imag, TURN
        )
        return rows.reshape(len(phi), 2, -1)


def make_scheme(
    cloud: Cloud,
    *,
    basis: str = "linear",
    dmax: float = DMAX,
    kind: str = "iicvmls",
    method: str = "displacement",
    conditions: str = "nodes",
    penalty: float = PENALTY,
) -> Scheme:
    """``Scheme`` of a cloud; the defaults are the paper's.

    ``method="displacement"`` takes J at every Gauss point, ``"cells"`` its mean over each cell.
    ``conditions`` of other ``kind``s of shape functions than "iicvmls" and "imls" are
    ``"penalty"``, with the factor ``penalty`` in kT/v per mm, or ``"lagrange"``. Raises ValueError
    for unknown options, and for plates that the paper has no equations for: moved or periodic
    edges, regions, films.
    """
    for name, value, accepted in (
        ("basis", basis, BASES),
        ("kind", kind, KINDS),
        ("method", method, METHODS),
    ):
        one_of(name, value, accepted)
    one_of("conditions", conditions, CONDITIONS)
    if conditions == "nodes" and kind not in INTERPOLATING:
        raise ValueError(
            f"kind: {kind!r} does not interpolate; use conditions = 'penalty' or 'lagrange', or "
            "kind = 'iicvmls' or 'imls'"
        )
    if not 0 < penalty < np.inf:
        raise ValueError(f"penalty: {penalty!r} is not a finite number above 0 (kT/v per mm)")
    plate = cloud.topology.plate
    if (
        plate.kinematics != "plane strain"
        or plate.regions
        or plate.moved
        or "periodic" in plate.edges.values()
    ):
        raise ValueError(
            "cloud: the paper's scheme has plane strain, one gel, and edges that are free, "
            "rollers or fixed in place"
        )
    cells = _cells(cloud, basis, dmax, kind, method)
    size = 2 * len(cloud.nodes)
    free = free_dofs(cloud.topology).masters if conditions == "nodes" else np.arange(size)
    scheme = Scheme(
        cloud,
        cells,
        basis,
        dmax,
        kind,
        conditions,
        free,
        sp.csr_array((size, size)),
        np.zeros((0, size)),
    )
    if conditions == "nodes":
        return scheme
    normal, weight, hat = _walls(scheme)
    if conditions == "lagrange":
        return dataclasses.replace(scheme, rows=(hat.T * weight) @ normal)
    return dataclasses.replace(
        scheme, stiffness=sp.csr_array(penalty * (normal.T * weight) @ normal)
    )


def square_cells(
    plate: Plate, side: int
) -> tuple[Float[np.ndarray, "c 16 2"], Float[np.ndarray, "c 16"]]:
    """Gauss points, mm, and weights, mm^2, of ``side`` x ``side`` cells with 4 x 4 points each.

    Those in holes have the weight 0.
    """
    middle = (np.arange(side) + 0.5) / side - 0.5
    centres = np.stack(
        np.meshgrid(middle * plate.width, middle * plate.height, indexing="ij"), axis=-1
    ).reshape(-1, 1, 2)
    half = np.array([plate.width, plate.height]) / (2 * side)
    points = (
        centres
        + np.stack(np.meshgrid(POINTS, POINTS, indexing="ij"), axis=-1).reshape(1, -1, 2) * half
    )
    in_gel = ~inside_holes(plate, points.reshape(-1, 2)).reshape(points.shape[:2])
    return points, in_gel * np.outer(WEIGHTS, WEIGHTS).ravel() * half.prod()


def cells_per_side(plate: Plate, spacing: float) -> int:
    """Number of the paper's cells along a side of a plate with node ``spacing``, mm.

    That of the background nodes.
    """
    own = CELLS.get(plate.name) if spacing == plate.spacing else None
    return own or round(min(plate.width, plate.height) / spacing)


def _cells(cloud, basis, dmax, kind, method):
    """The `Cells` of a cloud that have points in the gel."""
    topology = cloud.topology
    points, weight = square_cells(topology.plate, cells_per_side(topology.plate, topology.spacing))
    used = weight.any(axis=1)
    points, weight = points[used], weight[used]
    in_gel = weight > 0
    # dropped points repeat one of their cell, where every energy is finite
    first = in_gel.argmax(axis=1)[:, None]
    points = np.where(
        in_gel[..., None], points, np.take_along_axis(points, first[..., None], axis=1)
    )
    support = dmax * topology.node_spacing
    flat, owner = points.reshape(-1, 2), np.repeat(np.arange(len(points)), points.shape[1])
    lists, supports = pad_nodes(
        *reaching_nodes(topology, flat, owner, np.zeros(len(flat), int), support), support
    )
    dphi = _gradients(points, cloud.nodes[lists], supports, basis=basis, kind=kind)
    if not np.isfinite(dphi).all():
        raise ValueError(
            f"dmax: {dmax} is too small for the {basis} basis; use a larger one or a smaller "
            "spacing"
        )
    return Cells(jnp.asarray(lists), dphi, jnp.asarray(weight), method)


@functools.partial(jax.jit, static_argnames=("basis", "kind"))
def _gradients(points, neighbours, supports, *, basis, kind):
    """Shape function gradients (c, q, a, 2) at points (c, q, 2) by the lists of their cells.

    Neighbours (c, a, 2) and supports (c, a).
    """

    def at_point(point, neighbours, support):
        if kind in INTERPOLATING:
            gradients = shape_functions_and_gradients(
                point, neighbours, support, basis=basis, kind=kind
            )[1]
        else:
            gradients = jax.jacfwd(shape_functions)(
                point, neighbours, support, basis=basis, kind=kind
            )
        return jnp.where(
            (support > 0)[:, None], gradients.real if kind == "iicvmls" else gradients, 0.0
        )

    def of_cell(cell):
        points, neighbours, support = cell
        return jax.vmap(at_point, (0, None, None))(points, neighbours, support)

    return lax.map(of_cell, (points, neighbours, supports), batch_size=BATCH // len(POINTS) ** 2)


@functools.partial(jax.jit, static_argnames=("basis", "kind"))
def _values(points, nodes, support, *, basis, kind):
    return lax.map(
        lambda point: shape_functions(point, nodes, support, basis=basis, kind=kind),
        points,
        batch_size=BATCH,
    )


def _walls(scheme):
    """Normal displacement (w, N) at wall points, weights (w,), mm, and functions (w, m).

    Per nodal displacement; the functions are linear on the edges.
    """
    topology, nodes = scheme.cloud.topology, np.asarray(scheme.cloud.nodes)
    points, weight, components, hats = [], [], [], []
    s = (1 + POINTS[:, None]) / 2
    for edge in edge_lines(topology.plate):
        wall = nodes[topology.edge_nodes[edge]]
        along, ends = np.diff(wall, axis=0)[:, None], np.eye(len(wall))
        for component in held_components(topology.plate.edges, edge):
            points.append((wall[:-1, None] + s * along).reshape(-1, 2))
            weight.append((np.linalg.norm(along, axis=2) * WEIGHTS / 2).ravel())
            components.append(np.full(len(weight[-1]), component))
            hats.append(((1 - s) * ends[:-1, None] + s * ends[1:, None]).reshape(-1, len(wall)))
    rows = scheme.rows_at(np.concatenate(points))
    return (
        rows[np.arange(len(rows)), np.concatenate(components)],
        np.concatenate(weight),
        scipy.linalg.block_diag(*hats),
    )


# --- energies -------------------------------------------------------------------------------------


def strain_operators(dphi: Inexact[Array, "c q a 2"]) -> Float[Array, "c q 2 2 a 2"]:
    """Matrices that take the values of a cell's nodes to F_ij.

    Complex shape functions mix the components.
    """
    return jnp.einsum("cqaj,ik->cqijak", dphi.real, np.eye(2)) + jnp.einsum(
        "cqaj,ik->cqijak", dphi.imag, TURN
    )


def deformation_gradients(x: Float[Array, "n 2"], cells: Cells) -> Float[Array, "c q 2 2"]:
    """Deformation gradients at the Gauss points for nodal values ``x``, mm."""
    # without this round-off grows like (x / spacing)^2
    local = x[cells.nodes] - jnp.mean(x[cells.nodes], axis=1, keepdims=True)
    return jnp.einsum("cqijak,cak->cqij", strain_operators(cells.dphi), local)


@jax.jit
def volume_ratios(x: Float[Array, "n 2"], cells: Cells) -> Float[Array, "c g"]:
    """Volume ratios of the groups; 2 for dropped points."""
    F = deformation_gradients(x, cells)
    J = F[..., 0, 0] * F[..., 1, 1] - F[..., 0, 1] * F[..., 1, 0]
    if cells.method == "cells":
        return jnp.sum(cells.weight * J, axis=1, keepdims=True) / cells.volumes
    return jnp.where(cells.weight > 0, J, 2.0)


def network_energy(x: Float[Array, "n 2"], cells: Cells, gel: Gel) -> Float[Array, ""]:
    """Energy of the network, kT/v mm^2."""
    return jnp.sum(
        cells.weight
        * jax.vmap(jax.vmap(lambda F: gel.network(F, gel)))(deformation_gradients(x, cells))
    )


@jax.jit
def scheme_energy(x: Float[Array, "n 2"], cells: Cells, gel: Any, mu: Scalar) -> Float[Array, ""]:
    """Energy of the gel, kT/v mm^2, at the nodal values ``x``, mm; without the penalty.

    Deng et al. (2020), Eq. (3).
    """
    J = volume_ratios(x, cells)
    return network_energy(x, cells, gel) + jnp.sum(
        cells.volumes * (jax.vmap(jax.vmap(lambda J: gel.volumetric(J, gel)))(J) - mu * (J - 1))
    )
