"""Clouds of periodic cells: nodes of opposite edges match, no periodic edge is a wall."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.cloud import make_background
from jaxgel.mechanics import periodic_images

STRIP = {"left": "periodic", "right": "periodic", "bottom": "fixed", "top": "free"}


def facing(topology):
    """Largest mismatch, mm, of coordinates along a periodic edge, and of spacings."""
    nodes, spacing, apart = (
        topology.partition.vertices[topology.node_vertices],
        topology.node_spacing,
        [0.0],
    )
    for edge, opposite, along in (("left", "right", 1), ("bottom", "top", 0)):
        if topology.plate.edges[edge] == "periodic":
            one, other = topology.edge_nodes[edge], topology.edge_nodes[opposite]
            assert len(one) == len(other)
            apart += [
                np.abs(nodes[one, along] - nodes[other, along]).max(),
                np.abs(spacing[one] - spacing[other]).max(),
            ]
    return max(apart)


@pytest.mark.parametrize(
    ("edges", "across", "holes"),
    [
        # squares are halved next to one edge
        ("periodic", None, [((0.2, -0.1), 0.55, 20), ((-0.8, 0.75), 0.15, 20)]),
        ("periodic", 5, [((0.2, -0.1), 0.55, 20), ((-0.8, 0.75), 0.15, 20)]),
        ("periodic", 4, [((0.9, 1.0), 0.8, 16)]),
        (STRIP, None, [((0.9, 1.0), 0.5, 20), ((0.0, -0.3), 0.2, 20)]),
    ],
)
def test_nodes_of_periodic_edges_face_each_other(edges, across, holes):
    plate = jaxgel.Plate(
        2, 2, [jaxgel.Circle(centre, radius) for centre, radius, _ in holes], edges=edges
    )
    topology = jaxgel.make_cloud(
        plate, spacing=0.2, nodes_per_hole=holes[0][2], across=across
    ).topology
    assert facing(topology) < 1e-12
    assert len(np.unique(periodic_images(topology))) < len(topology.node_vertices)
    area = np.asarray(topology.quadrature.weights(topology.partition.vertices)).sum()
    if edges == "periodic":
        # polygons of 128 sides and more
        assert area == pytest.approx(4 - np.pi * sum(radius**2 for _, radius, _ in holes), rel=1e-3)


def test_squares_are_halved_next_to_the_image_of_a_strip():
    """A strip across the right edge is one across the left; neighbours differ by one halving."""
    import shapely

    plate = jaxgel.Plate(4, 4, edges="periodic")
    strips = np.array([shapely.box(1.8, 0.3, 2.1, 0.4)]), np.array([0.06])
    background = make_background(plate, 0.5, [strips])
    y = np.linspace(-1.99, 1.99, 80)
    depth = [background.halvings(np.stack([np.full(80, x), y], axis=1)) for x in (-1.999, 1.999)]
    assert depth[0].max() == depth[1].max() == 4
    assert np.abs(depth[0] - depth[1]).max() <= 1
    near, far = background.vertices[background.facing].transpose(1, 0, 2)
    np.testing.assert_array_equal(
        np.sort(np.abs(far - near), axis=1), np.tile([0.0, 4.0], (len(near), 1))
    )
    on_edges = (np.abs(background.vertices) == 2).sum()
    assert 2 * len(near) == on_edges  # every vertex on an edge has its image, a corner two


def test_ligaments_across_a_periodic_edge_are_those_to_the_image():
    plate = jaxgel.Plate(2, 2, [jaxgel.Circle((0.1, 0.05), 0.7)], edges="periodic")
    widths = jaxgel.make_cloud(plate, spacing=0.2, nodes_per_hole=32).topology.ligaments[1]
    assert widths.min() == pytest.approx(0.6, abs=2e-3)  # between nodes of the outline


def test_a_ligament_to_an_image_without_a_node_is_refused():
    plate = jaxgel.Plate(2, 2, [jaxgel.Ellipse((0.4, 0.9), (0.96, 0.3), 0.0)], edges="periodic")
    jaxgel.make_cloud(plate, spacing=0.25, nodes_per_hole=20)  # nodes on the edges lie in it
    assert (
        facing(jaxgel.make_cloud(plate, spacing=0.25, nodes_per_hole=20, across=4).topology) < 1e-12
    )


def test_the_nodes_of_a_hole_across_an_edge_follow_its_parameters():
    """Centre and radius move the outline as they do inside the cell: the frame is a constant."""
    plate = jaxgel.Plate(2, 2, [jaxgel.Circle((0.95, 0.3), 0.5)], edges="periodic")
    cloud = jaxgel.make_cloud(plate, spacing=0.5, nodes_per_hole=8)
    outline = cloud.topology.outlines[0].vertices

    def vertices(centre):
        return cloud.at(plate.at([{"centre": centre}])).vertices[outline]

    at = jnp.array([0.95, 0.3])
    np.testing.assert_allclose(vertices(at), cloud.vertices[outline], rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        jax.jacfwd(vertices)(at), np.tile(np.eye(2), (len(outline), 1, 1)), rtol=0, atol=1e-14
    )
    assert cloud.at(plate).plate is plate
