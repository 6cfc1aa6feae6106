"""Responsive gels: equations of their sources, Donnan equilibrium, limits, derivatives.

Equations are typed again, the equilibrium is solved another way; and refusals.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.optimize import brentq

import jaxgel
from jaxgel.materials import (
    ACCEPTED,
    Composite,
    Gel,
    Pnipam,
    Polyelectrolyte,
    bulk_stiffness,
    cauchy_stress,
    check_gel,
    check_parameter,
    free_swelling,
    ionic_energy,
    ions,
    isotropic_swelling,
    osmotic,
    pnipam_chi,
    pnipam_energy,
    responsive,
    rises_always,
    stiff_until,
    uniaxial_swelling,
    volume_ratio_at,
)

J = np.array([1.001, 1.2, 2.0, 5.0, 30.0, 400.0])
PER_V = 6.02214076e23 * 1e-28 * 1e3  # of 1 mol/l = 1e3 mol/m^3 in v = 1e-28 m^3
GELS = [Polyelectrolyte(pH=pH, salt=salt) for pH in (2.0, 4.3, 7.0) for salt in (1e-4, 0.1)]


def chi_of(kelvin):
    """Constants as printed by Cai & Suo (2011), and in the public UHYPER routine of Z. W.

    Ding (2012) for Abaqus.
    """
    return -12.947 + 0.04496 * kelvin, 17.92 - 0.0569 * kelvin


@functools.partial(jax.jit, static_argnums=(0, 3))
def slope(energy, J, gel, order=1):
    for _ in range(order):
        energy = jax.grad(energy)
    return jax.vmap(energy, (0, None))(jnp.asarray(J), gel)


# --- PNIPAM ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("temperature", [10.0, 32.0, 45.0])
def test_pnipam_energy_is_the_printed_one_less_chi0(temperature):
    chi0, chi1 = chi_of(temperature + 273.15)
    gel = Pnipam(0.01, temperature)
    printed = (J - 1) * np.log(1 - 1 / J) + (chi0 + chi1 / J) * (1 - 1 / J) - 0.01 * np.log(J)
    # ln(1 - 1/J) of the right side at J = 400
    np.testing.assert_allclose(pnipam_energy(J, gel) + chi0, printed, rtol=0, atol=1e-12)
    np.testing.assert_allclose(pnipam_chi(J, temperature), chi0 + chi1 / J, rtol=1e-13)


@pytest.mark.parametrize("temperature", [10.0, 32.0, 45.0])
def test_pnipam_pressure_and_stiffness_are_the_closed_forms(temperature):
    chi0, chi1 = chi_of(temperature + 273.15)
    gel = Pnipam(0.01, temperature)
    pressure = np.log1p(-1 / J) + 1 / J + (chi0 - chi1) / J**2 + 2 * chi1 / J**3 - 0.01 / J
    stiffness = 1 / (J**2 * (J - 1)) - 2 * (chi0 - chi1) / J**3 - 6 * chi1 / J**4 + 0.01 / J**2
    # 1/J at J = 1.001 is next to 1
    np.testing.assert_allclose(osmotic(J, -0.3, gel), pressure + 0.3, rtol=0, atol=1e-13)
    # differences of terms 1e4 times larger
    np.testing.assert_allclose(bulk_stiffness(J, gel), stiffness, rtol=1e-11, atol=1e-15)


def test_pnipam_without_a_concentration_term_is_the_gel(monkeypatch):
    monkeypatch.setattr(responsive, "PNIPAM_CONSTANTS", ((0.3, 0.0), (0.0, 0.0)))
    np.testing.assert_array_equal(
        pnipam_energy(J, Pnipam(0.01)), Gel().volumetric(J, Gel(0.01, 0.3))
    )


def test_free_swelling_of_pnipam_is_free_of_stress_and_the_shrunken_state():
    cold, warm = Pnipam(0.01, 25.0), Pnipam(0.01, 32.0)  # one state, and three
    for gel in (cold, warm):
        F = free_swelling(-0.001, gel) * jnp.eye(2)
        np.testing.assert_allclose(cauchy_stress(F, -0.001, gel), 0, atol=1e-14)
    assert free_swelling(-0.001, warm) ** 2 < 2 < 4 < free_swelling(-0.001, cold) ** 2


@pytest.mark.slow
def test_volume_ratio_of_pnipam_inverts_the_pressure_on_the_side_of_the_dry_state():
    gel = Pnipam(0.01, 34.0)
    end = osmotic(stiff_until(0.0, gel), -0.1, gel)
    p = end - np.array([1.0, 0.1, 1e-3])
    ratio = volume_ratio_at(p, -0.1, gel)
    np.testing.assert_allclose(osmotic(ratio, -0.1, gel), p, atol=1e-13)
    assert np.all(np.asarray(bulk_stiffness(ratio, gel)) > 0)
    # no state there: the end of the branch, where it is without stiffness
    last = volume_ratio_at(end + 0.1, -0.1, gel)
    assert abs(bulk_stiffness(last, gel)) < 1e-6
    assert rises_always(gel) is False and rises_always(Polyelectrolyte()) is False


# --- polyelectrolyte ------------------------------------------------------------------------------


def donnan(J, gel):
    """Ratio y >= 1 of cations in gel and bath, by bracketing.

    J (c_H + c_salt) (y - 1/y) v = f K / (K + c_H y).
    """
    hydrogen, K = 10.0**-gel.pH, 10.0**-gel.pKa
    anions = (gel.salt + hydrogen) * PER_V

    def excess(y):
        return J * anions * (y - 1 / y) - gel.acid_fraction * K / (K + hydrogen * y)

    return brentq(excess, 1.0, 2 + gel.acid_fraction / (J * anions), xtol=1e-14, rtol=1e-15)


@pytest.mark.parametrize("gel", GELS)
def test_ionic_pressure_is_that_of_a_donnan_equilibrium_solved_by_bracketing(gel):
    y = np.array([donnan(ratio, gel) for ratio in J])
    hydrogen = 10.0**-gel.pH
    bath = 2 * (hydrogen + gel.salt)
    inside = (hydrogen + gel.salt) * (y + 1 / y)
    # y - 1 has fewer digits
    np.testing.assert_allclose(
        slope(ionic_energy, J, gel), -PER_V * (inside - bath), rtol=1e-10, atol=1e-16
    )
    at = ions(J, gel)
    np.testing.assert_allclose(
        [at.hydrogen, at.cations, at.anions],
        [hydrogen * y, gel.salt * y, (hydrogen + gel.salt) / y],
        rtol=1e-12,
    )
    np.testing.assert_allclose(at.potential, -np.log(y), rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("gel", GELS)
def test_charges_balance_and_groups_dissociate_by_mass_action(gel):
    at = ions(J, gel)
    np.testing.assert_allclose(at.hydrogen + at.cations, at.anions + at.fixed, rtol=1e-13)
    undissociated = gel.acid_fraction / (J * PER_V) - at.fixed
    # undissociated is a small difference at pH 7
    np.testing.assert_allclose(at.hydrogen * at.fixed / undissociated, 10**-4.3, rtol=1e-9)
    np.testing.assert_allclose(
        at.hydrogen * at.anions, 10**-gel.pH * (10**-gel.pH + gel.salt), rtol=1e-13
    )


@pytest.mark.parametrize("gel", GELS)
def test_ionic_energy_is_the_sum_over_ions_and_groups(gel):
    """Amounts C in v of dry polymer: ions with the bath, and groups with their ions.

    C (ln(C / (J c_bath)) - 1) and + J c_bath of each ion, and the groups with the ions that they
    give.
    """
    at, hydrogen = ions(J, gel), 10.0**-gel.pH
    energy = 0.0
    for inside, bath in (
        (at.hydrogen, hydrogen),
        (at.cations, gel.salt),
        (at.anions, hydrogen + gel.salt),
    ):
        energy += J * PER_V * (inside * (np.log(inside / bath) - 1) + bath)
    f, charged = gel.acid_fraction, np.asarray(at.fixed) * J * PER_V
    energy += (
        charged * np.log(charged / f)
        + (f - charged) * np.log(1 - charged / f)
        + charged * np.log(10) * (gel.pKa - gel.pH)
    )
    np.testing.assert_allclose(
        jax.vmap(ionic_energy, (0, None))(J, gel), energy, rtol=1e-9, atol=1e-14
    )


def test_fully_dissociated_groups_have_the_closed_form():
    """Sum of c = sqrt(c_fixed^2 + 4 c_salt^2)."""
    gel = Polyelectrolyte(pH=12.0, salt=0.01, pKa=-20.0)
    fixed, salt = gel.acid_fraction / J, 0.01 * PER_V
    np.testing.assert_allclose(
        slope(ionic_energy, J, gel), 2 * salt - np.sqrt(fixed**2 + 4 * salt**2), rtol=1e-9
    )  # the anions are 1e-12 more
    basic = ions(J, Polyelectrolyte(pH=12.0))
    # pKa 4.3: 1e-7 of them is left without a potential, y times more
    np.testing.assert_allclose(basic.fixed * J * PER_V, 0.05, rtol=1e-3)


@pytest.mark.slow
def test_without_charge_it_is_the_gel():
    plain = Gel(1e-3, 0.1)
    # no groups; none dissociated
    for gel in (Polyelectrolyte(acid_fraction=0), Polyelectrolyte(pH=0.0, pKa=14.0)):
        for order in (0, 1, 2):
            own, other = (
                slope(gel.volumetric, J, gel, order),
                slope(plain.volumetric, J, plain, order),
            )
            np.testing.assert_allclose(own, other, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(
        isotropic_swelling(0.0, Polyelectrolyte(acid_fraction=0)),
        isotropic_swelling(0.0, plain),
        rtol=1e-13,
    )
    assert ions(2.0, Polyelectrolyte(acid_fraction=0)).potential == 0


def test_swelling_rises_with_the_ph_and_falls_with_salt():
    by_ph = [float(isotropic_swelling(0.0, Polyelectrolyte(pH=pH))) for pH in (2.0, 4.0, 6.0, 8.0)]
    by_salt = [
        float(isotropic_swelling(0.0, Polyelectrolyte(salt=salt)))
        for salt in (1e-3, 1e-2, 0.1, 1.0)
    ]
    assert np.all(np.diff(by_ph) > 0) and np.all(np.diff(by_salt) < 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "gel", [Polyelectrolyte(pH=4.0, salt=1e-3), Polyelectrolyte(pH=8.0, salt=0.1)]
)
def test_swollen_polyelectrolytes_are_free_of_stress(gel):
    for mu in (-0.5, -0.01, 0.0):
        np.testing.assert_allclose(
            cauchy_stress(free_swelling(mu, gel) * jnp.eye(2), mu, gel), 0, atol=1e-14
        )
        assert (
            abs(
                cauchy_stress(jnp.diag(jnp.array([1.0, uniaxial_swelling(mu, gel)])), mu, gel)[1, 1]
            )
            < 1e-14
        )


def test_donnan_potential_for_any_bath_and_gel():
    rng = np.random.default_rng(5)
    bath, acid = 10 ** rng.uniform(-17, 9, 20_000), 10 ** rng.uniform(-12, 0, 20_000)
    shift = rng.uniform(-35, 35, 20_000)
    psi = responsive._donnan(bath, acid, shift)
    given, taken = 2 * bath * jnp.sinh(psi), acid * jax.nn.sigmoid(-psi - shift)
    # psi up to 70: its last digit is 1e-14 of sinh
    np.testing.assert_allclose(given, taken, rtol=1e-13)


# --- derivatives ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "gel",
    [Pnipam(0.01, 32.0), Polyelectrolyte(pH=4.5, salt=1e-3), Polyelectrolyte(pH=7.0, salt=0.1)],
)
@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_derivatives_by_the_volume_ratio_are_differences_of_lower_ones(gel, order):
    at, h = np.array([1.5, 4.0, 30.0]), 1e-4
    lower = [
        np.asarray(slope(gel.volumetric, at * (1 + k * h), gel, order - 1)) for k in (-2, -1, 1, 2)
    ]
    difference = (lower[0] - 8 * lower[1] + 8 * lower[2] - lower[3]) / (12 * h * at)
    # round-off 1e-16/h of sums 1e3 times larger
    np.testing.assert_allclose(slope(gel.volumetric, at, gel, order), difference, rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("gel", [Pnipam(0.01, 32.0), Polyelectrolyte(pH=4.5, salt=1e-3)])
def test_pressures_have_derivatives_by_every_parameter(gel):
    # eps is 1 % of the salt, and of second differences 1e-16/eps^2 is 1e-6
    parameters = jax.tree.map(jnp.asarray, gel)
    check_grads(
        lambda gel, J: osmotic(J, 0.0, gel),
        (parameters, 3.0),
        order=2,
        modes=["fwd", "rev"],
        eps=1e-5,
        rtol=2e-3,
    )


@pytest.mark.slow
def test_swelling_has_derivatives_by_temperature_and_ph():
    def by_temperature(T):
        return free_swelling(-0.01, Pnipam(0.01, T))

    def by_ph(pH):
        return free_swelling(0.0, Polyelectrolyte(pH=pH))

    for function, x in ((by_temperature, 28.0), (by_ph, 4.5)):
        h = 1e-4
        # h^2 third derivatives
        np.testing.assert_allclose(
            jax.grad(function)(x), (function(x + h) - function(x - h)) / (2 * h), rtol=1e-6
        )


# --- input ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gel", "name"),
    [
        (Pnipam(temperature=305.4), "temperature: 305.4"),
        (Pnipam(temperature=-1), "temperature: -1"),
        (Pnipam(Nv=0.0), "Nv: 0"),
        (Polyelectrolyte(pH=15.0), "pH: 15"),
        (Polyelectrolyte(salt=-0.1), "salt: -0.1"),
        (Polyelectrolyte(acid_fraction=1.5), "acid_fraction: 1.5"),
        (Polyelectrolyte(pKa=float("inf")), "pKa: inf"),
        (Polyelectrolyte(solvent_volume=0.0), "solvent_volume: 0"),
        (Polyelectrolyte(chi=2.5), "chi: 2.5"),
    ],
)
def test_parameters_out_of_range_are_refused_in_one_line(gel, name):
    for refused in (gel, Composite(type(gel)(), (gel,))):
        with pytest.raises(ValueError, match=name) as problem:
            check_gel(refused)
        assert "\n" not in str(problem.value) and "must be a" in str(problem.value)


def test_fields_of_a_gel_that_responds_are_checked_at_their_places():
    check_gel(Pnipam(temperature=lambda X: 30.0 + X[0]))
    with pytest.raises(ValueError, match=r"temperature: 120 at \(1, 2\) mm"):
        check_parameter("temperature", np.array([20.0, 120.0]), np.array([[0.0, 0.0], [1.0, 2.0]]))


def test_every_parameter_of_a_gel_says_what_is_accepted():
    for kind in (Gel, Pnipam, Polyelectrolyte):
        assert {field.name for field in dataclasses.fields(kind)} - {
            "network",
            "volumetric",
        } <= set(ACCEPTED)
        check_gel(kind())
        check_gel(jaxgel.Gel())
