"""Minimum distance between background and outline nodes (close nodes give steep shape functions).

A steep shape function lets the outline fold between the pressures that hold it. Host NumPy on the
reference plate.
"""

import dataclasses

import numpy as np
from scipy.spatial import cKDTree

from ..geometry import image_offsets, inside_holes
from .cells import SNAP
from .outlines import OUTLINE_SEGMENTS, Lines, on_lines
from .quadtree import Background

# least distance of a background vertex from an outline node, in sides of the largest square around
# it
CLEARANCE = 0.2
ROUND_OFF = 1e-12  # of a unit vector
EQUAL = 1e-9  # of a side: difference of two distances that are equal


def with_clearance(background: Background, lines: Lines) -> Background:
    """The background with vertices at least ``CLEARANCE`` from the nearest outline node.

    Those in the gel are moved along the outline's normal there. From interfaces vertices on either
    side are moved, but not those on them. Vertices on an edge of the plate stay on it; the plate's
    corners do not move. Of a periodic plate the images of the outline nodes count, and vertices
    that face each other on opposite edges move alike.
    """
    if not lines.both:
        return background
    nodes = np.concatenate([line.points[::OUTLINE_SEGMENTS] for line in lines.both])
    normals = np.concatenate([line.normals(OUTLINE_SEGMENTS) for line in lines.both])
    first_on_interface, offsets = (
        sum(len(o.nodes) for o in lines.outlines),
        image_offsets(lines.plate),
    )
    on_interface = np.tile(np.arange(len(nodes)) >= first_on_interface, len(offsets))
    nodes, normals = (nodes + offsets[:, None]).reshape(-1, 2), np.tile(normals, (len(offsets), 1))
    vertices, side = background.vertices, background.side.min()
    least = CLEARANCE * side / 2.0 ** background.fewest_halvings(vertices)
    (distance, second), (nearest, other) = (part.T for part in cKDTree(nodes).query(vertices, k=2))
    free = distance < least * (1 - EQUAL)
    # between two as near: of both
    normals = normals[nearest] + np.where(
        (second < distance + EQUAL * side)[:, None], normals[other], 0.0
    )
    free[free] = ~inside_holes(lines.plate, vertices[free], 1e-9 * side)
    free &= ~on_lines(lines.interfaces, vertices, SNAP * side)
    on_edge = np.abs(np.abs(vertices) + background.low) < 1e-9 * side
    free &= ~on_edge.all(axis=1)
    from_node, least = vertices[free] - nodes[nearest[free]], least[free]
    direction = np.where(on_edge[free], 0.0, normals[free])
    # zero at an edge that the outline runs along
    direction /= np.linalg.norm(direction, axis=1, keepdims=True) + ROUND_OFF
    along = (from_node * direction).sum(axis=1)
    beyond = (along < 0) & on_interface[nearest[free]]  # on the other side of an interface
    direction[beyond], along[beyond] = -direction[beyond], -along[beyond]
    step = np.sqrt(along**2 + least**2 - distance[free] ** 2) - along
    moved = vertices.copy()
    moved[free] += step[:, None] * direction
    near, far = background.facing.T
    # between two nodes as near round-off may choose another one
    moved[far] = vertices[far] + moved[near] - vertices[near]
    return dataclasses.replace(background, vertices=moved)
