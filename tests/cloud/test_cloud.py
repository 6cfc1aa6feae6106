"""Facts about node clouds and about their placement when holes move."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from jaxgel.cases import sample
from jaxgel.cloud import OUTLINE_SEGMENTS, make_cloud, place, refuse_ligament
from jaxgel.geometry import Circle, Ellipse, Plate, Rectangle, edge_lines

NODES = {
    "sample-1": 1009,
    "sample-2": 1213,
    "sample-3": 1417,
    "sample-4": 989,
    "sample-5": 1225,
    "sample-6": 1437,
    "sample-7": 941,
    "sample-8": 1165,
    "sample-9": 1441,
    "lattice": 840,
    "square": 49,
}  # Deng et al. (2020), Table 1 and sections 5.1, 5.5


def triangle_areas(cloud):
    a, b, c = (np.asarray(cloud.vertices)[cloud.triangles[:, k]] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def moved(plate, amount):
    """The plate with all its ellipses shifted, stretched and turned, each in its own way."""
    theta = []
    for k, hole in enumerate(plate.theta):
        way = amount * np.array([[1, 0.5], [-0.5, 1], [0.3, -1], [-1, -0.2]])[k]
        theta.append(
            {
                "centre": hole["centre"] + way,
                "semi_axes": hole["semi_axes"] - way[::-1],
                "angle": hole["angle"] + way[0] / 4,
            }
        )
    return plate.at(tuple(theta))


@pytest.mark.parametrize("name", NODES)
def test_sample_has_the_papers_number_of_nodes(name):
    plate = sample(name)
    cloud = make_cloud(plate)
    assert cloud.nodes.shape == (NODES[name], 2)
    assert cloud.spacing == plate.spacing


@pytest.mark.parametrize("name", ["sample-1", "sample-7", "lattice", "square"])
def test_nodes_are_distinct_inside_the_plate_and_on_or_off_the_outlines(name, cloud_of):
    cloud = cloud_of(name)
    nodes, plate = np.asarray(cloud.nodes), cloud.plate
    apart = shapely.STRtree(shapely.points(nodes)).query_nearest(
        shapely.points(nodes), exclusive=True, return_distance=True
    )[1]
    assert apart.min() > 1e-3 * cloud.spacing
    assert np.all(np.abs(nodes) <= np.array([plate.width, plate.height]) / 2 + 1e-12)
    n_outline = sum(len(o.s[::OUTLINE_SEGMENTS]) for o in cloud.topology.outlines)
    for k, hole in enumerate(plate.holes):
        excess = np.asarray(jax.vmap(hole.excess)(nodes))
        own = sum(len(o.s[::OUTLINE_SEGMENTS]) for o in cloud.topology.outlines if o.arc.hole == k)
        assert np.sum(np.abs(excess) < 1e-9) == own
        assert np.all(excess[: len(nodes) - n_outline] > 1e-12)


@pytest.mark.parametrize("name", ["sample-1", "sample-4", "sample-7"])
def test_cloud_of_a_four_fold_plate_is_four_fold(name, cloud_of):
    nodes = np.asarray(cloud_of(name).nodes)
    turned = nodes @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    distance = np.linalg.norm(nodes[:, None] - turned[None], axis=2).min(axis=1)
    # of equal arc lengths, found to 1e-10 of the outline
    np.testing.assert_allclose(distance, 0.0, atol=1e-9)


@pytest.mark.parametrize("name", ["sample-1", "sample-7", "lattice", "square"])
def test_placement_on_the_reference_is_the_identity(name, cloud_of):
    cloud = cloud_of(name)
    placed = place(cloud.topology, cloud.topology.plate)
    np.testing.assert_allclose(
        placed, cloud.topology.partition.vertices, atol=1e-12 * cloud.spacing
    )


def test_a_cloud_of_numbers_has_numbers_inside_a_program(cloud_of):
    """Also if it is placed there: a search of gels makes its model in a program."""
    cloud = cloud_of("sample-1")
    found = []

    @jax.jit
    def scaled(factor):
        found.append(np.asarray(cloud.at(cloud.plate).nodes))
        return factor * found[0]

    own = np.asarray(cloud.at(cloud.plate).nodes)
    np.testing.assert_array_equal(scaled(2.0), 2.0 * own)
    np.testing.assert_array_equal(found[0], own)


def test_new_spacing_scales_the_nodes_on_holes_with_it(cloud_of):
    plate = sample("sample-1")
    assert [len(o.s) // OUTLINE_SEGMENTS for o in cloud_of("sample-1").topology.outlines] == [
        20,
        20,
        20,
        20,
    ]
    asked = make_cloud(plate, spacing=1.1, nodes_per_hole=32)
    assert [len(o.s) // OUTLINE_SEGMENTS for o in asked.topology.outlines] == [32, 32, 32, 32]


def test_edge_nodes_are_in_order_along_every_edge(cloud_of):
    cloud = cloud_of("lattice")
    nodes = np.asarray(cloud.nodes)
    for edge, (axis, coordinate) in edge_lines(cloud.plate).items():
        wall = cloud.topology.edge_nodes[edge]
        np.testing.assert_allclose(nodes[wall, axis], coordinate, atol=1e-12)
        assert np.all(np.diff(nodes[wall, 1 - axis]) > 0)
        assert len(wall) == np.sum(np.abs(nodes[:, axis] - coordinate) < 1e-6)


def test_moved_ellipses_leave_the_gel_the_area_they_should(cloud_of):
    cloud = cloud_of("sample-1")
    plate = moved(cloud.plate, 0.1)
    placed = cloud.at(plate)
    areas = triangle_areas(placed)  # tiny ones at an outline may turn over; cells keep their size
    assert np.bincount(cloud.cell_of_triangle, areas).min() > 0.25 * cloud.spacing**2
    outline = [np.asarray(placed.vertices)[o.vertices] for o in cloud.topology.outlines]
    polygons = sum(shapely.Polygon(loop).area for loop in outline)
    # cut points lie on parabolas, not on the polygons
    assert areas.sum() == pytest.approx(22.0**2 - polygons, rel=1e-4)
    holes = sum(float(hole.area()) for hole in plate.holes)
    # polygons of 160 equal chords miss 2 pi^2 / (3 n^2) = 2.6e-4 of a circle's area, of a moved
    # ellipse little more
    assert areas.sum() == pytest.approx(22.0**2 - holes, abs=4e-4 * holes)
    assert areas.sum() > 22.0**2 - holes


def test_outline_vertices_follow_their_hole_and_the_plate_keeps_its_shape(cloud_of):
    cloud = cloud_of("sample-1")
    plate = moved(cloud.plate, 0.2)
    placed = np.asarray(cloud.at(plate).vertices)
    for outline in cloud.topology.outlines:
        excess = jax.vmap(plate.holes[outline.arc.hole].excess)(placed[outline.vertices])
        np.testing.assert_allclose(excess, 0.0, atol=1e-12)
    before = cloud.topology.partition.vertices
    for axis, coordinate in edge_lines(plate).values():
        wall = np.abs(before[:, axis] - coordinate) < 1e-9
        np.testing.assert_allclose(placed[wall, axis], coordinate, atol=1e-12)


def test_linear_morph_takes_a_common_shift_of_all_holes_smoothly_to_the_walls(cloud_of):
    cloud = cloud_of("sample-1")
    plate = cloud.plate.at(
        tuple({"centre": hole["centre"] + np.array([0.2, 0.0])} for hole in cloud.plate.theta)
    )
    shift = np.asarray(cloud.at(plate).nodes) - np.asarray(cloud.nodes)
    assert shift[:, 0].min() > -0.02
    assert shift[:, 0].max() < 0.25
    nearest = np.linalg.norm(np.asarray(cloud.nodes), axis=1).argmin()
    # the core moves with the holes around it
    np.testing.assert_allclose(shift[nearest], [0.2, 0.0], atol=0.03)


def test_derivative_of_the_placement_matches_central_differences(cloud_of):
    cloud, step = cloud_of("sample-1"), 1e-5
    plate = moved(cloud.plate, 0.1)
    placement = jax.jit(lambda amount: place(cloud.topology, moved(cloud.plate, amount)))
    _, derivative = jax.jvp(placement, (0.1,), (1.0,))
    difference = (placement(0.1 + step) - placement(0.1 - step)) / (2 * step)
    assert np.abs(derivative).max() > 1
    # round-off 1e-15 / step; truncation step^2 |x'''|
    np.testing.assert_allclose(derivative, difference, atol=2e-9)
    np.testing.assert_allclose(placement(0.1), cloud.at(plate).vertices, atol=1e-13)


def test_placement_moves_every_parameter_of_every_hole(cloud_of):
    cloud = cloud_of("sample-1")

    def gel_area(theta):
        vertices = place(cloud.topology, cloud.plate.at(theta))
        u, v = (vertices[cloud.triangles[:, k]] - vertices[cloud.triangles[:, 0]] for k in (1, 2))
        return 0.5 * jnp.sum(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])

    gradient = jax.grad(gel_area)(cloud.plate.theta)
    for hole, slope in zip(cloud.plate.holes, gradient, strict=True):
        a, b = hole.semi_axes
        # of polygons, 3e-4
        np.testing.assert_allclose(slope["semi_axes"], [-np.pi * b, -np.pi * a], rtol=1e-3)
        np.testing.assert_allclose(slope["centre"], 0.0, atol=1e-10)
        np.testing.assert_allclose(slope["angle"], 0.0, atol=1e-10)


@pytest.mark.parametrize("radius", [0.85, 0.95])
def test_ends_of_cut_holes_stay_on_their_walls_as_the_radius_changes(radius, cloud_of):
    cloud = cloud_of("lattice")
    plate = cloud.plate.at(tuple({"radius": jnp.asarray(radius)} for _ in cloud.plate.holes))
    placed = cloud.at(plate)
    vertices, lines = np.asarray(placed.vertices), edge_lines(plate)
    ends = 0
    for outline in cloud.topology.outlines:
        arc = outline.arc
        for edge, vertex in (
            (arc.start_edge, outline.vertices[0]),
            (arc.end_edge, outline.vertices[-1]),
        ):
            if edge is not None:
                axis, coordinate = lines[edge]
                assert vertices[vertex, axis] == pytest.approx(coordinate, abs=1e-12)
                assert np.linalg.norm(
                    vertices[vertex] - plate.holes[arc.hole].centre
                ) == pytest.approx(radius, abs=1e-12)
                ends += 1
    assert ends == 2 * (12 + 4)
    areas = triangle_areas(placed)
    assert areas.min() > 0
    # 8 x 8 less sixteen whole circles; polygons of 160 chords miss 2.6e-4
    assert areas.sum() == pytest.approx(
        64 - 16 * np.pi * radius**2, abs=4e-4 * 16 * np.pi * radius**2
    )


def test_cloud_of_a_moved_plate_has_the_topology_of_its_reference(cloud_of):
    reference = cloud_of("sample-1").plate
    cloud = make_cloud(moved(reference, 0.2), spacing=1.1)
    again = cloud_of("sample-1").at(moved(reference, 0.2))
    np.testing.assert_array_equal(cloud.triangles, again.triangles)
    np.testing.assert_allclose(cloud.vertices, again.vertices, atol=1e-13)
    assert cloud.topology.plate is reference


def test_cloud_can_be_made_inside_jit_from_a_concrete_reference(cloud_of):
    reference = cloud_of("sample-1").plate
    nodes = jax.jit(lambda amount: make_cloud(moved(reference, amount), spacing=1.1).nodes)(0.2)
    np.testing.assert_allclose(
        nodes, cloud_of("sample-1").at(moved(reference, 0.2)).nodes, atol=1e-13
    )


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan, np.inf, 12.0])
def test_unusable_spacing_is_refused(spacing):
    with pytest.raises(
        ValueError, match=r"^spacing: \S+ is not in \(0, 11\], half the plate's shorter side$"
    ):
        make_cloud(sample("sample-1"), spacing=spacing)


def test_place_without_shape_functions_in_a_narrow_ligament_names_it():
    topology = make_cloud(
        Plate(4, 8, [Circle((0, 0), 1.92)], spacing=0.5, nodes_per_hole=16)
    ).topology
    refuse_ligament(topology, 0.5, np.array([0.0, 3.0]), 0.3)  # far away from it
    with pytest.raises(
        ValueError,
        match=r"^holes: a ligament of 0\.08 mm between holes\[0\] and the left edge is too narrow",
    ):
        refuse_ligament(topology, 0.5, np.array([-1.9, 0.1]), 0.3)


def test_ligament_without_a_node_is_refused_with_its_holes(monkeypatch):
    monkeypatch.setattr("jaxgel.cloud.outlines.CROWDED", np.inf)  # so that no square is halved
    plate = Plate(
        8,
        8,
        [Circle((-2.0, 0.4), 1.9), Circle((2.0, 0.4), 1.9), Rectangle((0.0, -3.0), (1.0, 1.0))],
    )
    with pytest.raises(
        ValueError,
        match=(
            r"^spacing: 1.6 mm leaves no node in the 0.2 mm ligament between holes\[0\] and "
            r"holes\[1\]; use"
        ),
    ):
        make_cloud(plate, spacing=1.6)
    assert make_cloud(plate, spacing=0.19).nodes.shape[1] == 2


def test_ligament_at_a_hole_that_the_edge_cuts_is_refused():
    with pytest.raises(ValueError, match=r"0.2 mm ligament between holes\[0\] and holes\[1\]"):
        make_cloud(sample("lattice"), spacing=0.4)


def test_unsound_plates_are_refused(refused):
    refused(
        lambda holes: make_cloud(Plate(10, 10, holes)),
        [
            (
                [Circle((0, 0), 2), Circle((2.9, 0), 2)],
                r"holes\[0\], holes\[1\]: they overlap or touch",
            ),
            ([Circle((9, 0), 2)], r"holes\[0\]: it lies outside the plate"),
            ([Ellipse((0, 0), (1.0, -2.0))], r"holes\[0\]"),
        ],
        start=True,
    )


def test_cloud_is_a_pytree_whose_leaves_move_with_the_holes(cloud_of):
    cloud = cloud_of("sample-1")
    leaves = jax.tree.leaves(cloud)
    assert len(leaves) == 1 + 3 * 4
    assert dataclasses.is_dataclass(cloud)
    doubled = jax.jit(lambda cloud: jax.tree.map(lambda leaf: 2 * leaf, cloud))(cloud)
    np.testing.assert_allclose(doubled.nodes, 2 * cloud.nodes, atol=1e-12)
