"""Derivative-based global sensitivity measures: closed forms and SALib."""

import itertools

import numpy as np
import pytest

from jaxgel.cases import sensitivity

A, B = 7.0, 0.1  # of the Ishigami function


def ishigami(x):
    return np.sin(x[:, 0]) + A * np.sin(x[:, 1]) ** 2 + B * x[:, 2] ** 4 * np.sin(x[:, 0])


def gradients(x):
    u, v, w = x.T
    return np.column_stack(
        [np.cos(u) * (1 + B * w**4), A * np.sin(2 * v), 4 * B * w**3 * np.sin(u)]
    )


def midpoints(lower, upper, number):
    return lower + (upper - lower) * (np.arange(number) + 0.5) / number


def test_the_measures_of_the_ishigami_function_have_their_closed_form():
    # exact for sines and cosines
    axes = [midpoints(-np.pi, np.pi, number) for number in (8, 8, 400)]
    x = np.array(list(itertools.product(*axes)))
    found = sensitivity(gradients(x), ishigami(x), [(-np.pi, np.pi)] * 3, ["u", "v", "w"])
    mean_squares = [
        (1 + 2 * B * np.pi**4 / 5 + B**2 * np.pi**8 / 9) / 2,
        A**2 / 2,
        8 * B**2 * np.pi**6 / 7,
    ]
    # midpoints of w^6 and w^8
    np.testing.assert_allclose(found.mean_squares, mean_squares, rtol=1e-4)
    variance = A**2 / 8 + B * np.pi**4 / 5 + B**2 * np.pi**8 / 18 + 0.5
    assert found.variance == pytest.approx(variance, rel=1e-4)
    first, interaction = (1 + B * np.pi**4 / 5) ** 2 / 2, 8 * B**2 * np.pi**8 / 225
    totals = np.array([first + interaction, A**2 / 8, interaction]) / variance
    assert np.all(found.total_bounds >= totals)
    np.testing.assert_allclose(found.total_bounds, 4 * np.array(mean_squares) / variance, rtol=1e-4)


def test_the_bound_is_sharp_for_half_a_cosine():
    lower, upper = 0.5, 3.0
    x = midpoints(lower, upper, 16)[:, None]
    phase = np.pi * (x - lower) / (upper - lower)
    found = sensitivity(
        -np.pi / (upper - lower) * np.sin(phase), np.cos(phase[:, 0]), [(lower, upper)]
    )
    np.testing.assert_allclose(found.total_bounds, [1.0], rtol=1e-12)  # its total index


@pytest.mark.filterwarnings("ignore")  # of SALib's own
def test_the_measures_are_those_of_salib_in_the_limit_of_small_differences():
    finite_diff = pytest.importorskip("SALib.sample.finite_diff")
    from SALib.analyze import dgsm

    problem = {"num_vars": 3, "names": ["u", "v", "w"], "bounds": [[-np.pi, np.pi]] * 3}
    x = finite_diff.sample(problem, 64, delta=1e-7, seed=1)
    theirs = dgsm.analyze(problem, x, ishigami(x), seed=1)
    base = x[:: problem["num_vars"] + 1]
    ours = sensitivity(gradients(base), ishigami(base), problem["bounds"])
    # differences of a step of 6e-7
    np.testing.assert_allclose(ours.mean_squares, theirs["vi"], rtol=1e-4)
    np.testing.assert_allclose(ours.total_bounds, theirs["dgsm"], rtol=1e-4)


def test_unusable_samples_are_refused(refused):
    refused(
        sensitivity,
        [
            (
                [[1.0]],
                [1.0],
                [(0, 1)],
                r"give gradients \(p, d\), values \(p,\) and bounds \(d, 2\), with p of at least 2",
            ),
            (
                [[1.0], [1.0]],
                [1.0, 2.0],
                [(0, 1), (0, 1)],
                r"arrays of the shapes \(2, 1\), \(2,\) and \(2, 2\) are not accepted",
            ),
            ([[1.0], [np.nan]], [1.0, 2.0], [(0, 1)], "are not finite, or all values are equal"),
            ([[1.0], [1.0]], [2.0, 2.0], [(0, 1)], "are not finite, or all values are equal"),
        ],
    )
