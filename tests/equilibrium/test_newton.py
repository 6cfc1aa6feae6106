"""Newton's method at one mu: speed from the dry nodes, statuses, another way to the state."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

import jaxgel
from jaxgel import Problem
from jaxgel._programs import fitted
from jaxgel.equilibrium import NEWTON, Status, dry_state, remedy, solve
from jaxgel.materials import Gel
from jaxgel.mechanics import (
    assembly,
    check_room,
    energy_at,
    free_dofs,
    linearise,
    residual,
    restrict,
    state_pressure,
    total_energy,
    with_free_values,
)


@pytest.fixture(scope="module")
def problem(tiny_model):
    return Problem(tiny_model, tiny_model.cloud.plate.gel, contact=False).prepared


@pytest.fixture(scope="module")
def state(problem):
    """Equilibrium of the tiny model at mu = -1.5."""
    found = solve(problem, -1.5, *dry_state(problem))
    assert found.status.ok
    return found


@pytest.mark.parametrize(
    ("fixture", "step"),
    [
        ("tiny_model", 1.0),
        *(pytest.param("coarse_model", step, marks=pytest.mark.slow) for step in (0.25, 0.5, 1.0)),
    ],
)
def test_newton_takes_few_iterations_from_the_dry_nodes_on(fixture, step, request):
    """Each state from the one before, without a predictor, with a new factor in every iteration."""
    model = request.getfixturevalue(fixture)
    problem = Problem(model, model.cloud.plate.gel, contact=False).prepared
    x, p = dry_state(problem)
    for mu in np.arange(-4.9678, -0.9, step):
        found = solve(problem, mu, x, p, own_factor=True)
        assert found.status.ok
        assert 2 <= found.newton_iterations <= 5
        x, p = found.x, found.pressure


@pytest.mark.smoke
def test_equilibrium_has_no_residual_but_on_held_components(problem, state):
    """Recomputed by differentiation of the energy."""
    model, gel = problem.model, problem.gel
    force = np.asarray(jax.jit(residual)(state.x, model, gel, -1.5, problem.loads)).ravel()
    free = free_dofs(model.cloud.topology).masters
    # the constraint's tolerance times the bulk stiffness
    assert np.linalg.norm(force[free]) < 1e-8 * np.linalg.norm(force)
    assert state.residual < NEWTON.tolerance
    held = np.delete(np.arange(force.size), free)
    np.testing.assert_array_equal(
        np.asarray(state.x).ravel()[held], np.asarray(model.cloud.nodes).ravel()[held]
    )
    np.testing.assert_allclose(state.pressure, state_pressure(state.x, model, gel, -1.5), rtol=1e-7)


def test_walls_push_back_with_balanced_forces(problem, state):
    force = np.asarray(jax.jit(residual)(state.x, problem.model, problem.gel, -1.5, problem.loads))
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-9 * np.abs(force).max())
    walls = problem.model.cloud.topology.edge_nodes
    # the gel presses outwards
    assert np.sum(force[walls["right"], 0]) < 0 < np.sum(force[walls["left"], 0])


@pytest.mark.slow
@pytest.mark.smoke
def test_scipys_minimiser_of_the_energy_finds_the_same_state(problem):
    """Trust-region minimisation of the total energy, from the state at a lower mu."""
    model, gel = problem.model, problem.gel
    start = solve(problem, -1.1, *dry_state(problem))
    mine = solve(problem, -1.0, *dry_state(problem))
    free, nodes = free_dofs(model.cloud.topology), model.cloud.nodes

    @jax.jit
    def energy(values):
        return total_energy(with_free_values(values, nodes, free), model, gel, -1.0, problem.loads)

    def value(values):
        result = float(energy(values))
        return result if np.isfinite(result) else np.inf  # J <= 1: the trust region shrinks

    gradient, hessian = jax.jit(jax.grad(energy)), jax.jit(jax.hessian(energy))
    found = minimize(
        value,
        restrict(np.asarray(start.x), free),
        jac=lambda v: np.nan_to_num(gradient(v)),  # of a point that is rejected for its value
        hess=lambda v: np.nan_to_num(hessian(v)),
        method="trust-exact",
        options={"gtol": 1e-12, "maxiter": 500},
    )
    # it stops where the energy falls by round-off only, at most sqrt(2e-16 / 7e-5) from its
    # minimum; one more step takes that away
    polished = found.x - np.linalg.solve(hessian(found.x), gradient(found.x))
    np.testing.assert_allclose(found.x, polished, atol=1e-6)
    np.testing.assert_allclose(polished, restrict(np.asarray(mine.x), free), atol=1e-10)
    assert value(found.x) == pytest.approx(
        float(energy_at(mine.x, model, gel, -1.0, problem.loads)), rel=1e-12
    )


def test_result_does_not_depend_on_the_start(problem, state):
    from_above = solve(problem, -1.2, state.x, state.pressure)
    back = solve(problem, -1.5, from_above.x, from_above.pressure)
    np.testing.assert_allclose(back.x, state.x, atol=1e-9)


def test_solution_is_recognised_without_an_iteration(problem, state):
    again = solve(problem, -1.5, state.x, state.pressure)
    assert (again.status, again.newton_iterations) == (Status.CONVERGED, 0)
    np.testing.assert_array_equal(again.x, state.x)


def test_every_iteration_count_is_bounded_and_bad_starts_are_named(problem):
    x, p = dry_state(problem)
    rough = x + 1.0 * np.random.default_rng(0).normal(size=x.shape)
    found = solve(problem, -2.0, rough, p)
    assert found.status in (Status.NOT_CONVERGED, Status.SINGULAR)  # which one, round-off decides
    assert found.newton_iterations <= NEWTON.max_iterations


def test_diverging_newton_is_named_and_warns_of_nothing(problem):
    """From the dry nodes to nearly the pure solvent in one step."""
    found = solve(problem, -0.1, *dry_state(problem))
    # round-off decides which comes first
    assert found.status in (Status.NOT_FINITE, Status.NOT_CONVERGED, Status.SINGULAR)
    assert found.newton_iterations <= NEWTON.max_iterations


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_start_that_is_no_number_is_named(bad, problem):
    x, p = dry_state(problem)
    assert solve(problem, -2.0, jnp.asarray(x).at[10, 1].set(bad), p).status is Status.NOT_FINITE
    assert solve(problem, -2.0, x, jnp.asarray(p).at[3].set(np.nan)).status is Status.NOT_FINITE


def test_tangent_without_stiffness_is_singular(tiny_model):
    """A network without chains: nothing resists a change of shape at constant volume."""
    gel = Gel(Nv=1e-300, chi=1e-4)
    problem = Problem(
        tiny_model, gel, loads=jnp.ones_like(tiny_model.cloud.nodes), contact=False
    ).prepared
    found = solve(problem, -2.0, *dry_state(problem))
    assert found.status is Status.SINGULAR


def test_every_status_has_a_line_that_helps():
    texts = [status.text for status in Status]
    assert len(set(texts)) == len(Status)
    assert all(text and "\n" not in text for text in texts)
    assert [status for status in Status if status.ok] == [Status.CONVERGED]


def test_failed_first_state_says_what_to_change():
    assert remedy(Status.NOT_CONVERGED, "mu") == "; start at a lower mu"
    assert remedy(Status.SELF_CONTACT, "chi") == "; sweep with contact"


def test_plate_that_may_slide_is_refused():
    plate = jaxgel.Plate(1, 1, edges={"left": "free", "right": "free"}, spacing=0.25)
    message = (
        r"^edges: left free, right free, bottom roller, top roller leave the plate free to slide; "
        r"hold at least one edge normal to each"
    )
    with pytest.raises(ValueError, match=message):
        free_dofs(jaxgel.make_cloud(plate).topology)


@pytest.mark.parametrize(
    ("room", "change"),
    [
        (False, {}),
        (False, {"edges": "fixed", "deformation": ((1.2, 0.0), (0.0, 0.8))}),
        (False, {"edges": "periodic"}),
        (False, {"displacement": {"top": (0.0, -0.1)}}),
        (True, {"displacement": {"top": (0.0, 0.1)}}),
        (True, {"edges": "periodic", "deformation": ((1.1, 0.3), (0.0, 1.0))}),
        (True, {"edges": {"top": "free"}}),
        (True, {"holes": [jaxgel.Circle((0.0, 0.0), 0.1)]}),
    ],
)
def test_plate_that_fills_a_closed_box_is_refused(room, change):
    plate = jaxgel.Plate(1, 2, **change)
    if room:
        check_room(plate)
    else:
        with pytest.raises(
            ValueError,
            match=(
                r"^edges: left .*leave no room to swell in; add a hole, free an edge or move one "
                r"outwards$"
            ),
        ):
            check_room(plate)


@pytest.mark.parametrize(("condition", "held"), [("roller", 4 * 5), ("fixed", 2 * 16)])
def test_walls_hold_the_components_they_should(condition, held):
    """5 x 5 nodes: rollers hold the normal component, at corners both; a fixed edge both."""
    topology = jaxgel.make_cloud(jaxgel.Plate(1, 1, edges=condition, spacing=0.25)).topology
    free = free_dofs(topology).masters
    assert len(free) == 50 - held
    assert np.all(np.diff(free) > 0)


@pytest.mark.thorough
def test_assembly_never_holds_the_matrices_of_all_points(coarse_model):
    """Of one component each, let alone four; a step needs less than a fifth of that."""
    gel = coarse_model.cloud.plate.gel
    problem = Problem(coarse_model, gel, contact=False).prepared
    x, pressure = dry_state(problem)
    stencil = max(block.nodes.shape[1] for block in coarse_model.blocks)
    then = linearise(problem, x, pressure, -4.9)
    shared = problem.shared
    at = shared, fitted(x, "n", shared.lengths), fitted(pressure, "g", shared.lengths)
    for function, last in ((linearise, -4.9), (assembly.tangent_blocks, then)):
        memory = jax.jit(function.__wrapped__).lower(*at, last).compile().memory_analysis()
        assert 0 < memory.temp_size_in_bytes < 8 * coarse_model.n_points * stencil**2 / 5
