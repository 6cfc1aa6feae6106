"""Surfaces that meet across free and periodic edges: uncrossed, with right derivatives.

States move as differences say.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from crossings import crossed

import jaxgel
from jaxgel.mechanics import touches

pytestmark = pytest.mark.thorough

GEL, RANGE, STEP = jaxgel.Gel(Nv=1e-3, chi=1e-4), 0.1, 1e-4
SLOT = jaxgel.Plate(
    2,
    2,
    [jaxgel.Rectangle((0.9, 0.02), (2.0, 0.3))],
    edges={"right": "free"},
    spacing=0.25,
    nodes_per_hole=24,
)
SEAM = jaxgel.Plate(
    2,
    2,
    [jaxgel.Ellipse((1.0, 0.02), (0.7, 0.35), 0.05)],
    edges="periodic",
    spacing=0.25,
    nodes_per_hole=24,
)
ARMS, ACROSS = "a C whose two arms meet", "a hole across a seam"
PLATES = {ARMS: (SLOT, [-3.0, -2.0, -1.2, -0.8, -0.5]), ACROSS: (SEAM, [-3.0, -2.0, -1.2, -0.9])}


def problem_of(plate, gel=GEL):
    return jaxgel.Problem(jaxgel.discretise(jaxgel.make_cloud(plate)), gel, contact_range=RANGE)


@pytest.mark.slow
@pytest.mark.parametrize("name", [ARMS, ACROSS])
def test_surfaces_that_meet_do_not_cross(name):
    """The slot's sides and the two halves of the free edge beside it are one surface."""
    plate, mu = PLATES[name]
    path = jaxgel.sweep(problem_of(plate), mu)
    assert path.stop.ok and touches(path.x[-1], path.model) and not crossed(path)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLATES)
def test_surfaces_that_meet_move_as_differences_say(name):
    """By the last mu and Nv."""
    plate, mu = PLATES[name]
    model = problem_of(plate).model

    def state(v):
        problem = jaxgel.Problem(model, jaxgel.Gel(v[1], 1e-4), contact_range=RANGE)
        return jaxgel.sweep(problem, jnp.append(jnp.array(mu[:-1]), v[0])).x[-1]

    at, direction = np.array([mu[-1], 1e-3]), np.array([0.1, 1e-4])
    _, moved = jax.jvp(state, (jnp.asarray(at),), (jnp.asarray(direction),))
    x = [
        np.asarray(state(jnp.asarray(at + step * direction)))
        for step in (STEP, -STEP, 2 * STEP, -2 * STEP)
    ]
    difference = (8 * (x[0] - x[1]) - (x[2] - x[3])) / (12 * STEP)
    # of fourth order in the step
    np.testing.assert_allclose(moved, difference, atol=1e-6 * np.abs(difference).max())


def test_without_contact_the_arms_cross():
    plate, mu = PLATES[ARMS]
    problem = problem_of(plate)
    path = jaxgel.sweep(jaxgel.Problem(problem.model, GEL, contact=False), [*mu[:-1], -0.4, -0.3])
    assert crossed(dataclasses.replace(path, problem=problem))
