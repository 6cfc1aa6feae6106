"""Derivatives of the paper's symmetric cases after buckling, against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse as sp
from jax.flatten_util import ravel_pytree

import jaxgel
from jaxgel import Problem
from jaxgel.equilibrium import State, with_own_factor
from jaxgel.linalg import nearest_modes

# radii, relative: without any symmetry, so that a plate buckles to the same side with all
# parameters
PERTURBED = {"sample-4": np.array([0.02, -0.02, 0.01, -0.01])}
CASES = {
    "sample-7": ([-3.0, -1.8], jaxgel.rotation_angle),
    "sample-4": ([-1.9, -1.4], jaxgel.rotation_angle),
}
# of central differences: mm, kT/v, 1, kT; their error is 1e-8 to 1e-7
STEPS = dict(shape=1e-5, Nv=2e-5, chi=3e-6, mu=5e-5)


class Objectives:
    """Rotation (degrees) and area reduction (2,) at the last mu by moves of the parameters."""

    def __init__(self, name, cloud):
        (self.mu, self.rotation), self.cloud, self.plate = CASES[name], cloud, cloud.plate
        sizes = 1 + PERTURBED.get(name, np.zeros(len(self.plate.holes)))
        theta = [
            {
                key: jnp.asarray(value) * (size if key == "radius" else 1.0)
                for key, value in hole.theta.items()
            }
            for hole, size in zip(self.plate.holes, sizes, strict=True)
        ]
        self.theta, self.unravel = ravel_pytree(theta)
        self.start = dict(shape=jnp.zeros(len(self.theta)), Nv=0.0, chi=0.0, mu=0.0)
        # of every parameter of every hole
        shape = STEPS["shape"] * np.random.default_rng(7).normal(size=len(self.theta))
        self.steps = STEPS | dict(shape=jnp.asarray(shape))

    def path(self, moved):
        model = jaxgel.discretise(
            self.cloud.at(self.plate.at(self.unravel(self.theta + moved["shape"])))
        )
        gel = jaxgel.Gel(self.plate.gel.Nv + moved["Nv"], self.plate.gel.chi + moved["chi"])
        return jaxgel.sweep(jaxgel.Problem(model, gel), jnp.array(self.mu).at[-1].add(moved["mu"]))

    def __call__(self, moved):
        path = self.path(moved)
        return jnp.stack([self.rotation(path)[-1], jaxgel.area_reduction(path)[-1]])


def round_off(path):
    """Relative difference of two solutions in double precision: 4 condition numbers of round-off.

    With the tangent of the last state, each with a rounded matrix and right-hand side: four times
    its condition number times the unit round-off.
    """
    x, pressure, mu = jnp.asarray(path.x[-1]), jnp.asarray(path.pressure[-1]), float(path.mu[-1])
    factor = with_own_factor(
        Problem(path.model, path.gel, contact=False).prepared, State(mu, mu, x, pressure)
    ).factor
    (softest,), _ = nearest_modes(factor, sp.identity(factor.matrix.shape[0], format="csr"), 1)
    return 4 * np.finfo(float).eps * factor.norm / abs(softest)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_derivatives_on_the_buckled_branch_are_those_of_the_resolved_problem(name, cloud_of):
    objectives = Objectives(name, cloud_of(name))
    start, steps = objectives.start, objectives.steps
    path = objectives.path(start)
    assert path.stop.ok and not path.negative_pivots.any()

    values, pullback = jax.vjp(objectives, start)
    assert abs(values[0]) > 1  # it has buckled
    gradients = [pullback(row)[0] for row in jnp.eye(2)]
    terms = {
        family: np.array([np.ravel(gradient[family] * step) for gradient in gradients])
        for family, step in steps.items()
    }
    scale = sum(np.abs(parts).sum(axis=1) for parts in terms.values())

    forward = jax.jvp(objectives, (start,), (steps,))[1]
    room = max(1e-10, round_off(path)) * scale
    np.testing.assert_array_less(
        np.abs(forward - sum(parts.sum(axis=1) for parts in terms.values())), room
    )

    for moved in [steps, {"Nv": steps["Nv"], "chi": -steps["chi"], "mu": -steps["mu"]}]:
        back = {family: -step for family, step in moved.items()}
        difference = (objectives(start | moved) - objectives(start | back)) / 2
        parts = [
            np.array([np.ravel(gradient[family] * step) for gradient in gradients])
            for family, step in moved.items()
        ]
        # of its terms, where they cancel
        room = 1e-6 * (np.abs(difference) + 1e-2 * sum(np.abs(part).sum(axis=1) for part in parts))
        np.testing.assert_array_less(
            np.abs(sum(part.sum(axis=1) for part in parts) - difference), room
        )
