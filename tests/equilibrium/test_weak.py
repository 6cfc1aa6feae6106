"""Essential conditions imposed weakly, and the shape functions that need them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.equilibrium import Status, dry_state, prepare_weak, solve_weak
from jaxgel.equilibrium.newton import iterate
from jaxgel.equilibrium.state import State
from jaxgel.equilibrium.weak import _WeakCorrection
from jaxgel.mechanics import free_dofs, prepare, total_energy

MU = [-3.0, -2.0, -1.0]


@pytest.fixture(scope="module")
def path_of(cloud_of):
    """Function: options of ``discretise`` -> the path of the paper's square, whose swelling is uniaxial."""
    cloud = cloud_of("square")
    return lambda **options: jaxgel.sweep(jaxgel.discretise(cloud, basis="linear", **options), cloud.plate.gel, mu=MU)


def stretch_error(path):
    """Relative error (k,) of the stretch between the middles of bottom and top against Eq. (59)."""
    ends = jaxgel.make_probe(path.model, np.array([[0.0, -0.5], [0.0, 0.5]]))
    y = np.stack([ends.position(jnp.asarray(x)) for x in path.x])
    return np.abs((y[:, 1, 1] - y[:, 0, 1]) / np.asarray(jaxgel.uniaxial_swelling(path.mu, path.gel)) - 1)


def slip(path):
    """Largest normal displacement of the side walls in the last state, mm."""
    side = jaxgel.make_probe(path.model, np.stack([np.full(13, 0.5), np.linspace(-0.5, 0.5, 13)], axis=1))
    return float(np.abs(side.position(jnp.asarray(path.x[-1]))[:, 0] - 0.5).max())


def test_the_second_solver_finds_what_the_first_does(tiny_displacement_model):
    """The dense Newton method of `weak` on a plate with a hole and conditions at its nodes against the sweep's own solver."""
    model = tiny_displacement_model
    gel = model.cloud.plate.gel
    path = jaxgel.sweep(model, gel, mu=[-3.0])
    problem = prepare_weak(model, gel, None, free_dofs(model.lists.topology))
    step = solve_weak(problem, -3.0, *dry_state(prepare(model, gel)))
    assert step.status is Status.CONVERGED and step.negative_pivots == path.negative_pivots[0] == 0
    np.testing.assert_allclose(step.x, path.x[0], atol=1e-10)  # both stop at a relative residual of 1e-10; 4 mm wide
    np.testing.assert_allclose(step.energy, path.energy[0], rtol=1e-12)


def test_consistent_conditions_are_exact_and_the_others_are_not(path_of):
    consistent, real, incomplete = path_of(), path_of(kind="mls", conditions="penalty"), path_of(kind="icvmls", conditions="penalty")
    for path in (consistent, real, incomplete):
        assert path.stop.ok and not path.negative_pivots.any()
    assert stretch_error(consistent).max() < 1e-10
    assert 1e-8 < stretch_error(real).max() < 1e-5  # the penalty lets the walls give way
    assert 1e-5 < stretch_error(incomplete).max() < 1e-3  # and the basis (1, z) has no other linear fields than z


def test_a_wall_gives_way_as_one_over_the_penalty(path_of):
    soft, stiff = (slip(path_of(kind="mls", conditions="penalty", penalty=alpha)) for alpha in (1e1, 1e3))
    assert soft / stiff == pytest.approx(100, rel=0.05)  # the states, solved to 1e-10, leave 1e-9 mm of the smaller, 4e-7


def test_multipliers_hold_the_walls_better_than_a_penalty(path_of):
    held, given_way = path_of(kind="mls", conditions="lagrange"), path_of(kind="mls", conditions="penalty", penalty=1.0)
    assert held.stop.ok and not held.negative_pivots.any()
    assert slip(held) < 0.1 * slip(given_way)


def test_newtons_matrix_is_the_hessian_of_the_energy_for_complex_shape_functions(path_of):
    path = path_of(kind="icvmls", conditions="penalty", method="displacement", quadrature="paper")
    model, gel, mu = path.model, path.gel, float(path.mu[-1])
    problem = prepare_weak(model, gel, None, None)
    x = jnp.asarray(path.x[-1]).ravel()
    correction = _WeakCorrection(np.zeros(0))
    start = State(mu, jnp.asarray(path.x[-1] + 1e-9), jnp.asarray(path.pressure[-1]))
    state = iterate(problem, start, correction)  # a step, to have a matrix
    assert state.status.ok
    u = x - model.cloud.nodes.ravel()

    def energy(u):
        moved = model.cloud.nodes + u.reshape(-1, 2)
        return total_energy(moved, model, gel, mu, jnp.zeros_like(moved)) + 0.5 * u @ problem.stiffness @ u

    slope, hessian = jax.jit(jax.grad(energy))(u), jax.jit(jax.hessian(energy))(u)
    assert np.abs(slope).max() < 1e-9 * np.abs(problem.stiffness @ u).max()
    np.testing.assert_allclose(correction.matrix, hessian, atol=1e-5 * np.abs(hessian).max())  # 1e-9 mm apart, and dp/dJ ~ 1 / (J - 1)


@pytest.mark.parametrize("kind", ["mls", "icvmls"])
def test_deformation_gradient_is_the_derivative_of_the_position(path_of, kind):
    path = path_of(kind=kind, conditions="penalty")
    x, at = jnp.asarray(path.x[-1]), np.array([[0.13, -0.21]])
    probe = jaxgel.make_probe(path.model, at)
    h = 1e-5
    moved = [jaxgel.make_probe(path.model, at + h * np.array(d)).position(x)[0] for d in ([1, 0], [-1, 0], [0, 1], [0, -1])]
    differences = np.stack([(moved[0] - moved[1]) / (2 * h), (moved[2] - moved[3]) / (2 * h)], axis=1)
    np.testing.assert_allclose(probe.deformation_gradient(x)[0], differences, atol=1e-7)  # h^2 times a third derivative of order 1e2


def test_what_cannot_be_is_refused(cloud_of):
    cloud = cloud_of("square")
    with pytest.raises(ValueError, match="kind: 'mls' does not interpolate"):
        jaxgel.discretise(cloud, kind="mls")
    with pytest.raises(ValueError, match="conditions: 'nitsche' is not one of nodes, penalty, lagrange"):
        jaxgel.discretise(cloud, kind="mls", conditions="nitsche")
    with pytest.raises(ValueError, match=r"penalty: -1\.0 is not a finite number above 0"):
        jaxgel.discretise(cloud, kind="mls", conditions="penalty", penalty=-1.0)
    model = jaxgel.discretise(cloud, conditions="penalty")
    with pytest.raises(ValueError, match="conditions: 'penalty' cannot be differentiated"):
        jax.grad(lambda Nv: jaxgel.sweep(model, jaxgel.Gel(Nv, 0.1), mu=[-2.0]).energy[0])(1e-3)


@pytest.mark.parametrize("moved", [dict(edges="periodic"), dict(displacement={"top": (0.0, 0.1)})])
def test_weak_conditions_refuse_edges_that_they_do_not_know(moved):
    plate = jaxgel.Plate(1.0, 1.0, **moved, spacing=1 / 4)
    model = jaxgel.discretise(jaxgel.make_cloud(plate), basis="linear", kind="mls", conditions="penalty")
    with pytest.raises(ValueError, match="conditions: 'penalty' knows neither periodic edges nor edges that move"):
        jaxgel.sweep(model, jaxgel.Gel(), mu=[-3.0])
