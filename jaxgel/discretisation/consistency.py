"""Corrected shape function gradients: linear fields are integrated exactly (patch test)."""

import jax
import jax.numpy as jnp
import numpy as np

from ..cloud import EDGE_POINTS, edge_points
from ..geometry import edge_lines
from .interpolation import evaluate_points


def _corrected_gradients(nodes, vertices, lists, basis, kind, wall):
    """Gradients (p, a, 2) at the points of all cells, corrected cell by cell, and weights (p,).

    The correction adds one constant vector per cell and node so that sum_q w_q dphi_a(q) equals the contour integral of phi_a n, the
    integration constraint of Chen et al. (2001); edges with ``wall`` nodes, see ``Lists``, carry the linear trace between the two.
    """
    topology = lists.topology
    edges, edge_owner = topology.partition.contour_edges
    quadrature = topology.quadrature
    shared = dict(lists=lists.nodes, supports=lists.support, basis=basis, kind=kind)
    _, dphi = evaluate_points(nodes, quadrature.points(vertices), owner=quadrature.owner, **shared)
    on_edges = edge_points(vertices, edges)
    trace = evaluate_points(nodes, on_edges, owner=np.repeat(edge_owner, len(EDGE_POINTS)), gradients=False, **shared)
    weight = quadrature.weights(vertices)
    corrected = _correct(nodes, vertices, trace, dphi, weight, quadrature.owner, edges, edge_owner, lists.nodes, lists.support, wall)
    return corrected, weight


@jax.jit
def _correct(nodes, vertices, trace, dphi, weight, owner, edges, edge_owner, lists, supports, wall):
    n_cells = len(lists)
    start, end = vertices[edges[:, 0]], vertices[edges[:, 1]]
    along = end - start
    linear = jax.vmap(_linear_trace)(start, along, nodes[lists[edge_owner]], wall)
    trace = jnp.where(wall[:, :1, None] >= 0, linear, trace.reshape(len(edges), 2, -1))
    normal = jnp.stack([along[:, 1], -along[:, 0]], axis=1)  # outward, times the edge's length
    flux = jax.ops.segment_sum(jnp.mean(trace, axis=1)[:, :, None] * normal[:, None, :], edge_owner, n_cells)
    integral = jax.ops.segment_sum(weight[:, None, None] * dphi, owner, n_cells)
    correction = (flux - integral) / jax.ops.segment_sum(weight, owner, n_cells)[:, None, None]
    real = (supports > 0)[owner][:, :, None]
    return jnp.where(real, dphi + correction[owner], 0.0)


def _linear_trace(start, along, nodes, wall):
    """Linear interpolation (2, a) between the two wall nodes of an essential edge, at the edge's two points."""
    first, span = nodes[wall[0]], nodes[wall[1]] - nodes[wall[0]]
    s = (start + EDGE_POINTS[:, None] * along - first) @ span / jnp.where(wall[0] >= 0, span @ span, 1.0)
    number = jnp.arange(len(nodes))
    return (1 - s)[:, None] * (number == wall[0]) + s[:, None] * (number == wall[1])


def wall_ends(topology, edges):
    """Wall nodes (e, 2) between which each essential contour edge lies, -1 for all other edges."""
    plate, vertices = topology.plate, topology.partition.vertices
    nodes = vertices[topology.node_vertices]
    ends = np.full((len(edges), 2), -1)
    for edge, (axis, coordinate) in edge_lines(plate).items():
        if plate.edges[edge] == "free":
            continue
        on = (np.abs(vertices[edges][:, :, axis] - coordinate) < 1e-9 * topology.spacing).all(axis=1)
        wall = topology.wall_nodes[edge]
        middle = vertices[edges[on]][:, :, 1 - axis].mean(axis=1)
        k = np.clip(np.searchsorted(nodes[wall, 1 - axis], middle) - 1, 0, len(wall) - 2)
        ends[on] = np.stack([wall[k], wall[k + 1]], axis=1)
    return ends
