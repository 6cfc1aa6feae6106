"""Cells of clouds: elliptic and square holes, holes cut by the plate's edge, no holes."""

import numpy as np
import pytest
import shapely

from jaxgel.cloud import SLIVER, make_background, make_cloud, partition, triangles
from jaxgel.geometry import Circle, Plate, Rectangle, edge_lines

each_case = pytest.mark.parametrize("name", ["sample-1", "sample-7", "lattice", "square"])


def signed_areas(part):
    a, b, c = (part.vertices[part.triangles[:, k]] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def shoelace(loop):
    following = np.roll(loop, -1, axis=0)
    return 0.5 * np.sum(loop[:, 0] * following[:, 1] - loop[:, 1] * following[:, 0])


def keys(edges):
    """One number for each directed edge, and for its reverse."""
    n = edges.max() + 1
    return edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]


@each_case
def test_triangles_fill_the_gel_up_to_the_fine_outlines(name, cloud_of):
    found = cloud_of(name).topology
    areas = signed_areas(found.partition)
    assert areas.min() > 0
    plate = found.plate
    # seen from a hole's centre, on the wall, every fine segment is the base of a triangle
    if name == "lattice":
        radius = 0.9
        turns = [
            np.diff(np.append(o.s, 1.0) if o.closed else o.s) * (o.arc.end - o.arc.start)
            for o in found.outlines
        ]
        holes = sum(radius**2 / 2 * np.sin(2 * np.pi * turn).sum() for turn in turns)
    else:
        holes = sum(shoelace(found.partition.vertices[o.vertices]) for o in found.outlines)
    gel = plate.width * plate.height - holes
    # cut points lie on the outline's parabolas, up to 3e-4 mm off its chords
    assert areas.sum() == pytest.approx(gel, rel=1e-4)


@each_case
def test_contours_of_cells_close_and_bound_their_area(name, cloud_of):
    part = cloud_of(name).topology.partition
    edges, owner = part.contour_edges
    start, end = part.vertices[edges[:, 0]], part.vertices[edges[:, 1]]
    for component in (0, 1):
        np.testing.assert_allclose(np.bincount(owner, (end - start)[:, component]), 0.0, atol=1e-12)
    for cell in range(part.n_cells):  # every vertex is left as often as it is entered
        own = edges[owner == cell]
        np.testing.assert_array_equal(np.sort(own[:, 0]), np.sort(own[:, 1]))
    by_contour = np.bincount(owner, 0.5 * (start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]))
    np.testing.assert_allclose(
        by_contour, np.bincount(part.cell_of_triangle, signed_areas(part)), rtol=1e-11
    )


@each_case
def test_inner_edges_appear_twice_and_the_others_lie_on_walls_or_outlines(name, cloud_of):
    found = cloud_of(name).topology
    part = found.partition
    edges, _ = part.contour_edges
    forward, backward = keys(edges)
    assert len(np.unique(forward)) == len(forward)  # each direction once
    boundary = edges[~np.isin(forward, backward)]
    middle = part.vertices[boundary].mean(axis=1)
    plate = found.plate
    on_wall = np.zeros(len(middle), dtype=bool)
    for axis, coordinate in edge_lines(plate).values():
        on_wall |= np.abs(middle[:, axis] - coordinate) < 1e-9
    lines = shapely.MultiLineString(
        [
            part.vertices[np.append(o.vertices, o.vertices[0]) if o.closed else o.vertices]
            for o in found.outlines
        ]
    )
    off = shapely.distance(shapely.points(middle[~on_wall]), lines)
    assert np.max(off, initial=0.0) < 1e-3  # chords between cut points, which lie on parabolas
    length = np.linalg.norm(np.diff(part.vertices[boundary], axis=1)[:, 0], axis=1)
    # 8e-6 longer by way of the cut points
    assert length[~on_wall].sum() == pytest.approx(lines.length, rel=2e-5)


@each_case
def test_no_cell_is_a_sliver(name, cloud_of):
    found = cloud_of(name).topology
    areas = np.bincount(found.partition.cell_of_triangle, signed_areas(found.partition))
    assert areas.min() > (SLIVER - 1e-12) * found.spacing**2
    assert areas.max() < (2 + SLIVER) * found.spacing**2


@pytest.mark.parametrize("name", ["sample-1", "sample-7", "lattice"])
def test_cut_points_lie_on_the_curves_of_the_outlines(name, cloud_of):
    found = cloud_of(name).topology
    part, curves = found.partition, found.curves
    assert len(part.cut_fractions) > 0
    assert np.all((part.cut_fractions > 0) & (part.cut_fractions < 1))
    numbers, weights = curves.points(part.cut_segments, part.cut_fractions)
    cuts = part.vertices[-len(part.cut_fractions) :]
    np.testing.assert_allclose(
        np.einsum("pk,pki->pi", weights, part.vertices[numbers]), cuts, atol=1e-12
    )
    ends, f = part.vertices[curves.ends[part.cut_segments]], part.cut_fractions[:, None]
    on_chord = (1 - f) * ends[:, 0] + f * ends[:, 1]
    background = found.background  # every cut is one of a chord with a side of a square
    sides = shapely.union_all(
        [shapely.linearrings(background.vertices[loop]) for loop in background.loops]
    )
    np.testing.assert_allclose(shapely.distance(shapely.points(on_chord), sides), 0.0, atol=1e-9)
    # no outline here is bent more than with a radius of 0.5 mm
    sagitta = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) ** 2 / 8 / 0.5
    assert np.all(np.linalg.norm(cuts - on_chord, axis=1) < sagitta)


@each_case
def test_cells_of_whole_squares_have_two_triangles(name, cloud_of):
    found = cloud_of(name).topology
    count = np.bincount(found.partition.cell_of_triangle)
    area = np.bincount(found.partition.cell_of_triangle, signed_areas(found.partition))
    whole = np.isclose(area, found.spacing**2, rtol=1e-10, atol=0)
    assert whole.sum() > 0
    np.testing.assert_array_equal(count[whole], 2)


STRIP = {"left": "periodic", "right": "periodic", "bottom": "fixed", "top": "free"}


@pytest.mark.parametrize(
    ("width", "spacing", "upper"),
    [(0.4, 0.1, 0.3), (1.0, 0.1, 0.2), (0.4, 0.05, 0.3), (0.1, 0.0125, 0.2), (0.4, 0.05, 0.22)],
)
def test_cells_of_layers_fit_together_also_along_a_grid_line_met_but_for_round_off(
    width, spacing, upper
):
    plate = Plate(
        width, 1.0, edges=STRIP, regions=[Rectangle((0, 0.5), (4, 2 * upper))], spacing=spacing
    )
    cloud = make_cloud(plate)
    part, on = cloud.topology.partition, cloud.topology.edge_nodes
    forward, backward = keys(part.contour_edges[0])
    lone = part.vertices[part.contour_edges[0][~np.isin(forward, backward)]].mean(axis=1)
    at_edge = np.isclose(np.abs(lone), [width / 2, 0.5], atol=1e-9).any(axis=1)
    assert at_edge.all()
    np.testing.assert_allclose(
        np.asarray(cloud.nodes)[on["left"], 1], np.asarray(cloud.nodes)[on["right"], 1], atol=1e-12
    )


def test_a_hole_inside_one_background_square_is_cut_out_of_it(monkeypatch):
    monkeypatch.setattr("jaxgel.cloud.outlines.CROWDED", np.inf)  # so that the square is not halved
    part = make_cloud(
        Plate(4, 4, [Circle((0.5, 0.5), 0.3)]), spacing=1.0, nodes_per_hole=8
    ).topology.partition
    assert part.n_cells == 16
    polygon = 64 / 2 * np.sin(2 * np.pi / 64) * 0.3**2
    assert signed_areas(part).sum() == pytest.approx(16 - polygon, rel=1e-12)


def test_a_clipped_corner_off_every_outline_is_reported():
    background = make_background(Plate(1, 1), 1.0)
    outline = np.array([[0.0, -0.5], [0.0, 0.5]])
    # not along the outline
    gel = shapely.Polygon([(-0.5, -0.5), (0.3, -0.5), (0.0, 0.5), (-0.5, 0.5)])
    with pytest.raises(
        RuntimeError, match=r"a clipped vertex lies 3\.0e-01 off every hole outline"
    ):
        partition(background, outline, np.array([[4, 5]]), [gel])


def test_a_piece_that_is_cut_in_two_leaves_its_images_whole():
    """As by round-off next to an outline: neither half is an image, triangles are alike."""
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    right = np.array([[1.0, -1.0], [2.0, -1.5], [2.0, 0.0], [2.0, 1.5], [1.0, 1.0], [1.0, 0.0]])
    vertices = np.concatenate([right @ np.linalg.matrix_power(turn, k).T for k in range(4)])
    images = [np.roll(np.arange(24), -6 * k) for k in (1, 2, 3)]
    whole = [np.arange(6) + 6 * k for k in range(4)]
    loops = [[whole[0]], [whole[1][[0, 1, 2, 5]]], [whole[1][[2, 3, 4, 5]]], [whole[2]], [whole[3]]]
    found, piece, _ = triangles.triangulate(vertices, loops, images)
    np.testing.assert_allclose(
        np.bincount(piece, triangles.signed_areas(vertices, found)), [2.5, 1.25, 1.25, 2.5, 2.5]
    )
    alike = [
        {frozenset(corners) for corners in (found[piece == k] % 6).tolist()} for k in (0, 3, 4)
    ]
    assert alike[0] == alike[1] == alike[2]
