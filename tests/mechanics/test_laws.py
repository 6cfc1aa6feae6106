"""Laws of the volume ratio, and a chemical potential of its own in each volume group."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel import Driven, Gel, Problem, Setting
from jaxgel.equilibrium import dry_state, solve
from jaxgel.materials import Filled, Pnipam, VolumeLaw
from jaxgel.mechanics import (
    all_volumes,
    condensed_rhs,
    energy_at,
    linearise,
    residual,
    state_pressure,
    tangent,
)

KINEMATICS = {"plane strain": {}, "generalised": {"axial": 1.1}, "film": {"film": True}}
MATERIALS = {
    "gel": Gel(jnp.array([1e-3, 2e-3, 0.1]), jnp.array([0.1, 0.3, 0.45])),
    "two phases": Pnipam(0.01, jnp.array([20.0, 33.0, 40.0])),
    "with elastomer": Filled(Gel(jnp.array([1e-3, 0.1, 2.0]), 0.1), jnp.array([0.0, 10.0, 0.5])),
}


@jax.jit
def numbers(law, A):
    """Energies, pressures, stiffnesses, volume ratios at areal stretches, and the inverses.

    Stiffnesses and stretches by ratios and pressures.
    """
    p, J = law.pressure(A), law.volume_ratio(A)
    return law.energy(A), p, law.stiffness(A), J, law.stiffness(A, J), law.areal_stretch(p)


def repeated(law, count):
    """The law with its parameters of three places ``count`` times one after the other."""
    return jax.tree.map(lambda leaf: np.tile(leaf, count) if np.ndim(leaf) else leaf, law)


@pytest.mark.thorough
@pytest.mark.parametrize("kinematics", KINEMATICS)
@pytest.mark.parametrize("material", MATERIALS)
def test_pressure_and_stiffness_are_slopes_of_the_energy_and_have_an_inverse(material, kinematics):
    """By differences of third order, and with local parameters as with equal ones.

    Other parameters and another mu at each place, as with the same at all.
    """
    gel, mu, A, h = (
        MATERIALS[material],
        np.array([-2.0, -0.5, -0.1]),
        np.array([1.15, 1.3, 1.25]),
        1e-4,
    )
    law = VolumeLaw(gel, mu, **KINEMATICS[kinematics])
    found = [
        np.asarray(part).reshape(5, 3)
        for part in numbers(
            repeated(law, 5), np.concatenate([A + k * h for k in (2, 1, 0, -1, -2)])
        )
    ]
    energy, p, stiffness, _, again, back = found
    for of, slope in ((energy, p), (p, stiffness)):
        np.testing.assert_allclose(
            (8 * (of[1] - of[3]) - of[0] + of[4]) / (12 * h), slope[2], rtol=1e-8, atol=1e-11
        )
    np.testing.assert_allclose(again, stiffness, rtol=1e-14)
    stiff = (stiffness[2] > 0) & (back[2] + 1e-9 > A)  # on the branch of the dry state
    assert stiff.any()
    np.testing.assert_allclose(back[2][stiff], A[stiff], rtol=1e-12)
    for k in range(3):
        same = jax.tree.map(lambda leaf, k=k: np.full(15, leaf[k]) if np.ndim(leaf) else leaf, law)
        for alone, values in zip(numbers(same, np.full(15, A[k])), found, strict=True):
            np.testing.assert_allclose(alone, values[2, k], rtol=1e-13)


@pytest.fixture(
    scope="module", params=["plane strain", pytest.param("plane stress", marks=pytest.mark.slow)]
)
def model(request, tiny_plate):
    return jaxgel.discretise(
        jaxgel.make_cloud(dataclasses.replace(tiny_plate, kinematics=request.param))
    )


def rough(model):
    """Positions (n, 2) with areal stretches between 1.2 and 2."""
    return 1.3 * model.cloud.nodes + 0.02 * np.random.default_rng(1).normal(
        size=model.cloud.nodes.shape
    )


def two_values(model):
    """A chemical potential (g,) that is -1 in one half of the groups and -0.6 in the other."""
    groups = len(all_volumes(model))
    return jnp.where(jnp.arange(groups) < groups // 2, -1.0, -0.6)


def of_groups(value, gel, mu):
    return Setting(value * mu, gel)


@pytest.mark.slow
def test_equal_chemical_potentials_of_all_groups_are_one(model):
    gel, x, every = Gel(1e-3, 0.1), rough(model), jnp.full(len(all_volumes(model)), -0.8)
    problem = Problem(model, gel, contact=False).prepared
    p = state_pressure(x, model, gel, -0.8)
    np.testing.assert_array_equal(state_pressure(x, model, gel, every), p)
    same = [
        (
            linearise(problem, x, p, mu),
            jax.jit(residual)(x, model, gel, mu, problem.loads),
            energy_at(x, model, gel, mu, problem.loads),
        )
        for mu in (-0.8, every)
    ]
    for one, other in zip(*map(jax.tree.leaves, same), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-14, atol=1e-15)
    driven = Problem(model, gel, control=Driven(of_groups, (every / 0.8,)), contact=False).prepared
    states = solve(problem, -0.8, *dry_state(problem)), solve(driven, 0.8, *dry_state(driven))
    assert all(state.status.ok for state in states)
    np.testing.assert_allclose(states[1].x, states[0].x, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_with_two_chemical_potentials_forces_and_tangent_are_slopes_of_the_energy(model):
    """By central differences along a random field, at an equilibrium of zero slope."""
    gel, mu, x = Gel(1e-3, 0.1), two_values(model), rough(model)
    problem = Problem(model, gel, contact=False).prepared
    field = np.random.default_rng(2).normal(size=x.shape)

    def slope(function, at, h=1e-4):
        values = [np.asarray(function(at + k * h * field)) for k in (2, 1, -1, -2)]
        return (8 * (values[1] - values[2]) - values[0] + values[3]) / (12 * h)

    def energy(x):
        return energy_at(x, model, gel, mu, problem.loads)

    def force(x):
        return jax.jit(residual)(x, model, gel, mu, problem.loads)

    assert slope(energy, x) == pytest.approx(float(jnp.sum(force(x) * field)), rel=1e-8)
    assert float(energy(x)) != pytest.approx(
        float(energy_at(x, model, gel, -1.0, problem.loads)), rel=1e-3
    )

    free, p = problem.free, state_pressure(x, model, gel, mu)
    now, v = linearise(problem, x, p, mu), np.random.default_rng(3).normal(size=len(problem.free))
    field = (free.matrix @ v).reshape(x.shape)
    exact = free.matrix.T @ slope(force, x).ravel()
    product = problem.pattern.matrix(tangent(problem, x, p, now)) @ v
    np.testing.assert_allclose(product, exact, rtol=0, atol=1e-8 * np.abs(exact).max())
    np.testing.assert_allclose(
        condensed_rhs(problem, now, now), -(free.matrix.T @ np.ravel(force(x))), rtol=0, atol=1e-12
    )

    driven = Problem(model, gel, control=Driven(of_groups, (mu,)), contact=False).prepared
    state = solve(driven, 1.0, *dry_state(driven))
    assert state.status.ok and "mu = -1 to -0.6 kT" in repr(state)
    assert abs(slope(energy, jnp.asarray(state.x))) < 1e-9 * abs(float(energy(state.x)))
