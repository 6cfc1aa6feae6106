"""The grid convergence index, and error bars of numbers that scatter about a trend."""

import numpy as np
import pytest

import jaxgel
from jaxgel.verification import error_bars

# cells of the published example, two-dimensional
CELIK = np.array([18000.0, 8000.0, 4500.0]) ** -0.5
SIZES = 2.0 ** np.array([0.5, 0.0, -0.25, -0.5])  # distances of the nodes, coarsest first


def test_published_example():
    """Celik et al. 2008, Table 1, column 1: order 1.53, value 6.1685, index 2.2 and 4.11 %."""
    found = jaxgel.grid_convergence_index(CELIK, (6.063, 5.972, 5.863), formal=2.0)
    assert found.order == pytest.approx(1.53, abs=0.005) and found.extrapolated == pytest.approx(
        6.1685, abs=1e-4
    )
    assert (
        found.index == (pytest.approx(0.0217, abs=5e-5), pytest.approx(0.0411, abs=5e-5))
        and found.reason == ""
    )


@pytest.mark.parametrize("order", [1.0, 2.0, 3.7])
def test_exact_order_is_found_and_the_limit_extrapolated(order):
    """Values a + b h^p on grids that are not refined evenly."""
    sizes = np.array([0.1, 0.13, 0.2])
    found = jaxgel.grid_convergence_index(sizes, 3.0 - 2.0 * sizes**order)
    assert found.order == pytest.approx(order, rel=1e-9) and found.extrapolated == pytest.approx(
        3.0, rel=1e-12
    )
    assert found.index[0] == pytest.approx(
        1.25 * 2.0 * sizes[0] ** order / (3.0 - 2.0 * sizes[0] ** order), rel=1e-9
    )


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ((1.0, 1.1, 1.0), "the values oscillate from grid to grid"),
        ((1.0, 1.0, 1.0), "the values differ by round-off alone"),
        ((1.0, 1.1, 1.11), "the observed order is not between 0.5 and 8"),
        (tuple(1 + CELIK**0.7), "the observed order 0.7 is far from the formal one, 2"),
    ],
)
def test_no_index_without_convergence(values, reason):
    """What has no index says why, and has nan in its place."""
    found = jaxgel.grid_convergence_index(CELIK, values, formal=2.0)
    assert found.reason == reason and np.isnan(found.index).all()


def test_sizes_that_do_not_rise_are_refused(refused):
    """Finest first, three of them."""
    rows = [
        ([3.0, 2.0, 1.0], "are not three sizes"),
        ([1.0, 2.0], "are not three sizes"),
        ([0.0, 1.0, 2.0], "are not three sizes"),
    ]
    refused(lambda sizes: jaxgel.grid_convergence_index(sizes, np.ones(len(sizes))), rows)


def test_bars_of_a_trend_without_scatter():
    """Error bars are 1.25 times the distance from the limit, whatever clouds there are."""
    limit, slope = np.array([1.0, -2.0, 0.0]), np.array([0.3, 0.0, -1.0])
    found = error_bars(SIZES, limit + slope * SIZES[:, None] ** 2, 1)
    np.testing.assert_allclose(found.extrapolated, limit, atol=1e-12)
    np.testing.assert_allclose(found.error, 1.25 * np.abs(slope), atol=1e-12)
    np.testing.assert_allclose(found.order, [2.0, np.nan, 2.0], atol=1e-9)


def test_bars_hold_for_values_that_scatter():
    """Of 4000 scattered numbers nine in ten lie within bars of at most four median errors.

    Their scatter falls as their trend.
    """
    random = np.random.default_rng(3)
    slope, scatter = random.normal(size=4000), np.exp(random.uniform(-3, 1, 4000))
    values = SIZES[:, None] ** 2 * (slope + scatter * random.normal(size=(len(SIZES), 4000)))
    found = error_bars(SIZES, values, 1)
    within, ratio = np.abs(found.own) <= found.error, found.error / np.abs(found.own)
    assert within.mean() >= 0.9 and np.median(ratio) <= 4


def test_values_that_are_missing_widen_nothing():
    """A state that one cloud lacks has its bar from the others; with two values there is none."""
    values = np.tile(1 + SIZES[:, None] ** 2, (1, 3))
    values[0, 1], values[[0, 3], 2] = np.nan, np.nan
    found = error_bars(SIZES, values, 1)
    np.testing.assert_allclose(found.error, [1.25, 1.25, np.nan], rtol=1e-9)
    np.testing.assert_allclose(found.order, [2.0, np.nan, np.nan], rtol=1e-9)
