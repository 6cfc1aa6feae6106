"""Limit of a Newton step, so that surfaces in contact do not pass through each other."""

import numpy as np

from .._types import Array, Float
from ..discretisation import Model
from .surfaces import host_points, near_pairs, surfaces_of, touched_obstacles

APPROACH = 0.5  # of a pair's distance, or range, that one Newton iteration leaves


def step_limit(x: Float[Array, "n 2"], dx: Float[Array, "n 2"], model: Model) -> float:
    """Share, at most 1, of the step ``dx`` (n, 2) that leaves ``APPROACH`` of every distance.

    If a pair is farther apart than its range, the range counts. No point moves farther than twice
    the range, so that no pair passes another unseen.
    """
    surfaces, reach = surfaces_of(model), float(model.contact.range)
    points, nodes = host_points(model, dx)
    moved = surfaces.positions(points)
    farthest = np.linalg.norm(moved, axis=1).max(initial=1e-300)
    most = min(1.0, 2 * reach / farthest)
    numbers, d, r = near_pairs(model, x, apart=2 * most * farthest)
    image, first, second = numbers.T
    sign, anchors, coefficient = surfaces.of_images(image)
    approach = np.linalg.norm(
        moved[first] - sign * moved[second] - np.sum(coefficient * nodes[anchors], axis=1), axis=1
    )
    (point, primitive), gaps = (
        part.T for part in touched_obstacles(model, x, reach + most * farthest)
    )
    normal = np.asarray(model.contact.obstacles.normal)[primitive]
    onto = np.where(
        np.any(normal != 0, axis=1),
        -np.sum(normal * moved[point], axis=1),
        np.linalg.norm(moved[point], axis=1),
    )
    d, r, approach = (
        np.concatenate(part)
        for part in ((d, gaps), (r, np.full(len(gaps), reach)), (approach, onto))
    )
    room = d - APPROACH * np.minimum(d, r)
    tight = approach * most > room
    return float(np.min(room[tight] / approach[tight], initial=most))
