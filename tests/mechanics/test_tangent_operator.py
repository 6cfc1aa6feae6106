"""Products of tangents that are not assembled: those of the Hessian of the energy, for all kinds of edges."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel import Problem
from jaxgel.materials import Gent
from jaxgel.mechanics import (
    STATES_TOGETHER,
    TangentOperator,
    free_dofs,
    gather,
    is_sparse,
    linearise,
    residual,
    scatter,
    state_pressure,
    tangent_product,
)

MU = np.array([-2.0, -1.5, -1.2, -1.0, -0.95])  # more than are made together


def states(model, number):
    """Positions (number, n, 2) of rough states."""
    assert number > STATES_TOGETHER
    random = np.random.default_rng(0)
    nodes = np.asarray(model.cloud.nodes)
    return nodes @ np.array([[1.25, 0.1], [-0.2, 1.2]]).T + 0.02 * random.normal(size=(number, *nodes.shape))


@pytest.mark.parametrize(
    "edges",
    [
        {"top": "free"},
        pytest.param(dict.fromkeys(("left", "right", "bottom", "top"), "roller"), marks=pytest.mark.slow),
        dict.fromkeys(("left", "right", "bottom", "top"), "periodic"),
    ],
    ids=["fixed", "roller", "periodic"],
)
def test_products_are_those_of_the_hessian_of_the_energy(edges, tiny_plate):
    """The Hessian by differentiating the residual, whose network and volumes are integrated point by point."""
    plate = jaxgel.Plate(4, 4, [jaxgel.Circle((0.0, 0.0), 1.1)], edges=edges, spacing=2 / 3, nodes_per_hole=12, gel=tiny_plate.gel)
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    free, x = free_dofs(model.lists.topology), states(model, len(MU))
    v = np.random.default_rng(1).normal(size=len(free))

    @jax.jit
    def exact(x, mu):
        def forces(x):
            return residual(x, model, plate.gel, mu, jnp.zeros_like(x))

        return gather(jax.jvp(forces, (x,), (scatter(jnp.asarray(v), free),))[1], free)

    problem = Problem(model, plate.gel, contact=False).prepared
    pressure = np.stack([state_pressure(jnp.asarray(x), model, plate.gel, mu) for x, mu in zip(x, MU, strict=True)])
    products = TangentOperator(problem).at(x, pressure, np.array(MU))
    for of_state, product in zip(zip(x, MU, strict=True), products, strict=True):
        wanted = exact(*of_state)
        assert np.linalg.norm(product(v) - wanted) < 1e-12 * np.linalg.norm(wanted)
    direct = tangent_product(problem, x[-1], pressure[-1], linearise(problem, x[-1], pressure[-1], MU[-1]), v)
    assert np.linalg.norm(direct - wanted) < 1e-12 * np.linalg.norm(wanted)


def test_only_the_default_kind_of_tangent_has_products(tiny_model):
    gel = jaxgel.Gel()
    assert is_sparse(Problem(tiny_model, gel, contact=False).prepared)
    assert not is_sparse(Problem(tiny_model, jaxgel.Gel(network=Gent(30.0)), contact=False).prepared)
    problem = Problem(tiny_model, gel, contact=False).prepared
    assert not is_sparse(problem.replace(model=dataclasses.replace(tiny_model, contact=object())))
