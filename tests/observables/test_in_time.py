"""Observables of transient swelling: interpolation, uptake, potential and flux."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.mechanics import all_volumes, volume_ratios
from jaxgel.observables import (
    at_time,
    flux_at,
    inflow,
    mean_volume_ratio,
    potential_at,
    solvent_flux,
    solvent_potential,
    time_to,
    uptake,
    uptake_fraction,
)

pytestmark = pytest.mark.thorough

GEL = jaxgel.Gel(1e-3, 0.1)
KINK = 0.1  # time at which the ramp of the top edge's bath ends


@pytest.fixture(scope="module")
def end(in_time):
    """Its equilibrium before and after."""
    return jaxgel.sweep(jaxgel.Problem(in_time.model, in_time.gel, contact=False), [-3.0, -1.5])


def at_times(path, times):
    """The path with other times, for quantities that are given as arrays.

    Its states have no meaning then.
    """
    numbers = np.arange(len(times)) % len(path)
    return dataclasses.replace(path[numbers], value=np.asarray(times))


def smooth(t):
    """As after a jump of the bath at time 0, and the slope of a ramp that ends at the kink."""
    return 1 - np.exp(-np.sqrt(t)) * np.cos(t) + np.maximum(t - KINK, 0.0) ** 1.5


def test_the_interpolation_is_of_fourth_order_from_one_kink_to_the_next(in_time):
    """From a span's thousandth to its end errors fall by 2^3.8, those of rates by 2^3."""
    errors, of_rates = [], []
    for n in (20, 40):
        spans = [
            start + np.geomspace(1e-3 * length, length, 3 * n + 1)
            for start, length in ((0.0, KINK), (KINK, 4.0))
        ]
        path = at_times(in_time, np.concatenate([[0.0], *spans]))
        between = np.geomspace(2e-4, 4.0, 300)
        errors.append(np.abs(at_time(path, smooth(path.value), between) - smooth(between)).max())
        times, step = path.value[path.value > KINK][3:-1], 1e-5
        exact = (smooth(times + step * times) - smooth(times - step * times)) / (2 * step * times)
        rate = inflow(dataclasses.replace(path, supplied=smooth(path.value)[:, None]))[:, 0]
        of_rates.append(np.abs(rate[path.value > KINK][3:-1] - exact).max())
    assert np.log2(errors[0] / errors[1]) > 3.6 and errors[1] < 1e-4
    assert np.log2(of_rates[0] / of_rates[1]) > 2.7 and of_rates[1] < 1e-2


def test_what_the_variables_of_the_interpolation_span_is_exact(in_time):
    """Cubic polynomials in the root of time near time 0, in its logarithm later.

    Linear functions between two states.
    """
    path = at_times(in_time, [0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06])
    root = 1 + 2 * np.sqrt(path.value) - path.value**1.5
    assert at_time(path, root, [0.003, 0.015]) == pytest.approx(
        [1 + 2 * t**0.5 - t**1.5 for t in (0.003, 0.015)], abs=1e-13
    )
    late = at_times(in_time, [0.01, 0.02, 0.03, 0.04])
    cubic = np.log(late.value) ** 3
    assert at_time(late, np.stack([cubic, -cubic], axis=1), 0.025) == pytest.approx(
        np.log(0.025) ** 3 * np.array([1, -1]), rel=1e-13
    )
    # of four times 0.01: half of its logarithm
    middle = float(at_time(late[[0, 3]], cubic[[0, 3]], 0.02))
    assert middle == pytest.approx((cubic[0] + cubic[3]) / 2, rel=1e-13)
    around = at_times(in_time, [0.05, 0.15])  # the kink lies between
    assert float(at_time(around, np.array([1.0, 2.0]), 0.075)) == pytest.approx(1.25, rel=1e-13)
    assert at_time(path, root, path.value) == pytest.approx(root, abs=1e-14)


def test_the_time_to_a_value_is_the_inverse_of_the_value_at_a_time(in_time):
    """Also of a falling quantity, of one at its first value, and of the first of two times."""
    path = at_times(in_time, np.concatenate([[0.0], np.geomspace(1e-3, 4.0, 40)]))
    rising = np.sqrt(path.value)
    assert float(time_to(path, rising, 0.5)) == pytest.approx(0.25, rel=1e-5)
    assert float(time_to(path, -rising, -1e-2)) == pytest.approx(1e-4, rel=1e-12)
    assert float(time_to(path, rising, 0.0)) == 0.0
    humped = np.sin(path.value)
    assert float(time_to(path, humped, 0.8)) == pytest.approx(np.arcsin(0.8), rel=1e-3)
    half = uptake(in_time)[-1] / 2
    assert float(at_time(in_time, "uptake", time_to(in_time, "uptake", half))) == pytest.approx(
        float(half), rel=1e-12
    )
    assert float(time_to(in_time, lambda path: path.supplied[:, 0], half)) > time_to(
        in_time, uptake, half
    )


def test_derivatives_of_times_and_values_are_those_of_differences(in_time):
    """First and second ones of the time to a value, by the value and the quantity.

    Central differences, error 1e-7 of the first.
    """
    direction = np.cos(np.arange(len(in_time)))

    def time(step, value):
        return time_to(in_time, jnp.asarray(uptake(in_time)) * (1 + 0.1 * step * direction), value)

    point = 0.0, float(uptake(in_time)[-1]) / 3
    for number, h in ((0, 1e-4), (1, 1e-4 * point[1])):
        moved = [[p + sign * h * (i == number) for i, p in enumerate(point)] for sign in (1, -1)]
        ahead, behind = (float(time(*at)) for at in moved)
        slope = float(jax.grad(time, number)(*point))
        assert slope == pytest.approx((ahead - behind) / (2 * h), rel=1e-6)
        second = float(jax.grad(jax.grad(time, number), number)(*point))
        of_slopes = [float(jax.grad(time, number)(*at)) for at in moved]
        assert second == pytest.approx((of_slopes[0] - of_slopes[1]) / (2 * h), rel=1e-5)
    value = jax.grad(lambda t: at_time(in_time, "uptake", t))(0.5)
    ahead, behind = (float(at_time(in_time, "uptake", 0.5 + sign * 1e-5)) for sign in (1, -1))
    assert float(value) == pytest.approx((ahead - behind) / 2e-5, rel=1e-7)
    assert np.isnan(jax.jit(lambda value: time_to(in_time, "uptake", value))(1.0))


@pytest.mark.slow
def test_observables_are_differentiable_in_the_arrays_of_a_path(in_time, end):
    """Forward and reverse derivatives of a number of all of them agree, and differences."""
    arrays = {
        name: np.asarray(getattr(in_time, name))
        for name in ("x", "pressure", "potential", "supplied")
    }
    rng = np.random.default_rng(0)
    along = {
        name: 1e-3 * rng.normal(size=v.shape) * np.std(v, axis=0).mean()
        for name, v in arrays.items()
    }
    points = [[-0.45, 0.4], [0.35, 0.1]]

    def number(arrays):
        path = dataclasses.replace(in_time, **arrays)
        values = [
            mean_volume_ratio(path)[-3],
            uptake_fraction(path, end)[4],
            jnp.sum(inflow(path)[5]),
            potential_at(path, points)[6, 1],
        ]
        fluxes = [
            jnp.sum(solvent_flux(path)[4] ** 2),
            flux_at(path, points)[5, 0, 0],
            time_to(path, "uptake", 0.05),
        ]
        return sum((k + 1) * value for k, value in enumerate(values + fluxes))

    slope, by_reverse = jax.jvp(number, (arrays,), (along,))[1], jax.grad(number)(arrays)
    assert sum(np.vdot(by_reverse[name], along[name]) for name in arrays) == pytest.approx(
        float(slope), rel=1e-9
    )
    h = 1e-2
    ahead, behind = (
        float(number({name: v + sign * h * along[name] for name, v in arrays.items()}))
        for sign in (1, -1)
    )
    assert float(slope) == pytest.approx((ahead - behind) / (2 * h), rel=1e-5)


def test_the_uptake_is_the_growth_of_the_gel_and_the_fraction_ends_at_one(in_time, end):
    """Mean swelling ratio times dry area, to the balance; a part of a path has equal fractions."""
    volumes = np.where(
        np.asarray(in_time.model.carries), np.asarray(all_volumes(in_time.model)), 0.0
    )
    area = np.array([volumes @ np.asarray(volume_ratios(x, in_time.model)) for x in in_time.x])
    assert np.abs(uptake(in_time) - area + area[0]).max() < 1e-10
    # of moments over patches, and of points
    assert mean_volume_ratio(in_time) == pytest.approx(area / volumes.sum(), rel=1e-9)
    share = np.asarray(uptake_fraction(in_time, end))
    assert (
        share[0] == 0
        and share[-1] == pytest.approx(1.0, abs=1e-4)
        and (np.diff(share)[:-8] > 0).all()
    )
    assert uptake_fraction(in_time[5:], end[-1]) == pytest.approx(share[5:], rel=1e-11)


def test_the_inflow_adds_up_to_the_uptake(in_time):
    """Integral of its interpolation, 2 % at three steps a decade; nan at time 0.

    There that of a jump is infinite.
    """
    rate, fine = np.asarray(inflow(in_time)), np.geomspace(in_time.t[1], in_time.t[-1], 1000)
    assert (
        rate.shape == (len(in_time), 2) and np.isnan(rate[0]).all() and np.isfinite(rate[1:]).all()
    )
    rates = np.asarray(at_time(in_time[1:], rate[1:], fine))
    supplied = np.diff(fine) @ (rates[1:] + rates[:-1]) / 2
    assert supplied == pytest.approx(in_time.supplied[-1] - in_time.supplied[1], rel=0.02)


def test_the_potential_at_points_is_that_of_bath_and_cells(in_time, end):
    """On wetted outlines the bath's own, inside between the values of the cells around.

    At time 0 that of the start.
    """
    nodes = np.asarray(in_time.model.nodes)
    node = nodes[np.argmin(np.linalg.norm(nodes - [0.0, 0.5], axis=1))]
    mu = np.asarray(potential_at(in_time, [node.tolist(), [0.0, 0.35], [0.45, -0.45]]))
    assert mu[1:, 0] == pytest.approx(
        np.interp(in_time.value[1:], [0.0, KINK], [-2.5, -1.5]), abs=1e-9
    )
    assert mu[0] == pytest.approx([-3.0] * 3, abs=1e-9) and mu[-1] == pytest.approx(
        [-1.5] * 3, abs=1e-3
    )
    cells = np.asarray(solvent_potential(in_time))
    assert (cells.min(axis=1) < mu[:, 1] + 1e-12).all() and (
        mu[:, 1] < cells.max(axis=1) + 1e-12
    ).all()
    assert solvent_potential(end).tolist() == [[mu] * in_time.model.n_cells for mu in end.mu]


def test_what_has_no_value_in_time_is_refused(in_time, end, refused):
    rows = [
        (uptake, end, "path: its states are in equilibrium; give a path in time"),
        (lambda path: at_time(path, "J_mean", 1.0), end, "path: its states are in equilibrium"),
        (
            lambda path: at_time(path, "J_mean", 11.0),
            in_time,
            "t: 11 is beyond the path, which runs from 0 to 10; give a time within",
        ),
        (lambda path: at_time(path, "status", 1.0), in_time, "quantity: 'status' is not one of mu"),
        (
            lambda path: at_time(path, np.zeros(3), 1.0),
            in_time,
            r"quantity: has the shape \(3,\), it must have a row for each of",
        ),
        (
            lambda path: time_to(path, "uptake", 1.0),
            in_time,
            r"value: uptake does not reach 1, its values until t = 10 are between 0 and ",
        ),
        (
            lambda path: time_to(path, lambda path: path.x, 1.0),
            in_time,
            r"quantity: has the shape \(\d+, \d+, 2\), it must be",
        ),
        (
            lambda path: potential_at(path, [[0.0, 0.0]]),
            in_time,
            r"points: \(0, 0\) is not in the dry gel",
        ),
        (
            lambda path: flux_at(path, [[5.0, 0.0]]),
            in_time,
            r"points: \(5, 0\) is not in the dry gel",
        ),
        (
            lambda path: uptake_fraction(path, 1.0),
            in_time,
            "end: an argument of the kind float is not accepted; give a state",
        ),
        (lambda path: inflow(path[:1]), in_time, "path: has one state, a rate needs two at least"),
    ]
    refused(lambda function, path: function(path), rows, start=True)


@pytest.mark.slow
def test_the_time_to_an_uptake_is_differentiated_through_the_steps():
    """By the diffusivity and the end of a ramp of the bath, with inflow, potential and flux.

    Central differences.
    """
    plate = jaxgel.Plate(0.8, 1.0, edges={"top": "free"})
    problem = jaxgel.Problem(
        jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.2)), GEL, contact=False
    )

    def number(D, mu):
        bath = jaxgel.Bath([-0.5, mu], times=[0.0, 0.1])
        path = jaxgel.swell(problem, bath, [0.01, 0.03, 0.1, 0.3, 1.0], start=-0.5, D=D)
        total = (
            time_to(path, "uptake", 0.02)
            + time_to(path, "J_mean", 1.42)
            + 0.1 * jnp.sum(inflow(path)[1:])
        )
        return total + 0.1 * solvent_flux(path)[3, 2, 1] + potential_at(path, [[0.1, 0.3]])[3, 0]

    slopes, point, h = jax.grad(number, (0, 1))(1.0, -0.4), (1.0, -0.4), 1e-4
    for i, slope in enumerate(slopes):
        ahead, behind = (
            float(number(*(p + sign * h * (i == k) for k, p in enumerate(point))))
            for sign in (1, -1)
        )
        assert float(slope) == pytest.approx((ahead - behind) / (2 * h), rel=1e-5)
