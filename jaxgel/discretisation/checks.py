"""Checks of a discretisation: enough neighbours, reproduction of linear fields."""

import jax
import numpy as np
from scipy.spatial import cKDTree

from .interpolation import in_plane
from .moving_least_squares import n_monomials

STEEPEST = 100.0  # largest gradient of a shape function in an accepted model, over 1 / spacing; 1 to 15 is usual
REPRODUCTION = 1e-7  # largest error with which the gradients of an accepted model reproduce the coordinates


def _check_support(topology, points, support, basis):
    """Refuse, naming the first point, points within the supports of fewer nodes than the basis needs."""
    nodes = topology.partition.vertices[topology.node_vertices]
    need = n_monomials(basis) + 1
    distance, index = cKDTree(nodes).query(points, k=need)
    index = np.minimum(index, len(nodes) - 1)  # a missing neighbour is infinitely far
    lonely = np.flatnonzero((distance >= support[index]).any(axis=1))
    lonely = [k for k in lonely if np.sum(np.linalg.norm(nodes - points[k], axis=1) < support) < need]  # farther nodes may reach
    if len(lonely):
        x, y = points[lonely[0]]
        raise ValueError(
            f"dmax: a support of {support.max():.3g} mm reaches fewer than {need} nodes at the point ({x:.4g}, {y:.4g}), "
            f"too few for the {basis} basis; use a larger dmax or a smaller spacing"
        )


def _check_reproduction(model):
    """Refuse, outside traces, a model whose gradients do not reproduce the coordinates: neighbours on too few lines."""
    if isinstance(model.cloud.vertices, jax.core.Tracer):
        return
    nodes, steepest = np.asarray(model.cloud.nodes), STEEPEST / model.cloud.topology.node_spacing.min()
    for block in model.blocks:
        dphi = np.asarray(block.dphi)
        F = np.asarray(in_plane(np.einsum("cai,cqaj->cqij", nodes[block.nodes], dphi), axis=2))
        error = np.abs(F - np.eye(2)).max(axis=(2, 3))
        poor = ~(error < REPRODUCTION) | ~(np.abs(dphi).max(axis=(2, 3)) < steepest)
        bad = np.argwhere(poor & (np.asarray(block.weight) > 0))
        if len(bad):
            x, y = nodes[block.nodes[bad[0, 0], 0]]
            raise ValueError(
                f"dmax: {model.dmax} is too small for the {model.basis} basis near the point ({x:.4g}, {y:.4g}): its neighbours lie on "
                "too few lines; use a larger dmax or a smaller spacing"
            )
