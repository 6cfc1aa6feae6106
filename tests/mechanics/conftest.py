"""What the tests of all kinematics have in common."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgel import Problem
from jaxgel.equilibrium import State, control_force
from jaxgel.mechanics import (
    curvature,
    gather,
    linearise,
    residual,
    scatter,
    state_pressure,
    tangent,
)


@pytest.fixture(scope="session")
def check_derivatives():
    return derivatives_are_those_of_the_energy


def derivatives_are_those_of_the_energy(model, gel, mu=-1.0):
    """Residual, tangent, force of mu and curvature at a rough state, by JAX from the energy."""
    problem, random, nodes = (
        Problem(model, gel, contact=False).prepared,
        np.random.default_rng(2),
        np.asarray(model.cloud.nodes),
    )
    x = jnp.asarray(
        nodes @ np.array([[1.2, 0.1], [-0.1, 1.15]]).T + 0.02 * random.normal(size=nodes.shape)
    )
    p, v = (
        state_pressure(x, model, problem.gel, mu),
        jnp.asarray(random.normal(size=len(problem.free))),
    )
    now, field = linearise(problem, x, p, mu), scatter(v, problem.free)

    def force(x, mu):
        return jax.jit(residual)(x, model, problem.gel, mu, problem.loads)

    exact, by_mu = (
        gather(jax.jvp(force, (x, mu), dots)[1], problem.free)
        for dots in ((field, 0.0), (jnp.zeros_like(x), 1.0))
    )
    np.testing.assert_allclose(
        gather(-now.rhs, problem.free), gather(force(x, mu), problem.free), atol=1e-13
    )
    assert np.linalg.norm(
        problem.pattern.matrix(tangent(problem, x, p, now)) @ v - exact
    ) < 1e-11 * np.linalg.norm(exact)
    assert np.linalg.norm(
        control_force(problem, State(mu, mu, x, p)) - by_mu
    ) < 1e-11 * np.linalg.norm(by_mu)
    curved = float(jax.jit(curvature)(x, field, model, problem.gel, mu, problem.loads))
    assert curved == pytest.approx(float(v @ exact), rel=1e-11)
