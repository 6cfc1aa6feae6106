"""Derivatives of swelling in time, by difference quotients of the runs themselves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel

KINEMATICS = "generalised plane strain"
TIMES = [1e-3, 0.01, 0.05, 0.2, 0.5]
FAMILIES = {
    "diffusivity": 1.0,
    "network": 2e-3,
    "mixing": 0.1,
    "field": 0.3,
    "axial stretch": 1.02,
    "start": -1.0,
    "bath": -0.3,
    "ramp": 0.1,
    "traction": 2e-4,
    "hole x": 0.02,
    "hole axis": 0.3,
    "hole axis 2": 0.2,
    "hole angle": 0.2,
}
VALUES = np.array(list(FAMILIES.values()))


@pytest.fixture(scope="module")
def quantity():
    """One number of the swelling of a plate with a hole, of all that it depends on; every part of the path is in it."""
    plate = jaxgel.Plate(
        1.2, 1.0, [jaxgel.Ellipse((0.02, 0.0), (0.3, 0.2), 0.2)], edges={"top": "free"}, axial_stretch=1.02, kinematics=KINEMATICS
    )
    cloud = jaxgel.make_cloud(plate, spacing=0.25, nodes_per_hole=12)

    def of(values):
        D, Nv, chi, slope, axial, start, bath, ramp, traction, x, *ellipse = values
        moved = jaxgel.Plate(
            1.2,
            1.0,
            [jaxgel.Ellipse((x, 0.0), tuple(ellipse[:2]), ellipse[2])],
            edges=plate.edges,
            axial_stretch=axial,
            kinematics=KINEMATICS,
        )
        model = jaxgel.discretise(cloud.at(moved))
        gel = jaxgel.Gel(jaxgel.WithHoles(lambda X: Nv * (1 + slope * X[0])), chi)
        loads = jaxgel.load_vector(model, traction={"top": jnp.stack([0.0, traction])})
        problem = jaxgel.Problem(model, gel, loads=loads, contact=False)
        baths = {0: jaxgel.Bath([-0.9, bath], times=[0.0, ramp]), "top": jaxgel.Bath(0.9 * bath)}
        path = jaxgel.swell(problem, baths, TIMES, start=start, D=D)
        weights = jnp.linspace(1.0, 2.0, len(path))
        parts = path.x[..., 0].mean(axis=1), path.x[..., 1].std(axis=1), path.energy, 10 * path.pressure.mean(axis=1)
        return sum(weights @ part for part in parts) + weights @ (
            path.supplied @ jnp.array([1.0, -0.5]) + 0.1 * path.potential.mean(axis=1)
        )

    return of


@pytest.fixture(scope="module")
def gradient(quantity):
    """By all values, in reverse mode."""
    return np.array(jax.grad(quantity)(list(VALUES)))


def quotient(function, direction, h=2e-4):
    """Central difference quotient of fourth order."""
    slopes = [(function(VALUES + s * direction) - function(VALUES - s * direction)) / (2 * s) for s in (h, h / 2)]
    return float(4 * slopes[1] - slopes[0]) / 3


def test_gradients_by_all_that_a_run_depends_on_are_difference_quotients(quantity, gradient):
    """Along two directions that change everything."""
    assert np.isfinite(gradient).all() and (np.abs(gradient) > 0).all()
    for seed in (0, 1):
        direction = VALUES * np.random.default_rng(seed).uniform(0.5, 1.0, len(VALUES))
        assert float(gradient @ direction) == pytest.approx(quotient(quantity, direction), rel=1e-6)


@pytest.mark.slow
def test_forward_mode_is_reverse_mode(quantity, gradient):
    direction = VALUES * np.random.default_rng(1).uniform(0.5, 1.0, len(VALUES))
    forward = jax.jvp(quantity, (list(VALUES),), (list(direction),))[1]
    assert float(forward) == pytest.approx(float(gradient @ direction), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(FAMILIES)), ids=list(FAMILIES))
def test_the_derivative_by_each_family_is_a_difference_quotient(quantity, gradient, number):
    """And leaves a remainder of second order.

    Where a hole moves, points enter supports, and there slopes jump: by 5e-5 of themselves at 8e-4
    along a semi-axis, by more from -3e-3 on. The steps of holes lie between.
    """
    direction = np.where(np.arange(len(VALUES)) == number, VALUES, 0.0)
    assert float(gradient @ direction) == pytest.approx(quotient(quantity, direction), rel=1e-6, abs=1e-9)
    value = quantity(VALUES)
    steps = (-0.0025, -0.00125) if list(FAMILIES)[number].startswith("hole") else (0.01, 0.005)
    change = [quantity(VALUES + h * direction) - value - h * float(gradient @ direction) for h in steps]
    assert abs(change[1]) < 1e-9 or np.log2(abs(change[0] / change[1])) > 1.95


@pytest.mark.slow
def test_a_run_that_starts_from_the_end_of_another_has_the_derivative_of_both(quantity):
    """By the bath of the first one, through the state between them."""
    model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.Plate(0.4, 1.0, edges={"top": "free"}), spacing=0.2))
    problem = jaxgel.Problem(model, jaxgel.Gel(1e-3, 0.1), contact=False)

    def thickness(bath):
        first = jaxgel.swell(problem, bath, [0.01, 0.1], start=-1.0)
        return jaxgel.swell(problem, -0.5, [0.01, 0.1], start=first[-1]).x[-1, :, 1].max()

    h = 1e-4
    slope = (thickness(-0.3 + h) - thickness(-0.3 - h)) / (2 * h)
    assert float(jax.grad(thickness)(-0.3)) == pytest.approx(float(slope), rel=1e-6)


def test_second_derivatives_and_compiled_runs_are_refused():
    model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.Plate(0.4, 1.0, edges={"top": "free"}), spacing=0.2))
    problem = jaxgel.Problem(model, jaxgel.Gel(1e-3, 0.1), contact=False)

    def height(bath):
        return jaxgel.swell(problem, bath, [0.01], start=-1.0).x[-1, :, 1].max()

    with pytest.raises(ValueError, match="first derivatives only"):
        jax.grad(jax.grad(height))(-0.3)
    with pytest.raises(ValueError, match=r"inside jax\.jit"):
        jax.jit(height)(-0.3)
    first = jaxgel.swell(problem, -0.3, [0.01], start=-1.0)
    with pytest.raises(ValueError, match="start: a path goes on without derivatives"):
        jax.grad(lambda bath: jaxgel.swell(problem, bath, [0.01, 0.1], start=first).x[-1, 0, 1])(-0.3)
