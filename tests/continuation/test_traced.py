"""Sweeps inside ``jax.jit``, ``jax.vmap`` and derivatives, against the host's sweep.

The states are the same, or nan with a status.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.equilibrium import Status
from jaxgel.mechanics import touches

pytestmark = pytest.mark.thorough

VALUES = np.array([-4.5, -3.0, -2.0, -1.4])
PLATE = jaxgel.Plate(8.0, 8.0, [jaxgel.Ellipse((3.8, 4.1), (3.0, 2.6), 0.3)])
DESIGN = np.array([3.0, 2.6, 1e-3, 0.1])  # semi-axes (mm), Nv, chi
RANDOM = np.random.default_rng(7)


@pytest.fixture(scope="module")
def model():
    return jaxgel.discretise(jaxgel.make_cloud(PLATE, spacing=2.0))


def quantities(problem, values):
    """A number of all states, and their path."""
    path = jaxgel.sweep(problem, values)
    areas = jnp.sum(jaxgel.area_reduction(path) * jnp.arange(1.0, 5.0))
    return areas + path.energy[-1] + jaxgel.core_rotation(path)[1], path


def check_batch(quantity, designs):
    """Values and gradients of a batch by one program beside those of single sweeps by the host."""
    batch = jax.jit(jax.vmap(jax.value_and_grad(quantity, (0, 1), has_aux=True), (0, None)))
    (numbers, paths), (by_design, by_value) = batch(jnp.asarray(designs), jnp.asarray(VALUES))
    single = jax.value_and_grad(quantity, (0, 1), has_aux=True)
    for k, design in enumerate(designs):
        (number, path), slopes = single(jnp.asarray(design), jnp.asarray(VALUES))
        np.testing.assert_allclose(paths.x[k], path.x, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(paths.status[k], path.status)
        np.testing.assert_array_equal(paths.negative_pivots[k], path.negative_pivots)
        np.testing.assert_allclose(numbers[k], number, rtol=1e-10)
        np.testing.assert_allclose(by_design[k], slopes[0], rtol=1e-8)
        np.testing.assert_allclose(
            by_value[k], slopes[1], rtol=1e-8, atol=1e-8 * np.abs(slopes[1]).max()
        )


@pytest.mark.slow
def test_a_batch_of_gels_has_the_states_and_gradients_of_single_sweeps(model):
    """Positions to 1e-9 mm, gradients by Nv, chi and the values of mu to 1e-8."""

    def quantity(gel, values):
        return quantities(
            jaxgel.Problem(model, jaxgel.Gel(Nv=gel[0], chi=gel[1]), contact=False), values
        )

    check_batch(quantity, DESIGN[2:] * RANDOM.uniform(0.9, 1.1, (2, 2)))


@pytest.mark.slow
def test_a_batch_of_designs_has_the_states_and_gradients_of_single_sweeps(model):
    """The same by semi-axes too."""

    def quantity(design, values):
        placed = jaxgel.discretise(model.cloud.at(PLATE.at([{"semi_axes": design[:2]}])))
        return quantities(
            jaxgel.Problem(placed, jaxgel.Gel(Nv=design[2], chi=design[3]), contact=False), values
        )

    check_batch(quantity, DESIGN * RANDOM.uniform(0.95, 1.05, (3, 4)))


@pytest.mark.slow
def test_second_derivatives_in_a_program_are_those_of_the_host(model):
    """Product of the Hessian of the last energy by Nv and chi with a direction, to 1e-7."""

    def energy(gel):
        return jaxgel.sweep(
            jaxgel.Problem(model, jaxgel.Gel(Nv=gel[0], chi=gel[1]), contact=False), VALUES
        ).energy[-1]

    gel, along = jnp.asarray(DESIGN[2:]), jnp.array([1e-4, 0.3])
    by_host = jax.jvp(jax.grad(energy), (gel,), (along,))[1]
    np.testing.assert_allclose(
        jax.jit(lambda gel: jax.jvp(jax.grad(energy), (gel,), (along,))[1])(gel), by_host, rtol=1e-7
    )


@pytest.fixture(scope="module")
def four_circles():
    """Sample 4's plate, coarse: its symmetric pattern buckles between the last two of `VALUES`."""
    plate = jaxgel.sample("sample-4")
    return jaxgel.discretise(jaxgel.make_cloud(plate, spacing=2.2)), plate.gel


def test_a_sheet_that_buckles_is_nan_from_there_on(four_circles):
    """States before are those of the host's sweep; the others of the batch go on."""
    model, gel = four_circles

    def states(last):
        path = jaxgel.sweep(jaxgel.Problem(model, gel), jnp.append(VALUES[:3], last))
        return path.x, path.status, path.energy

    x, status, energy = jax.jit(jax.vmap(states))(jnp.array([-0.9178, -1.4]))
    buckled = jaxgel.sweep(jaxgel.Problem(model, gel), [*VALUES[:3], -0.9178], branch="symmetric")
    assert buckled.negative_pivots.tolist() == [0, 0, 0, 1]
    np.testing.assert_allclose(x[0, :3], buckled.x[:3], rtol=0, atol=1e-9)
    assert status[0].tolist() == [0, 0, 0, Status.LOST_STABILITY]
    assert np.isnan(x[0, 3]).all() and np.isnan(energy[0, 3])
    assert status[1].tolist() == [0, 0, 0, 0] and np.isfinite(x[1]).all()


@pytest.mark.slow
def test_a_hole_that_closes_ends_with_the_status_of_first_touch():
    """Contact acts from there on, which a program has not."""
    values = [-4.5, -3.0, -2.5, -2.0]
    plate = jaxgel.Plate(8.0, 8.0, [jaxgel.Ellipse((4.0, 4.0), (3.0, 1.0))])
    problem = jaxgel.Problem(
        jaxgel.discretise(jaxgel.make_cloud(plate, spacing=1.6)), jaxgel.Gel(Nv=1e-3, chi=0.1)
    )
    path = jax.jit(lambda loads: jaxgel.sweep(problem.replace(loads=loads), values))(problem.loads)
    touched = [bool(touches(x, problem.model)) for x in jaxgel.sweep(problem, values).x]
    assert touched[-1] and not touched[0], touched
    assert [status == Status.SELF_CONTACT for status in path.status] == touched


def test_what_a_program_has_not_is_refused_in_one_line(model, refused):
    problem, adaptive = (
        jaxgel.Problem(model, jaxgel.Gel(Nv=1e-3, chi=0.1)),
        jaxgel.Adaptive(-4.5, -2.0),
    )

    def energy(values, **options):
        return lambda Nv: (
            jaxgel.sweep(
                jaxgel.Problem(model, jaxgel.Gel(Nv=Nv, chi=0.1)), values, **options
            ).energy
        )

    rows = [
        (
            lambda: jax.jit(energy(adaptive))(1e-3),
            "values: Adaptive steps are not available inside jax.jit",
        ),
        (
            lambda: jax.jit(energy(VALUES, branch="symmetric"))(1e-3),
            "branch: 'symmetric' is not available inside jax.jit",
        ),
        (
            lambda: jax.jit(lambda p: jaxgel.sweep(p, VALUES).energy)(problem),
            "problem: is not accepted as an argument of jax.jit",
        ),
    ]
    refused(lambda attempt: attempt(), rows, start=True)
