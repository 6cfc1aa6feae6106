"""Curved sides of cells: the contours enclose the gel's area, also after holes moved."""

import jax
import numpy as np
import pytest

import jaxgel
from jaxgel.cloud import boundary_edges, make_cloud

CUT_IN_PLATE = 16  # whole holes in the lattice's plate, whose outer ones are halves and quarters


def cross(a, b):
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def enclosed(cloud):
    """Area inside each cell's contour, mm^2: 1/2 of the integral of X x dX.

    Along the parabola through both ends and the middle.
    """
    topology, vertices = cloud.topology, np.asarray(cloud.vertices)
    edges, cell = topology.partition.contour_edges
    numbers, weights = topology.middles(edges)
    start, end, middle = (
        vertices[edges[:, 0]],
        vertices[edges[:, 1]],
        np.einsum("ek,eki->ei", weights, vertices[numbers]),
    )
    return np.bincount(
        cell, 2 / 3 * (cross(start, middle) + cross(middle, end)) - cross(start, end) / 6
    )


def gel_area(plate):
    """Area of the plate less that of its holes, mm^2."""
    holes = [float(hole.area()) for hole in plate.holes]
    return plate.width * plate.height - (
        CUT_IN_PLATE * holes[0] if plate.name == "lattice" else sum(holes)
    )


def with_all(plate, **changes):
    """The plate with these functions applied to the parameters of every hole."""
    return plate.at(
        tuple(
            {name: change(hole[name]) for name, change in changes.items()} for hole in plate.theta
        )
    )


def turned(plate, amount):
    """The plate with all its ellipses shifted, stretched and turned."""
    return with_all(
        plate,
        centre=lambda centre: centre + np.array([amount, -amount / 2]),
        semi_axes=lambda axes: axes + np.array([amount, -amount]),
        angle=lambda angle: angle + amount,
    )


@pytest.fixture(scope="module")
def ellipses():
    """Sample 1 on its own cloud."""
    return make_cloud(jaxgel.sample("sample-1"))


@pytest.mark.parametrize("amount", [0.0, 0.1, 0.2])
def test_contours_around_ellipses_enclose_the_area_of_the_gel(amount, ellipses):
    cloud = ellipses.at(turned(ellipses.plate, amount)) if amount else ellipses
    # 160 parabolas per hole miss 2.6e-9 of a nearly round hole's area, 1.3e-6 mm^2 of four;
    # polygons through the same points 1.6e-2
    assert enclosed(cloud).sum() == pytest.approx(gel_area(cloud.plate), abs=1e-5)


def test_missing_area_is_of_fourth_order_in_the_distance_of_outline_nodes(cloud_of, ellipses):
    coarse, fine = (
        enclosed(cloud).sum() - gel_area(cloud.plate) for cloud in (cloud_of("sample-1"), ellipses)
    )
    # the next term is of sixth order: 1e-3 with 20 nodes per hole
    assert coarse / fine == pytest.approx(16, rel=0.01)


@pytest.mark.parametrize("shift", [0.0, 0.1])
def test_contours_around_squares_enclose_the_area_of_the_gel_to_round_off(shift, cloud_of):
    cloud = cloud_of("sample-7")
    cloud = (
        cloud.at(with_all(cloud.plate, centre=lambda centre: centre + shift)) if shift else cloud
    )
    # parabolas along straight sides; 1e-14 of 484 mm^2
    assert enclosed(cloud).sum() == pytest.approx(gel_area(cloud.plate), abs=1e-11)


@pytest.mark.parametrize("radius", [0.9, 0.85, 0.95])
def test_contours_around_holes_cut_by_the_plate_enclose_the_area_of_the_gel(radius, cloud_of):
    cloud = cloud_of("lattice")
    cloud = cloud.at(with_all(cloud.plate, radius=lambda _: radius))
    # 80 parabolas per hole miss 8e-8 of its area: 3 to 4e-6 mm^2 of sixteen
    assert enclosed(cloud).sum() == pytest.approx(gel_area(cloud.plate), abs=1e-5)


@pytest.mark.parametrize("name", ["sample-1", "sample-7", "lattice", "square"])
def test_every_cell_encloses_a_positive_area(name, cloud_of):
    cloud = cloud_of(name)
    # slivers below 0.3, with chords for sides, have joined a neighbour
    assert enclosed(cloud).min() > 0.29 * cloud.spacing**2


@pytest.mark.parametrize("name", ["sample-1", "lattice"])
def test_cut_points_lie_on_the_parabola_of_their_segment(name, cloud_of):
    """A parabola with vertices (-1, 0), (0, 1), (1, 0) in its affine frame is y = 1 - x^2."""
    cloud = cloud_of(name)
    cloud = cloud.at(
        turned(cloud.plate, 0.2)
        if name == "sample-1"
        else with_all(cloud.plate, radius=lambda _: 0.95)
    )
    part, curves, vertices = (
        cloud.topology.partition,
        cloud.topology.curves,
        np.asarray(cloud.vertices),
    )
    assert len(part.cut_segments) > 100
    start, middle, end = np.moveaxis(vertices[curves.vertices[part.cut_segments]], 1, 0)
    cuts, chord, height = (
        vertices[-len(part.cut_segments) :],
        (end - start) / 2,
        middle - (start + end) / 2,
    )
    x, y = np.linalg.solve(
        np.stack([chord, height], axis=2), (cuts - (start + end) / 2)[:, :, None]
    )[:, :, 0].T
    # mm; round-off of coordinates of 10
    np.testing.assert_allclose((y - 1 + x**2) * np.linalg.norm(height, axis=1), 0.0, atol=1e-13)
    assert np.abs(x).max() <= 1
    first = curves.start[part.cut_segments] == 0
    np.testing.assert_array_equal(x < 0, first)  # each half of the parabola is one segment
    # round-off over heights of 1e-3 mm
    np.testing.assert_allclose((x + np.where(first, 1, 0)), part.cut_fractions, atol=1e-9)


def test_cut_points_lie_on_the_holes(ellipses):
    """Relative to the semi-axes 160 parabolas per hole are 4e-8 off, chords of halves 3e-4."""
    cloud = ellipses.at(turned(ellipses.plate, 0.2))
    part, curves, vertices = (
        cloud.topology.partition,
        cloud.topology.curves,
        np.asarray(cloud.vertices),
    )
    hole = np.concatenate([np.full(len(o.s), o.arc.hole) for o in cloud.topology.outlines])[
        part.cut_segments
    ]
    cuts = vertices[-len(part.cut_segments) :]
    for k, shape in enumerate(cloud.plate.holes):
        excess = np.asarray(jax.vmap(shape.excess)(cuts[hole == k]))
        f = part.cut_fractions[hole == k, None]
        ends = vertices[curves.ends[part.cut_segments[hole == k]]]
        on_chord = np.asarray(jax.vmap(shape.excess)((1 - f) * ends[:, 0] + f * ends[:, 1]))
        assert np.abs(excess).max() < 1e-6
        assert np.abs(on_chord).max() > 1e-4


@pytest.mark.parametrize("name", ["sample-1", "sample-7", "lattice"])
def test_both_cells_of_an_edge_have_the_same_middle(name, cloud_of):
    topology = cloud_of(name).topology
    edges, _ = topology.partition.contour_edges
    vertices = topology.partition.vertices
    there, back = (
        np.einsum("ek,eki->ei", weights, vertices[at])
        for at, weights in (topology.middles(e) for e in (edges, edges[:, ::-1]))
    )
    np.testing.assert_allclose(there, back, atol=1e-13)


@pytest.mark.parametrize("name", ["sample-1", "lattice"])
def test_only_sides_along_outlines_are_curved(name, cloud_of):
    topology = cloud_of(name).topology
    edges, _ = topology.partition.contour_edges
    numbers, weights = topology.middles(edges)
    vertices = topology.partition.vertices
    bend = np.linalg.norm(
        np.einsum("ek,eki->ei", weights, vertices[numbers]) - vertices[edges].mean(axis=1), axis=1
    )
    outer = {tuple(edge) for edge in boundary_edges(topology.partition.triangles)}
    along = np.array([tuple(sorted(edge)) in outer for edge in edges.tolist()]) & ~on_plate_edges(
        topology, edges
    )
    assert np.abs(bend[~along]).max() < 1e-13
    assert np.median(bend[along]) > 1e-4


def on_plate_edges(topology, edges):
    """Whether each edge (e,) lies on an edge of the plate."""
    half = np.array([topology.plate.width, topology.plate.height]) / 2
    return (
        (np.abs(np.abs(topology.partition.vertices[edges]) - half) < 1e-9).all(axis=1).any(axis=1)
    )
