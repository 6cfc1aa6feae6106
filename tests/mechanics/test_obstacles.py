"""Obstacles: closed forms of a pressed block and a strip at a wall, forces, refusals."""

import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxgel
from jaxgel.equilibrium import State, Status
from jaxgel.equilibrium.newton import uncrossed
from jaxgel.geometry import gap, primitives_of
from jaxgel.mechanics import contact_energy, couplings, crosses_lines, gather, scatter, tangent
from jaxgel.observables import contact_pressure, obstacle_force

GEL, MU = jaxgel.Gel(1e-3, 0.1), -0.3
RANGE = 1 / 80
DEPTHS = [0.08, 0.15, 0.3]


def stress(stretch, mu=MU):
    """Nominal stress, kT/v, in plane strain, uniaxial swelling (Deng et al. 2020, Eq. 59).

    Zero if free.
    """
    return (
        GEL.Nv * (stretch - 1 / stretch)
        + np.log1p(-1 / stretch)
        + 1 / stretch
        + GEL.chi / stretch**2
        - mu
    )


FREE = brentq(stress, 1.05, 50.0)  # stretch of a free block between rollers


def block(obstacle, spacing=0.25):
    """A block between rollers, free at the top, and an obstacle above it."""
    plate = jaxgel.Plate(1.0, 1.0, edges={"top": "free"}, obstacles=[obstacle], spacing=spacing)
    return jaxgel.discretise(jaxgel.make_cloud(plate))


@pytest.fixture(scope="module")
def pressed():
    """A block pressed by a flat punch that starts 0.1 mm above its free top."""
    model = block(jaxgel.HalfPlane((0.0, FREE - 0.5 + 0.1), (0.0, -2.0)))
    return jaxgel.sweep(
        jaxgel.Problem(model, GEL, control=jaxgel.Punch((0.0, -1.0), mu=MU), contact_range=RANGE),
        DEPTHS,
    )


def test_a_surface_that_has_passed_a_line_is_seen():
    """A needle above the free top: the dry gel is below it, the stretched one across it."""
    model = block(jaxgel.Polyline([(0.1, 0.6), (0.1, 2.0)]))
    problem = jaxgel.Problem(model, GEL, contact_range=RANGE).prepared
    x = np.asarray(model.nodes)
    assert not crosses_lines(x, problem.model) and crosses_lines(x * [1.0, 1.5], problem.model)
    found = uncrossed(problem, State(MU, MU, x * [1.0, 1.5], np.zeros(0), Status.CONVERGED), MU)
    assert found.status is Status.CROSSED


@pytest.mark.slow
def test_a_pressed_block_has_the_stress_of_uniform_compression(pressed):
    """At the stretch of its top, 0.5 %: uneven pressure between points, by less if shorter."""
    top = np.asarray(pressed.x)[:, pressed.model.lists.topology.edge_nodes["top"], 1].mean(axis=1)
    force = np.asarray(obstacle_force(pressed))
    np.testing.assert_allclose(force[0], 0.0, atol=1e-15)  # 0.02 mm apart
    np.testing.assert_allclose(force[1:, 0, 1], -stress(top[1:] + 0.5), rtol=5e-3)
    np.testing.assert_allclose(force[:, 0, 0], 0.0, atol=1e-12)


@pytest.mark.slow
def test_the_force_is_the_derivative_of_the_energy_by_the_punch(pressed):
    """By the derivative rule of the sweep, which moves the state with the punch.

    The force holds the state.
    """

    def energy(depth):
        return jaxgel.sweep(
            pressed.problem, jnp.stack([jnp.asarray(0.08), jnp.asarray(0.14), depth])
        ).energy[-1]

    _, slope = jax.jvp(energy, (jnp.asarray(0.15),), (jnp.asarray(1.0),))
    path = jaxgel.sweep(pressed.problem, [0.08, 0.14, 0.15])
    assert float(slope) == pytest.approx(float(obstacle_force(path)[-1, 0, 1]), rel=1e-8)


@pytest.mark.slow
def test_derivatives_by_the_place_of_an_obstacle_are_differences():
    """Of the energy and of the force, by fourth-order differences of sweeps to a moved wall.

    The derivative of the energy is the force.
    """

    def at_wall(y):
        path = jaxgel.sweep(
            jaxgel.Problem(
                block(jaxgel.HalfPlane((0.0, y), (0.0, -1.0))), GEL, contact_range=RANGE
            ),
            [-1.0, MU],
        )
        return jnp.stack([path.energy[-1], obstacle_force(path)[-1, 0, 1]])

    y, h = FREE - 0.6, 1e-4
    near, far = (at_wall(y + step) - at_wall(y - step) for step in (h, 2 * h))
    difference = (8 * near - far) / (12 * h)
    np.testing.assert_allclose(jax.jacrev(at_wall)(y), difference, rtol=1e-9)
    assert float(difference[0]) == pytest.approx(-float(at_wall(y)[1]), rel=1e-9)


@pytest.mark.thorough
def test_the_leak_area_is_what_is_left_to_the_wall(pressed):
    """Distance of a free block's flat top from the punch, differentiable; 0 if pressed."""
    open_area = np.asarray(jaxgel.leak_area(pressed))
    np.testing.assert_allclose(open_area, [0.1 - DEPTHS[0] - RANGE, 0.0, 0.0], rtol=0, atol=1e-9)

    def leak(depth):
        return jaxgel.leak_area(
            jaxgel.sweep(pressed.problem, jnp.stack([jnp.asarray(0.02), depth]))
        )[-1]

    assert float(jax.grad(leak)(0.05)) == pytest.approx(-1.0, rel=1e-12)


@pytest.mark.thorough
def test_pressure_along_the_top_adds_up_to_the_force(pressed):
    points, pressure = map(np.asarray, contact_pressure(pressed))
    assert pressure.max() > 0 and points[pressure > 0, 1].min() > 0.5
    length = 1.0 / ((len(points) - 1) if len(points) > 1 else 1)
    total = np.sum(pressure[1:-1]) * length + 0.5 * length * (pressure[0] + pressure[-1])
    assert total == pytest.approx(float(obstacle_force(pressed)[-1, 0, 1]), rel=1e-10)


@pytest.mark.slow
def test_the_pressure_has_the_derivative_of_differences(pressed):
    """By the depth of the punch, through the sweep; central differences of fourth order."""
    weights = np.cos(np.arange(len(contact_pressure(pressed)[1])))

    def weighted(depth):
        return (
            weights
            @ contact_pressure(
                jaxgel.sweep(
                    pressed.problem, jnp.stack([jnp.asarray(0.08), jnp.asarray(0.14), depth])
                )
            )[1]
        )

    wide, narrow = (
        (float(weighted(0.15 + h)) - float(weighted(0.15 - h))) / (2 * h) for h in (2e-4, 1e-4)
    )
    assert float(jax.grad(weighted)(0.15)) == pytest.approx((4 * narrow - wide) / 3, rel=1e-6)


@pytest.mark.slow
def test_a_strip_at_a_wall_swells_freely_and_is_then_held():
    """Eq. 59 until the range of contact.

    Beyond it the top rests short of the wall by less than the range.
    """
    heights = []
    wall = FREE - 0.5 - 0.1
    model = block(jaxgel.HalfPlane((0.0, wall), (0.0, -1.0)))
    for reach in (0.02, 0.01, 0.005):
        path = jaxgel.sweep(jaxgel.Problem(model, GEL, contact_range=reach), [-1.0, MU])
        top = np.asarray(path.x)[:, model.lists.topology.edge_nodes["top"], 1]
        free = brentq(lambda stretch: stress(stretch, -1.0), 1.05, 50.0)
        np.testing.assert_allclose(top[0], free - 0.5, rtol=1e-9)
        heights.append(wall - top[1].mean())
    assert np.all(np.array(heights) > 0)
    # 1.97, 1.96, 1.97
    assert heights[0] / heights[1] == pytest.approx(2.0, rel=0.03) == heights[1] / heights[2]


@pytest.mark.thorough
def test_tangent_at_an_obstacle_is_the_hessian(pressed):
    problem, state = pressed.problem, pressed[-1]
    near = problem.at(state.value)[0].touching(state.x).prepared
    linear = jaxgel.mechanics.linearise(near, state.x, state.pressure, state.mu)
    blocks, gel = (
        tangent(near, state.x, state.pressure, linear),
        tangent(near.without_pairs, state.x, state.pressure, linear),
    )
    assert couplings(near.model) is None  # an obstacle couples only nodes of one cell
    i, j = jaxgel.mechanics.node_pairs(near.model.lists)[0].T
    free = gather(jnp.asarray(np.random.default_rng(1).normal(size=state.x.shape)), near.free)
    v, product, other = np.asarray(scatter(free, near.free)), np.zeros(state.x.shape), i != j
    blocks = blocks - gel
    np.add.at(product, i, np.einsum("pkl,pl->pk", blocks, v[j]))
    np.add.at(product, j[other], np.einsum("plk,pl->pk", blocks[other], v[i[other]]))
    _, expected = jax.jvp(
        jax.grad(lambda x: contact_energy(x, near.model)),
        (jnp.asarray(state.x),),
        (jnp.asarray(v),),
    )
    # the gel's own tangent cancels
    np.testing.assert_allclose(product, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("obstacle", "point", "distance"),
    [
        (jaxgel.HalfPlane((0.0, 1.0), (0.0, -3.0)), (5.0, 0.25), 0.75),
        (jaxgel.Disc((1.0, 0.0), 0.5), (1.0, 2.0), 1.5),
        (jaxgel.Polyline([(0.0, 0.0), (2.0, 0.0)]), (3.0, 0.0), 1.0),
        (jaxgel.Polyline([(0.0, 0.0), (2.0, 0.0)]), (1.0, -0.5), 0.5),
    ],
)
def test_gaps_are_distances(obstacle, point, distance):
    primitive = jax.tree.map(lambda v: v[0], primitives_of((obstacle,)))
    assert float(gap(jnp.array(point), primitive)) == pytest.approx(distance, rel=1e-14)


def test_obstacles_that_cannot_be_used_are_refused(refused):
    def attempt(obstacle, **options):
        model = jaxgel.discretise(
            jaxgel.make_cloud(
                jaxgel.Plate(1, 1, edges={"top": "free"}, obstacles=obstacle, spacing=0.25)
            )
        )
        return jaxgel.Problem(model, GEL, **options)

    wall = jaxgel.HalfPlane((0.0, 0.4), (0.0, -1.0))
    rows = [
        ([3], r"obstacles[0]: 3 is not an obstacle; give a HalfPlane, a Disc or a Polyline"),
        (
            [jaxgel.HalfPlane((0, 1), (0, 0))],
            "obstacles[0].normal: [0, 0] has no direction; give a vector towards the gel",
        ),
        ([jaxgel.Disc((0, 2), -1.0)], "obstacles[0].radius: -1 is not a length > 0"),
        (
            [jaxgel.Polyline([(0, 2)])],
            "obstacles[0].points: one point is not a line; give at least two",
        ),
        ([wall], "obstacles[0]: it overlaps the dry gel; move it away"),
    ]
    refused(attempt, rows, literal=True)
    with pytest.raises(ValueError, match=r"^contact: False does not go with obstacles"):
        attempt([jaxgel.HalfPlane((0.0, 2.0), (0.0, -1.0))], contact=False)


WALL = {"kind": "half-plane", "point": [0.0, 0.55], "normal": [0.0, -1.0]}
PIN = {"kind": "disc", "centre": [0.0, 9.0], "radius": 1.0}
CASE = {
    "plate": {"width": 1.0, "height": 1.0, "edges": {"top": "free"}, "spacing": 0.25},
    "obstacles": [WALL, PIN],
    "gel": {"Nv": 1e-3, "chi": 0.1},
    "sweep": {"mu": [-2.0, -1.0], "contact_range": 0.02},
}


@pytest.mark.slow
def test_a_case_file_has_obstacles():
    """Read, written and read again; they hold the gel back, and a figure draws them."""
    case = jaxgel.cases.from_table(CASE, "held")
    again = jaxgel.cases.from_table(
        tomllib.loads(jaxgel.cases.case_text(jaxgel.cases.explicit(case))), "again"
    )
    assert [type(one).__name__ for one in again.plate.obstacles] == ["HalfPlane", "Disc"]
    path = case.path(case.model())
    top = np.asarray(path.x)[-1, path.model.lists.topology.edge_nodes["top"], 1]
    assert path.stop.ok and 0.55 - 0.02 < top.max() < 0.55
    drawn = jaxgel.plotting.plot_pattern(path).axes.patches
    assert sum(type(patch).__name__ in ("Polygon", "Circle") for patch in drawn) >= 2


@pytest.mark.parametrize(
    "entries",
    [{"kind": "cube"}, {"kind": "disc", "centre": [0.0, 2.0]}, PIN | {"normal": [0.0, 1.0]}],
)
def test_wrong_obstacles_in_a_case_file_are_refused(entries):
    with pytest.raises(ValueError, match=r"^(case file: )?obstacles\[0\]") as refusal:
        jaxgel.cases.from_table(CASE | {"obstacles": [entries]}, "wrong")
    assert "\n" not in str(refusal.value)
