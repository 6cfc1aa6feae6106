"""The matrix of a Newton step in time against differences of what it is the derivative of."""

import numpy as np
import pytest

import jaxgel
from jaxgel.mechanics import Bath, linearise, pressure_at, residual, volume_ratios
from jaxgel.transient.problem import transport
from jaxgel.transient.stage import acting_potential, acting_problem, balance_and_rates
from jaxgel.transient.tangent import FlowChange, Tangent, factorised

TAU = 0.02
BATH = Bath(np.array([-0.4, -0.6]), np.array([4.0, 5.0]), np.array([4.0, 5.0]))


@pytest.fixture(scope="module")
def moving():
    """A plate with a free edge that is being wetted: the `Tangent` at some nodes and mu.

    Forces with the opposite sign and missing solvent at unknowns that differ from these; numbers of
    the unknowns.
    """
    hole = jaxgel.Ellipse((0.15, -0.1), (1.2, 0.8), 0.4)
    plate = jaxgel.Plate(4, 4, [hole], edges={"top": "free"}, spacing=0.5, nodes_per_hole=12)
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    problem = jaxgel.Problem(model, jaxgel.Gel(1e-3, 0.1), contact=False).prepared
    of, rng = transport(problem, (0, "top")), np.random.default_rng(0)
    fields, groups = of.saddle.fields, of.saddle.groups
    f, m = fields.shape[1], np.zeros(len(model.carries))
    m[groups] = 0.02 * rng.normal(size=len(groups))
    means = np.concatenate(of.saddle.means)
    m[groups[means]] -= 0.6
    x = np.asarray(jaxgel.sweep(problem, [-1.0]).x[0])
    x = x + 0.01 * (fields @ rng.normal(size=f)).reshape(-1, 2)

    def pressures(x, m):
        J = np.asarray(volume_ratios(x, model))
        return np.asarray(pressure_at(J, model, problem.gel, acting_potential(of, m))), J

    def missed(v):
        at_x, at_m = x + (fields @ v[:f]).reshape(-1, 2), m.copy()
        at_m[groups] += v[f:]
        p, J = pressures(at_x, at_m)
        forces = residual(at_x, model, problem.gel, acting_potential(of, at_m), problem.loads, p)
        missing = balance_and_rates(of, at_x, p, at_m, J - 1, TAU, BATH)[0]
        return np.concatenate([fields.T @ np.ravel(forces), -np.asarray(missing)[groups]])

    (p, J), acting = pressures(x, m), acting_problem(of, m)
    now = linearise(acting, x, p, acting_potential(of, m))
    change = FlowChange.of(of, TAU, now, balance_and_rates(of, x, p, m, J - 1, TAU, BATH)[-1])
    return Tangent(factorised(of, acting, now, x, p, change), change), missed, (f, len(groups))


@pytest.mark.thorough
def test_products_are_differences_of_forces_and_balance(moving):
    """By the positions and by mu."""
    tangent, missed, sizes = moving
    rng, step = np.random.default_rng(1), 1e-6
    for part, size in enumerate(sizes):
        v = np.zeros(sum(sizes))
        v[part * sizes[0] :][:size] = rng.normal(size=size)
        found, quotient = tangent.product(v), (missed(step * v) - missed(-step * v)) / (2 * step)
        for rows in np.split(np.arange(sum(sizes)), [sizes[0]]):
            np.testing.assert_allclose(
                found[rows], quotient[rows], rtol=0, atol=1e-6 * np.abs(quotient[rows]).max()
            )


@pytest.mark.thorough
def test_transposed_products_are_those_of_the_transpose(moving):
    tangent, _, sizes = moving
    v, w = np.random.default_rng(2).normal(size=(2, sum(sizes)))
    assert w @ tangent.product(v) == pytest.approx(tangent.transposed(w) @ v, rel=1e-12)
