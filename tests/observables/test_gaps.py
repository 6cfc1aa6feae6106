"""Gaps: widths by closed forms and rotating calipers, necks, walls, edges, derivatives."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

import jaxgel
from jaxgel.observables.double_normals import (
    GEL,
    OPEN,
    WALL,
    kinds_of_sides,
    shortest_double_normal,
)
from jaxgel.observables.gaps import gap

STEP = 1e-6  # of central differences, relative to lengths of 1 mm


def polygon(hole, count):
    """About ``count`` points of a hole's outline, the corners among them, not at its axes."""
    return np.asarray(points_of(hole, np.union1d((np.arange(count) + 0.37) / count, hole.corners)))


@jax.jit
def points_of(hole, t):
    """Points of a hole's outline; one program for all holes of a kind."""
    return jax.vmap(hole.point)(t)


def width(outline, kinds=None):
    """Length of the shortest double normal, mm."""
    return shortest_double_normal(
        outline, np.full(len(outline), GEL) if kinds is None else np.asarray(kinds)
    ).length


def arc(radius, start, end, centre=(0.0, 0.0), count=60):
    """Points of a circle between two angles in degrees."""
    angle = np.radians(np.linspace(start, end, count))
    return np.asarray(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def turned(points, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return points @ np.array([[c, s], [-s, c]])


def states_of(model, x):
    """States with nodal positions (k, n, 2)."""
    return SimpleNamespace(x=jnp.asarray(x), model=model)


# --- outlines -------------------------------------------------------------------------------------

WIDTHS = {
    "square": (jaxgel.Rectangle((0.3, 0.1), (2.0, 2.0)), 2.0),
    "slit": (jaxgel.Rectangle((0.3, 0.1), (2.0, 0.4)), 0.4),
    "narrow slit": (jaxgel.Rectangle((0.3, 0.1), (2.0, 0.1), angle=0.4), 0.1),
    "ellipse": (jaxgel.Ellipse((0.3, 0.1), (1.5, 0.3), 0.7), 0.6),
    "circle": (jaxgel.Circle((0.3, 0.1), 1.3), 2.6),
    "square of sample 7": (jaxgel.sample("sample-7").holes[1], np.sqrt(20 * np.pi)),
    "ellipse of sample 1": (jaxgel.sample("sample-1").holes[1], 8.0),
}


@pytest.mark.parametrize("count", [24, 48, 320])
@pytest.mark.parametrize("name", WIDTHS)
def test_gap_of_a_dry_hole_is_its_width(name, count):
    """To the height of the arcs over their chords, less than (pi / count)^2 of the width."""
    hole, known = WIDTHS[name]
    assert width(polygon(hole, count)) == pytest.approx(known, rel=(np.pi / count) ** 2)


def test_gap_of_a_convex_hole_is_its_width_by_calipers():
    """The smallest over all sides of the largest distance of a corner from it: exact."""
    rng = np.random.default_rng(3)
    for count in (3, 4, 5, 7, 12, 30):
        for _ in range(5):
            angle = np.sort(rng.uniform(0, 2 * np.pi, count)) + np.arange(count) * 1e-3
            points = np.stack([2 * np.cos(angle), np.sin(angle)], axis=1) @ rng.normal(size=(2, 2))
            points = points if shapely.LinearRing(points).is_ccw else points[::-1]
            side = np.roll(points, -1, axis=0) - points
            inward = np.stack([-side[:, 1], side[:, 0]], axis=1) / np.linalg.norm(
                side, axis=1, keepdims=True
            )
            calipers = np.min(
                np.max((points[None] - points[:, None]) @ inward[:, :, None], axis=(1, 2))
            )
            assert width(points) == pytest.approx(calipers, rel=1e-12)


def test_sides_of_a_corner_have_no_gap():
    """A wedge of 4 degrees with points close to its tip: the gap is its smallest altitude."""
    first, tip, last = np.array([(0.0, 0.0), (2.0, 0.07), (0.0, 0.14)])
    sides = [
        np.linspace(start, end, 50)[:-1]
        for start, end in ((first, tip), (tip, last), (last, first))
    ]
    assert width(np.concatenate(sides)) == pytest.approx(
        0.14 * 2.0 / np.linalg.norm(tip), rel=1e-12
    )


def test_sides_of_a_slit_are_apart_by_far_less_than_their_points():
    """Points 0.1 and 0.07 mm apart on sides 1 um apart: the lines' distance, by Shapely."""
    lower = np.stack([np.linspace(0, 2, 21), 1e-3 * np.sin(np.linspace(0, 20, 21))], axis=1)
    x = np.linspace(2, 0, 29)
    upper = np.stack([x, np.interp(x, *lower.T) + 1e-3 + 1e-3 * (x - 1.0) ** 2], axis=1)
    distance = shapely.LineString(lower).distance(shapely.LineString(upper))
    assert 0 < distance < 2e-3
    assert width(np.concatenate([lower, upper])) == pytest.approx(distance, rel=1e-9)


def test_gap_of_a_pinched_hole_is_its_neck():
    x = np.linspace(-3, 3, 200)[1:-1]
    half = 0.7 * np.sqrt(1 - (x / 3) ** 2) * (1 - 0.9 * np.exp(-4 * (x - 0.5) ** 2))
    neck = 2 * half.min() if not np.any(half[20:-20] == half.min()) else 2 * np.min(half[20:-20])
    outline = np.concatenate(
        [[[-3, 0]], np.stack([x, -half], axis=1), [[3, 0]], np.stack([x, half], axis=1)[::-1]]
    )
    assert width(outline) == pytest.approx(neck, rel=1e-6)


def test_gel_between_two_sides_is_no_gap():
    """A square of 10 mm with two wedges, outer sides parallel, 1 mm of gel between."""
    outline = [
        (-10, -5),
        (0, -5),
        (0, 2),
        (4, 2),
        (0, 2.4),
        (0, 2.6),
        (4, 3),
        (0, 3),
        (0, 5),
        (-10, 5),
    ]
    assert width(np.array(outline, dtype=float)) == pytest.approx(10.0, rel=1e-12)


def test_gap_is_the_same_for_an_outline_shifted_turned_mirrored_or_read_from_another_point():
    outline = polygon(jaxgel.Fourier((0.1, -0.2), 1.0, (0.3, 0.1), (0.1, -0.05)), 90)
    outline = outline + 0.1 * np.sin(3 * outline[:, ::-1])
    expected = width(outline)
    for other in (
        turned(outline, 33.0) + [400.0, -300.0],
        (outline * [-1, 1])[::-1],
        np.roll(outline, 17, axis=0),
    ):
        # round-off at coordinates of 400 mm
        assert width(other) == pytest.approx(expected, rel=1e-11)
    assert width(np.repeat(outline, 2, axis=0)) == expected  # equal points change nothing


def test_gap_does_not_depend_on_how_many_points_an_outline_has():
    """Holes with lobes and necks, of 160 points and of 640; 80 see a spurious neck."""
    rng = np.random.default_rng(2)
    for cos, sin in 0.25 * rng.normal(size=(6, 2, 6)) / np.arange(1, 7):
        coarse, fine = (
            polygon(jaxgel.Fourier((0, 0), 1.0, cos, sin), count) for count in (160, 640)
        )
        # 1e-3 found: arcs over chords, of (pi / 160)^2, at lobes
        assert width(coarse) == pytest.approx(width(fine), rel=3e-3)


def test_an_outline_that_is_not_finite_has_no_gap():
    assert np.isnan(width(np.full((5, 2), np.nan)))


def test_an_outline_that_crosses_itself_has_gap_zero():
    assert width(np.array([(0, 0), (2, 0), (2, 1), (1, -0.1), (0, 1)], dtype=float)) == 0.0


# --- edges of the plate ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("outline", "walled", "free"),
    [
        (arc(1.0, 180, 360), 1.0, 2.0),  # half a circle: its depth, its mouth
        # most of one: the mouth is narrower than the circle, and so is the neck along a wall
        (arc(1.0, 120, 420), 1.0, 1.0),
        (arc(1.0, 240, 300), 1 - np.sqrt(0.75), np.inf),  # a dent has no sides that face each other
    ],
)
def test_a_wall_closes_a_hole_and_a_free_edge_does_not(outline, walled, free):
    for kind, known in ((WALL, walled), (OPEN, free)):
        kinds = np.append(np.full(len(outline) - 1, GEL), kind)
        assert width(outline, kinds) == pytest.approx(known, rel=2e-3)  # polygons of 60 sides


def test_a_hole_in_a_corner_of_walls_has_the_gap_to_them():
    outline = np.concatenate([arc(1.0, 0, 90), [(0.0, 0.0)]])
    kinds = np.full(len(outline), GEL)
    kinds[-2:] = WALL
    assert width(outline, kinds) == pytest.approx(1.0, rel=1e-3)
    kinds[-2:] = OPEN
    assert width(outline, kinds) == np.inf


def test_the_line_across_the_mouth_of_a_hole_is_no_surface():
    """The bottom of a notch in a free edge may come out of it."""
    notch = np.array(
        [(-1, 0), (-1, -1), (-0.5, -1), (0, 0.3), (0.5, -1), (1, -1), (1, 0)], dtype=float
    )
    kinds = np.append(np.full(6, GEL), OPEN)
    assert width(notch, kinds) > 0 and width(notch, np.append(kinds[:-1], WALL)) == 0


def test_sides_on_the_plates_edges_have_their_kinds():
    edges = np.array([(0, -2.0, WALL), (0, 2.0, OPEN), (1, -1.0, OPEN), (1, 1.0, WALL)])
    corner = np.array([(2.0, 0.0), (2.0, 1.0), (1.5, 1.0), (1.4, 0.4)])
    assert kinds_of_sides(corner, edges).tolist() == [OPEN, WALL, GEL, GEL]
    assert kinds_of_sides(corner * [-0.5, 0.5], edges).tolist() == [GEL] * 4


# --- models ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lopsided():
    """Plate and cloud with a hole without symmetries."""
    plate = jaxgel.Plate(
        4,
        4,
        [jaxgel.Fourier((0.1, -0.05), 1.0, (0.3, 0.1), (0.1, -0.05))],
        spacing=0.8,
        nodes_per_hole=12,
    )
    return plate, jaxgel.make_cloud(plate)


@pytest.fixture(scope="module")
def lopsided_model(lopsided):
    return jaxgel.discretise(lopsided[1])


def bent(model):
    """Nodal positions without symmetries, near those of the dry plate."""
    x = np.asarray(model.cloud.nodes)
    return jnp.asarray(x @ np.array([[1.2, 0.1], [0.3, 0.9]]) + 0.05 * np.sin(x[:, ::-1]))


def test_gap_of_a_circle_in_an_affine_motion_is_its_diameter_over_the_smallest_stretch(tiny_model):
    """The circle of radius 1.1 as an ellipse, in any motion; 64 sides lack at most 0.3 %."""
    x = np.asarray(tiny_model.cloud.nodes)
    motions = [
        np.eye(2),
        np.diag([0.1, 1.0]),
        np.array([[1.0, 0.6], [0.2, 0.7]]),
        np.diag([1e-4, 1.3]),
    ]
    found = jaxgel.min_gap(states_of(tiny_model, [x @ F.T + [3.0, 1.0] for F in motions]))
    expected = [2.2 * np.linalg.svd(F)[1].min() for F in motions]
    np.testing.assert_allclose(found, expected, rtol=3e-3)


def test_a_circle_across_a_wall_and_one_across_a_free_edge():
    """Gap to the wall, and mouth at the free edge, the plate's gap if it is smaller."""
    holes = [jaxgel.Circle((0.0, -2.0), 0.8), jaxgel.Circle((0.0, 1.6), 0.5)]
    cloud = jaxgel.make_cloud(
        jaxgel.Plate(4, 4, holes, edges={"top": "free"}, spacing=0.8, nodes_per_hole=20)
    )
    model = jaxgel.discretise(cloud)
    x = np.asarray(cloud.nodes)
    mouth = 2 * np.sqrt(0.5**2 - 0.4**2)
    found = jaxgel.min_gap(states_of(model, [x, x * [2.0, 1.0], x * [2.0, 0.9]]))
    # the mouth twice as wide is 1.2
    np.testing.assert_allclose(found, [mouth, 0.8, 0.72], rtol=3e-3)


def test_gap_is_min_gap_or_the_shorter_side(lopsided_model, square_model):
    states = states_of(lopsided_model, np.stack([lopsided_model.cloud.nodes, bent(lopsided_model)]))
    np.testing.assert_allclose(gap(states), jaxgel.min_gap(states), rtol=1e-12)
    solid = states_of(square_model, square_model.cloud.nodes[None])
    assert gap(solid)[0] == 1.0 and jaxgel.min_gap(solid)[0] == np.inf


def test_gap_has_the_derivative_by_positions_of_differences(lopsided_model):
    def value(x):
        return gap(states_of(lopsided_model, x[None]))[0]

    x = bent(lopsided_model)
    slope = jax.jit(jax.grad(value))(x)
    for direction in np.random.default_rng(1).normal(size=(3, *x.shape)):
        difference = (value(x + STEP * direction) - value(x - STEP * direction)) / (2 * STEP)
        # round-off over the step
        assert jnp.vdot(slope, direction) == pytest.approx(float(difference), rel=1e-6, abs=1e-8)
    np.testing.assert_allclose(
        jax.vmap(value)(jnp.stack([x, 2 * x])), [value(x), 2 * value(x)], rtol=1e-12
    )


@pytest.mark.thorough
def test_gap_has_the_derivative_by_hole_parameters_of_differences(lopsided):
    plate, cloud = lopsided
    names = ("radius", "cos", "sin")

    def value(*parameters):
        model = jaxgel.discretise(cloud.at(plate.at([dict(zip(names, parameters, strict=True))])))
        return gap(states_of(model, model.cloud.nodes[None]))[0]

    at = [plate.theta[0][name] for name in names]
    along = [jnp.asarray(v) for v in (1.0, [0.3, -0.5], [0.7, 0.2])]
    _, slope = jax.jvp(value, at, along)
    ahead, behind = (
        value(*[a + sign * STEP * d for a, d in zip(at, along, strict=True)]) for sign in (1, -1)
    )
    assert slope == pytest.approx(float(ahead - behind) / (2 * STEP), rel=1e-6)


def test_an_outline_that_crosses_itself_has_no_derivative(lopsided_model):
    x = lopsided_model.cloud.nodes
    folded = jnp.stack([(x[:, 0] - 0.1) * (x[:, 1] + 0.2), x[:, 1]], axis=1)
    value, slope = jax.value_and_grad(lambda x: gap(states_of(lopsided_model, x[None]))[0])(folded)
    assert value == 0.0 and np.isnan(slope).any()


@pytest.mark.slow
def test_gap_of_a_slit_narrower_than_the_node_spacing_is_its_width():
    """0.1 mm of 2 mm; `test_gap_of_a_dry_hole_is_its_width` without a cloud."""
    plate = jaxgel.Plate(
        4, 4, [jaxgel.Rectangle((0, 0.1), (2, 0.1))], spacing=0.8, nodes_per_hole=20
    )
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    assert gap(states_of(model, model.cloud.nodes[None]))[0] == pytest.approx(0.1, rel=1e-9)
