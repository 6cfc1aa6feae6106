"""Whether surfaces cross each other or an obstacle, in NumPy, by nothing but their points."""

import numpy as np

from jaxgel import Disc, HalfPlane
from jaxgel.mechanics import surface_points
from jaxgel.mechanics.voids import lines_of_voids
from jaxgel.observables import obstacle_displacement

ROUND_OFF = 1e-12  # of a product of two lengths, mm^2


def segments(path, k):
    """Straight pieces (s, 2, 2) of all surfaces in state ``k``, with periodic images.

    Of a path; the images are those in the next periodic cells.
    """
    model, x = path.problem.model, np.asarray(path.x[k])
    points = np.asarray(surface_points(x, model))
    numbers = [
        np.append(line.numbers, line.numbers[: line.closed])
        for line in lines_of_voids(model.lists.topology)[0]
    ]
    found = [np.stack([points[line[:-1]], points[line[1:]]], axis=1) for line in numbers]
    periodic = [("left", "right"), ("bottom", "top")]
    for first, last in periodic:
        nodes = model.lists.topology.edge_nodes
        if model.cloud.plate.edges[first] == "periodic":
            period = x[nodes[last][0]] - x[nodes[first][0]]
            found += [piece + period for piece in found]
    return np.concatenate([np.zeros((0, 2, 2)), *found])


def cross(first, other):
    """Whether any of ``first`` (s, 2, 2) crosses one of ``other`` (t, 2, 2) inside both."""

    def side(line, point):
        along, to = line[:, :, 1] - line[:, :, 0], point - line[:, :, 0]
        return along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]

    a, b = np.broadcast_arrays(first[:, None], other[None])
    apart = [
        (side(line, points[:, :, 0]), side(line, points[:, :, 1]))
        for line, points in ((a, b), (b, a))
    ]
    return bool(
        np.any(
            np.all(
                [(p * q < 0) & (np.minimum(np.abs(p), np.abs(q)) > ROUND_OFF) for p, q in apart],
                axis=0,
            )
        )
    )


def distance(pieces, point):
    """Smallest distance of straight pieces (s, 2, 2) from a ``point`` (2,)."""
    along, to = pieces[:, 1] - pieces[:, 0], point - pieces[:, 0]
    share = np.clip(
        np.sum(to * along, axis=1) / np.maximum(np.sum(along**2, axis=1), ROUND_OFF), 0.0, 1.0
    )
    return np.min(np.linalg.norm(to - share[:, None] * along, axis=1))


def crossed(path):
    """A text for every state of a path in which surfaces cross, or lie in or across an obstacle.

    Empty for a path without.
    """
    found = []
    for k, moved in enumerate(obstacle_displacement(path)):
        pieces = segments(path, k)
        if cross(pieces, pieces):
            found.append(f"state {k}: surfaces cross")
        for number, (obstacle, by) in enumerate(
            zip(path.model.cloud.plate.obstacles, moved, strict=True)
        ):
            if isinstance(obstacle, HalfPlane):
                inside = (
                    np.min((pieces - np.asarray(obstacle.point) - by) @ np.asarray(obstacle.normal))
                    <= 0
                )
            elif isinstance(obstacle, Disc):
                inside = distance(pieces, np.asarray(obstacle.centre) + by) <= float(
                    obstacle.radius
                )
            else:
                line = np.asarray(obstacle.points) + by
                inside = cross(pieces, np.stack([line[:-1], line[1:]], axis=1))
            if inside:
                found.append(f"state {k}: the surface is inside obstacle {number}")
    return found
