"""Facts about the room between grid points and the nodes of the outlines."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from jaxgel.cases import sample
from jaxgel.cloud import CLEARANCE, make_cloud
from jaxgel.geometry import Circle, Plate

TANGENTIAL = Plate(6, 6, [Circle((0.05, 1.9), 1.5), Circle((-1.2, -3.0), 1.1), Circle((1.4, -3.0), 1.02)], spacing=0.5, nodes_per_hole=14)
"""Holes whose nodes come close to grid points from all sides, two of them cut by an edge next to a grid point on it."""


def parted(cloud):
    """Grid nodes (m, 2) and outline nodes (k, 2) of a cloud."""
    nodes, on_grid = np.asarray(cloud.nodes), cloud.topology.node_vertices < cloud.topology.n_background
    return nodes[on_grid], nodes[~on_grid]


@pytest.mark.parametrize("plate", [sample("sample-1"), TANGENTIAL], ids=["sample 1", "cut holes"])
def test_no_grid_point_lies_next_to_an_outline_node(plate):
    (before, _), (after, outline) = parted(make_cloud(plate, follow_outlines=False)), parted(make_cloud(plate))
    distance = [cKDTree(outline).query(points)[0] / plate.spacing for points in (before, after)]
    assert len(before) == len(after)
    assert distance[0].min() < 0.1  # the plate has such a point
    assert distance[1].min() > CLEARANCE - 1e-9
    still = distance[0] > CLEARANCE
    np.testing.assert_array_equal(after[still], before[still])


def test_moved_points_stay_in_the_gel_and_on_the_edges_of_the_plate():
    before, after = make_cloud(TANGENTIAL, follow_outlines=False), make_cloud(TANGENTIAL)
    for edge, numbers in before.topology.edge_nodes.items():
        np.testing.assert_array_equal(after.topology.edge_nodes[edge], numbers, edge)
    for hole in TANGENTIAL.holes:
        distance = np.linalg.norm(parted(after)[0] - np.asarray(hole.centre), axis=1)
        assert distance.min() > hole.radius
    assert np.asarray(after.topology.quadrature.weights(after.vertices)).min() > 0
