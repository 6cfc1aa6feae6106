"""Lowest eigenvalue and negative count of accepted states against dense eigenvalues."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import jaxgel
from jaxgel import Problem
from jaxgel.continuation import ACCURACY, StabilityAnalysis, lowest_eigenvalue, oriented
from jaxgel.equilibrium import solve
from jaxgel.linalg import nearest_modes
from jaxgel.mechanics import total_energy

MU = np.linspace(-4.9678, -0.9178, 10)


def dense_eigenvalues(path):
    """All eigenvalues (k, f) of the dense Hessian over the network's stiffness, at all states."""
    problem = Problem(path.model, path.gel, contact=False).prepared
    free, stiffness = problem.pattern.free, StabilityAnalysis(problem).stiffness.toarray()

    @jax.jit
    def hessian(x, mu):
        def energy(v):
            return total_energy(
                x.ravel().at[free].set(v).reshape(-1, 2), path.model, problem.gel, mu, problem.loads
            )

        return jax.jacfwd(jax.grad(energy))(x.ravel()[free])

    hessians = (np.asarray(hessian(x, mu)) for x, mu in zip(path.x, path.mu, strict=True))
    return np.array([scipy.linalg.eigh(dense, stiffness, eigvals_only=True) for dense in hessians])


@pytest.fixture(scope="module")
def tiny_path(tiny_model):
    return jaxgel.sweep(
        jaxgel.Problem(tiny_model, tiny_model.cloud.plate.gel), MU, eigenvalues=True
    )


@pytest.mark.thorough
def test_lowest_eigenvalues_along_a_sweep_are_those_of_the_hessian(tiny_path):
    """To the analysis's accuracy, 1e-3; a factor of two for the estimate of the last gain."""
    np.testing.assert_allclose(
        tiny_path.lowest_eigenvalue, dense_eigenvalues(tiny_path)[:, 0], rtol=2e-3
    )


@pytest.mark.slow
def test_large_steps_leave_the_lowest_eigenvalue_as_accurate(coarse_model):
    """There the modes at hand are those of a state far away."""
    path = jaxgel.sweep(
        jaxgel.Problem(coarse_model, coarse_model.cloud.plate.gel),
        [-4.9678, -4.5, -4.0, -3.0],
        eigenvalues=True,
    )
    problem = Problem(path.model, path.gel, contact=False).prepared
    states = [
        solve(problem, mu, x, p, own_factor=True)
        for mu, x, p in zip(path.mu, path.x, path.pressure, strict=True)
    ]
    exact = [
        nearest_modes(state.factor, StabilityAnalysis(problem).stiffness, 1)[0][0]
        for state in states
    ]
    np.testing.assert_allclose(path.lowest_eigenvalue, exact, rtol=2e-3)


def test_the_network_stiffness_is_the_hessian_of_the_networks_energy(tiny_model):
    """So a gel without pressure has the eigenvalue 1 in every direction."""
    from jaxgel.mechanics import network_energy

    problem = Problem(tiny_model, tiny_model.cloud.plate.gel, contact=False).prepared
    free, x = problem.pattern.free, jax.numpy.asarray(tiny_model.cloud.nodes)

    def energy(v):
        return network_energy(x.ravel().at[free].set(v).reshape(-1, 2), tiny_model, problem.gel)

    hessian = jax.jit(jax.jacfwd(jax.grad(energy)))(x.ravel()[free])
    np.testing.assert_allclose(
        np.asarray(hessian), StabilityAnalysis(problem).stiffness.toarray(), atol=1e-15
    )


@pytest.fixture(scope="module")
def unstable_path(buckling_model):
    problem = jaxgel.Problem(buckling_model, buckling_model.cloud.plate.gel)
    return jaxgel.sweep(problem, [-2.2, -1.645, -1.635, -1.3], branch="symmetric", eigenvalues=True)


@pytest.mark.thorough
def test_a_negative_eigenvalue_is_found_from_modes_that_are_blind_to_it(unstable_path):
    """Modes followed so far may all have another symmetry than the unstable one."""
    problem = Problem(unstable_path.model, unstable_path.gel, contact=False).prepared
    stiffness, mu = StabilityAnalysis(problem).stiffness, unstable_path.mu[-1]
    state = solve(problem, mu, unstable_path.x[-1], unstable_path.pressure[-1], own_factor=True)
    eigenvalues, modes = nearest_modes(state.factor, stiffness, 6)
    assert eigenvalues[0] < 0 < eigenvalues[-1]
    found, _ = StabilityAnalysis(problem).check(state, modes[:, eigenvalues > 0][:, :2])
    np.testing.assert_allclose(found.eigenvalues[0], eigenvalues[0], rtol=2e-3)
    assert found.negative == np.sum(eigenvalues < 0)


@pytest.mark.slow
def test_the_lowest_eigenvalue_is_found_where_modes_change_their_order(cloud_of):
    """On the lattice the lowest three, one double, give way to a mode of another symmetry."""
    model = jaxgel.discretise(cloud_of("lattice"))
    path = jaxgel.sweep(
        jaxgel.Problem(model, model.cloud.plate.gel, contact=False),
        np.linspace(-3.5, -1.6, 14),
        eigenvalues=True,
    )
    problem = Problem(path.model, path.gel, contact=False).prepared
    states = [
        solve(problem, mu, x, p, own_factor=True)
        for mu, x, p in zip(path.mu, path.x, path.pressure, strict=True)
    ]
    exact = [
        nearest_modes(state.factor, StabilityAnalysis(problem).stiffness, 1)[0][0]
        for state in states
    ]
    np.testing.assert_allclose(path.lowest_eigenvalue, exact, rtol=2e-3)


@pytest.mark.thorough
def test_modes_that_were_followed_may_have_become_the_same(unstable_path):
    problem = Problem(unstable_path.model, unstable_path.gel, contact=False).prepared
    stiffness, mu = StabilityAnalysis(problem).stiffness, unstable_path.mu[0]
    state = solve(problem, mu, unstable_path.x[0], unstable_path.pressure[0], own_factor=True)
    eigenvalues, modes = nearest_modes(state.factor, stiffness, 4)
    round_off = 1e-12 * np.random.default_rng(6).normal(size=modes.shape)
    for followed in (some for some in itertools.product(range(4), repeat=4) if 0 in some):
        found, _ = StabilityAnalysis(problem).check(state, modes[:, followed] + round_off)
        np.testing.assert_allclose(found.eigenvalues[0], eigenvalues[0], rtol=1e-8)


@pytest.mark.slow
def test_negative_eigenvalues_are_counted_for_the_state_itself(unstable_path):
    exact = dense_eigenvalues(unstable_path)
    np.testing.assert_array_equal(unstable_path.negative_pivots, np.sum(exact < 0, axis=1))
    np.testing.assert_allclose(unstable_path.lowest_eigenvalue, exact[:, 0], rtol=2e-3)
    assert list(unstable_path.negative_pivots[[0, -1]]) == [0, 1]


@pytest.mark.slow
@pytest.mark.parametrize("asked", [True, False])
def test_the_history_has_the_lowest_eigenvalues_that_were_asked_for(tiny_model, asked):
    """The pivots are counted either way."""
    table = jaxgel.observables.history(
        jaxgel.sweep(
            jaxgel.Problem(tiny_model, jaxgel.Gel(1e-3, 0.1)), [-3.0, -2.0], eigenvalues=asked
        )
    )
    assert (
        np.all(table["lowest_eigenvalue"] > 0)
        if asked
        else np.all(np.isnan(table["lowest_eigenvalue"]))
    )
    assert list(table["negative_pivots"]) == [0, 0]


@pytest.mark.thorough
def test_a_mode_points_the_same_way_whatever_the_sign_it_comes_with(tiny_path):
    problem = Problem(tiny_path.model, tiny_path.gel, contact=False).prepared
    vectors = np.random.default_rng(1).normal(size=(len(problem.pattern.free), 3))
    np.testing.assert_array_equal(oriented(vectors, problem), oriented(-vectors, problem))


@pytest.mark.thorough
def test_a_state_that_was_not_reached_has_no_lowest_eigenvalue(tiny_path):
    x = tiny_path.x.copy()
    x[-1] = np.nan
    found = lowest_eigenvalue(dataclasses.replace(tiny_path, x=x))
    assert np.isnan(found[-1])
    np.testing.assert_allclose(found[:-1], tiny_path.lowest_eigenvalue[:-1], rtol=ACCURACY)


@pytest.mark.thorough
def test_the_lowest_eigenvalue_of_a_path_under_loads_is_that_of_its_states(tiny_model):
    """Dead loads have no stiffness, but change states: a tenth and more of the eigenvalue."""
    gel = tiny_model.cloud.plate.gel
    loads = np.where(
        np.asarray(tiny_model.cloud.nodes) == np.asarray(tiny_model.cloud.nodes).max(axis=0),
        [0.0, -2e-5],
        0.0,
    )
    path, unloaded = (
        jaxgel.sweep(jaxgel.Problem(tiny_model, gel, loads=force), [-3.0, -2.0], eigenvalues=True)
        for force in (loads, None)
    )
    found = np.asarray(lowest_eigenvalue(path))
    np.testing.assert_allclose(found, path.lowest_eigenvalue, rtol=ACCURACY)
    assert np.all(np.abs(found / unloaded.lowest_eigenvalue - 1) > 1e-2)


@pytest.mark.slow
def test_every_float_of_a_path_has_the_derivative_of_differences_or_none(tiny_model):
    """Tangents of numbers without derivatives are nan; counts and texts have no tangents."""

    def floats(chi):
        path = jaxgel.sweep(
            jaxgel.Problem(tiny_model, jaxgel.Gel(1e-3, chi), contact=False), [-3.0, -2.0]
        )
        columns = {field.name: getattr(path, field.name) for field in dataclasses.fields(path)}
        return {
            name: jnp.asarray(c)
            for name, c in columns.items()
            if isinstance(c, jax.Array | np.ndarray) and c.dtype == float
        }

    h = 1e-4
    _, slopes = jax.jvp(floats, (0.1,), (1.0,))
    differences = jax.tree.map(lambda a, b: (a - b) / (2 * h), floats(0.1 + h), floats(0.1 - h))
    none = {name for name, slope in slopes.items() if np.isnan(slope).all()}
    assert none == {"residual", "lowest_eigenvalue"} and slopes.keys() == {
        "mu",
        "value",
        "x",
        "pressure",
        "energy",
        *none,
    }
    for name in slopes.keys() - none:
        # h^2 of the third derivative
        np.testing.assert_allclose(slopes[name], differences[name], rtol=1e-5, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lowest_eigenvalue", "residual"])
def test_a_number_without_derivative_refuses_the_reverse_pass_that_asks_for_it(tiny_model, name):
    def number(chi, use):
        path = jaxgel.sweep(
            jaxgel.Problem(tiny_model, jaxgel.Gel(1e-3, chi), contact=False), [-3.0, -2.0]
        )
        column = getattr(path, name)
        return path.energy[-1] + (
            column[-1] if use else jnp.where(column[-1] > 0, 0.0, 1.0)
        ), column

    message = {
        "lowest_eigenvalue": r"jaxgel\.continuation\.lowest_eigenvalue\(path\)",
        "residual": "round-off",
    }[name]
    with pytest.raises(ValueError, match=rf"^path\.{name}: .*{message}"):
        jax.grad(number, has_aux=True)(0.1, True)
    slope, column = jax.grad(number, has_aux=True)(0.1, False)  # shown beside it, and compared
    assert np.isfinite(slope) and np.isfinite(column).all()
