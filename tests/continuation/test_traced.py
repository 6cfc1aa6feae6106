"""Sweeps inside ``jax.jit``, ``jax.vmap`` and derivatives, against the host's sweep.

The states are the same, or nan with a status.
"""

import dataclasses

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
    """Positions to 1e-9 mm, gradients by Nv, chi and the values of mu to 1e-8.

    The last gel is in a poor solvent, for which alone a phase is searched.
    """

    def quantity(gel, values):
        problem = jaxgel.Problem(model, jaxgel.Gel(Nv=gel[0], chi=gel[1]), contact=False)
        number, path = quantities(problem, values)
        return number + jaxgel.observables.surface_ratio(path)[-1], path

    gels = DESIGN[2:] * RANDOM.uniform(0.9, 1.1, (2, 2))
    check_batch(quantity, [*gels, [1e-3, 0.8]])


@pytest.fixture(scope="module", params=["sample-1", "sample-4", "film"])
def symmetric(request):
    """Models of plates with the symmetries C4 and D4, and of a film with D4."""
    if request.param == "film":
        holes = [jaxgel.Circle((x, y), 0.7) for x in (-1, 1) for y in (-1, 1)]
        plate, spacing = jaxgel.Plate(4.0, 4.0, holes, kinematics="plane stress"), 0.5
    else:
        plate, spacing = jaxgel.sample(request.param), 2.2
    return jaxgel.discretise(jaxgel.make_cloud(plate, spacing=spacing))


@pytest.mark.slow
def test_a_batch_of_symmetric_sheets_has_the_states_and_gradients_of_single_sweeps(symmetric):
    """Each program solves a part of the plate; quantities and their cotangents are of all of it."""
    weights = jnp.asarray(RANDOM.normal(size=(symmetric.n_nodes, 2)))

    def quantity(gel, values):
        path = jaxgel.sweep(
            jaxgel.Problem(symmetric, jaxgel.Gel(Nv=gel[0], chi=gel[1]), contact=False), values
        )
        assert set(path.symmetry) in ({"C4"}, {"D4"})
        return jnp.sum(path.x[1:] * weights) + path.energy[-1] + path.pressure[2, 1], path

    check_batch(quantity, DESIGN[2:] * RANDOM.uniform(0.9, 1.1, (2, 2)))


@pytest.mark.slow
def test_derivatives_by_loads_that_break_the_symmetry_are_those_of_the_whole_plate(four_circles):
    """Gradient of a displacement of the last state by all nodal forces, under ``jax.vmap``."""
    model, gel = four_circles
    along = RANDOM.normal(size=(model.n_nodes, 2))

    def gradient(Nv, symmetry):
        def moved(loads):
            own = dataclasses.replace(gel, Nv=Nv)
            problem = jaxgel.Problem(model, own, loads=loads, contact=False)
            path = jaxgel.sweep(problem, VALUES[:3], symmetry=symmetry)
            used.update(path.symmetry)
            return jnp.sum(path.x[-1] * along)

        return jax.grad(moved)(jnp.zeros((model.n_nodes, 2)))

    used = set()
    found = jax.vmap(lambda Nv: gradient(Nv, "auto"))(jnp.array([1e-3, 2e-3]))
    assert used == {"D4"}
    for k, Nv in enumerate((1e-3, 2e-3)):
        expected = gradient(Nv, "off")
        np.testing.assert_allclose(found[k], expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.slow
def test_sheets_said_to_be_symmetric_are_solved_on_a_region_and_nan_if_they_are_not(four_circles):
    """By radii, along all of which they are differentiated, as along those that break it."""
    model, gel = four_circles
    plate = model.cloud.plate

    def quantity(radii, values):
        placed = jaxgel.discretise(model.cloud.at(plate.at([{"radius": r} for r in radii])))
        path = jaxgel.sweep(jaxgel.Problem(placed, gel, contact=False), values, symmetry="D4")
        assert set(path.symmetry) == {"D4"}
        return jnp.sum(jaxgel.area_reduction(path)) + path.energy[1] + path.pressure[2, 1], path

    radius = plate.holes[0].theta["radius"]
    check_batch(quantity, radius * np.array([[1.0] * 4, [1.02] * 4]))
    one_larger = radius * jnp.array([[1.02, 1.0, 1.0, 1.0]])
    _, path = jax.jit(jax.vmap(lambda radii: quantity(radii, jnp.asarray(VALUES))))(one_larger)
    assert set(path.status[0].tolist()) == {Status.ASYMMETRIC} and np.isnan(path.x).all()


def test_a_group_that_a_problem_lacks_is_refused(model, four_circles):
    """Also in a program, if the cloud lacks it; part of the plate's own group is accepted."""
    circles, own = four_circles
    path = jaxgel.sweep(jaxgel.Problem(circles, own), VALUES[:1], symmetry="C4")
    assert path.symmetry == ("C4",)
    gel = jaxgel.Gel(Nv=1e-3, chi=0.1)
    problem = jaxgel.Problem(model, gel, loads=np.ones((model.n_nodes, 2)))
    with pytest.raises(ValueError, match=r"symmetry: 'C4' is not accepted, plate, gel.* have C1"):
        jaxgel.sweep(problem, VALUES[:1], symmetry="C4")
    with pytest.raises(ValueError, match=r"symmetry: 'C4' is not accepted, plate, gel.* have C1"):
        jax.eval_shape(
            lambda loads: jaxgel.sweep(problem.replace(loads=loads), VALUES[:1], symmetry="C4").x,
            problem.loads,
        )
    with pytest.raises(ValueError, match="symmetry: 'C3' is not one of auto, off, C2, C4"):
        jaxgel.sweep(problem, VALUES[:1], symmetry="C3")


def test_a_program_uses_the_symmetries_that_are_known_when_it_is_made(model, four_circles):
    """Of the gel nothing need be known; places and loads must be."""
    circles, gel = four_circles
    cloud, plate = circles.cloud, circles.cloud.plate
    turned = np.ones((circles.n_nodes, 2))

    def symmetry(own, changed, **options):
        def sheet(number):
            placed, loads, Nv = changed(number)
            problem = jaxgel.Problem(placed, dataclasses.replace(own, Nv=Nv), loads=loads)
            return jaxgel.sweep(problem, VALUES[:2], **options)

        return set(jax.eval_shape(sheet, 1e-3).symmetry)

    assert symmetry(gel, lambda Nv: (circles, None, Nv)) == {"D4"}
    assert symmetry(gel, lambda Nv: (circles, None, Nv), symmetry="off") == {"C1"}
    assert symmetry(gel, lambda Nv: (model, None, Nv)) == {"C1"}
    assert symmetry(gel, lambda force: (circles, force * turned, 1e-3)) == {"C1"}
    moved = lambda radius: jaxgel.discretise(cloud.at(plate.at([{"radius": radius}] * 4)))  # noqa: E731
    assert symmetry(gel, lambda radius: (moved(1e3 * radius), None, 1e-3)) == {"C1"}


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
    assert set(buckled.symmetry) == {"D4"}  # of the program too


@pytest.mark.slow
def test_a_symmetric_sheet_buckles_at_the_state_at_which_the_whole_one_does(four_circles):
    """A program that solves an eighth of the plate looks at all modes."""
    model, gel = four_circles

    def states(symmetry):
        def path(Nv):
            own = dataclasses.replace(gel, Nv=Nv)
            return jaxgel.sweep(jaxgel.Problem(model, own), values, symmetry=symmetry)

        return jax.jit(jax.vmap(path))(jnp.array([1e-3, 2e-3]))

    values = np.linspace(-1.6, -0.9178, 12)
    part, whole = states("auto"), states("off")
    assert (part.symmetry[0], whole.symmetry[0]) == ("D4", "C1")
    np.testing.assert_array_equal(part.status, whole.status)
    np.testing.assert_array_equal(np.isnan(part.x), np.isnan(whole.x))
    np.testing.assert_allclose(part.x, whole.x, rtol=0, atol=1e-9)
    assert all(0 < (row == Status.LOST_STABILITY).sum() < 12 for row in part.status), part.status


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
