"""Derivatives of swelling in time, by difference quotients of the runs themselves."""

import gc

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.transient.derivatives import March

pytestmark = pytest.mark.thorough

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


def plate(x=0.02, axes=(0.3, 0.2), angle=0.2, axial=1.02, *, width=1.0):
    """A plate with a hole."""
    holes = [jaxgel.Ellipse((x, 0.0), axes, angle)]
    return jaxgel.Plate(
        width, 1.0, holes, edges={"top": "free"}, axial_stretch=axial, kinematics=KINEMATICS
    )


def swelling(cloud, values, times=TIMES, start=None):
    """Path of the plate of a cloud, of all that it depends on."""
    D, Nv, chi, slope, axial, first, bath, ramp, traction, x, *ellipse = values
    width = cloud.plate.width
    model = jaxgel.discretise(
        cloud.at(plate(x, tuple(ellipse[:2]), ellipse[2], axial, width=width))
    )
    gel = jaxgel.Gel(jaxgel.WithHoles(lambda X: Nv * (1 + slope * X[0])), chi)
    loads = jaxgel.load_vector(model, traction={"top": jnp.stack([0.0, traction])})
    problem = jaxgel.Problem(model, gel, loads=loads, contact=False)
    baths = {0: jaxgel.Bath([-0.9, bath], times=[0.0, ramp]), "top": jaxgel.Bath(0.9 * bath)}
    return jaxgel.swell(problem, baths, times, start=first if start is None else start, D=D)


@jax.jit
def number(x, energy, pressure, supplied, potential):
    """One number of the arrays of a path; every part is in it."""
    weights = jnp.linspace(1.0, 2.0, len(x))
    parts = x[..., 0].mean(axis=1), x[..., 1].std(axis=1), energy, 10 * pressure.mean(axis=1)
    return sum(weights @ part for part in parts) + weights @ (
        supplied @ jnp.array([1.0, -0.5]) + 0.1 * potential.mean(axis=1)
    )


def quantity_of(cloud, times):
    def quantity(values):
        path = swelling(cloud, values, times)
        return number(path.x, path.energy, path.pressure, path.supplied, path.potential)

    return quantity


@pytest.fixture(scope="module")
def cloud():
    """40 nodes."""
    return jaxgel.make_cloud(plate(), spacing=0.2, nodes_per_hole=8)


def changed(numbers, values):
    """`VALUES` with other values in some places."""
    given = list(VALUES)
    for number, value in zip(numbers, values, strict=True):
        given[number] = value
    return given


def quotient(function, direction, h=2e-4):
    """Central difference quotient of fourth order."""
    slopes = [
        (function(VALUES + s * direction) - function(VALUES - s * direction)) / (2 * s)
        for s in (h, h / 2)
    ]
    return float(4 * slopes[1] - slopes[0]) / 3


def forward(function, direction):
    """Derivative along a direction in forward mode, by the values that it changes."""
    moving = np.flatnonzero(direction)
    return float(
        jax.jvp(
            lambda values: function(changed(moving, values)),
            (list(VALUES[moving]),),
            (list(direction[moving]),),
        )[1]
    )


def test_gradients_by_gel_and_bath_are_difference_quotients(cloud):
    """Along a direction that changes all of them, before and after the end of a ramp.

    The states of the run do not stay in memory.
    """
    quantity = quantity_of(cloud, [0.01, 0.2])
    some = [
        list(FAMILIES).index(name)
        for name in ("diffusivity", "network", "mixing", "start", "bath", "ramp")
    ]
    gradient = np.zeros(len(VALUES))
    gradient[some] = jax.grad(lambda values: quantity(changed(some, values)))(list(VALUES[some]))
    assert np.isfinite(gradient).all() and (np.abs(gradient[some]) > 0).all()
    gc.collect()
    assert not any(isinstance(one, March) for one in gc.get_objects())
    direction = VALUES * np.random.default_rng(0).uniform(0.5, 1.0, len(VALUES)) * (gradient != 0)
    assert float(gradient @ direction) == pytest.approx(quotient(quantity, direction), rel=1e-6)


@pytest.mark.slow
def test_gradients_by_all_that_a_run_depends_on_are_difference_quotients(cloud):
    """Along a direction that changes everything, before and after the end of a ramp."""
    quantity = quantity_of(cloud, [0.01, 0.2])
    gradient = np.array(jax.grad(quantity)(list(VALUES)))
    assert np.isfinite(gradient).all() and (np.abs(gradient) > 0).all()
    direction = VALUES * np.random.default_rng(0).uniform(0.5, 1.0, len(VALUES))
    assert float(gradient @ direction) == pytest.approx(quotient(quantity, direction), rel=1e-6)


@pytest.fixture(scope="module")
def fine():
    """One number of a swelling in five steps and more on 52 nodes, and its gradient."""
    quantity = quantity_of(
        jaxgel.make_cloud(plate(width=1.2), spacing=0.25, nodes_per_hole=12), TIMES
    )
    return quantity, np.array(jax.grad(quantity)(list(VALUES)))


@pytest.mark.slow
def test_forward_and_reverse_mode_agree_by_all_values(fine):
    quantity, gradient = fine
    direction = VALUES * np.random.default_rng(1).uniform(0.5, 1.0, len(VALUES))
    assert forward(quantity, direction) == pytest.approx(float(gradient @ direction), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(FAMILIES)), ids=list(FAMILIES))
def test_the_derivative_by_each_family_is_a_difference_quotient(fine, number):
    """And leaves a remainder of second order.

    Where a hole moves, points enter supports, and there slopes jump: by 5e-5 of themselves at 8e-4
    along a semi-axis, by more from -3e-3 on. The steps of holes lie between.
    """
    quantity, gradient = fine
    direction = np.where(np.arange(len(VALUES)) == number, VALUES, 0.0)
    assert float(gradient @ direction) == pytest.approx(
        quotient(quantity, direction), rel=1e-6, abs=1e-9
    )
    value = quantity(VALUES)
    steps = (-0.0025, -0.00125) if list(FAMILIES)[number].startswith("hole") else (0.01, 0.005)
    change = [
        quantity(VALUES + h * direction) - value - h * float(gradient @ direction) for h in steps
    ]
    assert abs(change[1]) < 1e-9 or np.log2(abs(change[0] / change[1])) > 1.95


@pytest.mark.slow
def test_a_run_that_starts_from_the_end_of_another_has_the_derivative_of_both():
    """By the bath of the first one, through the state between them."""
    model = jaxgel.discretise(
        jaxgel.make_cloud(jaxgel.Plate(0.4, 1.0, edges={"top": "free"}), spacing=0.2)
    )
    problem = jaxgel.Problem(model, jaxgel.Gel(1e-3, 0.1), contact=False)

    def thickness(bath):
        first = jaxgel.swell(problem, bath, [0.01, 0.1], start=-1.0)
        return jaxgel.swell(problem, -0.5, [0.01, 0.1], start=first[-1]).x[-1, :, 1].max()

    h = 1e-4
    slope = (thickness(-0.3 + h) - thickness(-0.3 - h)) / (2 * h)
    assert float(jax.grad(thickness)(-0.3)) == pytest.approx(float(slope), rel=1e-6)


def test_second_derivatives_and_compiled_runs_are_refused(cloud):
    def height(bath, start=None):
        return swelling(cloud, [*VALUES[:6], bath, *VALUES[7:]], [0.01], start).x[-1, 0, 1]

    with pytest.raises(ValueError, match="first derivatives only"):
        jax.grad(jax.grad(height))(-0.3)
    with pytest.raises(ValueError, match=r"inside jax\.jit"):
        jax.jit(height)(-0.3)
    first = swelling(cloud, VALUES, [0.01])
    with pytest.raises(ValueError, match="start: a path goes on without derivatives"):
        jax.grad(height)(-0.3, first)
