"""Facts about the room between grid points and the nodes of the outlines."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from jaxgel.cases import sample
from jaxgel.cloud import CLEARANCE, make_cloud
from jaxgel.geometry import Circle, Plate

TANGENTIAL = Plate(
    6,
    6,
    [Circle((0.05, 1.9), 1.5), Circle((-1.2, -3.0), 1.1), Circle((1.4, -3.0), 1.02)],
    spacing=0.5,
    nodes_per_hole=14,
)
"""Holes with nodes close to grid points from all sides, two cut by an edge at a grid point."""


def parted(cloud):
    """Grid nodes (m, 2) and outline nodes (k, 2) of a cloud."""
    nodes, on_grid = (
        np.asarray(cloud.nodes),
        cloud.topology.node_vertices < cloud.topology.n_background,
    )
    return nodes[on_grid], nodes[~on_grid]


@pytest.mark.parametrize("plate", [sample("sample-1"), TANGENTIAL], ids=["sample 1", "cut holes"])
def test_grid_points_next_to_an_outline_node_are_moved_away_from_it(plate):
    grid, outline = parted(make_cloud(plate))
    distance = cKDTree(outline).query(grid)[0] / plate.spacing
    assert distance.min() > CLEARANCE - 1e-9
    # none is halved more than twice
    squares = (grid + np.array([plate.width, plate.height]) / 2) / plate.spacing * 4
    moved = np.abs(squares - np.round(squares)).max(axis=1) > 1e-6
    assert 0 < moved.sum() < len(grid) / 10
    np.testing.assert_allclose(distance[moved], CLEARANCE, rtol=1e-9)


def test_moved_points_stay_in_the_gel_and_on_the_edges_of_the_plate():
    after = make_cloud(TANGENTIAL)
    for edge, (component, at) in {
        "left": (0, -3),
        "right": (0, 3),
        "bottom": (1, -3),
        "top": (1, 3),
    }.items():
        np.testing.assert_allclose(
            np.asarray(after.nodes)[after.topology.edge_nodes[edge], component],
            at,
            rtol=1e-15,
            err_msg=edge,
        )
    for hole in TANGENTIAL.holes:
        distance = np.linalg.norm(parted(after)[0] - np.asarray(hole.centre), axis=1)
        assert distance.min() > hole.radius
    assert np.asarray(after.topology.quadrature.weights(after.vertices)).min() > 0
