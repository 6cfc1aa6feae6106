"""Derivatives of whole sweeps against differences of re-solved problems and each other."""

import gc
import inspect
import itertools
import sys
import weakref

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import jaxgel
from jaxgel import IllPosedDerivative
from jaxgel.continuation import ACCURACY, lowest_eigenvalue
from jaxgel.mechanics import all_volumes, volume_ratios

MU = [-3.5, -2.2, -1.5]
# of the value; central differences of states solved to 1e-13 are then good to about 1e-8 and the
# kinks of the weights to 1e-6
STEP = 1e-5


@pytest.fixture(scope="module")
def cloud(tilted_cloud):
    return tilted_cloud


@pytest.fixture(scope="module")
def start(cloud):
    """Semi-axes, centre's shift, tilt, Nv, chi and last mu as a flat vector, and back."""
    gel = cloud.plate.gel
    tree = dict(
        axes=cloud.plate.holes[0].semi_axes,
        shift=jnp.array([0.1, -0.05]),
        tilt=0.02,
        Nv=gel.Nv,
        chi=gel.chi,
        mu=MU[-1],
    )
    return ravel_pytree(jax.tree.map(lambda v: jnp.asarray(v, dtype=float), tree))


@pytest.fixture(scope="module")
def path_at(cloud, start):
    plate, (hole,) = cloud.plate, cloud.plate.holes

    def path_at(vector):
        p = start[1](vector)
        theta = dict(
            semi_axes=p["axes"], centre=hole.centre + p["shift"], angle=hole.angle + p["tilt"]
        )
        model = jaxgel.discretise(cloud.at(plate.at([theta])))
        return jaxgel.sweep(
            jaxgel.Problem(model, jaxgel.Gel(p["Nv"], p["chi"])),
            jnp.stack([jnp.asarray(MU[0]), p["mu"]]),
            eigenvalues=True,
        )

    return path_at


@pytest.fixture(scope="module")
def observables(path_at):
    """Last rotation, last area reduction and a sum over the whole curve, (3,)."""

    def observables(vector):
        path = path_at(vector)
        return jnp.stack(
            [
                jaxgel.rotation_angle(path)[-1],
                jaxgel.area_reduction(path)[-1],
                jnp.sum(jaxgel.core_rotation(path) ** 2),
            ]
        )

    return observables


@pytest.fixture(scope="module")
def jacobian(observables, start):
    values, pullback = jax.vjp(observables, start[0])
    return np.stack([pullback(row)[0] for row in np.eye(len(values))])


@pytest.mark.smoke
@pytest.mark.parametrize("seed", [0, 1])
def test_gradients_are_those_of_the_resolved_problem(seed, observables, start, jacobian):
    """Along a direction of all parameters: semi-axes, centre, tilt, Nv, chi, the last mu."""
    vector = np.asarray(start[0])
    step = (
        STEP
        * np.maximum(np.abs(vector), 0.03)
        * np.random.default_rng(seed).normal(size=len(vector))
    )
    difference = (
        np.asarray(observables(vector + step)) - np.asarray(observables(vector - step))
    ) / 2
    # of the terms, where they cancel
    scale = np.abs(difference) + 1e-2 * np.abs(jacobian) @ np.abs(step)
    np.testing.assert_array_less(np.abs(jacobian @ step - difference), 1e-6 * scale)


def test_a_plate_that_is_no_longer_in_use_leaves_the_memory(cloud, start):
    """With its lists and factors; JAX remembers the parameters of primitives that it has traced."""
    plate, (hole,) = cloud.plate, cloud.plate.holes

    def lists_of_own_cloud():
        own, kept = jaxgel.make_cloud(plate, spacing=cloud.spacing), []

        def turned(axes):
            model = jaxgel.discretise(own.at(plate.at([{"semi_axes": axes}])))
            kept.append(weakref.ref(model.lists))
            path = jaxgel.sweep(jaxgel.Problem(model, plate.gel), [MU[0], MU[-1]], eigenvalues=True)
            return jaxgel.rotation_angle(path)[-1]

        assert np.isfinite(jax.grad(turned)(jnp.asarray(hole.semi_axes))).all()
        return weakref.ref(own.topology), *kept

    kept = [*lists_of_own_cloud(), *lists_of_own_cloud()]  # of the first JAX may remember nothing
    gc.collect()
    assert [ref() for ref in kept] == [None] * 4


@pytest.mark.slow
def test_forward_equals_reverse(observables, start, jacobian):
    direction = np.random.default_rng(0).normal(size=len(start[0])) * np.abs(start[0])
    _, forward = jax.jvp(observables, (start[0],), (direction,))
    # of the terms, which nearly cancel in the third observable
    scale = np.abs(jacobian) @ np.abs(direction)
    np.testing.assert_array_less(np.abs(forward - jacobian @ direction), 1e-10 * scale)


@pytest.mark.slow
def test_the_lowest_eigenvalue_has_the_derivative_of_differences(cloud):
    model = jaxgel.discretise(cloud)

    def lowest(chi):
        return lowest_eigenvalue(
            jaxgel.sweep(jaxgel.Problem(model, jaxgel.Gel(1e-3, chi), contact=False), MU[-1:])
        )[-1]

    difference = (lowest(0.1 + 1e-4) - lowest(0.1 - 1e-4)) / 2e-4
    np.testing.assert_allclose(jax.grad(lowest)(0.1), difference, rtol=1e-6)


@pytest.mark.slow
def test_the_lowest_eigenvalue_has_first_derivatives(path_at, start):
    """Along one direction, with a longer step, against kinks of the weights.

    The tangent has these, but is known to 1e-10 of the network's only.
    """

    def lowest(vector):
        return lowest_eigenvalue(path_at(vector))[-1]

    vector = np.asarray(start[0])
    direction, step = np.random.default_rng(0).normal(size=len(vector)) * np.abs(vector), 1e-4
    gradient = np.asarray(jax.grad(lowest)(start[0]))
    difference = (lowest(vector + step * direction) - lowest(vector - step * direction)) / (
        2 * step
    )
    np.testing.assert_allclose(gradient @ direction, difference, rtol=1e-6)
    value, forward = jax.jvp(lowest, (start[0],), (direction,))
    np.testing.assert_allclose(forward, gradient @ direction, rtol=1e-10)
    # 7e-3 after a step of 1.3 in mu
    np.testing.assert_allclose(value, path_at(vector).lowest_eigenvalue[-1], rtol=10 * ACCURACY)
    with pytest.raises(ValueError, match="has first derivatives only"):
        jax.jvp(jax.grad(lowest), (start[0],), (direction,))


@pytest.mark.slow
def test_second_derivatives_by_the_gel_are_differences_of_gradients(cloud):
    """By chi; all three gradients come from one program."""
    model = jaxgel.discretise(cloud)

    def gradient(chi):
        return jax.grad(
            lambda chi: jaxgel.area_reduction(
                jaxgel.sweep(jaxgel.Problem(model, jaxgel.Gel(1e-3, chi), contact=False), MU)
            )[-1]
        )(chi)

    def along(chi):
        return jax.jvp(gradient, (chi,), (1.0,))

    difference = (along(0.1 + 1e-4)[0] - along(0.1 - 1e-4)[0]) / 2e-4
    np.testing.assert_allclose(along(0.1)[1], difference, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("basis", ["linear", "quadratic"])
def test_second_derivatives_are_differences_of_gradients(cloud, basis):
    """Area reduction and midline rotation by the first semi-axis, Nv and chi.

    The extrema of the midline move along the line. The gradient is smooth but where a node enters a
    support, hence the short step. All three gradients come from one program.
    """

    def gradient(v):
        def reading(v):
            model = jaxgel.discretise(
                cloud.at(cloud.plate.at([dict(semi_axes=jnp.stack([v[0], 1.6]))])), basis=basis
            )
            path = jaxgel.sweep(
                jaxgel.Problem(model, jaxgel.Gel(v[1], v[2]), contact=False), [-3.0, -1.8]
            )
            # of like slopes
            return jaxgel.area_reduction(path)[-1] + 0.1 * jaxgel.rotation_angle(path)[-1]

        return jax.grad(reading)(v)

    at, direction, step = jnp.array([2.4, 1e-3, 1e-4]), jnp.array([1.0, 1e-3, 0.1]), 1e-4

    def along(s):
        return jax.jvp(gradient, (at + s * direction,), (direction,))

    difference = (along(step)[0] - along(-step)[0]) / (2 * step)
    np.testing.assert_allclose(along(0.0)[1], difference, rtol=1e-5)


@pytest.fixture
def last_energy(cloud):
    """Function of the last of two mu: the energy there.

    The solvent that the gel holds and its pressures.
    """
    model = jaxgel.discretise(cloud)

    def last(mu):
        path = jaxgel.sweep(
            jaxgel.Problem(model, cloud.plate.gel), jnp.stack([jnp.asarray(-2.5), mu])
        )
        solvent = jnp.where(
            model.carries, all_volumes(model) * (volume_ratios(path.x[-1], model) - 1), 0.0
        )
        return path.energy[-1], (jnp.sum(solvent), path.pressure[-1])

    return last


@pytest.mark.slow
def test_energy_falls_by_the_solvent_that_the_gel_holds(last_energy):
    slope, (solvent, _) = jax.grad(last_energy, has_aux=True)(jnp.asarray(-2.0))
    np.testing.assert_allclose(slope, -solvent, rtol=1e-10)


@pytest.mark.slow
def test_pressures_have_derivatives(last_energy):
    def pressure(mu):
        return last_energy(mu)[1][1]

    mu, step = jnp.asarray(-2.0), 1e-4
    difference = (pressure(mu + step) - pressure(mu - step)) / (2 * step)
    np.testing.assert_allclose(
        jax.jvp(pressure, (mu,), (1.0,))[1], difference, atol=1e-6 * np.abs(difference).max()
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "along",
    [lambda f, mu: jax.jvp(f, (mu,), (1.0,))[1], lambda f, mu: jax.grad(f)(mu)],
    ids=["forward", "reverse"],
)
def test_the_energy_has_second_derivatives(along, last_energy):
    slope, mu, step = jax.grad(lambda mu: last_energy(mu)[0]), jnp.asarray(-2.0), 1e-4
    np.testing.assert_allclose(
        along(slope, mu), (slope(mu + step) - slope(mu - step)) / (2 * step), rtol=1e-6
    )


@pytest.mark.thorough
def test_chosen_steps_have_the_derivative_of_given_ones(cloud):
    model = jaxgel.discretise(cloud)

    def path(mu, chi=1e-4):
        return jaxgel.sweep(jaxgel.Problem(model, jaxgel.Gel(1e-3, chi), contact=False), mu)

    def last_area(mu):
        return jax.value_and_grad(lambda chi: jaxgel.area_reduction(path(mu, chi))[-1])(1e-4)

    ends = MU[0], MU[-1]
    given = np.linspace(*ends, len(path(ends)))  # as many, for one program serves both
    np.testing.assert_allclose(last_area(ends), last_area(given), rtol=1e-9)


@pytest.mark.slow
def test_a_sweep_inside_vmap_alone_is_that_of_every_gel(tiny_model):
    """Without ``jax.jit``; programs are compared in tests/continuation/test_traced.py."""

    def height(chi):
        return jaxgel.sweep(jaxgel.Problem(tiny_model, jaxgel.Gel(1e-3, chi)), [-2.0]).x[0].max()

    chi = jnp.array([1e-4, 0.2])
    np.testing.assert_allclose(jax.vmap(height)(chi), [height(value) for value in chi], rtol=1e-10)


@pytest.mark.slow
def test_rows_and_columns_of_a_jacobian_are_solved_together(tiny_model):

    def heights(v):
        return jnp.sum(
            jaxgel.sweep(jaxgel.Problem(tiny_model, jaxgel.Gel(v[0], v[1])), [-2.0, -1.5]).x[
                ..., 1
            ],
            axis=1,
        )

    at = jnp.array([1e-3, 1e-4])
    rows, columns = jax.jacrev(heights)(at), jax.jacfwd(heights)(at)
    np.testing.assert_allclose(rows, columns, rtol=1e-10)
    assert np.all(rows != 0)


@pytest.mark.thorough
def test_a_stopped_gradient_is_noticed(observables, start, jacobian, monkeypatch):
    """This file's check is sensitive: a fixed contour gives another shape gradient.

    It pretends not to move with the nodes.
    """
    from jaxgel.discretisation import consistency

    correct = consistency._consistent

    def stopped(*args, **options):
        given = inspect.signature(correct).bind(*args, **options)
        given.arguments["trace"] = jax.lax.stop_gradient(given.arguments["trace"])
        return correct(*given.args, **given.kwargs)

    monkeypatch.setattr(consistency, "_consistent", stopped)
    gradient = jax.vjp(observables, start[0])[1](jnp.array([0.0, 0.0, 1.0]))[0]
    assert np.abs(gradient - jacobian[2]).max() > 1e-6 * np.abs(jacobian[2]).max()


@pytest.mark.thorough
def test_states_out_of_reach_are_nan_and_say_so(cloud):
    model = jaxgel.discretise(cloud)

    def sweep(chi):
        problem, steps = (
            jaxgel.Problem(model, jaxgel.Gel(1e-3, chi), contact=False),
            jaxgel.StepControl(max_cuts=2),
        )
        path = jaxgel.sweep(problem, [MU[0], 9.0], branch="symmetric", steps=steps)
        return path.x[-1, 0, 0], (path.x, path.status)

    with pytest.warns(IllPosedDerivative, match=r"^sweep: ill-posed derivative at mu = 9: "):
        (_, (x, status)), _ = jax.value_and_grad(sweep, has_aux=True)(1e-4)
    reached = np.asarray(status) == jaxgel.Status.CONVERGED
    assert reached[0] and not reached[-1]
    assert np.all(np.isnan(x[~reached])) and np.all(np.isfinite(x[reached]))


@pytest.fixture(scope="module")
def critical(buckling_point):
    """Where the symmetric state of the coarse sample 4 buckles.

    At 0.3 kT below, its lowest eigenvalue is 0.02.
    """
    return float(buckling_point.mu)


@pytest.mark.slow
def test_derivatives_next_to_a_bifurcation_are_flagged(buckling_model, critical):
    gel = buckling_model.cloud.plate.gel

    def core_rotation(chi):
        path = jaxgel.sweep(
            jaxgel.Problem(buckling_model, jaxgel.Gel(gel.Nv, chi)),
            [-3.0, critical - 0.3, critical - 1e-5],
            branch="symmetric",
        )
        return jaxgel.core_rotation(path)[-1], (path.derivative, path.ok)

    with pytest.warns(IllPosedDerivative, match=r"a fold or bifurcation is near"):
        derivative, ok = jax.grad(core_rotation, has_aux=True)(gel.chi)[1]
    assert ok.all()  # each of them satisfies equilibrium
    assert derivative.tolist() == [
        jaxgel.Status.CONVERGED,
        jaxgel.Status.CONVERGED,
        jaxgel.Status.NEARLY_SINGULAR,
    ]


@pytest.mark.thorough
def test_derivatives_of_overlapping_holes_are_flagged(cloud, monkeypatch):
    model, found = jaxgel.discretise(cloud), itertools.cycle([False, False, True])
    monkeypatch.setattr(sys.modules["jaxgel.continuation.path"], "overlaps", lambda *_: next(found))

    def area(chi):
        path = jaxgel.sweep(jaxgel.Problem(model, jaxgel.Gel(1e-3, chi), contact=False), MU)
        return jaxgel.area_reduction(path)[-1], path.derivative

    with pytest.warns(IllPosedDerivative, match=r"hole boundaries touch or overlap"):
        status = jax.grad(area, has_aux=True)(1e-4)[1]
    assert status.tolist() == [
        jaxgel.Status.CONVERGED,
        jaxgel.Status.CONVERGED,
        jaxgel.Status.SELF_CONTACT,
    ]
