"""Shape functions over the patches that integrate linear fields exactly (patch test), and the areas of the patches' contours."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float, Int
from .connectivity import Connectivity
from .interpolation import evaluate_points


def consistent_gradients(
    nodes: Float[Array, "n 2"], vertices: Float[Array, "v 2"], connectivity: Connectivity, basis: str
) -> tuple[Float[Array, "p a 2"], Float[Array, " p"], Float[Array, "e 2 a"]]:
    """Shape function gradients at all quadrature points, the quadrature weights, and the `area_rows` of the contours.

    One constant vector per cell and node is added to the gradients so that sum_q w_q dphi_a(q) is the contour integral of phi_a n, the
    integration constraint of Chen et al. (2001). The weights are scaled to the area inside each cell's dry contour, and
    the contour integral is the derivative of that area by the position of node a. Contour edges on held edges of the plate carry
    the linear trace between two nodes, see ``Contour.edge_ends``, and points on interfaces the trace that is common to both sides.
    """
    lists, supports, contour = connectivity.nodes, connectivity.support, connectivity.contour
    quadrature = connectivity.topology.quadrature
    shared = dict(lists=lists, supports=supports, basis=basis)
    _, dphi = evaluate_points(nodes, quadrature.points(vertices), owner=connectivity.owner, **shared)
    on_contour = contour.points(vertices)
    trace = evaluate_points(nodes, on_contour, owner=np.repeat(contour.owner, 2), gradients=False, **shared)
    if contour.on_interfaces is not None:
        at, weights = contour.on_interfaces
        trace = jnp.asarray(trace).at[at].set(weights)
    numbers = connectivity.cell_of_point, connectivity.patch_of_cell, contour.ends, contour.cell, contour.following
    weight = quadrature.weights(vertices)
    return _consistent(nodes, vertices, on_contour, trace, dphi, weight, *numbers, lists, supports, contour.edge_ends)


@jax.jit
def _consistent(nodes, vertices, on_contour, trace, dphi, weight, cell, patch, ends, edge_cell, following, lists, supports, edge_ends):
    start, along = vertices[ends[:, 0]], vertices[ends[:, 1]] - vertices[ends[:, 0]]
    linear = jax.vmap(functools.partial(_linear_trace, np.array([0.0, 0.5])))(start, along, nodes[lists[patch[edge_cell]]], edge_ends)
    trace = jnp.where(edge_ends[:, :1, None] >= 0, linear, trace.reshape(len(ends), 2, -1))
    rows, dry = area_rows(trace, following), area_rows(on_contour.reshape(len(ends), 2, 2), following)
    turned = jnp.stack([dry[..., 1], -dry[..., 0]], axis=-1)
    flux = rows[:, 0, :, None] * turned[:, 1, None] - rows[:, 1, :, None] * turned[:, 0, None]
    sides = dry[:, 0, 0] * dry[:, 1, 1] - dry[:, 0, 1] * dry[:, 1, 0]
    area = jax.ops.segment_sum(sides, edge_cell, len(patch))
    weight = weight * (area / jax.ops.segment_sum(weight, cell, len(patch)))[cell]
    flux = jax.ops.segment_sum(flux, edge_cell, len(patch))
    integral = jax.ops.segment_sum(weight[:, None, None] * dphi, cell, len(patch))
    correction = (flux - integral) / jax.ops.segment_sum(weight, cell, len(patch))[:, None, None]
    real = (supports > 0)[patch[cell]][:, :, None]
    return jnp.where(real, dphi + correction[cell], 0.0), weight, rows


def area_rows(trace: Float[Array, "e 2 *v"], following: Int[Array, " e"]) -> Float[Array, "e 2 *v"]:
    """Rows R, S (e, 2, *v) of the area form, one of each per edge: the area inside a contour is the sum of (R x) x (S x) over its edges.

    ``trace`` holds values at the start, y_0, and the middle, y_m, of every edge; its end, y_1, is the start of the ``following`` one. The
    edge's image is the parabola through the three, and 1/2 of the integral of y x dy along it is
    2/3 (y_0 x y_m + y_m x y_1) - 1/6 y_0 x y_1 = (y_0 - y_1) x (2/3 y_m - (y_0 + y_1) / 12).
    """
    start, middle, end = trace[:, 0], trace[:, 1], trace[following, 0]
    return jnp.stack([start - end, 2 / 3 * middle - (start + end) / 12], axis=1)


def _linear_trace(at, start, along, nodes, ends):
    """Linear interpolation (2, a) between the two nodes ``ends`` on the plate's edge, ``at`` two fractions of a contour edge."""
    first, span = nodes[ends[0]], nodes[ends[1]] - nodes[ends[0]]
    s = (start + at[:, None] * along - first) @ span / jnp.where(ends[0] >= 0, span @ span, 1.0)
    number = jnp.arange(len(nodes))
    return (1 - s)[:, None] * (number == ends[0]) + s[:, None] * (number == ends[1])
