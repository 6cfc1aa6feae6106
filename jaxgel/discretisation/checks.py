"""Checks of a discretisation: its options, enough neighbours, reproduction of linear fields."""

from typing import TYPE_CHECKING

import jax
import numpy as np
from scipy.spatial import cKDTree

from .._types import Float, Int
from .._validation import Inadmissible
from ..cloud import Topology, narrow_ligament
from ..linalg import SOLVERS
from .moving_least_squares import n_monomials

if TYPE_CHECKING:
    from .model import Model

STEEPEST_ACCEPTED = 100.0  # largest gradient of a shape function, over 1 / spacing; 1 to 15 is usual
REPRODUCTION = 1e-7  # largest error with which the gradients of an accepted model reproduce the coordinates
BASES = ("linear", "quadratic")


def check_options(basis: str, solver: str) -> None:
    """Raise ValueError, which names the option and what is accepted, for an unknown one."""
    n_monomials(basis)
    if solver not in SOLVERS:
        raise ValueError(f"solver: {solver!r} is not one of {', '.join(SOLVERS)}")


def check_support(
    topology: Topology, points: Float[np.ndarray, "p 2"], regions: Int[np.ndarray, " p"], support: Float[np.ndarray, " n"], basis: str
) -> None:
    """Raise ValueError, which names the first point, for points within the supports of fewer nodes of their region than the basis needs."""
    nodes = topology.partition.vertices[topology.node_vertices]
    for region in np.unique(regions):
        own = (topology.node_regions == region).any(axis=1)
        _check_support(topology, nodes[own], points[regions == region], support[own], basis)


def _check_support(topology, nodes, points, support, basis):
    need = n_monomials(basis) + 1
    distance, index = cKDTree(nodes).query(points, k=need)
    index = np.minimum(index, len(nodes) - 1)  # a missing neighbour is infinitely far
    lonely = np.flatnonzero((distance >= support[index]).any(axis=1))
    lonely = [k for k in lonely if np.sum(np.linalg.norm(nodes - points[k], axis=1) < support) < need]  # farther nodes may reach
    if len(lonely):
        x, y = place = points[lonely[0]]
        _refuse_ligament(topology, place, support.max())
        raise Inadmissible(
            f"dmax: a support of {support.max():.3g} mm reaches fewer than {need} nodes at the point ({x:.4g}, {y:.4g}), "
            f"too few for the {basis} basis; use a larger dmax or a smaller spacing"
        )


def _refuse_ligament(topology, place, reach):
    """ValueError that names the narrow ligament within ``reach``, mm, of a place without usable shape functions, if there is one."""
    ligament = narrow_ligament(topology.lines, topology.spacing, place, reach)
    if ligament:
        raise Inadmissible(
            f"holes: a ligament of {ligament} is too narrow for the spacing {topology.spacing:g} mm; move the outlines apart, "
            "or across the edge, or use a smaller spacing"
        )


def check_reproduction(model: "Model") -> None:
    """Raise ValueError, outside traces, for a model whose gradients do not reproduce the coordinates: neighbours on too few lines."""
    if isinstance(model.cloud.vertices, jax.core.Tracer):
        return
    nodes, steepest = np.asarray(model.cloud.nodes), STEEPEST_ACCEPTED / model.cloud.topology.node_spacing.min()
    for block in model.blocks:
        dphi = np.asarray(block.dphi)
        F = np.einsum("cai,cqaj->cqij", nodes[block.nodes], dphi)
        error = np.abs(F - np.eye(2)).max(axis=(2, 3))
        poor = ~(error < REPRODUCTION) | ~(np.abs(dphi).max(axis=(2, 3)) < steepest)
        bad = np.argwhere(poor & (np.asarray(block.weight) > 0))
        if len(bad):
            x, y = nodes[block.nodes[bad[0, 0], 0]]
            stencil = nodes[np.unique(block.nodes[bad[0, 0]])]
            _refuse_ligament(model.cloud.topology, stencil.mean(axis=0), np.ptp(stencil, axis=0).max() / 2)
            raise Inadmissible(
                f"dmax: {model.dmax} is too small for the {model.basis} basis near the point ({x:.4g}, {y:.4g}): its neighbours lie on "
                "too few lines; use a larger dmax or a smaller spacing"
            )
