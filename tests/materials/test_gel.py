"""The gel: known states, inverse functions, users' energies, errors."""

import dataclasses
import functools
import pickle
import types
from decimal import Decimal, localcontext

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxgel  # noqa: F401  (the 64-bit switch)
from jaxgel.materials import (
    ArrudaBoyce,
    Gel,
    Gent,
    bulk_stiffness,
    cauchy_stress,
    check_gel,
    flory_huggins,
    flory_rehner,
    free_energy,
    free_swelling,
    neo_hookean,
    osmotic,
    stiff_until,
    swelling,
    uniaxial_swelling,
    volume_ratio_at,
)

EPS = np.finfo(float).eps
PAPER = Gel(Nv=1e-3, chi=1e-4)
pressure = jax.jit(osmotic)
GELS = [PAPER, Gel(1e-3, 1e-5), Gel(1e-3, 0.1), Gel(0.02, 0.45)]
MUS = [-8.0, -4.9678, -2.9678, -0.9178, -0.1688, -0.01, 0.0]


def stress_roundoff(J, mu, gel):
    """Round-off of a stress that vanishes: of its summands, and of J in the pressure."""
    return 4 * EPS * (abs(mu) + 1 / J + gel.Nv * J + bulk_stiffness(J, gel) * J)


def exact(derivative, lower, upper):
    """Zero of an increasing function by bisection in 50-digit arithmetic."""
    with localcontext() as context:
        context.prec = 50
        lower, upper = Decimal(lower), Decimal(upper)
        for _ in range(160):
            middle = (lower + upper) / 2
            lower, upper = (middle, upper) if derivative(middle) < 0 else (lower, middle)
        return float(lower)


# --- free energy and its derivatives --------------------------------------------------------------


def test_free_energy_is_the_printed_sum():
    F = jnp.array([[1.3, 0.2], [-0.1, 1.2]])
    J, mu = 1.3 * 1.2 + 0.02, -0.7
    expected = (
        PAPER.Nv / 2 * (float(jnp.sum(F**2)) + 1 - 3 - 2 * np.log(J))
        - (J - 1) * np.log(J / (J - 1))
        - PAPER.chi / J
        - mu * (J - 1)
    )
    # a sum of five terms of like size
    np.testing.assert_allclose(free_energy(F, mu, PAPER), expected, rtol=1e-14)


def test_free_energy_does_not_see_rotations():
    F, angle = jnp.array([[1.3, 0.2], [-0.1, 1.2]]), 0.7
    Q = jnp.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    for rotated in (Q @ F, F @ Q):  # objective, isotropic
        np.testing.assert_allclose(
            free_energy(rotated, -0.5, PAPER), free_energy(F, -0.5, PAPER), rtol=1e-14
        )


@pytest.mark.parametrize(
    "F", [jnp.eye(2), jnp.diag(jnp.array([1.2, 0.8])), jnp.diag(jnp.array([-1.0, 2.0]))]
)
def test_free_energy_is_nan_at_and_below_the_dry_volume(F):
    assert jnp.isnan(free_energy(F, -0.5, PAPER))


@pytest.mark.parametrize("gel", GELS)
def test_pressure_and_bulk_stiffness_are_the_closed_forms(gel):
    swelling = 10.0 ** np.arange(-10, 4)
    J = 1 + swelling
    s = J - 1
    m = -np.log1p(1 / s) + 1 / J + gel.chi / J**2 - gel.Nv / J
    scale = 1 / (J**2 * s) + gel.Nv / J**2
    np.testing.assert_allclose(osmotic(J, -0.3, gel), m + 0.3, rtol=1e-14, atol=1e-15)
    # automatic differentiation adds terms of size 1/s^2 to get one of size 1/s^3 where s is large:
    # it loses eps s
    assert np.all(
        np.abs(bulk_stiffness(J, gel) - (scale - 2 * gel.chi / J**3)) < 8 * EPS * (1 + s) * scale
    )


def test_flory_huggins_keeps_its_digits_far_from_and_close_to_the_dry_state():
    for more in (1e-12, 1e-6, 1.0, 1e3, 1e6):
        J = 1 + more
        with localcontext() as context:
            context.prec = 50
            exact_J = Decimal(J)
            chi = Decimal(0.1)  # noqa: RUF032 (the binary number)
            expected = -(exact_J - 1) * (exact_J / (exact_J - 1)).ln() - chi / exact_J
        np.testing.assert_allclose(flory_huggins(J, 0.1), float(expected), rtol=4 * EPS)


def test_cauchy_stress_is_the_derivative_of_the_energy_pushed_forward():
    F, mu = jnp.array([[1.3, 0.2], [-0.1, 1.2]]), -0.7
    expected = jax.grad(free_energy)(F, mu, PAPER) @ F.T / jnp.linalg.det(F)
    np.testing.assert_allclose(cauchy_stress(F, mu, PAPER), expected, atol=1e-15)  # |p| = 0.1
    np.testing.assert_allclose(
        cauchy_stress(F, mu, PAPER, pressure=0.25),
        PAPER.Nv * F @ F.T / jnp.linalg.det(F) + 0.25 * jnp.eye(2),
        atol=1e-15,
    )


# --- homogeneous states ---------------------------------------------------------------------------


def test_free_swelling_is_the_paper_s():
    # printed with four decimals
    assert abs(free_swelling(-0.1688, Gel(Nv=1e-3, chi=1e-5)) - 1.4510) < 5e-5


@pytest.mark.parametrize("gel", GELS)
@pytest.mark.parametrize("mu", MUS)
def test_free_swelling_to_the_last_digits(gel, mu):
    Nv, chi, target = Decimal(gel.Nv), Decimal(gel.chi), Decimal(mu)
    J = exact(
        lambda J: Nv * (1 - 1 / J) + (1 - 1 / J).ln() + 1 / J + chi / J**2 - target, 1 + 1e-9, 1e4
    )
    np.testing.assert_allclose(free_swelling(mu, gel), np.sqrt(J), rtol=1e-14)


@pytest.mark.parametrize("gel", GELS)
@pytest.mark.parametrize("mu", MUS)
def test_uniaxial_swelling_satisfies_equation_59_to_the_last_digits(gel, mu):
    Nv, chi, target = Decimal(gel.Nv), Decimal(gel.chi), Decimal(mu)
    expected = exact(
        lambda J: Nv * (J - 1 / J) + ((J - 1) / J).ln() + 1 / J + chi / J**2 - target, 1 + 1e-9, 1e4
    )
    np.testing.assert_allclose(uniaxial_swelling(mu, gel), expected, rtol=1e-14)


@pytest.mark.parametrize(
    "gel",
    [
        *GELS,
        Gel(1e-3, 0.1, network=Gent(20.0)),
        pytest.param(Gel(1e-3, 0.1, network=ArrudaBoyce(10.0)), marks=pytest.mark.slow),
    ],
)
def test_swollen_states_are_free_of_stress(gel):
    for mu in MUS:
        l1, l2 = free_swelling(mu, gel), uniaxial_swelling(mu, gel)
        np.testing.assert_allclose(
            cauchy_stress(l1 * jnp.eye(2), mu, gel), 0, atol=stress_roundoff(l1**2, mu, gel)
        )
        assert abs(cauchy_stress(jnp.diag(jnp.array([1.0, l2])), mu, gel)[1, 1]) < stress_roundoff(
            l2, mu, gel
        )


def test_swelling_takes_arrays_and_traces_once():
    traces = []

    def counted(F, gel):
        traces.append(1)
        return neo_hookean(F, gel)

    gel, mu = Gel(network=counted), np.linspace(-5.0, -0.1, 6).reshape(2, 3)
    first = free_swelling(mu, gel)
    count = len(traces)
    again = free_swelling(mu - 0.1, dataclasses.replace(gel, chi=0.2))
    assert (len(traces), first.shape, again.shape) == (count, (2, 3), (2, 3))
    np.testing.assert_array_equal(
        first, [[free_swelling(value, PAPER) for value in row] for row in mu]
    )


@jax.jit
def largest_pressure(mu, gel):
    """At the end of the branch from the dry state."""
    return osmotic(stiff_until(0.0, gel), mu, gel)


def test_largest_mu_is_Nv_for_a_good_solvent():
    """At F = l I the network's Nv (1 - 1/J) meets mixing, ever weaker: J = inf at mu = Nv."""
    for Nv in (1e-4, 1e-3, 0.1):
        gel = Gel(Nv, 0.3)
        assert jnp.isfinite(free_swelling(0.99 * Nv, gel))
        assert jnp.isnan(free_swelling(1.01 * Nv, gel))


@pytest.mark.thorough
@pytest.mark.parametrize("Nv", [1e-4, 1e-3, 0.1])
@pytest.mark.parametrize("excess", [0.01, 0.1, 0.5])
def test_a_poor_solvent_has_a_spinodal(Nv, excess):
    """dp/dJ = 0 at s = J - 1: Nv s^2 - (2 chi - 1 - Nv) s + 1 = 0, 2 chi >= (1 + sqrt(Nv))^2.

    The roots are real from there on.
    """
    chi = (1 + np.sqrt(Nv)) ** 2 / 2 * (1 + excess)
    gel, b = Gel(Nv, chi), 2 * chi - 1 - Nv
    s = 2 / (b + np.sqrt(b**2 - 4 * Nv))
    J = volume_ratio_at(jnp.array([5.0, jnp.inf]), -1.0, gel)
    # a maximum is as sharp as the square root of round-off
    np.testing.assert_allclose(J, 1 + s, rtol=1e-8)
    # of s: (2 Nv s - b) ds = 2 s dchi - (s^2 + s) dNv
    slopes = jax.grad(lambda gel: volume_ratio_at(5.0, -1.0, gel))(gel)
    # as sharp as J over the distance of the two roots
    np.testing.assert_allclose(slopes.chi, 2 * s / (2 * Nv * s - b), rtol=1e-6)
    np.testing.assert_allclose(slopes.Nv, -(s**2 + s) / (2 * Nv * s - b), rtol=1e-6)
    assert jax.grad(volume_ratio_at)(5.0, -1.0, gel) == 0
    np.testing.assert_allclose(largest_pressure(-1.0, gel), osmotic(1 + s, -1.0, gel), rtol=1e-14)
    largest_mu = osmotic(1 + s, 0.0, gel) + Nv  # the network adds Nv to dW/dJ
    below = volume_ratio_at(largest_pressure(-1.0, gel) - 1e-6, -1.0, gel)
    assert below < 1 + s
    assert bulk_stiffness(below, gel) > 0
    assert jnp.isnan(free_swelling(largest_mu + 1e-6, gel))
    assert jnp.isfinite(free_swelling(largest_mu - 1e-6, gel))


# --- the inverse of the pressure ------------------------------------------------------------------


@settings(deadline=None, max_examples=100)
@given(st.floats(-12.0, 3.0), st.floats(-8.0, 0.0), st.floats(-5.0, 0.0), st.floats(1e-5, 0.5))
def test_volume_ratio_at_inverts_the_pressure(log_swelling, mu, log_Nv, chi):
    gel, J = Gel(10.0**log_Nv, chi), 1 + 10.0**log_swelling
    found = volume_ratio_at(pressure(J, mu, gel), mu, gel)
    stiffness = gel.Nv / J**2 + 1 / (J**2 * (J - 1)) - 2 * chi / J**3
    # of J itself, and of p + mu
    roundoff = 4 * EPS * (J + (1 + abs(mu) + abs(pressure(J, 0.0, gel))) / stiffness)
    assert abs(found - J) < roundoff


@settings(deadline=None, max_examples=100)
@given(st.floats(-1e3, 1e3), st.floats(-1e2, 1e2), st.floats(-6.0, 1.0), st.floats(1e-6, 1.999999))
def test_volume_ratio_at_is_finite_and_solves_wherever_a_root_exists(p, mu, log_Nv, chi):
    gel = Gel(10.0**log_Nv, chi)
    J, slope = jax.value_and_grad(volume_ratio_at)(p, mu, gel)
    assert 1 < J <= 1 + 2 * swelling.LARGEST_SWELLING
    assert jnp.isfinite(slope)
    if -28 < p + mu < largest_pressure(0.0, gel):
        stiffness = jax.grad(osmotic)(J, mu, gel)
        assert abs(osmotic(J, mu, gel) - p) <= 16 * EPS * (abs(p) + abs(mu) + 1 + stiffness * J)


@pytest.mark.parametrize("chi", [0.0, -0.5, -5.0])
def test_athermal_and_better_solvents_swell_more_without_a_spinodal(chi):
    """The energy's slope, ln(1 - 1/J) + 1/J + chi/J^2 - Nv/J, is monotone for chi <= 0."""
    gel, J = Gel(1e-3, chi), 1 + jnp.logspace(-9.0, 3.0, 61)
    check_gel(gel)
    p = osmotic(J, -1.0, gel)
    assert jnp.all(jnp.diff(p) > 0)
    # round-off of p over J dp/dJ, 1e-6 at the largest J
    np.testing.assert_allclose(volume_ratio_at(p, -1.0, gel), J, rtol=1e-9)
    Nv, x = Decimal(gel.Nv), Decimal(chi)
    expected = exact(
        lambda J: Nv * (1 - 1 / J) + (1 - 1 / J).ln() + 1 / J + x / J**2 + 1, 1 + 1e-9, 1e4
    )
    assert float(free_swelling(-1.0, gel)) ** 2 == pytest.approx(float(expected), rel=1e-13)
    assert free_swelling(-1.0, gel) > free_swelling(-1.0, Gel(1e-3, 0.1))


@jax.jit
def ratios_and_slopes(p, mu, gel):
    """Volume ratios (n,) at pressures (n,), and their slopes."""
    return jax.vmap(jax.value_and_grad(volume_ratio_at), (0, None, None))(p, mu, gel)


@pytest.mark.parametrize("chi", [1e-5, 0.5, 0.6, 1.0, 1.99])
def test_volume_ratio_at_grows_with_the_pressure_up_to_its_largest_value(chi):
    gel, p = Gel(1e-3, chi), np.linspace(-45.0, 10.0, 551)
    J, slopes = map(np.asarray, ratios_and_slopes(p, -1.0, gel))
    assert np.all(np.diff(J) >= 0)
    largest = float(largest_pressure(-1.0, gel))
    np.testing.assert_array_equal(slopes[(p < -32) | (p > largest)], 0)
    assert np.all(slopes[(p > -28) & (p < largest)] > 0)


def test_close_pressures_are_inverted_whatever_the_compiler_rounds():
    # 135 of these led to J = 2790 where Newton's last step was below the resolution of u
    p = jnp.linspace(-1.3e-3, -0.9e-3, 4001)
    J = jax.jit(volume_ratio_at)(p, -1.7, PAPER)
    np.testing.assert_allclose(pressure(J, -1.7, PAPER), p, rtol=0, atol=1e-14)


def test_a_pressure_that_is_nan_stays_so():
    assert jnp.isnan(volume_ratio_at(jnp.nan, -1.0, PAPER))


# --- derivatives of the inverse functions ---------------------------------------------------------


FUNCTIONS = {
    "free_swelling": lambda v: free_swelling(v[0], Gel(v[1], v[2])),
    "uniaxial_swelling": lambda v: uniaxial_swelling(v[0], Gel(v[1], v[2])),
    "volume_ratio_at": lambda v: volume_ratio_at(-0.01 * v[3], v[0], Gel(v[1], v[2])),
    "gent": lambda v: free_swelling(v[0], Gel(v[1], v[2], network=Gent(8.0))),
}


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name in ("gent", "uniaxial_swelling")))
        for name in FUNCTIONS
    ],
)
def test_implicit_derivatives_forward_and_reverse_agree_with_finite_differences(name):
    function, x = jax.jit(FUNCTIONS[name]), jnp.array([-0.4, 0.01, 0.2, 1.0])
    g = jax.jit(jax.grad(function))
    gradient, hessian = g(x), jax.jit(jax.hessian(function))(x)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(function))(x), gradient, rtol=1e-13, atol=1e-15)
    for i, h in enumerate(1e-3 * np.abs(x)):
        e = jnp.zeros(4).at[i].set(h)
        # fourth order, h = 1e-3 |x|: truncation (h/x)^4 = 1e-12 and round-off 1e-16/1e-3 relative
        # to function and gradient
        difference = (
            8 * (function(x + e) - function(x - e)) - function(x + 2 * e) + function(x - 2 * e)
        ) / (12 * h)
        np.testing.assert_allclose(gradient[i], difference, rtol=1e-9, atol=1e-10)
        difference = (8 * (g(x + e) - g(x - e)) - g(x + 2 * e) + g(x - 2 * e)) / (12 * h)
        np.testing.assert_allclose(
            hessian[i], difference, rtol=1e-7, atol=1e-8 * np.max(np.abs(hessian))
        )


@pytest.mark.slow
def test_derivatives_pass_through_vmap_and_jit():
    mu = jnp.linspace(-3.0, -0.1, 5)
    slopes = jax.jit(jax.vmap(jax.grad(free_swelling), (0, None)))(mu, PAPER)
    np.testing.assert_allclose(
        slopes, jax.grad(lambda mu: jnp.sum(free_swelling(mu, PAPER)))(mu), rtol=1e-14
    )


# --- other energies -------------------------------------------------------------------------------


@functools.partial(jax.jit, static_argnums=0)
def derivatives(network, F, gel):
    """Energy of a network, and its first and second derivatives by F."""
    return [
        derivative(network)(F, gel) for derivative in (lambda energy: energy, jax.grad, jax.hessian)
    ]


@pytest.mark.parametrize("network", [Gent(1e10), ArrudaBoyce(1e10)])
def test_long_chains_are_gaussian(network):
    F = np.array([[1.8, 0.3], [-0.4, 1.5]])
    for long, gaussian in zip(
        derivatives(network, F, PAPER), derivatives(neo_hookean, F, PAPER), strict=True
    ):
        # the relative difference is I/Jm, I/N
        np.testing.assert_allclose(long, gaussian, rtol=0, atol=1e-8 * np.max(np.abs(gaussian)))


@pytest.mark.parametrize(
    "network", [neo_hookean, Gent(5.0), Gent(60.0), ArrudaBoyce(3.0), ArrudaBoyce(50.0)]
)
def test_dry_networks_have_the_shear_modulus_Nv_and_no_stress(network):
    """With -Nv ln J: derivatives at F = I are -Nv I and 0; simple shear costs Nv/2 gamma^2."""
    energy, stress, moduli = map(np.asarray, derivatives(network, np.eye(2), PAPER))
    assert abs(energy) < 1e-15 * PAPER.Nv
    np.testing.assert_allclose(stress - PAPER.Nv * np.eye(2), 0, atol=4 * EPS * PAPER.Nv)
    np.testing.assert_allclose(moduli[0, 1, 0, 1], PAPER.Nv, rtol=1e-14)


def test_arruda_boyce_is_the_expansion_of_the_inverse_langevin_chain():
    """Five terms of the eight-chain energy near the exact dW/dI.

    It is Nv/6 sqrt(3 N/I) L^-1(sqrt(I/(3 N))).
    """
    N, gel = 8.0, Gel(1.0)

    def inverse_langevin(y):
        return exact(
            lambda x: (((2 * x).exp() + 1) / ((2 * x).exp() - 1) - 1 / x) - Decimal(y), 1e-6, 50.0
        )

    def slope(invariant):
        return np.sqrt(3 * N / invariant) * inverse_langevin(np.sqrt(invariant / (3 * N))) / 6

    stretch = jnp.sqrt((4.0 - 1) / 2)
    # dI/dl = 4 l
    automatic = jax.grad(lambda stretch: ArrudaBoyce(N)(stretch * jnp.eye(2), gel))(stretch) / (
        4 * stretch
    )
    # both scaled to the modulus at I = 3; the sixth term of the series is (I/(3N))^5 * 0.6 = 8e-5
    np.testing.assert_allclose(automatic / 0.5, slope(4.0) / slope(3.0), rtol=1e-4)


def test_gent_locks_the_swelling():
    gel = Gel(1e-3, 0.1, network=Gent(3.0))
    stretch = free_swelling(jnp.array([-0.5, 0.0, 1.0, 1e3]), gel)
    assert jnp.all(jnp.diff(stretch) > 0)
    assert stretch[-1] < np.sqrt(1 + 3.0 / 2)  # I - 3 = 2 (l^2 - 1) = Jm
    assert jnp.isnan(gel.network(1.6 * jnp.eye(2), gel))


def test_a_user_s_energy_plugs_in():
    """The same gel, with -Nv ln J in the network: another split of one energy."""

    def network(F, gel):
        return neo_hookean(F, gel) - gel.Nv * jnp.log(jnp.linalg.det(F))

    def volumetric(J, gel):
        return flory_huggins(J, gel.chi)

    gel = Gel(1e-3, 0.1, network=network, volumetric=volumetric)
    default = Gel(1e-3, 0.1)
    F = jnp.array([[1.3, 0.2], [-0.1, 1.2]])
    for function in (free_energy, cauchy_stress):
        np.testing.assert_allclose(
            *(jax.jit(function)(F, -0.5, of) for of in (gel, default)), atol=1e-15
        )
    for function in (free_swelling, uniaxial_swelling):
        np.testing.assert_allclose(function(-0.5, gel), function(-0.5, default), rtol=1e-14)
    J = volume_ratio_at(-0.1, -0.5, default)
    # the network carries -Nv/J of the pressure
    np.testing.assert_allclose(volume_ratio_at(-0.1 + gel.Nv / J, -0.5, gel), J, rtol=1e-14)


def test_a_user_s_gel_with_parameters_of_its_own_is_differentiable():
    @jax.tree_util.register_dataclass
    @dataclasses.dataclass(frozen=True)
    class Charged:
        Nv: float
        chi: float
        charge: float
        network = staticmethod(neo_hookean)
        volumetric = staticmethod(lambda J, gel: flory_rehner(J, gel) - gel.charge * jnp.log(J))

    def swelling(charge):
        return free_swelling(-0.05, Charged(1e-3, 0.1, charge))

    np.testing.assert_allclose(swelling(0.0), free_swelling(-0.05, Gel(1e-3, 0.1)), rtol=1e-14)
    difference = (swelling(0.01 + 1e-5) - swelling(0.01 - 1e-5)) / 2e-5
    # second order: (1e-5/0.01)^2 = 1e-6 times 0.1
    np.testing.assert_allclose(jax.grad(swelling)(0.01), difference, rtol=1e-7)


def test_the_inverse_of_the_pressure_does_not_need_a_concave_energy():
    """p = ln s - 1/s^2 + 5 s^5 of s = J - 1 rises from -inf to inf, faster than mixing.

    At both ends, much faster than the mixing energy.
    """

    def volumetric(J, gel):
        s = J - 1
        return s * jnp.log(s) - s + 1 / s + 5 / 6 * s**6

    gel, p = Gel(volumetric=volumetric), jnp.array([-1e6, -5.0, -0.5, 0.0, 0.5, 3.0, 1e6])
    J = volume_ratio_at(p, 0.0, gel)
    assert jnp.all(
        jnp.abs(osmotic(J, 0.0, gel) - p) < 8 * EPS * (jnp.abs(p) + 1 + bulk_stiffness(J, gel) * J)
    )


# --- the record and its errors --------------------------------------------------------------------


def test_a_gel_is_a_value():
    gel = Gel(1e-3, 0.1, network=Gent(5.0))
    assert gel == pickle.loads(pickle.dumps(gel))
    assert hash(gel) == hash(Gel(1e-3, 0.1, network=Gent(5.0)))
    assert jax.tree.leaves(gel) == [1e-3, 0.1]
    assert Gel() == PAPER


def with_chains(Nv):
    """A gel of the user's own that has no number there."""
    return types.SimpleNamespace(Nv=Nv, chi=0.1, network=neo_hookean, volumetric=flory_rehner)


@pytest.mark.parametrize(
    ("gel", "mu", "text"),
    [
        (Gel(Nv=0.0), None, "Nv: 0 "),
        (Gel(Nv=-1e-3), None, "Nv: -0.001 "),
        (Gel(Nv=np.inf), None, "Nv: inf "),
        (Gel(Nv=jnp.array(np.nan)), None, "Nv: nan "),
        (with_chains("1"), None, "Nv: '1' "),
        (with_chains(None), None, "Nv: None "),
        (Gel(chi=2), None, "chi: 2 "),
        (Gel(chi=-np.inf), None, "chi: -inf "),
        (Gel(chi=np.nan), None, "chi: nan "),
        (PAPER, np.nan, "mu: nan "),
        (PAPER, [-1.0, -np.inf], "mu: -inf "),
        (PAPER, jnp.array([-1.0, np.nan]), "mu: nan "),
        (PAPER, "low", "mu: 'low' "),
    ],
)
def test_an_unusable_gel_gives_one_line(gel, mu, text):
    with pytest.raises(ValueError, match="must be") as error:
        check_gel(gel, mu)
    assert str(error.value).startswith(text)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [0, -1.0, np.nan, np.inf, "many"])
@pytest.mark.parametrize(("network", "name"), [(Gent, "Jm"), (ArrudaBoyce, "N")])
def test_an_unusable_network_gives_one_line(network, name, value):
    with pytest.raises(ValueError, match=f"^{name}: .* must be a finite number > 0$"):
        network(value)


def test_a_usable_gel_passes_also_while_traced():
    check_gel(PAPER)
    check_gel(Gel(np.float64(1.0), 1), np.linspace(-5, 1, 4))
    jax.jit(lambda gel, mu: check_gel(gel, mu))(PAPER, -1.0)
