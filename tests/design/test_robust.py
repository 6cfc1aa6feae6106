"""Robust objectives: mean and standard deviation of a design as made, exact gradients."""

import tomllib

import jax
import numpy as np
import pytest

import jaxgel
from jaxgel.cases import study_from_table
from jaxgel.design import Spread
from jaxgel.design.search import Search

STUDY = """
plate = { width = 4.0, height = 4.0, edges = { top = "free" } }
holes = [{ kind = "circle", centre = [0.1, -0.2], radius = 1.1 }]
gel = { Nv = 1e-3, chi = 1e-4 }
sweep = { mu = [-3.0] }
discretisation = { spacing = 0.5, nodes_per_hole = 12 }
parameters = [{ of = "radius", lower = 0.8, upper = 1.3 }]
objective = [{ of = "area_reduction", goal = "maximise", at = -3.0 }]
robust = { uncertainty = { radius = "2 %", Nv = "10 %" }, samples = 3, weight = 2.0 }
"""


def study(*changes):
    table = tomllib.loads(STUDY)
    for section, entries in changes:
        table[section] = table[section] | entries
    return study_from_table(table, "small")


def test_the_objective_is_the_mean_less_some_deviations():
    values, spread = (
        np.array([1.0, 2.0, 4.0]),
        Spread(lambda plate, gel, e: (plate, gel), np.zeros((3, 1)), 2.0),
    )
    mean, deviation = values.mean(), values.std(ddof=1)
    assert float(spread.objective(values, maximise=True)) == pytest.approx(mean - 2 * deviation)
    assert float(spread.objective(values, maximise=False)) == pytest.approx(mean + 2 * deviation)
    alike = jax.grad(lambda v: spread.objective(v * np.ones(3), maximise=True))(1.5)
    assert float(alike) == 1.0  # no deviation, and no nan of its root


@pytest.mark.slow
def test_gradients_of_a_robust_objective_are_differences():
    """By the radius, of three samples with errors of radius and Nv."""
    problem = study().problem
    search = Search(problem, 3)
    search.first()
    slope = search.at(problem.vector).gradient(np.eye(1)[0])[0]
    step = 4e-6  # 2e-6 mm: beyond it the kinks of the weights
    up, down = (search.at(problem.vector + sign * step).values[0] for sign in (1, -1))
    assert slope == pytest.approx((up - down) / (2 * step), rel=1e-6)


def test_samples_have_the_given_deviations():
    """Of the radius and of Nv as shares of the case's own values.

    The design and its errors add up.
    """
    problem = study(("robust", {"samples": 256})).problem
    plate = problem.plate(problem.start)
    made = [problem.spread.change(plate, problem.gel, errors) for errors in problem.spread.errors]
    radii, chains = np.array(
        [(float(plate.holes[0].radius), float(gel.Nv)) for plate, gel in made]
    ).T
    np.testing.assert_allclose([radii.mean(), chains.mean()], [1.1, 1e-3], rtol=2e-3)
    np.testing.assert_allclose([radii.std(), chains.std()], [0.022, 1e-4], rtol=0.03)


@pytest.mark.slow
def test_the_verification_judges_by_the_same_samples():
    """Value on the same spacing: mean less two deviations of the swollen samples."""
    found = study()
    problem = found.problem
    verified, path = found.verify(problem.start, spacing=0.5)
    values = [
        float(jaxgel.area_reduction(one)[-1])
        for one in problem.as_made(problem.start, path.model.cloud, problem.refined)
    ]
    assert len(values) == 3 and verified["value"] == pytest.approx(
        np.mean(values) - 2 * np.std(values, ddof=1)
    )


@pytest.mark.slow
def test_wrong_entries_are_refused(refused):
    rows = [
        (("robust", {"uncertainty": {"radios": 0.1}}), "radios"),
        (("robust", {"weight": -1.0}), "robust.weight: -1.0"),
        (("robust", {"samples": 1}), "robust.samples: 1"),
    ]
    refused(study, rows)
    refused(
        lambda errors: Spread(lambda plate, gel, e: (plate, gel), errors),
        [(np.zeros((1, 2)), "errors: an array of shape")],
    )
