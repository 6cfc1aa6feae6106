"""Facts about clouds refined in their ligaments."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from scipy.spatial import cKDTree

from jaxgel import Problem, core_rotation, discretise, make_cloud, sample, sweep, uniaxial_swelling
from jaxgel.cloud import (
    GRADING,
    OUTLINE_SEGMENTS,
    Cloud,
    assemble,
    find_ligaments,
    make_background,
    place,
    sample_lines,
)
from jaxgel.geometry import Circle, Plate, Rectangle, frame_of
from jaxgel.materials import bulk_stiffness
from jaxgel.mechanics import free_dofs, residual

SPACING = 22 / 30  # mm; one or two grid lines cross the 1 mm ligaments of the samples
AWKWARD = {
    "oblique": Plate(
        10, 10, [Circle((-1.4, -0.7), 1.5), Circle((1.4, 0.7), 1.5)], spacing=0.5, nodes_per_hole=20
    ),
    "straight": Plate(
        10,
        10,
        [Rectangle((-2.1, 0), (4, 4)), Rectangle((2.1, 0), (4, 4))],
        spacing=0.5,
        nodes_per_hole=32,
    ),
    "cut by walls": Plate(
        10,
        10,
        [
            Circle((-5, -2), 1.5),
            Circle((-5, 1.2), 1.5),
            Circle((5, 5), 2),
            Circle((3.4, -3.3), 1.5),
        ],
        spacing=0.5,
        nodes_per_hole=20,
    ),
}


@pytest.fixture(scope="module")
def refined():
    return make_cloud(sample("sample-1"), spacing=SPACING, across=4)


def nodes_along(cloud, start, end):
    """Number of nodes abreast on the line from ``start`` to ``end``, with both ends."""
    nodes, line = np.asarray(cloud.nodes), np.subtract(end, start)
    along = (nodes - start) @ line / (line @ line)
    off = np.abs((nodes - start) @ [-line[1], line[0]]) / np.linalg.norm(line)
    inner = (along > 0.02) & (along < 0.98) & (off < 0.51 * cloud.topology.node_spacing)
    for point in (start, end):
        distance = np.linalg.norm(nodes - point, axis=1)
        assert np.any(distance < cloud.topology.node_spacing)
    return 2 + len(np.unique(np.round(along[inner], 6)))


@pytest.mark.parametrize("across", [3, 4, 5, 7])
def test_ligaments_between_holes_and_to_walls_have_the_nodes_asked_for(across):
    cloud = make_cloud(sample("sample-1"), spacing=SPACING, across=across)
    for start, end in [
        ((-1, 5), (0, 5)),
        ((5, 0), (5, 1)),
        ((10, 5), (11, 5)),
        ((-5, 10), (-5, 11)),
        ((-10, -5), (-11, -5)),
    ]:
        assert nodes_along(cloud, start, end) >= across


def test_straight_ligament_has_the_nodes_asked_for_all_along():
    cloud = make_cloud(AWKWARD["straight"], across=5)
    for y in np.linspace(-1.9, 1.9, 7):
        assert nodes_along(cloud, (-0.1, y), (0.1, y)) >= 5


def test_two_nodes_across_change_nothing():
    plate = sample("sample-1")
    cloud, same = make_cloud(plate, spacing=1.1), make_cloud(plate, spacing=1.1, across=2)
    np.testing.assert_array_equal(cloud.nodes, same.nodes)
    np.testing.assert_array_equal(cloud.triangles, same.triangles)
    assert np.all(cloud.topology.node_spacing == 1.1)


def test_wedge_between_a_cut_hole_and_its_wall_is_no_ligament():
    _, widths = find_ligaments(sample_lines(Plate(10, 10, [Circle((-4.5, 0), 2)]), 40, 0.5))
    assert widths.min() == pytest.approx(3, abs=1e-3)  # from its top and bottom to those walls


@pytest.mark.parametrize("name", AWKWARD)
@pytest.mark.parametrize("across", [4, pytest.param(6, marks=pytest.mark.slow)])
def test_cells_fill_the_gel_without_gaps_at_hanging_vertices(name, across):
    # sides of "straight" lie along grid lines
    topology = make_cloud(AWKWARD[name], across=across).topology
    part = topology.partition
    edges, _ = part.contour_edges
    directed = {tuple(edge) for edge in edges}
    assert len(directed) == len(edges)
    open_edges = np.array([edge for edge in edges if (edge[1], edge[0]) not in directed])
    middle = part.vertices[open_edges].mean(axis=1)
    on_wall = (np.abs(np.abs(middle) - 5) < 1e-9).any(axis=1)
    outline = np.concatenate([[o.vertices[0], *o.vertices] for o in topology.outlines])
    on_outline = np.isin(open_edges, outline) | (
        open_edges >= len(part.vertices) - len(part.cut_segments)
    )
    assert np.all(on_wall | on_outline.all(axis=1))


def test_node_spacing_follows_the_squares_and_falls_gently(refined):
    nodes, spacing = np.asarray(refined.nodes), refined.topology.node_spacing
    assert spacing.max() == refined.spacing
    assert spacing.min() == refined.spacing / 2
    slope = (spacing[:, None] - spacing) / (
        np.linalg.norm(nodes[:, None] - nodes, axis=2) + np.eye(len(nodes))
    )
    assert slope.max() <= GRADING * (1 + 1e-9)


def test_neighbouring_squares_differ_by_one_halving_at_most():
    plate = Plate(8, 8)
    strips = np.array([shapely.box(0.1, 0.1, 0.12, 0.9)]), np.array([0.05])
    background = make_background(plate, 1.0, [strips])
    squares = [shapely.Polygon(background.vertices[loop]) for loop in background.loops]
    assert sum(square.area for square in squares) == pytest.approx(64, rel=1e-12)
    side = np.sqrt(shapely.area(squares))
    assert side.min() == pytest.approx(1 / 32)  # the first below 0.05
    near = shapely.STRtree(squares).query(squares, predicate="touches")
    assert (side[near[0]] / side[near[1]]).max() < 2 + 1e-9
    inside = np.array([square.representative_point().coords[0] for square in squares])
    np.testing.assert_allclose(background.halvings(inside), -np.log2(side), atol=1e-9)


def halved_square(basis, region):
    """Model of the unit square whose squares in a region are halved, and its gel."""
    plate = sample("square")
    background = make_background(
        plate, plate.spacing, [(np.array([shapely.box(*region)]), np.array([0.05]))]
    )
    topology = assemble(
        plate, frame_of(plate), sample_lines(plate, 0, 1.0), background, plate.spacing, 0, None
    )
    cloud = Cloud(plate, jnp.asarray(topology.partition.vertices), topology)
    assert len(cloud.nodes) > 120  # 49 without refinement
    return discretise(cloud, basis=basis), plate.gel


def stretched(model, stretch):
    """Positions (n, 2) of the square stretched along y, its bottom at rest."""
    x, y = np.asarray(model.cloud.nodes).T
    return np.stack([x, (y + 0.5) * stretch - 0.5], axis=1)


CORNER, FREE_CORNER = (-0.5, -0.5, 0.02, 0.03), (0.1, 0.2, 0.5, 0.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("basis", "region"),
    [("linear", CORNER), ("quadratic", CORNER), ("quadratic", FREE_CORNER)],
    ids=[
        "linear, corner of rollers",
        "quadratic, corner of rollers",
        "quadratic, corner at the free edge",
    ],
)
def test_patch_test_stays_exact_where_a_square_is_refined(basis, region):
    model, gel = halved_square(basis, region)
    mu = np.linspace(-4.9, 0, 6)
    path = sweep(Problem(model, gel), list(mu))
    for x, stretch in zip(path.x, np.asarray(uniaxial_swelling(mu, gel)), strict=True):
        assert np.abs(x - stretched(model, stretch)).max() / stretch < 1e-10


@pytest.mark.slow
def test_the_exact_state_is_in_equilibrium_where_a_square_is_refined():
    model, gel = halved_square("quadratic", FREE_CORNER)
    free = free_dofs(model.cloud.topology).masters
    for mu in (-4.9, -2.0, 0.0):
        stretch = float(uniaxial_swelling(mu, gel))
        forces = np.asarray(
            jax.jit(residual)(
                stretched(model, stretch), model, gel, mu, np.zeros((model.n_nodes, 2))
            )
        )
        # round-off: in J, times the bulk stiffness, 400 near the dry state; and in the network's
        # stress
        atol = 2e-15 * float(bulk_stiffness(stretch, gel)) + 2e-14 * gel.Nv * stretch
        np.testing.assert_allclose(forces.ravel()[free], 0.0, atol=atol)


@pytest.mark.parametrize("basis", [pytest.param("linear", marks=pytest.mark.slow), "quadratic"])
def test_gradients_of_inner_nodes_integrate_to_zero(refined, basis):
    model = discretise(refined, basis=basis, dmax=2.5)  # so that there are inner nodes
    total = np.zeros((model.n_nodes, 2))
    for block in model.blocks:
        np.add.at(total, block.nodes, np.einsum("cq,cqai->cai", block.weight, block.dphi))
    boundary = np.concatenate(
        [refined.topology.partition.vertices[o.vertices] for o in refined.topology.outlines]
    )
    nodes = np.asarray(refined.nodes)
    away = np.linalg.norm(nodes[:, None] - boundary, axis=2).min(axis=1)
    away = np.minimum(away, (11 - np.abs(nodes)).min(axis=1))
    # 0.1: more than half a fine segment
    inner = away > model.dmax * refined.topology.node_spacing + 0.1
    assert inner.sum() >= 5
    # mm; the weights are up to 0.3 mm^2, the gradients about 1 / mm
    assert np.abs(total[inner]).max() < 1e-13


def test_placement_of_a_refined_cloud_is_smooth_and_the_identity_on_its_reference(refined):
    plate, step = refined.topology.plate, 1e-5

    def placement(amount):
        theta = tuple(
            {
                "centre": h["centre"] + amount,
                "semi_axes": h["semi_axes"] - amount,
                "angle": h["angle"],
            }
            for h in plate.theta
        )
        return place(refined.topology, plate.at(theta))

    np.testing.assert_allclose(placement(0.0), refined.vertices, atol=1e-12)
    _, derivative = jax.jvp(placement, (0.05,), (1.0,))
    difference = (placement(0.05 + step) - placement(0.05 - step)) / (2 * step)
    np.testing.assert_allclose(derivative, difference, atol=1e-8)  # round-off 1e-14 / step
    assert np.abs(derivative).max() > 0.5


def test_moved_refined_cloud_is_accepted_and_keeps_the_gel_together(refined):
    plate = refined.plate.at(
        tuple({"semi_axes": h["semi_axes"] - 0.1} for h in refined.plate.theta)
    )
    moved = refined.at(plate)
    model = discretise(moved)
    weight = sum(float(jnp.sum(block.weight)) for block in model.blocks)
    holes = sum(float(hole.area()) for hole in plate.holes)
    # polygons of 240 chords and more: 2 pi^2 / (3 n^2) of a circle
    assert weight == pytest.approx(22**2 - holes, abs=6e-4 * holes)


def test_refined_cloud_takes_traced_hole_parameters():
    plate = sample("sample-1")

    def centroid(shift):
        holes = tuple({"centre": h["centre"] + shift} for h in plate.theta)
        return jnp.mean(make_cloud(plate.at(holes), spacing=1.1, across=4).nodes, axis=0)

    slope = jax.jacfwd(centroid)(jnp.zeros(2))
    assert 0.3 < slope[0, 0] < 1
    assert 0.3 < slope[1, 1] < 1


def test_outline_through_grid_points_leaves_no_empty_triangles():
    # of which 8 are grid points
    plate = Plate(8, 8, [Circle((0, 0), 1), Circle((-4, 0), 2)], spacing=0.5, nodes_per_hole=24)
    cloud = make_cloud(plate)
    a, b, c = (np.asarray(cloud.vertices)[cloud.triangles[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert area.min() > 1e-9
    moved = cloud.at(plate.at(({"centre": np.array([0.1, 0.0])}, {})))
    # at the outline: controls are all distinct
    assert np.abs(moved.nodes - cloud.nodes).max() == pytest.approx(0.1, rel=1e-3)


@pytest.mark.slow
def test_refined_sample_1_turns_as_finite_elements_do(refined):
    path = sweep(
        Problem(discretise(refined), refined.plate.gel),
        [-2.9678, -1.9678, -1.4678, -0.9678, -0.9178],
    )
    exact = [2.009, 7.832, 15.94, 29.06, 30.73]  # degrees, converged finite elements
    # 1.6 % at -1.9678; 0.15 % at the end
    np.testing.assert_allclose(core_rotation(path), exact, rtol=0.018)


@pytest.mark.parametrize("across", [1, 0, -3, 2.5, 4.0, True, "4"])
def test_number_across_is_refused_unless_it_is_whole_and_at_least_two(across):
    with pytest.raises(ValueError, match=r"across: .* is not a whole number of at least 2"):
        make_cloud(sample("sample-1"), across=across)


def test_ligament_too_narrow_to_refine_is_named():
    plate = Plate(
        10,
        10,
        [Circle((-1.5001, 0), 1.5), Circle((1.5001, 0), 1.5)],
        spacing=0.5,
        nodes_per_hole=20,
    )
    with pytest.raises(
        ValueError,
        match=(
            r"^spacing: squares of 0.5 mm would have to be halved more than 8 times, to 0.0001 mm "
            r"near .*; use a"
        ),
    ):
        make_cloud(plate, across=4)


@pytest.mark.parametrize("nodes_per_hole", [30, 60, 120])
def test_squares_are_halved_where_outline_nodes_are_dense(nodes_per_hole):
    """From 1.15 outline nodes to a side on.

    The outline keeps its nodes, and no node of the grid lies on one of them.
    """
    plate = Plate(10, 10, [Circle((0.1, -0.2), 2.0)], spacing=0.5)
    cloud = make_cloud(plate, nodes_per_hole=nodes_per_hole)
    (outline,) = cloud.topology.outlines
    nodes = cloud.topology.partition.vertices[outline.vertices[::OUTLINE_SEGMENTS]]
    assert len(nodes) == nodes_per_hole
    side = 0.5 / 2.0 ** cloud.topology.background.halvings(nodes)
    distance = 2 * 2.0 * np.sin(np.pi / nodes_per_hole)
    assert np.all(side < 1.15 * distance)
    assert side.min() > 1.15 * distance / 2 or side.min() == 0.5
    near = cKDTree(np.asarray(cloud.nodes)).query(nodes, k=2)[0][:, 1]
    assert near.min() > 0.02 * side.min()


def test_outline_nodes_are_as_dense_as_the_squares_around_them(refined):
    for outline in refined.topology.outlines:
        points = refined.topology.partition.vertices[outline.vertices[::OUTLINE_SEGMENTS]]
        length = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
        plain = 28.36 / 32  # mm: perimeter of the ellipse over its plain intervals
        assert length.max() == pytest.approx(plain, rel=0.02)
        assert length.min() == pytest.approx(plain / 2, rel=0.02)
