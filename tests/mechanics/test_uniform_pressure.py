"""Tangent of a plate without holes, all edges moved: linear pressures keep it stable."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from scipy.optimize import brentq

import jaxgel
from jaxgel import Problem
from jaxgel.materials import free_energy, osmotic
from jaxgel.mechanics import linearise, residual, state_pressure, tangent

GEL, MU = jaxgel.Gel(Nv=1e-3, chi=1e-4), -2.0
# Nv
PRESSURES = (45, *(pytest.param(p, marks=pytest.mark.slow) for p in (71, 150, 500, -150)), -600)
EACH_SPACING = [0.25, pytest.param(0.125, marks=pytest.mark.slow)]
# eigenvalue of the tangent over Nv, that of a smooth motion: it has an area per node in it
LOWEST = {0.25: 0.6003, 0.125: 0.15115}


def volume_ratio(p):
    """Volume ratio at which the gel carries the pressure ``p``, kT/v."""
    return brentq(lambda J: float(osmotic(J, MU, GEL)) - p, 1 + 1e-9, 1e3, xtol=1e-14)


@functools.cache
def tangents(over_network, spacing):
    """Tangent and network's form (f, f) over Nv at a uniform pressure of ``over_network`` Nv."""
    stretch = math.sqrt(volume_ratio(over_network * GEL.Nv))
    plate = jaxgel.Plate(
        4, 2, edges="fixed", deformation=((stretch, 0), (0, stretch)), spacing=spacing
    )
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    problem, x = Problem(model, GEL, contact=False).prepared, stretch * model.cloud.nodes
    p = state_pressure(x, model, GEL, MU)
    now = linearise(problem, x, p, MU)
    np.testing.assert_allclose(np.asarray(p)[model.carries], over_network * GEL.Nv, rtol=1e-6)
    # a state of equilibrium: its forces are in balance, too
    assert float(jnp.abs(now.error).max()) < 1e-9
    assert float(now.residual_norm) < 1e-9
    none = dataclasses.replace(now, stiffness=0.0 * now.stiffness)
    return [
        problem.pattern.matrix(tangent(problem, x, *of)).toarray() / GEL.Nv
        for of in ((p, now), (0.0 * p, none))
    ]


@pytest.mark.thorough
@pytest.mark.parametrize("spacing", EACH_SPACING)
@pytest.mark.parametrize("p", PRESSURES)
def test_lowest_eigenvalue_of_the_tangent_is_the_same_at_all_pressures(p, spacing):
    # the volume inside held edges does not depend on the inner nodes; what is left of p is the bulk
    # stiffness: 5e-6 measured
    assert scipy.linalg.eigvalsh(tangents(p, spacing)[0])[0] == pytest.approx(
        LOWEST[spacing], rel=1e-4
    )


@pytest.mark.thorough
@pytest.mark.parametrize("spacing", EACH_SPACING)
@pytest.mark.parametrize("p", PRESSURES)
def test_tangent_costs_no_motion_less_than_the_network_does(p, spacing):
    K, network = tangents(p, spacing)
    least = scipy.linalg.eigh(K, network, eigvals_only=True, subset_by_index=[0, 0])[0]
    # equal where no volume changes, to round-off of the bulk stiffness of some 1e3 Nv
    assert least > 1 - 1e-9


def test_a_traction_balances_a_uniform_stress():
    """Nodal forces of P n on the free edges hold the freely deformed gel."""
    plate = jaxgel.Plate(
        4,
        2,
        edges=dict.fromkeys(("left", "right", "bottom", "top"), "free") | {"bottom": "roller"},
        spacing=0.3,
    )
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    A = jnp.array([[1.3, 0.0], [0.0, 1.1]])
    stress = jax.grad(lambda F: free_energy(F, MU, GEL))(A)
    loads = jaxgel.load_vector(
        model,
        traction={
            "right": stress[:, 0],
            "left": -stress[:, 0],
            "top": stress[:, 1],
            "bottom": -stress[:, 1],
        },
    )
    forces = np.asarray(jax.jit(residual)(model.cloud.nodes @ A, model, GEL, MU, loads))
    np.testing.assert_allclose(forces, 0.0, atol=1e-13 * float(jnp.abs(stress).max()))
