"""Conformal motions must cost energy, or outlines become noisy.

For p near -Nv those that the volumes do not see are free. With the pressure -Nv everywhere the
second variation of the mixed form at the dry state is, on motions u without change of any volume
that is carried, Nv/2 [(u1,1 - u2,2)^2 + (u1,2 + u2,1)^2], the network's form plus that of p
det(grad u), and what is held. In the continuum its quotient by the network's form is bounded from
below (Korn's inequality). The pair of displacements and pressures has an inf-sup constant.
"""

import dataclasses
import functools

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import jaxgel
from jaxgel import Problem
from jaxgel.mechanics import all_volumes, linearise, tangent

GEL = jaxgel.Gel(Nv=1e-3, chi=1e-4)

# of the network's form; 0.67 measured on the finest of the clouds below, falling by 0.01 from the
# one before
LEAST = 0.5
# 0.585 to 0.604 measured on all clouds but the coarsest, half of whose squares are single
LEAST_INF_SUP = 0.5
ROUND_OFF = 1e-9  # of singular values


@functools.cache
def round_hole(spacing, nodes_per_hole):
    """A plate of 6 x 6 mm with one round hole 1.6 mm in radius."""
    plate = jaxgel.Plate(
        6, 6, [jaxgel.Circle((0.0, 0.0), 1.6)], spacing=spacing, nodes_per_hole=nodes_per_hole
    )
    return jaxgel.discretise(jaxgel.make_cloud(plate))


@functools.cache
def large_hole(nodes_per_hole):
    """One hole of sample 1 with its spacing: semi-axes 5 and 4 mm in 12.1 x 12.1 mm.

    40 nodes on the outline are sample 1's own.
    """
    plate = jaxgel.Plate(
        12.1,
        12.1,
        [jaxgel.Ellipse((0.0, 0.0), (5.0, 4.0))],
        spacing=0.55,
        nodes_per_hole=nodes_per_hole,
    )
    return jaxgel.discretise(jaxgel.make_cloud(plate))


def forms(model):
    """Dry state, p = -Nv: stabilised form (f, f), network's (f, f), scaled constraints (g, f)."""
    problem, carries, volumes = (
        Problem(model, GEL, contact=False).prepared,
        model.carries,
        np.asarray(all_volumes(model)),
    )
    x, p = model.cloud.nodes, jnp.where(carries, -GEL.Nv, 0.0)
    now = linearise(problem, x, p, -2.0)
    held = dataclasses.replace(
        now, stiffness=jnp.where(problem.shared.model.carries, 0.0, now.stiffness)
    )
    none = dataclasses.replace(now, stiffness=0.0 * now.stiffness)
    form, network = (
        problem.pattern.matrix(tangent(problem, x, *of)).toarray()
        for of in ((p, held), (0.0 * p, none))
    )
    now = now.cut(model)
    rows = [np.zeros((*G.shape[:2], model.n_nodes, 2)) for G in now.gradients]
    for row, G, block in zip(rows, now.gradients, model.blocks, strict=True):
        c, g = np.ogrid[: G.shape[0], : G.shape[1]]
        np.add.at(
            row,
            (c[:, :, None], g[:, :, None], np.asarray(block.nodes)[:, None, :]),
            np.asarray(G).swapaxes(2, 3),
        )
    G = np.concatenate([row.reshape(-1, 2 * model.n_nodes) for row in rows])[
        :, np.asarray(problem.free.masters)
    ]
    return form, network, (G / np.sqrt(volumes)[:, None])[carries]


def least_quotient(model):
    """Smallest quotient of the form and the network's over motions without volume change."""
    form, network, constraints = forms(model)
    motions = scipy.linalg.null_space(constraints, rcond=ROUND_OFF)
    return scipy.linalg.eigh(
        motions.T @ form @ motions,
        motions.T @ network @ motions,
        eigvals_only=True,
        subset_by_index=[0, 0],
    )[0]


def inf_sup(model):
    """Smallest (q, div u) / (|grad u| |q|) over q for the best u: a singular value.

    q are pressures; it is one of the constraints. The four volumes of a linear patch are those of
    three moments, so that one singular value per linear patch is zero.
    """
    _, network, constraints = forms(model)
    root = np.linalg.cholesky(network / GEL.Nv)
    values = np.linalg.svd(
        scipy.linalg.solve_triangular(root, constraints.T, lower=True), compute_uv=False
    )
    count = len(values) - model.lists.linear.sum()
    assert np.all(values[count:] < ROUND_OFF)
    return values[count - 1]


REFINEMENT = [
    (0.75, 14),
    (0.375, 28),
    *(pytest.param(*sizes, marks=pytest.mark.slow) for sizes in ((0.5, 20), (0.25, 40))),
]


@pytest.mark.slow
@pytest.mark.parametrize(("spacing", "nodes_per_hole"), REFINEMENT)
def test_conformal_motions_cost_energy_under_refinement(spacing, nodes_per_hole):
    # 0.80, 0.69, 0.71, 0.67 measured
    assert least_quotient(round_hole(spacing, nodes_per_hole)) > LEAST


@pytest.mark.slow
@pytest.mark.parametrize(("spacing", "nodes_per_hole"), REFINEMENT)
def test_displacements_and_pressures_have_an_inf_sup_constant_under_refinement(
    spacing, nodes_per_hole
):
    # 0.503, 0.596, 0.604, 0.585 measured
    assert inf_sup(round_hole(spacing, nodes_per_hole)) > LEAST_INF_SUP


@pytest.mark.slow
@pytest.mark.parametrize("nodes_per_hole", [20, 40, 80, 120, 160])
def test_conformal_motions_cost_energy_with_few_and_many_outline_nodes(nodes_per_hole):
    """Squares are halved along an outline with many."""
    # 0.69, 0.69, 0.69, 0.68, 0.68 measured
    assert least_quotient(large_hole(nodes_per_hole)) > LEAST


MANY = [(0.75, 28), *(pytest.param(0.5, number, marks=pytest.mark.slow) for number in (60, 120))]


@pytest.mark.slow
@pytest.mark.parametrize(("spacing", "nodes_per_hole"), MANY)
def test_conformal_motions_cost_energy_with_two_to_six_outline_nodes_to_a_square(
    spacing, nodes_per_hole
):
    # 0.71 measured with three and six
    assert least_quotient(round_hole(spacing, nodes_per_hole)) > LEAST


@pytest.mark.slow
def test_conformal_motions_are_soft_with_many_outline_nodes_around_large_squares(monkeypatch):
    """What the tests above can find, on clouds whose squares are not halved."""
    monkeypatch.setattr("jaxgel.cloud.outlines.CROWDED", np.inf)
    assert least_quotient(large_hole.__wrapped__(120)) < LEAST  # 0.47 measured
