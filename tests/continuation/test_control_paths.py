"""Sweeps along any control, up and down, against plain sweeps, held plates, differences."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.controls import Driven, Load, Setting, Stretch, chi
from jaxgel.equilibrium import Status

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def model(tiny_model):
    return tiny_model


def _held(model, **edges):
    """The plate of a model with other values of its edges."""
    return jaxgel.discretise(jaxgel.make_cloud(dataclasses.replace(model.cloud.plate, **edges)))


GEL = jaxgel.Gel(1e-3, 0.1)


def test_states_along_chi_are_those_of_gels_with_that_chi_up_and_down(model):
    """Bulk stiffness times round-off of the volume ratio leaves 1e-12 mm."""
    path = jaxgel.sweep(
        jaxgel.Problem(model, GEL, control=chi(mu=-0.5)),
        [0.1, 0.3, 0.4, 0.3, 0.1],
        eigenvalues=True,
    )
    assert path.stop.ok
    np.testing.assert_array_equal(path.value, [0.1, 0.3, 0.4, 0.3, 0.1])
    np.testing.assert_array_equal(path.mu, np.full(5, -0.5))
    # of the issue of hysteresis: there is none
    np.testing.assert_allclose(path.x[:2], path.x[:2:-1], atol=1e-9)
    for k, number in enumerate(path.value[:3]):
        plain = jaxgel.sweep(
            jaxgel.Problem(model, dataclasses.replace(GEL, chi=float(number))),
            [-2.0, -0.5],
            eigenvalues=True,
        )
        np.testing.assert_allclose(path.x[k], plain.x[-1], atol=1e-10)
        assert path.energy[k] == pytest.approx(plain.energy[-1], rel=1e-10)
        assert path.lowest_eigenvalue[k] == pytest.approx(plain.lowest_eigenvalue[-1], rel=2e-3)
    assert repr(path) == (
        f"Path of 5 states of {model.n_nodes} nodes, chi = 0.1000 ... 0.1000, 0 unstable: converged"
    )


def test_mu_may_fall(model):
    up = jaxgel.sweep(jaxgel.Problem(model, GEL), [-3.0, -1.0, -0.5])
    down = jaxgel.sweep(jaxgel.Problem(model, GEL), [-0.5, -1.0, -3.0], start=up[1])
    np.testing.assert_allclose(down.x, up.x[::-1], atol=1e-9)


@pytest.mark.slow
def test_adaptive_steps_go_to_every_turning_point_and_back(model):
    path = jaxgel.sweep(jaxgel.Problem(model, GEL), jaxgel.Adaptive(-3.0, -0.5, -2.0))
    turn = int(np.argmax(path.mu))
    assert (path.mu[0], path.mu[turn], path.mu[-1]) == (-3.0, -0.5, -2.0)
    assert np.all(np.diff(path.mu[: turn + 1]) > 0)
    assert np.all(np.diff(path.mu[turn:]) < 0)
    assert len(path) - turn > 2  # the way back has steps of its own
    back = np.interp(
        path.mu[turn + 1], path.mu[: turn + 1], jaxgel.area_reduction(path)[: turn + 1]
    )
    # linear between states
    assert jaxgel.area_reduction(path)[turn + 1] == pytest.approx(back, abs=2e-2)


@pytest.mark.slow
def test_a_stretched_plate_is_that_whose_edges_are_held_stretched(model):
    path = jaxgel.sweep(jaxgel.Problem(model, GEL, control=Stretch("x", mu=-1.0)), [1.0, 1.1, 1.0])
    held = jaxgel.sweep(
        jaxgel.Problem(_held(model, deformation=((1.1, 0.0), (0.0, 1.0))), GEL), [-3.0, -1.0]
    )
    np.testing.assert_allclose(path.x[1], held.x[-1], atol=1e-10)
    np.testing.assert_allclose(path.x[0], path.x[2], atol=1e-10)


def test_a_load_is_that_of_the_same_nodal_forces(model):
    loads = np.zeros((model.n_nodes, 2))
    loads[np.asarray(model.cloud.nodes)[:, 1] > 1.99, 1] = -1e-4
    path = jaxgel.sweep(jaxgel.Problem(model, GEL, control=Load(loads, mu=-1.0)), [0.0, 2.0])
    for k, factor in enumerate(path.value):
        plain = jaxgel.sweep(jaxgel.Problem(model, GEL, loads=factor * loads), [-2.0, -1.0])
        np.testing.assert_allclose(path.x[k], plain.x[-1], atol=1e-10)


def _drawn(value, gel, rate):
    """A softer gel that is drawn out while it swells."""
    own = dataclasses.replace(gel, Nv=gel.Nv * (1 - 0.2 * value), chi=gel.chi + 0.1 * value)
    return Setting(
        -1.0 + rate * value, own, displacement={"right": jnp.stack([0.3 * value, 0.0 * value])}
    )


@pytest.mark.slow
def test_an_own_path_sets_mu_gel_and_edges_together(model):
    path = jaxgel.sweep(
        jaxgel.Problem(model, GEL, control=Driven(_drawn, (0.5,), name="draw")), [0.0, 1.0]
    )
    there = jaxgel.sweep(
        jaxgel.Problem(_held(model, displacement={"right": (0.3, 0.0)}), jaxgel.Gel(0.8e-3, 0.2)),
        [-2.0, -0.5],
    )
    assert path.mu[1] == -0.5
    np.testing.assert_allclose(path.x[1], there.x[-1], atol=1e-10)
    assert path.energy[1] == pytest.approx(there.energy[-1], rel=1e-10)
    stress = jaxgel.cauchy_stress(path)[1]
    np.testing.assert_allclose(stress, jaxgel.cauchy_stress(there)[-1], atol=1e-12)


# --- derivatives ----------------------------------------------------------------------------------


def _of_chi(model, v):
    """A number of states along chi by the gel's Nv, the control's mu and its two values."""
    path = jaxgel.sweep(jaxgel.Problem(model, jaxgel.Gel(v[0], 0.1), control=chi(mu=v[1])), v[2:])
    return jnp.sum(jaxgel.area_reduction(path) * jnp.array([1.0, 2.0])) + 1e-3 * jnp.sum(
        path.energy
    )


def _of_stretch(model, v):
    """The same by a hole's radius, mu and the stretches of edges along which nodes slide."""
    own = jaxgel.discretise(model.cloud.at(model.cloud.plate.at([{"radius": v[0]}])))
    path = jaxgel.sweep(jaxgel.Problem(own, GEL, control=Stretch("x", mu=v[1])), v[2:])
    return jnp.sum(jaxgel.area_reduction(path)) + jnp.sum(path.x[-1] ** 2) + 10 * path.energy[0]


def _of_path(model, v):
    """The same by the parameter of an own path, a value of it and the gel's chi."""
    path = jaxgel.sweep(
        jaxgel.Problem(model, jaxgel.Gel(1e-3, v[2]), control=Driven(_drawn, (v[0],), name="draw")),
        v[1:2],
    )
    return (
        jnp.sum(jaxgel.area_reduction(path))
        + jnp.sum(jnp.sin(path.x))
        + jnp.sum(path.mu)
        + 1e4 * jnp.mean(jaxgel.cauchy_stress(path))
    )


def _of_load(model, v):
    """The same by the factor of loads that themselves depend on a number."""
    loads = v[1] * jnp.where(model.cloud.nodes[:, 1:] > 1.99, jnp.array([0.0, -1.0]), 0.0)
    path = jaxgel.sweep(jaxgel.Problem(model, GEL, control=Load(loads, mu=-1.0)), v[:1])
    return jnp.sum(path.x**2) + path.energy[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("function", "at", "steps"),
    [
        pytest.param(
            _of_chi,
            [1e-3, -0.5, 0.1, 0.3],
            [1e-7, 1e-4, 1e-4, 1e-4],
            id="chi",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            _of_stretch,
            [1.1, -1.0, 1.05, 1.1],
            [1e-5, 1e-4, 1e-4, 1e-4],
            id="stretch",
            marks=pytest.mark.slow,
        ),
        pytest.param(_of_path, [0.5, 0.7, 0.1], [1e-4, 1e-4, 1e-4], id="own path"),
        pytest.param(_of_load, [2.0, 1e-4], [1e-3, 1e-7], id="load", marks=pytest.mark.slow),
    ],
)
def test_derivatives_are_differences_of_sweeps(model, function, at, steps):
    """Along two directions of all numbers.

    Central differences leave their own error, of second order in steps of 1e-4, and round-off.
    """
    of, at, directions = (
        functools.partial(function, model),
        jnp.asarray(at),
        np.random.default_rng(0).uniform(0.3, 1.0, (2, len(steps))),
    )
    backward = jax.grad(of)(at)
    for step in directions * [steps, np.multiply(steps, (-1.0) ** np.arange(len(steps)))]:
        terms = np.abs(backward) @ np.abs(step)
        assert float(backward @ step) == pytest.approx(
            float(of(at + step) - of(at - step)) / 2, abs=2e-6 * terms
        )
    assert float(jax.jvp(of, (at,), (jnp.asarray(step),))[1]) == pytest.approx(
        float(backward @ step), abs=1e-8 * terms
    )


@pytest.mark.slow
def test_the_lowest_eigenvalue_is_differentiable_along_a_control(model):
    def lowest(value):
        path = jaxgel.sweep(jaxgel.Problem(model, GEL, control=Stretch("x", mu=-1.0)), value[None])
        return jaxgel.continuation.lowest_eigenvalue(path)[0]

    at, step = jnp.asarray(1.05), 1e-4
    assert float(jax.grad(lowest)(at)) == pytest.approx(
        float(lowest(at + step) - lowest(at - step)) / (2 * step), rel=1e-5
    )


# --- what is refused ------------------------------------------------------------------------------


def test_arguments_that_do_not_fit_are_refused_in_one_line(model, refused):
    refused(
        lambda control, values: jaxgel.sweep(jaxgel.Problem(model, GEL, control=control), values),
        [
            (3.0, [1.0], "control: 3.0 is not accepted, it must have a name, a unit and a scale"),
            (chi(), [], r"chi: \[\] is not accepted, it must be a list of finite numbers"),
            (chi(), [0.1, 0.1], "chi: 0.1 is followed by 0.1"),
            (chi(), [0.1, 3.0], "chi = 3: chi: 3 is not accepted"),
        ],
        start=True,
    )


@pytest.mark.slow
def test_a_path_that_cannot_go_on_says_at_which_value(model):
    """Edges that are pushed together until no room is left for the dry polymer."""
    path = jaxgel.sweep(
        jaxgel.Problem(model, GEL, control=Stretch("x", mu=-3.0), contact=False),
        jaxgel.Adaptive(1.0, 0.2, max_steps=8),
    )
    assert path.stop in (Status.STEP_TOO_SMALL, Status.TOO_MANY_STEPS)
    assert path.stop_text.startswith(f"stopped after stretch = {path.value[-1]:.6g}: ")
