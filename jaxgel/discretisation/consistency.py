"""Corrected shape function gradients: linear fields are integrated exactly (patch test)."""

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float, Inexact, Int
from ..cloud import EDGE_POINTS, edge_points
from .connectivity import Connectivity
from .interpolation import evaluate_points


def corrected_gradients(
    nodes: Float[Array, "n 2"],
    vertices: Float[Array, "v 2"],
    connectivity: Connectivity,
    basis: str,
    kind: str,
    edge_ends: Int[np.ndarray, "e 2"],
) -> tuple[Inexact[Array, "p a 2"], Float[Array, " p"]]:
    """Shape function gradients at the quadrature points of all cells, corrected cell by cell, and the quadrature weights.

    The correction adds one constant vector per cell and node so that sum_q w_q dphi_a(q) equals the contour integral of phi_a n, the
    integration constraint of Chen et al. (2001). Contour edges with ``edge_ends``, see ``Connectivity``, carry the linear trace between
    these two nodes.
    """
    topology, lists, supports = connectivity.topology, connectivity.nodes, connectivity.support
    edges, edge_owner = topology.partition.contour_edges
    quadrature = topology.quadrature
    shared = dict(lists=lists, supports=supports, basis=basis, kind=kind)
    _, dphi = evaluate_points(nodes, quadrature.points(vertices), owner=quadrature.owner, **shared)
    on_edges = edge_points(vertices, edges)
    trace = evaluate_points(nodes, on_edges, owner=np.repeat(edge_owner, len(EDGE_POINTS)), gradients=False, **shared)
    weight = quadrature.weights(vertices)
    corrected = _correct(nodes, vertices, trace, dphi, weight, quadrature.owner, edges, edge_owner, lists, supports, edge_ends)
    return corrected, weight


@jax.jit
def _correct(nodes, vertices, trace, dphi, weight, owner, edges, edge_owner, lists, supports, edge_ends):
    n_cells = len(lists)
    start, end = vertices[edges[:, 0]], vertices[edges[:, 1]]
    along = end - start
    linear = jax.vmap(_linear_trace)(start, along, nodes[lists[edge_owner]], edge_ends)
    trace = jnp.where(edge_ends[:, :1, None] >= 0, linear, trace.reshape(len(edges), 2, -1))
    normal = jnp.stack([along[:, 1], -along[:, 0]], axis=1)  # outward, times the edge's length
    flux = jax.ops.segment_sum(jnp.mean(trace, axis=1)[:, :, None] * normal[:, None, :], edge_owner, n_cells)
    integral = jax.ops.segment_sum(weight[:, None, None] * dphi, owner, n_cells)
    correction = (flux - integral) / jax.ops.segment_sum(weight, owner, n_cells)[:, None, None]
    real = (supports > 0)[owner][:, :, None]
    return jnp.where(real, dphi + correction[owner], 0.0)


def _linear_trace(start, along, nodes, ends):
    """Linear interpolation (2, a) between the two nodes ``ends`` on the plate's edge, at the two points of a contour edge."""
    first, span = nodes[ends[0]], nodes[ends[1]] - nodes[ends[0]]
    s = (start + EDGE_POINTS[:, None] * along - first) @ span / jnp.where(ends[0] >= 0, span @ span, 1.0)
    number = jnp.arange(len(nodes))
    return (1 - s)[:, None] * (number == ends[0]) + s[:, None] * (number == ends[1])
