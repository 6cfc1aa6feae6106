"""The assembled tangent is the Hessian of the energy, for all kinds of edges and networks."""

import jax.numpy as jnp
import pytest

import jaxgel

EDGES = ("left", "right", "bottom", "top")
ROLLERS, PERIODIC = (
    pytest.param(dict.fromkeys(EDGES, kind), marks=pytest.mark.slow)
    for kind in ("roller", "periodic")
)


@pytest.mark.thorough
@pytest.mark.parametrize("edges", [{"top": "free"}, ROLLERS, PERIODIC])
def test_derivatives_are_those_of_the_energy_for_all_edges(edges, check_derivatives):
    plate = jaxgel.Plate(
        4, 4, [jaxgel.Circle((0.0, 0.0), 1.1)], edges=edges, spacing=2 / 3, nodes_per_hole=12
    )
    check_derivatives(jaxgel.discretise(jaxgel.make_cloud(plate)), jaxgel.Gel())


def stiffening(F, gel):
    """A network whose tangent depends on F."""
    return 0.5 * gel.Nv * jnp.sum(F**2) * (1 + 0.1 * jnp.sum(F**2))


@pytest.mark.slow
def test_derivatives_are_those_of_the_energy_for_a_network_of_a_user(
    square_model, check_derivatives
):
    check_derivatives(square_model, jaxgel.Gel(network=stiffening))
