"""Homogeneous states, spinodals and coexistence, against root finding and equal areas."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

from jaxgel.materials import (
    Composite,
    Gel,
    Gent,
    Pnipam,
    Polyelectrolyte,
    coexistence,
    free_swelling,
    homogeneous_states,
    isotropic_swelling,
    limits_of_stability,
    uniaxial_swelling,
)

# stretch over the other two
NETWORK = {
    "isotropic": lambda J: J ** (-1 / 3),
    "plane strain": lambda J: 1.0,
    "uniaxial": lambda J: J,
}
FIRST = {
    "isotropic": lambda *a: isotropic_swelling(*a) ** 3,
    "plane strain": lambda *a: free_swelling(*a) ** 2,
    "uniaxial": uniaxial_swelling,
}
RANGE = (20.0, 45.0)  # degrees Celsius
CASE = (0.01, "isotropic")
OTHERS = [(0.001, "plane strain"), (0.001, "uniaxial")]
MORE = [(0.001, "isotropic"), (0.01, "plane strain"), (0.05, "isotropic")]


def slow(cases):
    return [pytest.param(*case, marks=pytest.mark.slow) for case in cases]


def slope(J, temperature, Nv, swelling):
    """W'(J) after Cai & Suo (2011): network stress over two stretches, and the mixture.

    The stress is that in a swelling direction, over the other two stretches.
    """
    kelvin = temperature + 273.15
    chi0, chi1 = -12.947 + 0.04496 * kelvin, 17.92 - 0.0569 * kelvin
    return (
        Nv * (NETWORK[swelling](J) - 1 / J)
        + np.log1p(-1 / J)
        + 1 / J
        + (chi0 - chi1) / J**2
        + 2 * chi1 / J**3
    )


def temperature_of(J, Nv, swelling, mu=0.0):
    """The temperature at which ``J`` is in equilibrium: W' is linear in it."""
    at = [slope(J, T, Nv, swelling) - mu for T in (0.0, 1.0)]
    return at[0] / (at[0] - at[1])


def roots(function, J):
    values = function(J)
    return [
        brentq(function, J[k], J[k + 1], xtol=1e-14, rtol=1e-14)
        for k in np.flatnonzero(values[:-1] * values[1:] < 0)
    ]


def states(temperature, Nv, swelling, mu=0.0):
    return roots(
        lambda J: slope(J, temperature, Nv, swelling) - mu, 1 + np.geomspace(1e-6, 1e3, 4000)
    )


def extremes(Nv, swelling, mu=0.0):
    """The limits (temperature, J), lower first: least and largest T(J) between its ends."""
    scan = 1 + np.geomspace(0.15, 100, 4000)  # at J = 1.117 no temperature matters
    T = temperature_of(scan, Nv, swelling, mu)
    found = []
    for k in np.flatnonzero((np.diff(T)[:-1] < 0) != (np.diff(T)[1:] < 0)) + 1:
        sign = 1 if T[k] < T[k - 1] else -1
        best = minimize_scalar(
            lambda J, sign=sign: sign * temperature_of(J, Nv, swelling, mu),
            bounds=scan[[k - 1, k + 1]],
            method="bounded",
            options={"xatol": 1e-9},
        )
        found.append((sign * best.fun, best.x))
    return sorted(found)


def equal_areas(Nv, swelling, low, high):
    """Temperature of equal areas on either side of mu = 0, between the limits, by quadrature."""

    def area(temperature):
        first, _, last = states(temperature, Nv, swelling)
        return quad(
            slope,
            first,
            last,
            args=(temperature, Nv, swelling),
            epsabs=1e-15,
            epsrel=1e-13,
            limit=200,
        )[0]

    inside = 0.05 * (high - low)  # three states on either side
    return brentq(area, low + inside, high - inside, xtol=1e-13)


# --- states ---------------------------------------------------------------------------------------


FEW = (31.9, 45.0)  # three states and one


@pytest.mark.slow
@pytest.mark.parametrize(
    ("Nv", "swelling", "temperatures"),
    [
        *((Nv, swelling, FEW) for Nv, swelling in (CASE, OTHERS[1])),
        *(
            pytest.param(*case, (15.0, 30.71, 31.9, 32.2, 33.0, 45.0), marks=pytest.mark.slow)
            for case in (CASE, *OTHERS, *MORE)
        ),
    ],
)
def test_all_states_of_pnipam_are_those_of_scalar_root_finding(Nv, swelling, temperatures):
    counts = set()
    for temperature in temperatures:
        for mu in (0.0, -0.001):
            found, expected = (
                homogeneous_states(Pnipam(Nv, temperature), mu, swelling),
                states(temperature, Nv, swelling, mu),
            )
            np.testing.assert_allclose(found.J, expected, rtol=1e-10)
            np.testing.assert_array_equal(found.stable, [True, False, True][: len(expected)])
            from_dry = FIRST[swelling](mu, Pnipam(Nv, temperature))
            on_the_way = slope(np.linspace(1.001, expected[0], 4000), temperature, Nv, swelling)
            if np.all(np.diff(on_the_way) > 0):
                np.testing.assert_allclose(from_dry, found.J[0], rtol=1e-10)
            else:
                # the state connected with the dry one has ended at a lower mu
                assert np.isnan(from_dry)
            counts.add(len(expected))
    assert counts == {1, 3}


def test_the_swollen_state_is_the_phase_below_the_transition_and_the_shrunken_one_above():
    for temperature, phase in ((31.7, 2), (32.6, 0)):
        assert np.argmin(homogeneous_states(Pnipam(temperature=temperature)).energy) == phase


@pytest.mark.slow
def test_gels_that_lock_have_states_up_to_straight_chains():
    gel = Gel(1e-3, 0.1, network=Gent(20.0))
    found = homogeneous_states(gel, 0.0, "plane strain")
    np.testing.assert_allclose(found.J, [free_swelling(0.0, gel) ** 2], rtol=1e-12)


def test_a_gel_without_a_state_has_none():
    assert homogeneous_states(Gel(1e-3, 0.1), 0.01, "plane strain").J.shape == (0,)  # mu > Nv


# --- limits of stability and coexistence ----------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize(("Nv", "swelling"), [CASE, *slow([*OTHERS, *MORE])])
def test_phases_end_at_extremes_of_the_temperature_and_coexist_where_areas_are_equal(Nv, swelling):
    """PNIPAM solutions separate at 32 degrees (Heskins & Guillet, 1968), gels shrink at 32-34."""

    def gel(T):
        return Pnipam(Nv, T)

    found, expected = (
        limits_of_stability(gel, between=RANGE, swelling=swelling),
        np.array(extremes(Nv, swelling)),
    )
    np.testing.assert_allclose(found.control, expected[:, 0], rtol=0, atol=1e-8)
    # a minimum is known to the square root of round-off
    np.testing.assert_allclose(found.J, expected[:, 1], rtol=1e-5)

    found = coexistence(gel, between=RANGE, swelling=swelling)
    np.testing.assert_allclose(
        found.control, [equal_areas(Nv, swelling, *expected[:, 0])], rtol=0, atol=1e-8
    )
    first, _, last = states(float(found.control[0]), Nv, swelling)
    np.testing.assert_allclose(found.J, [[first, last]], rtol=1e-8)
    if swelling == "isotropic" and Nv <= 0.01:
        assert 31.5 < found.control[0] < 34


def poor(chi, Nv=0.06):
    return Gel(Nv, chi)


@pytest.mark.thorough
def test_a_good_solvent_has_one_phase():
    assert coexistence(poor, between=(0.1, 0.3), swelling="plane strain").control.shape == (0,)
    assert coexistence(Gel(), swelling="plane strain").J.shape == (0, 2)


@pytest.mark.slow
@pytest.mark.parametrize(("Nv", "swelling"), [(0.01, "uniaxial"), (0.06, "isotropic")])
def test_more_crosslinks_leave_one_phase(Nv, swelling):
    for find in (limits_of_stability, coexistence):
        assert find(lambda T: Pnipam(Nv, T), between=RANGE, swelling=swelling).control.shape == (0,)


@pytest.mark.thorough
def test_limits_in_mu_of_a_poor_solvent_are_the_roots_of_a_quadratic_equation():
    """W'' = 0 in plane strain: Nv J^2 + (1 - 2 chi - Nv) J + 2 chi = 0."""
    for Nv in (1e-3, 0.1148, 0.114879):  # the last two J are 4 % apart
        chi = 0.8965
        expected = np.sort(np.roots([Nv, 1 - 2 * chi - Nv, 2 * chi]).real)
        found = limits_of_stability(Gel(Nv, chi), swelling="plane strain")
        np.testing.assert_allclose(found.J, expected, rtol=1e-9)
        mu = Nv * (1 - 1 / expected) + np.log1p(-1 / expected) + 1 / expected + chi / expected**2
        np.testing.assert_allclose(found.control, mu, rtol=0, atol=1e-14)
    both = coexistence(Gel(Nv, chi), swelling="plane strain")
    assert (
        found.control[1] < both.control[0] < found.control[0]
        and both.J[0, 0] < found.J[0] < found.J[1] < both.J[0, 1]
    )
    assert limits_of_stability(Gel(0.12, chi), swelling="plane strain").J.shape == (0,)


def test_the_same_limit_at_a_control_whichever_is_found():
    """At the chi at which a state loses stability at a mu, it does so at that mu."""
    found = limits_of_stability(poor, mu=0.058, between=(0.7, 1.0), swelling="plane strain")
    again = limits_of_stability(poor(found.control[0]), swelling="plane strain")
    np.testing.assert_allclose(again.control[0], 0.058, rtol=0, atol=1e-13)
    # known to the square root of round-off
    np.testing.assert_allclose(again.J[0], found.J[0], rtol=1e-7)


@pytest.mark.slow
def test_the_same_phases_at_a_control_whichever_is_found():
    """At the temperature at which phases coexist at a mu, they coexist at that mu."""
    found = coexistence(
        lambda T: Pnipam(0.01, T), mu=-0.002, between=RANGE, swelling="plane strain"
    )
    again = coexistence(Pnipam(0.01, found.control[0]), swelling="plane strain")
    np.testing.assert_allclose(again.control, [-0.002], rtol=0, atol=1e-13)
    np.testing.assert_allclose(again.J, found.J, rtol=1e-10)


def poor_polyelectrolyte(pH):
    return Polyelectrolyte(chi=0.9, pH=pH, salt=1e-3)


def slope_with_ions(J, pH):
    """W'(J) of `poor_polyelectrolyte` after Marcombe et al. (2010), Donnan by bracketing."""
    hydrogen = 10.0**-pH
    anions = (1e-3 + hydrogen) * 0.0602214076
    y = brentq(
        lambda y: J * anions * (y - 1 / y) - 0.05 / (1 + hydrogen * y * 10**4.3),
        1,
        1e4,
        xtol=1e-13,
        rtol=1e-15,
    )
    return (
        1e-3 * (J ** (-1 / 3) - 1 / J)
        + np.log1p(-1 / J)
        + 1 / J
        + 0.9 / J**2
        - anions * (y + 1 / y - 2)
    )


@pytest.mark.slow
def test_a_polyelectrolyte_in_a_poor_solvent_has_two_phases_above_a_ph():
    scan = 1 + np.geomspace(0.1, 400, 400)
    for pH, count in ((4.0, 1), (7.0, 3)):
        expected = roots(np.vectorize(lambda J, pH=pH: slope_with_ions(J, pH)), scan)
        np.testing.assert_allclose(
            homogeneous_states(poor_polyelectrolyte(pH)).J, expected, rtol=1e-9
        )
        assert len(expected) == count


@pytest.mark.slow
def test_phases_of_a_polyelectrolyte_coexist_where_areas_are_equal():
    pH, (first, last) = (part[0] for part in coexistence(poor_polyelectrolyte, between=(5.0, 9.0)))
    area = quad(
        slope_with_ions, first, last, args=(float(pH),), points=[3.0, 10.0], epsabs=1e-12, limit=400
    )[0]
    assert abs(area) < 1e-8  # of areas of 0.1 on either side
    limit = limits_of_stability(poor_polyelectrolyte, between=(1.0, 9.0))
    # the shrunken phase stays metastable
    assert limit.control.shape == (1,) and limit.control[0] < pH
    for step, count in ((-0.01, 1), (0.01, 3)):
        assert (
            len(homogeneous_states(poor_polyelectrolyte(float(limit.control[0]) + step)).J) == count
        )


# --- derivatives ----------------------------------------------------------------------------------


def states_at_a_temperature(Nv):
    found = homogeneous_states(Pnipam(Nv, 32.0), -1e-3 + Nv / 10)
    return found.J[2] + 10 * found.energy[0]


def largest_temperature(Nv):
    return limits_of_stability(
        lambda T: Pnipam(Nv, T), mu=-Nv / 5, between=(31.0, 34.0), swelling="plane strain"
    ).control[1]


def coexisting(Nv):
    found = coexistence(lambda T: Pnipam(Nv, T), between=RANGE)
    return found.control[0] + found.J[0] @ jnp.array([-1.0, 1.0])


def coexisting_in_mu(Nv):
    return coexistence(Pnipam(Nv, 32.0), swelling="plane strain").control[0]


def states_in_a_poor_solvent(Nv):
    found = homogeneous_states(Gel(Nv, 0.85), 0.054 + Nv / 10, "plane strain")
    return found.J[1] + 10 * found.energy[0]


def limit_of_chi(Nv):
    return limits_of_stability(
        lambda chi: poor(chi, Nv), mu=0.052 + Nv / 10, between=(0.7, 1.0), swelling="plane strain"
    ).control[0]


def coexisting_in_a_poor_solvent(Nv):
    return coexistence(Gel(Nv, 0.85), swelling="plane strain").control[0]


def forward(quantity):
    """The derivative, by JAX's forward mode."""
    return lambda Nv: jax.jvp(quantity, (Nv,), (1.0,))[1]


OF_POOR = (states_in_a_poor_solvent, limit_of_chi, coexisting_in_a_poor_solvent)
OF_PNIPAM = (states_at_a_temperature, largest_temperature, coexisting, coexisting_in_mu)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("quantity", "Nv", "derivative"),
    [
        *((of, 0.06, forward) for of in OF_POOR),
        *slow(
            [*((of, 0.06, jax.grad) for of in OF_POOR), *((of, 0.01, jax.grad) for of in OF_PNIPAM)]
        ),
    ],
)
def test_derivatives_are_differences_of_new_searches(quantity, Nv, derivative):
    """Of a state, an energy, a spinodal and coexistence, by a parameter and the control."""
    h = 1e-5
    expected = (quantity(Nv + h) - quantity(Nv - h)) / (2 * h)
    # (h / Nv)^2 of the third derivative
    np.testing.assert_allclose(derivative(quantity)(Nv), expected, rtol=1e-5)


# --- input ----------------------------------------------------------------------------------------


def family(T):
    return Pnipam(temperature=T)


def test_input_is_refused_in_one_line(refused):
    refused(
        lambda call: call(),
        [
            (
                lambda: homogeneous_states(Pnipam(), swelling="free"),
                "swelling: 'free' is not one of isotropic, plane strain, uniaxial",
            ),
            (lambda: homogeneous_states(Pnipam(), np.zeros(2)), "mu: .*must be a finite number"),
            (
                lambda: homogeneous_states(Pnipam(temperature=lambda X: X[0])),
                "gel: a gel that varies",
            ),
            (lambda: homogeneous_states(Composite(Gel(), (Gel(),))), "gel: a gel that varies"),
            (lambda: homogeneous_states(Pnipam(temperature=305.0)), "temperature: 305"),
            (
                lambda: coexistence(family, between=(20.0, 305.0)),
                r"temperature: \d+.* degrees Celsius",
            ),
            (lambda: coexistence(family), "between: None"),
            (
                lambda: coexistence(family, between=(45.0, 20.0)),
                r"between: \(45.0, 20.0\) is not accepted",
            ),
            (lambda: coexistence(family, mu=np.nan, between=RANGE), "mu: nan"),
            (lambda: limits_of_stability(Pnipam(), mu=0.0), "mu, between: not accepted with a gel"),
            (
                lambda: limits_of_stability(Gel(network=lambda F, gel: F[0, 0])),
                "network: .*must be neo_hookean",
            ),
            (
                lambda: jax.jit(lambda T: homogeneous_states(Pnipam(temperature=T)).J)(30.0),
                "jax.jit",
            ),
        ],
    )
