"""The assembled tangent is the Hessian of the energy, for all kinds of edges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel import Problem
from jaxgel.mechanics import gather, linearise, residual, scatter, state_pressure, tangent

EDGES = ("left", "right", "bottom", "top")


@pytest.mark.parametrize("edges", [{"top": "free"}, dict.fromkeys(EDGES, "roller"), dict.fromkeys(EDGES, "periodic")])
def test_tangent_is_the_hessian_of_the_energy(edges, tiny_plate):
    """At a rough state, by differentiating the residual, whose volumes are integrated point by point."""
    hole = jaxgel.Circle((0.0, 0.0), 1.1)
    plate = jaxgel.Plate(4, 4, [hole], edges=edges, spacing=2 / 3, nodes_per_hole=12, gel=tiny_plate.gel)
    model, random, mu = jaxgel.discretise(jaxgel.make_cloud(plate)), np.random.default_rng(0), -1.5
    problem, nodes = Problem(model, plate.gel, contact=False).prepared, np.asarray(model.cloud.nodes)
    x = nodes @ np.array([[1.25, 0.1], [-0.2, 1.2]]).T + 0.02 * random.normal(size=nodes.shape)
    v, pressure = random.normal(size=len(problem.free)), state_pressure(jnp.asarray(x), model, plate.gel, mu)
    forces = jax.jit(lambda x: residual(x, model, plate.gel, mu, jnp.zeros_like(x)))
    exact = gather(jax.jvp(forces, (jnp.asarray(x),), (scatter(jnp.asarray(v), problem.free),))[1], problem.free)
    K = problem.pattern.matrix(tangent(problem, x, pressure, linearise(problem, x, pressure, mu)))
    assert np.linalg.norm(K @ v - exact) < 1e-12 * np.linalg.norm(exact)
