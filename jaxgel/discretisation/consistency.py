"""Consistent shape functions over patches (exact patch test), and areas of the contours.

Linear fields are integrated exactly.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._sizes import padded, resized, room
from .._types import Array, Float, Int
from ..cloud import Cloud
from .connectivity import Connectivity
from .interpolation import evaluate_groups, widened
from .layout import layout_of
from .pressures import group_weights


def consistent_patches(cloud: Cloud, lists: Connectivity, basis: str) -> list[tuple[Array, ...]]:
    """Per block positions and weights of quadrature, gradients, group weights and `area_rows`.

    These are positions (c, q, 2) of the quadrature points, shape function gradients (c, q, a, 2)
    and weights (c, q) there, those of the volume groups (c, q, g), and the `area_rows` (c, 2, r, a)
    of the contours. One constant vector per cell and node is added to the gradients so that sum_q
    w_q dphi_a(q) is the contour integral of phi_a n, the integration constraint of Chen et al.
    (2001). The weights are scaled to the area inside each cell's dry contour, and the contour
    integral is the derivative of that area by the position of node a. Contour edges on held edges
    of the plate carry the linear trace between two nodes, see ``Contour.edge_ends``, and points on
    interfaces the trace that is common to both sides.
    """
    layout, n_points, n_edges = layout_of(lists), len(lists.cell_of_point), len(lists.contour.ends)
    nodes, points, weight, on_contour = _placed(cloud.placed, layout)
    of_patches, owner, on_edges = (
        (layout.nodes, layout.support),
        layout.patch[layout.quadrature.owner],
        np.repeat(layout.contour.owner, 2),
    )
    dphi = evaluate_groups(nodes, points, *of_patches, owner, n_points, basis=basis)[1]
    (trace,) = evaluate_groups(
        nodes, on_contour, *of_patches, on_edges, 2 * n_edges, basis=basis, gradients=False
    )
    linear = tuple(bool(lists.linear[patches[0]]) for patches in lists.patches)
    blocks = _consistent(nodes, points, weight, on_contour, trace, dphi, layout, linear=linear)
    cut = []
    for patches, numbers, edges, values in zip(
        lists.patches, lists.points, lists.contour.numbers, blocks, strict=True
    ):
        (c, q), r, a, g = (
            numbers.shape,
            edges.shape[1],
            int((lists.support[patches] > 0).sum(axis=1).max()),
            values[3].shape[2],
        )
        cut.append(
            tuple(map(resized, values, ((c, q, 2), (c, q, a, 2), (c, q), (c, q, g), (c, 2, r, a))))
        )
    return cut


def consistent_gradients(
    cloud: Cloud,
    lists: Connectivity,
    places: Float[Array, "v 2"],
    of_patches: tuple[Int[np.ndarray, "l b"], Float[np.ndarray, "l b"]],
    edge_ends: Int[np.ndarray, "e 2"],
) -> list[Array]:
    """Per block of patches gradients (c, q, b, 2) of shape functions of other ``places``.

    These replace the nodes, with a linear basis, at the quadrature points, corrected as in
    `consistent_patches`. ``of_patches`` are the lists of places of each patch and their supports;
    the contour edges with ``edge_ends``, positions in these lists, carry the linear trace between
    two places, -1 for the others.
    """
    layout, n_points, n_edges = layout_of(lists), len(lists.cell_of_point), len(lists.contour.ends)
    _, points, weight, on_contour = _placed(cloud.placed, layout)
    nodes, supports = (padded(widened(part), len(layout.nodes)) for part in of_patches)
    ends = np.full(layout.contour.edge_ends.shape, -1)
    ends[:n_edges] = edge_ends
    contour = dataclasses.replace(layout.contour, edge_ends=ends, on_interfaces=None)
    layout = layout._replace(nodes=nodes, support=supports, contour=contour)
    places, owners = (
        padded(places, room(len(places))),
        (layout.patch[layout.quadrature.owner], np.repeat(contour.owner, 2)),
    )
    _, gradients = evaluate_groups(
        places, points, nodes, supports, owners[0], n_points, basis="linear"
    )
    (trace,) = evaluate_groups(
        places, on_contour, nodes, supports, owners[1], 2 * n_edges, basis="linear", gradients=False
    )
    linear = tuple(bool(lists.linear[patches[0]]) for patches in lists.patches)
    blocks = _consistent(
        places, points, weight, on_contour, trace, gradients, layout, linear=linear
    )
    wide = of_patches[0].shape[1]
    return [
        resized(values[1], (*numbers.shape, wide, 2))
        for numbers, values in zip(lists.points, blocks, strict=True)
    ]


@compiled()
def _placed(vertices, layout):
    """Nodes, quadrature, starts and middles of the contour edges for given vertex positions.

    Quadrature are points and their weights.
    """
    quadrature = layout.quadrature
    on_contour = layout.contour.points(vertices).reshape(-1, 2)
    return (
        vertices[layout.node_vertices],
        quadrature.points(vertices),
        quadrature.weights(vertices),
        on_contour,
    )


@compiled(static=("linear",))
def _consistent(nodes, points, weight, on_contour, trace, dphi, layout, *, linear):
    """What `consistent_patches` returns, padded."""
    cell, patch, contour = layout.quadrature.owner, layout.patch, layout.contour
    edge_cell, following, ends = contour.cell, contour.following, contour.edge_ends
    on_contour = on_contour.reshape(len(ends), 2, 2)
    start = on_contour[:, 0]
    if contour.on_interfaces is not None:
        trace = trace.at[contour.on_interfaces[0]].set(contour.on_interfaces[1])
    straight = jax.vmap(functools.partial(_linear_trace, np.array([0.0, 0.5])))
    straight = straight(start, start[following] - start, nodes[layout.nodes[contour.owner]], ends)
    trace = jnp.where(ends[:, :1, None] >= 0, straight, trace.reshape(len(ends), 2, -1))
    rows, dry = area_rows(trace, following), area_rows(on_contour, following)
    turned = jnp.stack([dry[..., 1], -dry[..., 0]], axis=-1)
    flux = rows[:, 0, :, None] * turned[:, 1, None] - rows[:, 1, :, None] * turned[:, 0, None]
    sides = dry[:, 0, 0] * dry[:, 1, 1] - dry[:, 0, 1] * dry[:, 1, 0]
    area, given = (
        jax.ops.segment_sum(sides, edge_cell, len(patch)),
        jax.ops.segment_sum(weight, cell, len(patch)),
    )
    weight = weight * (area / jnp.where(given > 0, given, 1.0))[cell]
    flux = jax.ops.segment_sum(flux, edge_cell, len(patch))
    integral = jax.ops.segment_sum(weight[:, None, None] * dphi, cell, len(patch))
    correction = (flux - integral) / jnp.where(area > 0, area, 1.0)[:, None, None]
    dphi = jnp.where((layout.support > 0)[patch[cell]][:, :, None], dphi + correction[cell], 0.0)
    return [
        _patches(points, dphi, weight, rows, *numbers, of)
        for *numbers, of in zip(layout.points_of, contour.numbers, linear, strict=True)
    ]


def _patches(points, dphi, weight, rows, numbers, edges, linear):
    """The part of one block.

    Padding repeats a point of its own patch, where every energy is finite.
    """
    at = jnp.where(numbers >= 0, numbers, numbers[:, :1])
    w = jnp.where(numbers >= 0, weight[at], 0.0)
    contour = jnp.where((edges >= 0)[:, None, :, None], jnp.swapaxes(rows[edges], 1, 2), 0.0)
    return points[at], dphi[at], w, group_weights(points[at], w, linear), contour


def area_rows(trace: Float[Array, "e 2 *v"], following: Int[Array, " e"]) -> Float[Array, "e 2 *v"]:
    """Rows R, S (e, 2, *v) of the area form, one each per edge: the area is sum (R x) x (S x).

    It is the area inside a contour, the sum is over its edges. ``trace`` holds values at the start,
    y_0, and the middle, y_m, of every edge; its end, y_1, is the start of the ``following`` one.
    The edge's image is the parabola through the three, and 1/2 of the integral of y x dy along it
    is 2/3 (y_0 x y_m + y_m x y_1) - 1/6 y_0 x y_1 = (y_0 - y_1) x (2/3 y_m - (y_0 + y_1) / 12).
    """
    start, middle, end = trace[:, 0], trace[:, 1], trace[following, 0]
    return jnp.stack([start - end, 2 / 3 * middle - (start + end) / 12], axis=1)


def _linear_trace(at, start, along, nodes, ends):
    """Linear interpolation (2, a) between the nodes ``ends`` of an edge, ``at`` two fractions.

    They lie on the plate's edge; the fractions are those of a contour edge.
    """
    first, span = nodes[ends[0]], nodes[ends[1]] - nodes[ends[0]]
    s = (start + at[:, None] * along - first) @ span / jnp.where(ends[0] >= 0, span @ span, 1.0)
    number = jnp.arange(len(nodes))
    return (1 - s)[:, None] * (number == ends[0]) + s[:, None] * (number == ends[1])
