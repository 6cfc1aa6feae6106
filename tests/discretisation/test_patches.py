"""Patches of cells, the volumes of their groups, and stabilisation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

import jaxgel
from jaxgel import Problem
from jaxgel.mechanics import all_volumes, by_block, linearise, volume_ratios

ratios = jax.jit(volume_ratios)


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def cells_of(model):
    """Areas (c,), mm^2, and centroids (c, 2), mm, of the cells, by their triangles."""
    part = model.cloud.topology.partition
    polygons = [
        shapely.union_all(
            shapely.polygons(part.vertices[part.triangles[part.cell_of_triangle == c]])
        )
        for c in range(part.n_cells)
    ]
    return shapely.area(polygons), shapely.get_coordinates(shapely.centroid(polygons))


def patch_polygons(model):
    """The gel of every patch, joined from triangles."""
    part, patch = model.cloud.topology.partition, model.lists.patch_of_cell
    triangles = shapely.polygons(part.vertices[part.triangles])
    return [
        shapely.union_all(triangles[patch[part.cell_of_triangle] == k])
        for k in range(len(model.lists.linear))
    ]


def carrying(values, model):
    """Per block the values (c, g) of the groups that carry volume."""
    return [
        np.asarray(own)[:, : block.carrying]
        for own, block in zip(by_block(jnp.asarray(values), model), model.blocks, strict=True)
    ]


def held(values, model):
    """Per block the values (c, g) of the groups that are held."""
    return [
        np.asarray(own)[:, block.carrying :]
        for own, block in zip(by_block(jnp.asarray(values), model), model.blocks, strict=True)
    ]


@pytest.fixture(scope="module")
def bare_model():
    """A plate of 4 x 4 mm without holes, held at all edges, with 9 x 9 nodes."""
    return jaxgel.discretise(jaxgel.make_cloud(jaxgel.Plate(4, 4, edges="fixed", spacing=0.5)))


@pytest.fixture(scope="module")
def wide_model():
    """A plate of 8 x 8 mm with one small hole in a corner, and 17 x 17 nodes."""
    hole = jaxgel.Circle((1.6, 1.7), 1.0)
    return jaxgel.discretise(
        jaxgel.make_cloud(jaxgel.Plate(8, 8, [hole], spacing=0.5, nodes_per_hole=12))
    )


@pytest.fixture(scope="module")
def slit_model():
    """Four by four blocks of 2 x 2 squares of 0.5 mm, of which a slit 0.06 mm wide divides two."""
    slit = jaxgel.Rectangle((0.5, 0.0), (0.06, 1.9))
    with pytest.MonkeyPatch.context() as patch:
        # so that squares around it are not halved
        patch.setattr("jaxgel.cloud.outlines.CROWDED", np.inf)
        cloud = jaxgel.make_cloud(jaxgel.Plate(4, 4, [slit], spacing=0.5, nodes_per_hole=32))
    return jaxgel.discretise(cloud, basis="linear")


# --- which cells make a patch ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "fixture",
    ["coarse_model", "tiny_model", "buckling_model", "square_model", "bare_model", "slit_model"],
)
def test_every_cell_is_in_exactly_one_patch(fixture, request):
    model = request.getfixturevalue(fixture)
    lists = model.lists
    assert lists.patch_of_cell.shape == (model.cloud.topology.partition.n_cells,)
    np.testing.assert_array_equal(np.unique(lists.patch_of_cell), np.arange(len(lists.linear)))
    np.testing.assert_array_equal(
        np.sort(np.concatenate([block.patches for block in model.blocks])),
        np.arange(len(lists.linear)),
    )
    points = np.concatenate([numbers[numbers >= 0] for numbers in lists.points])
    np.testing.assert_array_equal(np.sort(points), np.arange(len(lists.cell_of_point)))
    for numbers, patches in zip(lists.points, lists.patches, strict=True):
        np.testing.assert_array_equal(
            (lists.owner[numbers] == patches[:, None]) | (numbers < 0), True
        )


@pytest.mark.parametrize("fixture", ["coarse_model", "tiny_model", "slit_model"])
def test_every_patch_is_one_piece_of_gel(fixture, request):
    for polygon in patch_polygons(request.getfixturevalue(fixture)):
        assert polygon.geom_type == "Polygon"


@pytest.mark.parametrize("fixture", ["buckling_model", "square_model"])
def test_patches_of_a_mirror_symmetric_plate_are_mirror_symmetric(fixture, request):
    check_mirror_images(request.getfixturevalue(fixture))


def check_mirror_images(model):
    """All images of a patch, by its area and centroid, are patches of the same kind."""
    area, centre = cells_of(model)
    lists = model.lists
    size = np.bincount(lists.patch_of_cell, area)
    centre = np.stack(
        [np.bincount(lists.patch_of_cell, area * centre[:, i]) / size for i in range(2)], axis=1
    )
    described = np.column_stack([centre, size, np.bincount(lists.patch_of_cell), lists.linear])
    for image in ([-1, 1], [1, -1]):
        mirrored = described * [*image, 1, 1, 1]
        gap = np.abs(described[:, None] - mirrored[None]).max(axis=2)
        # of equal arc lengths, found to 1e-10 of the outline
        np.testing.assert_allclose(gap.min(axis=1), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    "fixture", ["coarse_model", "tiny_model", "buckling_model", "square_model", "slit_model"]
)
def test_linear_patches_have_two_whole_squares_and_more(fixture, request):
    model = request.getfixturevalue(fixture)
    lists, background = model.lists, model.cloud.topology.background
    area, _ = cells_of(model)
    square = background.side.prod()  # no square was halved
    assert len(background.halved) == 0
    whole = np.bincount(lists.patch_of_cell, area > square * (1 - 1e-9))
    size = np.bincount(lists.patch_of_cell, area) / square
    assert lists.linear.any()
    assert whole[lists.linear].min() >= 2
    assert size[lists.linear].min() > 2 + 1e-9
    assert size[lists.linear].max() < 5.3  # four squares and the slivers that joined them
    assert np.all(np.bincount(lists.patch_of_cell)[~lists.linear] == 1)


def test_what_is_held_of_a_patch_is_no_round_off():
    """Its second-degree functions are independent: beside two squares, y^2 would be constant."""
    model = jaxgel.discretise(
        jaxgel.make_cloud(jaxgel.Plate(4, 4, [jaxgel.Circle((0, 0), 1)], spacing=4 / 15))
    )
    for block in model.blocks:
        share = block.weight / np.sum(block.weight, axis=1, keepdims=True)
        centre = np.einsum("cq,cqi->ci", share, block.position)
        x, y = np.moveaxis(
            (np.asarray(block.position) - centre[:, None]) / model.cloud.spacing, 2, 0
        )
        lower, upper = (
            np.stack([np.ones_like(x), x, y], axis=2),
            np.stack([x**2, x * y, y**2], axis=2),
        )
        for weight, low, up in zip(share, lower, upper, strict=True) if block.carrying > 1 else ():
            root = np.sqrt(weight)[:, None]
            left = up - low @ np.linalg.lstsq(root * low, root * up)[0]
            # slivers leave 4e-4, round-off 1e-16
            assert np.linalg.eigvalsh((root * left).T @ (root * left))[0] > 1e-6


def test_a_block_divided_by_a_hole_gives_separate_patches(slit_model):
    lists = slit_model.lists
    _, centre = cells_of(slit_model)
    # the four squares to either side of the slit
    beside = (np.abs(centre[:, 0] - 0.5) < 0.5) & (np.abs(centre[:, 1]) < 1)
    left, right = (
        set(lists.patch_of_cell[beside & side].tolist())
        for side in (centre[:, 0] < 0.5, centre[:, 0] > 0.5)
    )
    assert left
    assert right
    assert not left & right
    assert beside.sum() == 8
    assert lists.linear[lists.patch_of_cell[~beside]].all()  # the blocks that are whole


# --- volumes of the groups ------------------------------------------------------------------------


def test_volumes_that_are_carried_add_up_to_the_dry_area_inside_the_contours(coarse_model):
    model = coarse_model
    plate = model.cloud.plate
    total = float(np.asarray(all_volumes(model))[model.carries].sum())
    # 80 parabolas per hole miss 4.2e-8 of its area, 2.1e-5 mm^2 of four
    assert total == pytest.approx(
        plate.width * plate.height - sum(float(hole.area()) for hole in plate.holes), abs=4e-5
    )
    weights = sum(float(jnp.sum(block.weight)) for block in model.blocks)
    assert total == pytest.approx(weights, rel=1e-13)


@pytest.mark.parametrize("fixture", ["coarse_model", "tiny_model", "square_model", "slit_model"])
def test_linear_deformation_has_its_determinant_in_all_groups_and_no_held_moment(fixture, request):
    model = request.getfixturevalue(fixture)
    A = jnp.array([[1.3, 0.2], [-0.1, 1.2]])
    J = ratios(model.cloud.nodes @ A.T + jnp.array([3.0, -1.0]), model)
    carries = model.carries
    # round-off: 1e-13 measured
    np.testing.assert_allclose(J[carries], np.linalg.det(A), rtol=0, atol=1e-12)
    np.testing.assert_allclose(J[~carries], 0.0, atol=1e-12)


@pytest.mark.parametrize("fixture", ["wide_model", "bare_model"])
def test_four_groups_have_mean_and_slopes_of_a_linear_volume_ratio(fixture, request):
    """J = 1 + a X_1 + b X_2 over 2 x 2 squares of side h, by the groups.

    J at the centre, and +- a h / sqrt(3) +- b h / sqrt(3).
    """
    model, a, b = request.getfixturevalue(fixture), 0.02, -0.03
    X = np.asarray(model.cloud.nodes)
    x = jnp.asarray(
        np.stack([X[:, 0] + a / 2 * X[:, 0] ** 2 + b * X[:, 0] * X[:, 1], X[:, 1]], axis=1)
    )
    J = ratios(x, model)
    inner = interior_blocks(model)
    assert sum(mine.sum() for mine in inner) > 0
    slopes = model.cloud.topology.background.side * [a, b] / np.sqrt(3)
    at_four = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ slopes
    for mine, four, rest, block in zip(
        inner, carrying(J, model), held(J, model), model.blocks, strict=True
    ):
        if not mine.any():
            continue
        centre = patch_centres(model)[np.asarray(block.patches)[mine]]
        middle = 1 + centre @ [a, b]
        # gradients 1e-13 relative to 1/h times coordinates of 10
        np.testing.assert_allclose(four[mine], middle[:, None] + at_four, rtol=0, atol=1e-12)
        np.testing.assert_allclose(rest[mine], 0.0, atol=1e-12)


def patch_centres(model):
    return shapely.get_coordinates(shapely.centroid(patch_polygons(model)))


def interior_blocks(model):
    """Per block which patches (c,) are four whole squares away from the plate's edges.

    On these the trace is linear.
    """
    half = np.array([model.cloud.plate.width, model.cloud.plate.height]) / 2
    polygons, side = patch_polygons(model), model.cloud.topology.background.side
    bounds = shapely.bounds(polygons).reshape(-1, 2, 2)
    squares = np.isclose(shapely.area(polygons), 4 * side.prod(), rtol=1e-9) & np.isclose(
        np.diff(bounds, axis=1)[:, 0], 2 * side
    ).all(axis=1)
    inside = model.lists.linear & squares & (np.abs(bounds) < half - 1e-9).all(axis=(1, 2))
    return [inside[np.asarray(block.patches)] for block in model.blocks]


@pytest.mark.parametrize("fixture", ["coarse_model", "tiny_model"])
def test_the_four_volume_ratios_of_a_linear_patch_are_those_of_a_linear_function(fixture, request):
    model = request.getfixturevalue(fixture)
    for four, block in zip(carrying(ratios(rough(model), model), model), model.blocks, strict=True):
        if block.carrying == 4:
            np.testing.assert_allclose(four @ [1, -1, 1, -1], 0.0, atol=1e-12)
            assert np.ptp(four, axis=1).max() > 1e-2


# --- derivatives ----------------------------------------------------------------------------------


def rough(model, seed=0):
    """Positions (n, 2) of a rough state."""
    nodes = np.asarray(model.cloud.nodes)
    return jnp.asarray(
        nodes @ [[1.2, -0.2], [0.1, 1.25]]
        + 0.02 * np.random.default_rng(seed).normal(size=nodes.shape)
    )


@pytest.mark.thorough
@pytest.mark.parametrize("fixture", ["coarse_model", "tiny_model", "slit_model"])
def test_gradients_of_volumes_are_their_difference_quotients(fixture, request):
    """V J is quadratic in the positions, so that a central difference is exact at any step."""
    model = request.getfixturevalue(fixture)
    x, way = rough(model), np.random.default_rng(3).normal(size=(model.n_nodes, 2))
    volumes = np.asarray(all_volumes(model))
    difference = (
        volumes
        * (np.asarray(ratios(x + way / 8, model)) - np.asarray(ratios(x - way / 8, model)))
        * 4
    )
    now = linearise(
        Problem(model, jaxgel.Gel(), contact=False).prepared, x, jnp.zeros(len(volumes)), -1.5
    ).cut(model)
    slopes = [
        np.einsum("cgia,cai->cg", G, way[block.nodes]).ravel()
        for G, block in zip(now.gradients, model.blocks, strict=True)
    ]
    size = np.abs(difference).max()
    assert size > 0.1
    np.testing.assert_allclose(np.concatenate(slopes), difference, rtol=0, atol=1e-12 * size)


@pytest.mark.slow
def test_derivative_of_volume_ratios_by_a_hole_matches_central_differences(tiny_model):
    cloud, x, step = tiny_model.cloud, rough(tiny_model), 1e-4

    @jax.jit
    def of_radius(radius):
        placed = cloud.at(cloud.plate.at(({"radius": radius, "centre": jnp.array([0.1, -0.2])},)))
        return volume_ratios(x, jaxgel.discretise(placed))

    _, slope = jax.jvp(of_radius, (1.045,), (1.0,))  # where no point enters or leaves a support
    J = {k: of_radius(1.045 + k * step) for k in (-2, -1, 1, 2)}
    difference = (8 * (J[1] - J[-1]) - (J[2] - J[-2])) / (12 * step)
    assert np.abs(slope).max() > 0.1
    # truncation step^4 = 1e-16 times a fifth derivative; round-off 1e-14 / step
    np.testing.assert_allclose(slope, difference, rtol=0, atol=1e-8 * np.abs(slope).max())


# --- volume as a null Lagrangian ------------------------------------------------------------------


def carried_volume(x, model):
    return float(np.sum(np.asarray(all_volumes(model) * ratios(x, model))[model.carries]))


def test_volume_of_a_plate_without_holes_is_that_inside_its_edges_wherever_its_inner_nodes_are(
    bare_model,
):
    model = bare_model
    nodes, random = np.asarray(model.cloud.nodes), np.random.default_rng(5)
    inner = np.abs(nodes).max(axis=1) < 2 - 1e-9
    x = 1.2 * nodes + 0.1 * random.normal(size=nodes.shape)
    edges = model.cloud.topology.edge_nodes
    ring = np.concatenate(
        [edges["bottom"][:-1], edges["right"][:-1], edges["top"][:0:-1], edges["left"][:0:-1]]
    )
    inside = 0.5 * cross(x[ring], np.roll(x[ring], -1, axis=0)).sum()
    for _ in range(3):
        x[inner] += 0.1 * random.normal(size=(inner.sum(), 2))
        assert carried_volume(jnp.asarray(x), model) == pytest.approx(inside, rel=1e-12)


@pytest.mark.parametrize("fixture", ["coarse_model", "tiny_model"])
def test_volume_is_the_area_inside_the_deformed_boundary(fixture, request):
    """Free sides are parabolas through the images of the ends and the middle of every edge.

    Held ones are straight between nodes.
    """
    model = request.getfixturevalue(fixture)
    topology, x = model.cloud.topology, rough(model, 6)
    edges, _ = topology.partition.contour_edges
    pairs = {tuple(edge) for edge in edges.tolist()}
    outer = np.array([edge for edge in edges.tolist() if (edge[1], edge[0]) not in pairs])
    vertices = topology.partition.vertices
    numbers, weights = topology.middles(outer)
    middle = np.einsum("ek,eki->ei", weights, vertices[numbers])
    images = np.asarray(
        jaxgel.make_probe(
            model, np.concatenate([vertices[outer[:, 0]], middle, vertices[outer[:, 1]]])
        ).position(x)
    )
    start, middle, end = images.reshape(3, -1, 2).copy()
    ends = jaxgel.discretisation.plate_edge_ends(topology, outer)
    on = ends[:, 0] >= 0
    X, Y = np.asarray(model.cloud.nodes)[ends], np.asarray(x)[ends]
    span = X[:, 1] - X[:, 0]
    for image, at in ((start, vertices[outer[:, 0]]), (end, vertices[outer[:, 1]])):
        s = np.einsum("ei,ei->e", at - X[:, 0], span)[on] / np.einsum("ei,ei->e", span, span)[on]
        image[on] = (1 - s)[:, None] * Y[on, 0] + s[:, None] * Y[on, 1]
    middle[on] = (start + end)[on] / 2
    inside = np.sum(2 / 3 * (cross(start, middle) + cross(middle, end)) - cross(start, end) / 6)
    assert carried_volume(x, model) == pytest.approx(inside, rel=1e-12)


def test_volume_does_not_change_when_nodes_away_from_the_hole_move(wide_model):
    model, random = wide_model, np.random.default_rng(8)
    nodes, x = np.asarray(model.cloud.nodes), np.array(rough(model, 7))
    # their supports end before the outline
    away = np.linalg.norm(nodes - [1.6, 1.7], axis=1) > 1.0 + model.dmax * model.cloud.spacing
    inner = away & (np.abs(nodes).max(axis=1) < 4 - 1e-9)
    assert inner.sum() > 50
    before = carried_volume(jnp.asarray(x), model)
    x[inner] += 0.3 * random.normal(size=(inner.sum(), 2))
    assert carried_volume(jnp.asarray(x), model) == pytest.approx(before, rel=1e-12)
