"""Total energy, its derivatives, the mixed form's condensed tangent, and dead loads."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import jaxgel
from jaxgel import Problem
from jaxgel.equilibrium import State, control_force, dry_state, solve
from jaxgel.linalg import analyse
from jaxgel.materials import ArrudaBoyce, Gel, Gent, free_energy
from jaxgel.mechanics import (
    all_volumes,
    condensed_rhs,
    energy_at,
    free_dofs,
    gather,
    linearise,
    network_energy,
    node_pairs,
    pressure_step,
    ratio_at,
    residual,
    state_pressure,
    tangent,
    total_energy,
    volume_ratios,
)

each_network = pytest.mark.parametrize(
    "gel", [Gel(), Gel(network=Gent(30.0))], ids=["default", "gent"]
)

residual_at = jax.jit(residual)


def no_loads(model):
    return np.zeros((model.n_nodes, 2))


def swollen(model, seed=0):
    """Positions (n, 2) of a rough state with J between 1.2 and 2."""
    random = np.random.default_rng(seed)
    nodes = np.asarray(model.cloud.nodes)
    return nodes @ np.array([[1.2, 0.1], [-0.2, 1.25]]) + 0.02 * random.normal(size=nodes.shape)


def dense_tangent(model, gel, mu, x):
    """The assembled condensed tangent (2n, 2n) at the state ``x`` and its pressures."""
    problem, p = Problem(model, gel, contact=False).prepared, state_pressure(x, model, gel, mu)
    points = model.lists.topology.partition.vertices[model.lists.topology.node_vertices]
    pattern = analyse(node_pairs(model.lists)[0], points, np.arange(2 * model.n_nodes))
    return pattern.matrix(tangent(problem, x, p, linearise(problem, x, p, mu))).toarray()


def test_energy_of_a_homogeneous_state_is_area_times_energy_density(tiny_model):
    A = np.array([[1.3, 0.2], [-0.1, 1.2]])
    gel, mu, x = Gel(1e-3, 0.2), -1.1, np.asarray(tiny_model.cloud.nodes) @ A.T
    energy = energy_at(x, tiny_model, gel, mu, no_loads(tiny_model))
    area = float(np.sum(np.asarray(all_volumes(tiny_model))[tiny_model.carries]))
    assert float(energy) == pytest.approx(area * float(free_energy(A, mu, gel)), rel=1e-12)
    assert float(jax.jit(network_energy)(x, tiny_model, gel)) == pytest.approx(
        area * float(gel.network(A, gel)), rel=1e-12
    )


@each_network
def test_residual_is_the_difference_quotient_of_the_energy(tiny_model, gel):
    model = tiny_model
    x, loads = swollen(model), np.random.default_rng(1).normal(size=(model.n_nodes, 2))
    gradient, step = np.asarray(residual_at(x, model, gel, -1.5, loads)), 1e-4
    for seed in range(3):
        way = np.random.default_rng(10 + seed).normal(size=x.shape)
        e = {
            k: float(energy_at(x + k * step * way, model, gel, -1.5, loads)) for k in (-2, -1, 1, 2)
        }
        difference = (8 * (e[1] - e[-1]) - (e[2] - e[-2])) / (12 * step)
        # fourth order: truncation step^4 = 1e-16 times the fifth derivative; round-off 1e-16 / step
        # of an energy of 10
        assert difference == pytest.approx(np.sum(gradient * way), rel=1e-8)


def test_energy_does_not_see_rigid_motions(tiny_model):
    model = tiny_model
    gel, x, loads = Gel(), swollen(model), no_loads(model)
    c, s = np.cos(1.0), np.sin(1.0)
    Q = np.array([[c, -s], [s, c]])
    moved = x @ Q.T + np.array([3.0, -2.0])
    assert float(energy_at(moved, model, gel, -1.5, loads)) == pytest.approx(
        float(energy_at(x, model, gel, -1.5, loads)), rel=1e-13
    )
    force, turned = (
        np.asarray(residual_at(positions, model, gel, -1.5, loads)) for positions in (x, moved)
    )
    size = np.abs(force).max()
    np.testing.assert_allclose(turned, force @ Q.T, atol=1e-12 * size)
    # no net force, no net moment
    np.testing.assert_allclose(np.sum(force, axis=0), 0.0, atol=1e-12 * size)
    assert abs(np.sum(x[:, 0] * force[:, 1] - x[:, 1] * force[:, 0])) < 1e-11 * size


def test_energy_below_the_dry_volume_is_nan_and_says_so(tiny_model):
    model = tiny_model
    assert np.isnan(
        float(energy_at(0.99 * np.asarray(model.cloud.nodes), model, Gel(), -1.5, no_loads(model)))
    )


# --- the condensed tangent ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "gel",
    [Gel(), pytest.param(Gel(network=Gent(30.0)), marks=pytest.mark.slow)],
    ids=["default", "gent"],
)
def test_tangent_is_the_hessian_of_the_energy_at_a_converged_state(tiny_model, gel):
    model, mu = tiny_model, -1.8
    problem = Problem(model, gel, contact=False).prepared
    found = solve(problem, mu, *dry_state(problem))
    assert found.status.ok
    hessian = jax.jit(jax.hessian(lambda x: total_energy(x, model, gel, mu, no_loads(model))))(
        found.x
    ).reshape((2 * model.n_nodes,) * 2)
    K = dense_tangent(model, gel, mu, found.x)
    # second derivatives of energies near 1/(J-1) times network moduli: round-off 1e-16 times 1e5
    np.testing.assert_allclose(K, hessian, rtol=0, atol=1e-9 * np.abs(hessian).max())
    assert np.abs(K - hessian).max() < 1e-6 * gel.Nv  # so the network's part is right as well


@pytest.mark.parametrize(
    "gel",
    [Gel(), pytest.param(Gel(network=ArrudaBoyce(8.0)), marks=pytest.mark.slow)],
    ids=["default", "arruda-boyce"],
)
def test_linearisation_has_the_forces_and_constraint_errors_of_the_mixed_functional(
    gel, tiny_model
):
    model, mu, x = tiny_model, -1.8, swollen(tiny_model)
    p = 1e-3 * np.random.default_rng(2).normal(size=len(all_volumes(model)))
    loads = 1e-3 * np.random.default_rng(3).normal(size=x.shape)
    now = linearise(Problem(model, gel, loads=loads, contact=False).prepared, x, p, mu).cut(model)

    def functional(x):
        return (
            network_energy(x, model, gel)
            + jnp.sum(all_volumes(model) * p * volume_ratios(x, model))
            - jnp.sum(loads * x)
        )

    forces = jax.jit(jax.grad(functional))(x)
    scale = float(jnp.linalg.norm(jax.jit(jax.grad(network_energy))(x, model, gel)))
    np.testing.assert_allclose(now.rhs, -forces, atol=1e-13 * scale)
    star = ratio_at(p, model, gel, mu)
    np.testing.assert_allclose(
        star[model.carries], jaxgel.materials.volume_ratio_at(p, mu, gel)[model.carries], rtol=1e-15
    )
    np.testing.assert_allclose(now.error, volume_ratios(x, model) - star, atol=1e-13)
    assert 1 / float(now.per_force) == pytest.approx(scale + np.linalg.norm(loads), rel=1e-12)
    assert float(now.violation) > 1


@pytest.mark.thorough
def test_condensed_newton_step_solves_the_full_saddle_point_system(tiny_model):
    model, gel, mu = tiny_model, Gel(), -1.8
    problem, free = (
        Problem(model, gel, contact=False).prepared,
        free_dofs(model.cloud.topology).masters,
    )
    x, volumes = swollen(model, 4), np.asarray(all_volumes(model))
    p = -1e-3 + 1e-4 * np.random.default_rng(5).normal(size=len(volumes))
    now = linearise(problem, x, p, mu)

    condensed = problem.pattern.matrix(tangent(problem, x, p, now)).toarray()
    rhs, now = np.asarray(condensed_rhs(problem, now, now)), now.cut(model)
    dx = np.zeros(2 * model.n_nodes)
    dx[free] = np.linalg.solve(condensed, rhs)
    dp = pressure_step(dx.reshape(-1, 2), now, now, model)

    lagrangian = jax.jit(
        jax.hessian(
            lambda x: network_energy(x, model, gel) + jnp.sum(p * volumes * volume_ratios(x, model))
        )
    )(x)
    G = jax.jit(jax.jacfwd(lambda x: volumes * volume_ratios(x, model)))(x).reshape(
        len(volumes), -1
    )[:, free]
    K = np.asarray(lagrangian).reshape((2 * model.n_nodes,) * 2)[np.ix_(free, free)]
    system = np.block([[K, G.T], [G, np.diag(-volumes / np.asarray(now.stiffness))]])
    right = np.concatenate([np.asarray(now.rhs).ravel()[free], -volumes * np.asarray(now.error)])
    solution = np.linalg.solve(system, right)
    # the systems have condition numbers near 1e7
    np.testing.assert_allclose(dx[free], solution[: len(free)], atol=1e-8 * np.abs(dx).max())
    np.testing.assert_allclose(dp, solution[len(free) :], atol=1e-8 * np.abs(dp).max())


# --- loads ----------------------------------------------------------------------------------------


def test_nodal_forces_add_up_to_the_load(tiny_model):
    model = tiny_model
    part = model.cloud.topology.partition
    a, b, c = (part.vertices[part.triangles[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    body = np.array([0.3, -0.7])
    forces = jaxgel.load_vector(model, body_force=body)
    np.testing.assert_allclose(np.sum(forces, axis=0), body * area.sum(), rtol=1e-12)
    # of linear reproduction, about the origin
    moments = np.einsum("ai,aj->ij", forces, model.cloud.nodes)
    np.testing.assert_allclose(moments, np.outer(body, area @ ((a + b + c) / 3)), atol=1e-11)
    same = jaxgel.load_vector(model, body_force=lambda X: jnp.array([0.3, -0.7]) + 0.0 * X)
    np.testing.assert_allclose(same, forces, atol=1e-14)


@pytest.mark.parametrize("edge", ["left", "right", "bottom", "top"])
def test_edge_forces_add_up_to_the_load_and_its_moment(tiny_model, edge):
    """A linear traction on each edge, free (top) or held."""
    model = tiny_model
    along = 0 if edge in ("bottom", "top") else 1
    forces = jaxgel.load_vector(
        model, traction={edge: lambda X: jnp.array([0.2, -0.5]) * (1 + X[along])}
    )
    # 4 mm long, mean of X = 0
    np.testing.assert_allclose(np.sum(forces, axis=0), np.array([0.8, -2.0]), rtol=1e-12)
    first_moment = np.asarray(forces).T @ np.asarray(model.cloud.nodes[:, along])
    np.testing.assert_allclose(first_moment, np.array([0.2, -0.5]) * 2 * 2**3 / 3, rtol=1e-12)
    if edge != "top":
        nodes = np.asarray(model.cloud.nodes)
        on = np.isclose(nodes[:, 1 - along], -2.0 if edge in ("left", "bottom") else 2.0)
        assert np.all(np.asarray(forces)[~on] == 0)


def test_loads_of_several_kinds_superpose(tiny_model):
    both = jaxgel.load_vector(
        tiny_model, body_force=(1.0, 2.0), traction={"top": (0.0, 1.0), "left": (0.5, 0.0)}
    )
    single = [
        {"body_force": (1.0, 2.0)},
        {"traction": {"top": (0.0, 1.0)}},
        {"traction": {"left": (0.5, 0.0)}},
    ]
    np.testing.assert_allclose(
        both, sum(jaxgel.load_vector(tiny_model, **load) for load in single), atol=1e-14
    )
    np.testing.assert_array_equal(jaxgel.load_vector(tiny_model), np.zeros((tiny_model.n_nodes, 2)))


@pytest.mark.parametrize("traction", [2e-3, -5e-4])
def test_strip_under_uniform_traction_has_the_uniaxial_closed_form(traction, square_model):
    gel, mu = jaxgel.sample("square").gel, -1.0
    loads = jaxgel.load_vector(square_model, traction={"top": (0.0, traction)})
    path = jaxgel.sweep(jaxgel.Problem(square_model, gel, loads=loads), [-2.0, mu])
    # dW/dl2 = t
    slope = jax.jit(
        jax.grad(lambda stretch: free_energy(jnp.diag(jnp.stack([1.0, stretch])), mu, gel))
    )
    exact = brentq(lambda stretch: float(slope(stretch)) - traction, 1.0 + 1e-6, 9.0, xtol=1e-15)
    nodes = np.asarray(square_model.cloud.nodes)
    expected = np.stack([nodes[:, 0], exact * (nodes[:, 1] + 0.5) - 0.5], axis=1)
    np.testing.assert_allclose(path.x[-1], expected, atol=1e-10 * exact)
    assert path.energy[-1] == pytest.approx(
        float(energy_at(expected, square_model, gel, mu, loads)), rel=1e-12
    )


def test_column_under_its_weight_follows_the_one_dimensional_equation(square_model):
    """dP/dY + b = 0 with P = dW/dl2 gives l2(Y) by roots, and the height by quadrature."""
    gel, mu, weight = Gel(Nv=0.05, chi=0.1), -0.05, 0.05
    path = jaxgel.sweep(
        jaxgel.Problem(
            square_model, gel, loads=jaxgel.load_vector(square_model, body_force=(0.0, -weight))
        ),
        [-2.0, -0.5, mu],
    )
    slope = jax.jit(
        jax.grad(lambda stretch: free_energy(jnp.diag(jnp.stack([1.0, stretch])), mu, gel))
    )

    def stretch(Y):
        return brentq(
            lambda stretch: float(slope(stretch)) + weight * (0.5 - Y), 1.0 + 1e-6, 9.0, xtol=1e-13
        )

    nodes = np.asarray(square_model.cloud.nodes)
    levels = np.unique(nodes[:, 1].round(9))
    heights = [-0.5 + quad(stretch, -0.5, Y, epsabs=1e-9)[0] for Y in levels]
    expected = np.interp(nodes[:, 1], levels, heights)
    sag = float(jaxgel.uniaxial_swelling(mu, gel)) - 0.5 - heights[-1]
    assert sag > 0.1
    # three patches over the height: second order, 1.3 % of the sag (0.39 % with six, 0.10 % with
    # twelve)
    np.testing.assert_allclose(path.x[-1][:, 1], expected, atol=0.014 * sag)
    np.testing.assert_allclose(path.x[-1][:, 0], nodes[:, 0], atol=0.006 * sag)


def test_unusable_loads_are_refused(tiny_model, refused):
    refused(
        lambda load: jaxgel.load_vector(tiny_model, **load),
        [
            (
                {"traction": {"topp": (0.0, 1.0)}},
                r"traction: unknown edge 'topp'; did you mean 'top'",
            ),
            (
                {"traction": {"top": 1.0}},
                r"traction: top: shape \(\) is not accepted, give a vector \(2,\)",
            ),
            ({"body_force": (0.0, 0.0, 1.0)}, r"body_force: shape \(3,\) is not accepted"),
            ({"body_force": lambda X: X[0]}, r"body_force: shape \(\) is not accepted"),
        ],
        start=True,
    )


def test_forces_at_a_given_pressure_are_those_of_the_mixed_form(tiny_model):
    """Newton's final pressures, near those of the volume ratios, enter to second order."""
    gel, mu, x, loads = Gel(), -1.5, swollen(tiny_model), no_loads(tiny_model)
    gap = 1e-7 * np.random.default_rng(5).normal(size=len(all_volumes(tiny_model)))
    pressure = np.asarray(state_pressure(x, tiny_model, gel, mu)) + gap
    mixed = linearise(Problem(tiny_model, gel, contact=False).prepared, x, pressure, mu).cut(
        tiny_model
    )
    given, own = (
        np.asarray(residual_at(x, tiny_model, gel, mu, loads, p)) for p in (pressure, None)
    )
    np.testing.assert_allclose(given, -mixed.rhs, rtol=0, atol=1e-5 * np.abs(own - given).max())


def test_force_of_mu_is_the_derivative_of_the_residual(tiny_model):
    """Gradient of the volume by area forms, against autodiff of the residual; round-off."""
    model = tiny_model
    problem = Problem(model, Gel(1e-3, 1e-4), contact=False).prepared
    x = 1.2 * np.asarray(model.cloud.nodes) + 0.02 * np.random.default_rng(3).standard_normal(
        model.cloud.nodes.shape
    )
    expected = jax.jvp(
        lambda mu: residual_at(x, model, problem.gel, mu, problem.loads), (-1.0,), (1.0,)
    )[1]
    scale = np.abs(expected).max()
    np.testing.assert_allclose(
        control_force(problem, State(-1.0, -1.0, x, state_pressure(x, model, problem.gel, -1.0))),
        gather(expected, problem.free),
        rtol=0,
        atol=1e-12 * scale,
    )
