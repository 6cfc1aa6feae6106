import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from jax.flatten_util import ravel_pytree
from scipy.integrate import quad
from scipy.special import ellipeinc

from jaxgel.geometry import (
    KINDS,
    Circle,
    Ellipse,
    Fourier,
    Plate,
    Polygon,
    Rectangle,
    Superellipse,
    arc_parameter,
    arc_points,
    arcs,
    check_plate,
    edge_lines,
    equal_arc_length,
    inside_holes,
    reference_plate,
)

HOLES = {
    "circle": Circle(centre=(0.3, -0.2), radius=1.5),
    "ellipse": Ellipse(centre=(0.3, -0.2), semi_axes=(2.0, 1.2), angle=0.4),
    "superellipse": Superellipse(centre=(0.3, -0.2), semi_axes=(2.0, 1.2), exponent=3.5, angle=0.4),
    "fourier": Fourier(centre=(0.3, -0.2), radius=1.5, cos=(0.1, -0.03), sin=(0.05, 0.08)),
    "rectangle": Rectangle(centre=(0.3, -0.2), sides=(3.0, 2.0), angle=0.4),
    "polygon": Polygon(
        vertices=[(-0.9, -1), (1.1, -1), (1.2, 0.3), (0.1, 0.4), (0, 1.5), (-0.9, 1)]
    ),
}
each_kind = pytest.mark.parametrize("hole", HOLES.values(), ids=HOLES.keys())


LARGEST = 12000  # points, to which all are filled up: compiled once per kind


def filled(function):
    """``function(hole, row)`` at many rows, NumPy."""
    mapped = jax.jit(jax.vmap(function, (None, 0)))

    def call(hole, rows):
        rows = np.asarray(rows)
        return np.asarray(mapped(hole, np.resize(rows, (LARGEST, *rows.shape[1:]))))[: len(rows)]

    return call


points = filled(lambda hole, t: hole.point(t))
velocities = filled(lambda hole, t: jax.jacfwd(hole.point)(t))
excess = filled(lambda hole, x: hole.excess(x))
speed = jax.jit(lambda hole, t: jnp.linalg.norm(jax.jacfwd(hole.point)(t)))
by_parameters = jax.jit(jax.vmap(jax.jacfwd(lambda hole, t: hole.point(t)), (None, 0)))
slope_of_excess = jax.jit(jax.jacfwd(lambda x, hole: hole.excess(x)))


def outline(hole, n):
    return points(hole, np.arange(n) / n)


def test_every_kind_is_covered_here():
    assert set(HOLES) == set(KINDS)


@each_kind
def test_point_derivatives_in_all_parameters_match_central_differences(hole):
    flat, unravel = ravel_pytree(hole)
    t = np.array([0.0, 0.11, 0.25, 0.5, 0.61, 0.97])  # axis ends among them
    step = 1e-6
    flat, ways = np.asarray(flat), step * np.eye(len(flat))
    differences = [
        (points(unravel(flat + e), t) - points(unravel(flat - e), t)) / (2 * step) for e in ways
    ]
    slopes = [
        np.asarray(leaf).reshape(len(t), 2, -1) for leaf in jax.tree.leaves(by_parameters(hole, t))
    ]
    # central differences: truncation step^2 = 1e-12, round-off 1e-16 / step = 1e-10
    np.testing.assert_allclose(
        np.concatenate(slopes, axis=2), np.stack(differences, axis=-1), atol=2e-9
    )


@each_kind
def test_point_derivative_in_t_matches_central_differences_between_corners(hole):
    t, step = np.array([0.03, 0.22, 0.41, 0.58, 0.91]), 1e-6
    differences = (points(hole, t + step) - points(hole, t - step)) / (2 * step)
    # truncation step^2 |point'''| / 6 up to 1e-12 (2 pi)^3 50, round-off 1e-10
    np.testing.assert_allclose(velocities(hole, t), differences, atol=2e-8)


@pytest.mark.parametrize("exponent", [1.2, 2.0, 4.0, 100.0])
def test_superellipse_derivatives_are_finite_all_round(exponent):
    hole = Superellipse(centre=(0.0, 0.0), semi_axes=(5.0, 0.5), exponent=exponent)
    t = np.linspace(0.0, 1.0, 721)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(by_parameters(hole, t)))
    assert np.isfinite(velocities(hole, t)).all()
    # the centre is where the polar angle is not defined
    assert np.isfinite(slope_of_excess(np.zeros(2), hole)).all()


@each_kind
def test_outline_is_periodic(hole):
    t = np.array([0.0, 0.125, 0.7])
    # round-off of 2 pi (t + 1)
    np.testing.assert_allclose(points(hole, t + 1), points(hole, t), atol=1e-14)
    np.testing.assert_allclose(points(hole, t - 2), points(hole, t), atol=1e-14)


@each_kind
def test_area_is_that_inside_the_anticlockwise_outline(hole):
    # midpoint rule, spectral for periodic outlines and exact for straight sides
    t = (np.arange(12000) + 0.5) / 12000
    (x, y), (dx, dy) = points(hole, t).T, velocities(hole, t).T
    np.testing.assert_allclose(hole.area(), np.mean(x * dy - y * dx) / 2, rtol=1e-12)


@each_kind
def test_excess_is_zero_on_the_outline_and_has_the_right_sign_beside_it(hole):
    # round-off of lengths near 1
    np.testing.assert_allclose(excess(hole, outline(hole, 101)), 0.0, atol=1e-14)
    random = np.random.default_rng(1).uniform(-3, 3, (500, 2))
    inside = shapely.contains_xy(shapely.Polygon(outline(hole, 12000)), random)
    assert np.array_equal(excess(hole, random) < 0, inside)


def test_special_superellipse_and_fourier_are_ellipse_and_circle():
    ellipse = Ellipse(centre=(1.0, 2.0), semi_axes=(3.0, 2.0), angle=0.3)
    twin = Superellipse(centre=(1.0, 2.0), semi_axes=(3.0, 2.0), exponent=2.0, angle=0.3)
    np.testing.assert_allclose(excess(ellipse, outline(twin, 50)), 0.0, atol=1e-14)
    np.testing.assert_allclose(twin.area(), ellipse.area(), rtol=1e-14)
    circle = Circle(centre=(1.0, 2.0), radius=3.0)
    twin = Fourier(centre=(1.0, 2.0), radius=3.0, cos=(), sin=())
    np.testing.assert_allclose(outline(twin, 50), outline(circle, 50), atol=1e-14)


@each_kind
def test_corners_are_the_kinks_of_the_outline(hole):
    def tangents(t):
        v = velocities(hole, t)
        return v / np.linalg.norm(v, axis=1, keepdims=True)

    t = np.unique(np.concatenate([np.arange(60) / 60 + 1e-3, np.asarray(hole.corners)]))
    turn = np.linalg.norm(tangents(t + 1e-9) - tangents(t - 1e-9), axis=1)
    assert np.array_equal(turn > 0.1, np.isin(t, hole.corners))


@each_kind
def test_holes_pass_through_jax_transformations(hole):
    def x_of(hole):
        return hole.point(0.3)[0]

    np.testing.assert_allclose(jax.jit(x_of)(hole), points(hole, [0.3])[0, 0], rtol=1e-14)
    stack = jax.tree.map(lambda leaf: np.stack([leaf, leaf + 0.1]), hole)
    axes = jax.tree.map(lambda leaf: 0, hole)  # placeholders as leaves
    assert jax.jit(jax.vmap(x_of, in_axes=(axes,)))(stack).shape == (2,)
    assert jax.tree.structure(jax.tree.map(lambda leaf: object(), hole)) == jax.tree.structure(hole)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(jax.jit(jax.grad(x_of))(hole)))


def test_unusable_construction_is_refused_by_name(refused):
    refused(
        lambda make: make(),
        [
            (lambda: Ellipse(centre=(0, 0, 0), semi_axes=(1, 1)), "Ellipse.centre"),
            (lambda: Circle(centre=(0, 0), radius="big"), "Circle.radius: 'big' is not a number"),
            (lambda: Polygon(vertices=[1, 2, 3]), "Polygon.vertices"),
            (lambda: Fourier(centre=(0, 0), radius=1, cos=(0.1,), sin=()), "same number"),
            (lambda: Plate(-1, 2), "width: -1"),
            (lambda: Plate(1, 2, holes=["hole"]), r"holes\[0\]"),
            (lambda: Plate(1, 2, edges={"tpo": "free"}), "did you mean 'top'"),
            (lambda: Plate(1, 2, edges="rollers"), "did you mean 'roller'"),
            (lambda: Plate(1, 2, edges=3), "edges: 3"),
        ],
    )


# --- plates


def four_holes():
    return Plate(
        20, 10, holes=[Circle((-4, 0), 2.0), Ellipse((4.0, 0.0), (3.0, 2.0))], edges={"top": "free"}
    )


def test_edges_left_out_are_rollers():
    assert dict(four_holes().edges) == {
        "left": "roller",
        "right": "roller",
        "bottom": "roller",
        "top": "free",
    }
    assert hash(four_holes().edges) == hash(four_holes().edges)


def test_at_replaces_what_is_given_and_remembers_the_reference():
    plate = four_holes()
    moved = plate.at(({"radius": 2.5}, {}))
    assert (float(moved.holes[0].radius), moved.holes[0].centre.tolist()) == (2.5, [-4.0, 0.0])
    assert moved.theta[1]["semi_axes"].tolist() == [3.0, 2.0]
    assert moved.reference is plate
    assert moved.at(moved.theta).reference is plate
    assert plate.reference is None
    assert moved.edges == plate.edges


def test_gradient_passes_through_at():
    plate = four_holes()
    gradient = jax.jit(jax.grad(lambda theta: plate.at(theta).holes[1].area()))(plate.theta)
    np.testing.assert_allclose(gradient[1]["semi_axes"], [2 * np.pi, 3 * np.pi], rtol=1e-14)
    assert gradient[0]["radius"] == 0


def test_at_refuses_what_does_not_fit_the_holes(refused):
    refused(
        four_holes().at,
        [
            (({},), "1 entries for 2 holes"),
            (({"radus": 1.0}, {}), "unknown parameter 'radus' of Circle; did you mean 'radius'"),
            (({"radius": (1.0, 2.0)}, {}), r"radius has shape \(2,\)"),
        ],
    )


def test_reference_of_a_plate_under_differentiation_has_the_values():
    def radius(r):
        plate = Plate(20, 10, holes=[Circle((0.0, 0.0), r)])
        assert float(reference_plate(plate).holes[0].radius) == 3.0
        return plate.holes[0].area()

    np.testing.assert_allclose(jax.grad(radius)(3.0), 6 * np.pi, rtol=1e-15)
    with pytest.raises(ValueError, match="inside jit"):
        jax.jit(radius)(3.0)


def test_reference_of_a_moved_plate_is_the_plate_it_came_from():
    plate = four_holes()
    assert reference_plate(plate) is plate
    assert reference_plate(plate.at(({"radius": 2.5}, {}))) is plate


# --- arcs


def lattice():
    return Plate(
        8, 8, holes=[Circle((x, y), 0.9) for x in (-4, -2, 0, 2, 4) for y in (-4, -2, 0, 2, 4)]
    )


def distance_to_edge(plate, points, edge):
    axis, coordinate = edge_lines(plate)[edge]
    return np.abs(np.atleast_2d(points)[:, axis] - coordinate).max()


def test_lattice_has_whole_half_and_quarter_circles():
    found = arcs(lattice())
    lengths = sorted(round(arc.end - arc.start, 13) for arc in found)
    assert lengths == [0.25] * 4 + [0.5] * 12 + [1.0] * 9
    assert sum(arc.closed for arc in found) == 9
    assert [arc.hole for arc in found] == list(range(25))


def test_arc_ends_lie_on_their_edges_to_round_off():
    plate = lattice()
    for arc in arcs(plate):
        if not arc.closed:
            start, middle, end = np.asarray(arc_points(plate, arc, [0.0, 0.5, 1.0]))
            assert distance_to_edge(plate, start, arc.start_edge) < 1e-14
            assert distance_to_edge(plate, end, arc.end_edge) < 1e-14
            assert np.abs(middle).max() < 4


@pytest.mark.parametrize(
    "kind", ["circle", "ellipse", "superellipse", "fourier", "rectangle", "polygon"]
)
@pytest.mark.parametrize("edge", ["left", "right", "bottom", "top"])
def test_arc_ends_stay_on_the_edge_when_the_hole_moves_and_grows(kind, edge):
    axis, coordinate = edge_lines(Plate(20, 10))[edge]
    hole = HOLES[kind]
    shift = np.zeros(2)
    shift[axis] = coordinate + 0.1

    def moved(by, factor):
        size = {
            name: factor * np.asarray(hole.theta[name])
            for name in ("radius", "semi_axes", "sides", "vertices")
            if name in hole.theta
        }
        place = "vertices" if kind == "polygon" else "centre"
        theta = hole.theta | size
        return theta | {place: np.asarray(theta[place]) + by}

    plate = Plate(20, 10, holes=[type(hole)(**moved(shift, 1.0))])
    (arc,) = arcs(plate)
    other = plate.at((moved(shift + np.array([0.2, -0.15]), 1.2),))
    for placed in (plate, other):
        line = np.asarray(arc_points(placed, arc, np.linspace(0.0, 1.0, 33)))
        # a few roundings of coordinates near 10
        assert distance_to_edge(placed, line[[0, -1]], edge) < 1e-13
        assert (np.abs(line) < [10 + 1e-12, 5 + 1e-12]).all()


def test_derivatives_of_a_cut_end_match_the_circle():
    plate = Plate(20, 10, holes=[Circle((-9.0, 0.0), 2.0)])
    (arc,) = arcs(plate)

    # the arc is anticlockwise, so it ends at the upper crossing: y^2 = r^2 - (x + 10)^2
    def height(radius, x):
        return arc_points(
            plate.at(({"radius": radius, "centre": jnp.stack([x, 0.0])},)), arc, [1.0]
        )[0, 1]

    r, x, y = 2.2, -9.1, np.sqrt(2.2**2 - 0.9**2)
    np.testing.assert_allclose(height(r, x), y, rtol=1e-14)
    np.testing.assert_allclose(
        jax.jit(jax.grad(height, (0, 1)))(r, x), (r / y, -0.9 / y), rtol=1e-13
    )
    np.testing.assert_allclose(jax.jit(jax.hessian(height))(r, x), 1 / y - r**2 / y**3, rtol=1e-12)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(height))(r, x), r / y, rtol=1e-13)


def test_arc_parameter_is_linear_between_the_ends():
    plate = Plate(20, 10, holes=[Circle((-9.0, 0.0), 2.0)])
    (arc,) = arcs(plate)
    s = jnp.linspace(0.0, 1.0, 5)
    t = jax.vmap(lambda s: arc_parameter(plate, arc, s))(s)
    np.testing.assert_allclose(t, arc.start + s * (arc.end - arc.start), atol=1e-15)
    assert arc.start < 1 < arc.end  # through t = 1


def test_hole_that_touches_the_edge_in_a_point_is_whole():
    diamond = Rectangle((0, 3.0), (np.sqrt(2), np.sqrt(2)), np.pi / 4)
    for hole in (Circle((3.1, 0.0), 0.9), Ellipse((3.1, 0.3), (1.2, 0.9), np.pi / 2), diamond):
        (arc,) = arcs(Plate(8, 8, holes=[hole]))
        assert arc.closed


@pytest.mark.parametrize("depth", [1e-3, 1e-6, 1e-9])
def test_slight_cuts_between_samples_are_found(depth):
    # a circle turned by a third of the distance of the samples
    hole = Ellipse((3.1 + depth, 0.1), (0.9, 0.9), angle=0.0011)
    (arc,) = arcs(Plate(8, 8, holes=[hole]))
    assert (arc.start_edge, arc.end_edge) == ("right", "right")
    cap = np.arccos(1 - (3.1 + depth + 0.9 - 4) / 0.9) / np.pi
    # round-off of coordinates, 1e-15, over the depth
    np.testing.assert_allclose(1 - (arc.end - arc.start), cap, rtol=1e-5)


def test_hole_around_a_corner_ends_on_both_edges():
    (arc,) = arcs(Plate(8, 8, holes=[Ellipse((3.8, 4.1), (1.0, 0.7), 0.3)]))
    assert (arc.start_edge, arc.end_edge) == ("top", "right")


def test_hole_cut_twice_by_one_edge_has_two_arcs():
    staple = Polygon([(-2, 3), (-1, 3), (-1, 4.5), (1, 4.5), (1, 3), (2, 3), (2, 5), (-2, 5)])
    plate = Plate(8, 8, holes=[staple])
    ends = np.concatenate([arc_points(plate, arc, [0.0, 1.0]) for arc in arcs(plate)])
    np.testing.assert_allclose(ends, [(1, 4), (2, 4), (-2, 4), (-1, 4)], atol=1e-14)


def test_corner_of_a_hole_on_the_edge_is_an_end():
    plate = Plate(8, 8, holes=[Rectangle((0.0, 4.0), (2.0, 2.0), np.pi / 4)])
    (arc,) = arcs(plate)
    np.testing.assert_allclose(arc_points(plate, arc, [0.0]), [(-np.sqrt(2), 4)], atol=1e-14)
    for y in (3.9, 4.1):
        (end,) = arc_points(plate.at(({"centre": np.array([0.0, y])},)), arc, [1.0])
        np.testing.assert_allclose(end, (np.sqrt(2) - 0.1, 4), atol=1e-14)


# --- equal arc length


@each_kind
@pytest.mark.parametrize("cut", [False, True], ids=["whole", "cut"])
def test_pieces_between_corners_have_equal_length(hole, cut):
    plate = Plate(0.9, 20, holes=[hole]) if cut else Plate(20, 20, holes=[hole])
    for arc in arcs(plate)[:1]:
        n = 17
        s = equal_arc_length(plate, arc, n)
        assert len(s) == (n if arc.closed else n + 1)
        t = arc.start + np.append(s, 1.0)[: n + 1] * (arc.end - arc.start)
        own = functools.partial(speed, hole)
        lengths = np.array(
            [quad(own, a, b, epsabs=1e-13, epsrel=1e-13)[0] for a, b in itertools.pairwise(t)]
        )
        stops = [
            arc.start,
            *sorted(c + k for c in hole.corners for k in (0, 1) if arc.start < c + k < arc.end),
            arc.end,
        ]
        # corners are cuts
        assert np.isclose(np.asarray(stops)[:, None], t[None], rtol=0, atol=1e-14).any(axis=1).all()
        stretch = np.searchsorted(np.asarray(stops) + 1e-9, t[:-1] + 2e-9)
        for k in np.unique(stretch):
            np.testing.assert_allclose(
                lengths[stretch == k], lengths[stretch == k].mean(), rtol=1e-10
            )


def test_ellipse_is_cut_where_the_elliptic_integral_says():
    plate = Plate(20, 20, holes=[Ellipse((0.0, 0.0), (2.0, 3.0))])
    s = equal_arc_length(plate, arcs(plate)[0], 40)
    # with b > a the length from the end of the first axis is b E(phi | 1 - a^2/b^2)
    lengths = 3.0 * ellipeinc(2 * np.pi * s, 1 - 4 / 9)
    np.testing.assert_allclose(
        lengths, np.arange(40) / 40 * 3.0 * ellipeinc(2 * np.pi, 1 - 4 / 9), atol=1e-12
    )


def test_intervals_go_with_the_side_lengths():
    plate = Plate(20, 20, holes=[Rectangle((0.0, 0.0), (8.0, 4.0))])
    s = equal_arc_length(plate, arcs(plate)[0], 40)
    assert [int(np.sum((s >= a) & (s < a + 0.25))) for a in (0, 0.25, 0.5, 0.75)] == [13, 7, 13, 7]
    with pytest.raises(ValueError, match=r"^n_intervals: 3 on an arc of holes"):
        equal_arc_length(plate, arcs(plate)[0], 3)


# --- inside and checks


def test_points_on_the_outline_count_as_inside():
    holes = [Circle((-5, 0), 2.0), Rectangle((5, 0), (2.0, 2.0))]
    plate = Plate(20, 10, holes=holes)
    grid = np.array(
        [[-3.0, 0.0], [-3.0 + 1e-9, 0.0], [4.0, 0.5], [6.0, 1.0], [6.0, 1.0 + 1e-6], [0.0, 0.0]]
    )
    assert inside_holes(plate, grid).tolist() == [True, False, True, True, False, False]
    assert inside_holes(plate, grid, 1e-8).tolist() == [True, True, True, True, False, False]
    assert inside_holes(Plate(1, 1), grid).tolist() == [False] * 6


@each_kind
def test_check_accepts_holes_inside_and_cut(hole):
    check_plate(Plate(20, 20, holes=[hole]))
    check_plate(Plate(4.5, 8, holes=[hole]))
    check_plate(Plate(20, 20))


def test_check_refuses_in_one_line(refused):
    refused(
        lambda holes: check_plate(Plate(10, 10, holes=holes)),
        [
            ([Circle((0, 0), np.nan)], r"holes\[0\].radius: nan is not finite"),
            ([Circle((0, 0), 1), Circle((np.inf, 0), 1)], r"holes\[1\].centre"),
            ([Circle((0, 0), -1)], r"holes\[0\].radius: -1.0 is not positive"),
            ([Ellipse((0, 0), (1, 0))], r"holes\[0\].semi_axes"),
            ([Superellipse((0, 0), (1, 1), 0.5)], r"holes\[0\].exponent: 0.5"),
            ([Circle((7, 0), 1)], r"holes\[0\]: it lies outside"),
            ([Circle((0, 0), 9)], r"holes\[0\]: it covers the whole plate"),
            (
                [Circle((0, 0), 1), Circle((-3, 0), 1), Circle((1.5, 0), 1)],
                r"holes\[0\], holes\[2\]: they overlap or touch",
            ),
            (
                [Circle((0, 0), 1), Circle((2, 0), 1)],
                r"holes\[0\], holes\[1\]: they overlap or touch",
            ),
            ([Circle((0, 0), 2), Circle((0, 0), 1)], r"holes\[0\], holes\[1\]"),
            (
                [Polygon([(0, 0), (1, 1), (1, 0), (0, 1)])],
                r"holes\[0\]: its outline crosses itself",
            ),
            ([Polygon([(0, 0), (0, 1), (1, 0)])], r"holes\[0\]: .*clockwise"),
            ([Polygon([(0, 0), (1, 0)])], r"holes\[0\].vertices"),
            ([Fourier((0, 0), 1.0, (1.5,), (0.0,))], r"holes\[0\]: its outline crosses itself"),
            ([Rectangle((0, 0), (2.0, 12.0))], "cut the plate into 2 parts"),
            (
                [Rectangle((0, 4), (2.0, 2.0))],
                r"holes\[0\]: its side 2 lies along the plate's edge",
            ),
        ],
    )


def test_holes_that_meet_only_outside_the_plate_are_accepted():
    check_plate(Plate(10, 10, holes=[Circle((-1.5, 6), 1.6), Circle((1.5, 6), 1.6)]))
