"""Surface stability: closed forms, Stroh's eigenproblem, energy of a deep strip, by NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import legendre
from scipy.optimize import brentq

from jaxgel.materials import (
    Gel,
    Gent,
    VolumeLaw,
    bulk_stiffness,
    film_edge_volume_ratio,
    osmotic,
    surface_stability,
    surface_volume_ratio,
    uniaxial_swelling,
)

ONSETS = {
    (1e-4, 0.0): 3.377,
    (1e-4, 0.4): 3.369,
    (1e-3, 0.0): 3.326,
    (1e-3, 0.4): 3.265,
    (5e-3, 0.0): 3.158,
    (5e-3, 0.4): 3.003,
    (1e-2, 0.0): 3.019,
    (1e-2, 0.4): 2.831,
    (2e-2, 0.0): 2.841,
}  # (Nv, chi) -> J of a layer on a rigid base at which it wrinkles, in four digits


@jax.jit
def confined(mu, gel):
    """Volume ratio of a layer on a rigid base at ``mu``, and the stability of its surface."""
    J = uniaxial_swelling(mu, gel)
    return J, surface_stability(
        jnp.stack([jnp.ones_like(J), J]), osmotic(J, mu, gel), bulk_stiffness(J, gel), gel
    )


def onset(gel):
    mu = brentq(lambda mu: float(confined(mu, gel)[1]), -0.5, -1e-6, xtol=1e-10)
    return float(confined(mu, gel)[0])


@pytest.mark.parametrize("gel", ONSETS)
def test_a_confined_layer_wrinkles_at_the_swelling_of_its_gel(gel):
    """The fourth digit is the last of the reference."""
    assert onset(Gel(*gel)) == pytest.approx(ONSETS[gel], abs=6e-4)


def test_a_confined_layer_of_much_network_in_a_fair_solvent_stays_smooth_in_pure_solvent():
    assert confined(0.0, Gel(2e-2, 0.4))[1] > 0


def test_the_onset_of_a_confined_layer_is_that_of_kang_and_huang():
    """Increments decay as exp(ky) and exp(beta ky): (J + 1/J)^2 = 4 beta, Kang & Huang (2010).

    beta^2 = (Nv + K J^2) / (Nv + K) with K = dp/dJ: 1/(J^2 (J-1)) - 2 chi/J^3 + Nv/J^2. The
    critical swelling is between 2.5 and 3.4.
    """

    def excess(J, Nv, chi):
        K = 1 / (J**2 * (J - 1)) - 2 * chi / J**3 + Nv / J**2
        return (J + 1 / J) ** 2 - 4 * np.sqrt((Nv + K * J**2) / (Nv + K))

    for Nv, chi in ((1e-5, 0.2), (3e-3, 0.45), (1.5e-2, 0.1)):
        critical = brentq(excess, 2.0, 4.0, args=(Nv, chi))
        assert 2.5 < critical < 3.4
        assert onset(Gel(Nv, chi)) == pytest.approx(critical, rel=1e-7)  # mu to 1e-10


def test_the_limit_of_little_network_is_biots():
    """Stretches l and 1/l with (l^2 + 1)^2 = 4 l^6 at l^-2: r^3 - 3 r^2 - r - 1 = 0.

    r is their ratio.
    """
    biot = max(np.roots([1, -3, -1, -1]).real)
    assert biot == pytest.approx(0.5437**-2, rel=1e-3)
    assert onset(Gel(1e-9, 0.3)) == pytest.approx(biot, rel=1e-6)


# --- the impedance by Stroh's eigenproblem --------------------------------------------------------


def moduli(stress, F, step=1e-6):
    """Moduli A_ijkl (2, 2, 2, 2) by central differences of the nominal stress."""
    A = np.zeros((2, 2, 2, 2))
    for k in range(2):
        for m in range(2):
            H = np.zeros((2, 2))
            H[k, m] = step
            A[:, :, k, m] = (stress(F + H) - stress(F - H)) / (2 * step)
    return A


def stability_by_stroh(A):
    """det Z / (Z11 Z22 + Z12^2) of the Z from displacements to tractions of decaying waves."""
    # u = U exp(ik (x + q y)): (T q^2 + (R + R^T) q + Q) U = 0
    T, R, Q = A[:, 1, :, 1], A[:, 0, :, 1], A[:, 0, :, 0]
    inverse = np.linalg.inv(T)
    system = np.block([[-inverse @ R.T, inverse], [R @ inverse @ R.T - Q, -R @ inverse]])
    q, waves = np.linalg.eig(system)
    waves = waves[:, q.imag < 0]  # exp(ikqy) decays to y = -inf
    Z = 1j * waves[2:] @ np.linalg.inv(waves[:2])
    assert np.allclose(Z, Z.conj().T, rtol=1e-4, atol=1e-4 * abs(Z).max())
    coupling, product = abs(Z[0, 1]) ** 2, (Z[0, 0] * Z[1, 1]).real
    return (product - coupling) / (product + coupling)


@pytest.mark.parametrize("stretches", [(1.0, 2.0), (0.9, 3.2), (1.3, 1.5)])
@pytest.mark.parametrize("Jm", [np.inf, 30.0])
def test_the_closed_form_is_strohs_impedance(stretches, Jm):
    """Differences of the stress leave 1e-9 of the bulk stiffness, a hundred times the network's."""
    Nv, mu, chi = 2e-3, -0.05, 0.2

    def slope(J):
        return np.log1p(-1 / J) + 1 / J + chi / J**2 - Nv / J - mu

    def stress(F):
        J = np.linalg.det(F)
        return Nv * F / (1 - (np.sum(F**2) - 2) / Jm) + slope(J) * J * np.linalg.inv(F).T

    gel = Gel(Nv, chi) if np.isinf(Jm) else Gel(Nv, chi, network=Gent(Jm))
    J = stretches[0] * stretches[1]
    value = surface_stability(
        jnp.array(stretches), osmotic(J, mu, gel), bulk_stiffness(J, gel), gel
    )
    assert float(value) == pytest.approx(
        stability_by_stroh(moduli(stress, np.diag(stretches))), abs=1e-5
    )


# --- the energy of a deep strip -------------------------------------------------------------------


def lowest_energy(A, depth=12.0, degree=48):
    """Lowest energy eigenvalue of waves (u(y), i v(y)) exp(ix) in -depth < y < 0, polynomials.

    Held at the base.
    """
    xi, weight = legendre.leggauss(2 * degree)
    scale = 2 / depth
    basis = np.stack([legendre.legval(xi, np.eye(degree)[j]) * (1 + xi) for j in range(degree)])
    slopes = np.stack(
        [
            legendre.legval(xi, np.eye(degree)[j])
            + legendre.legval(xi, legendre.legder(np.eye(degree)[j])) * (1 + xi)
            for j in range(degree)
        ]
    )
    basis, slopes = basis / np.sqrt(depth), scale * slopes / np.sqrt(depth)
    zero = np.zeros_like(basis)
    u, v = np.concatenate([basis, zero]), np.concatenate([zero, basis])
    du, dv = np.concatenate([slopes, zero]), np.concatenate([zero, slopes])
    w = weight * depth / 2

    def product(a, b):
        return (a * w) @ b.T

    # real parts of H = [[i u, u'], [-v, i v']] exp(ix)
    energy = (
        A[0, 0, 0, 0] * product(u, u)
        + A[1, 1, 1, 1] * product(dv, dv)
        + A[0, 1, 0, 1] * product(du, du)
        + A[1, 0, 1, 0] * product(v, v)
    )
    normal, shear = A[0, 0, 1, 1] * product(u, dv), -A[0, 1, 1, 0] * product(du, v)
    energy += normal + normal.T + shear + shear.T
    factor = np.linalg.inv(np.linalg.cholesky(product(u, u) + product(v, v)))
    return np.linalg.eigvalsh(factor @ energy @ factor.T)[0]


def film_onset(gel):
    """Stretch l of a film held along x at which its edge wrinkles in the plane.

    F = diag(1, l) and l through the thickness.
    """

    @jax.jit
    def stability(stretch):
        law = VolumeLaw(gel, osmotic(stretch**2, 0.0, gel) + gel.Nv, film=True)
        return surface_stability(
            jnp.stack([1.0, stretch]), law.pressure(stretch), law.stiffness(stretch), gel
        )

    return brentq(stability, 1.5, 8.0, xtol=1e-6)


def test_the_edge_of_a_film_wrinkles_where_waves_of_a_deep_strip_lose_their_energy():
    """The film's stress follows from its thickness, at which no stress acts through it.

    A strip 12 / k deep has the half-plane's onset.
    """
    Nv, chi = 1e-3, 0.1

    def slope(J):
        return np.log1p(-1 / J) + 1 / J + chi / J**2 - Nv / J

    def film_moduli(stretch):
        mu = slope(stretch**2) + Nv

        def stress(F):
            A = np.linalg.det(F)
            thickness = brentq(
                lambda v: Nv * v + A * (slope(A * v) - mu),
                (1 + 1e-9) / A,
                50.0,
                xtol=1e-14,
                rtol=1e-14,
            )
            return Nv * F - Nv * thickness**2 * np.linalg.inv(F).T  # p = -Nv l3^2 / A

        return moduli(stress, np.diag([1.0, stretch]), 1e-5)

    critical = brentq(lambda stretch: lowest_energy(film_moduli(stretch)), 1.5, 8.0, xtol=1e-5)
    assert film_onset(Gel(Nv, chi)) == pytest.approx(critical, rel=1e-3)  # 5e-3 asked for


def test_a_gel_wrinkles_where_waves_of_a_deep_strip_lose_their_energy():
    Nv, chi = 5e-3, 0.4

    def layer_moduli(J):
        K, A = 1 / (J**2 * (J - 1)) - 2 * chi / J**3 + Nv / J**2, np.zeros((2, 2, 2, 2))
        C, p = np.array([J, 1.0]), -Nv * J
        for i in range(2):
            for j in range(2):
                A[i, j, i, j] += Nv
                A[i, i, j, j] += K * C[i] * C[j] + p * (i != j)
                A[i, j, j, i] -= p * (i != j)
        return A

    critical = brentq(lambda J: lowest_energy(layer_moduli(J)), 2.0, 4.0, xtol=1e-5)
    assert ONSETS[Nv, chi] == pytest.approx(critical, rel=1e-3)


# --- scale, derivatives, ends ---------------------------------------------------------------------


def test_the_scale_of_energies_does_not_matter():
    stretches = jnp.array([0.9, 2.0])
    values = [
        surface_stability(stretches, -2e-3 * scale, 0.3 * scale, Gel(1e-3 * scale, 0.1))
        for scale in (1.0, 7.0)
    ]
    assert float(values[0]) == pytest.approx(float(values[1]), rel=1e-12)


def test_a_dry_gel_is_stable_and_a_gel_in_its_miscibility_gap_is_not():
    """The bulk stiffness next to the dry state is 1e12 times the network's.

    Beyond the spinodal it is negative.
    """
    J = 1 + 1e-9
    dry = surface_stability(
        jnp.array([1.0, J]), -1e-3 * J, bulk_stiffness(J, Gel(1e-3, 0.1)), Gel(1e-3, 0.1)
    )
    assert float(dry) == pytest.approx(1.0, abs=1e-9)
    poor = Gel(1e-3, 0.9)
    assert bulk_stiffness(3.0, poor) < 0
    assert surface_stability(jnp.array([1.0, 3.0]), -3e-3, bulk_stiffness(3.0, poor), poor) == -1


@pytest.mark.thorough
def test_the_state_of_a_surface_has_no_traction():
    """dW/dl2 = 0 for the network written out.

    The volume ratio of a swollen gel, whose bulk is as soft as its network, to round-off.
    """
    Nv, chi, mu = 2e-2, 0.4, -1e-3
    t = np.array([0.7, 1.0, 1.4])
    locking = 30.0
    for gel, factor in (
        (Gel(Nv, chi), lambda squares: 1.0),
        (Gel(Nv, chi, network=Gent(locking)), lambda squares: 1 / (1 - (squares - 2) / locking)),
    ):
        J = np.asarray(jax.jit(surface_volume_ratio)(t, mu, gel))
        n = J / t
        np.testing.assert_allclose(
            Nv * n * factor(t**2 + n**2), -np.asarray(osmotic(J, mu, gel)) * t, rtol=1e-9
        )
    J = np.asarray(jax.jit(film_edge_volume_ratio)(t, mu, Gel(Nv, chi)))
    np.testing.assert_allclose(
        VolumeLaw(Gel(Nv, chi), mu, film=True).pressure(np.sqrt(J * t)),
        -Nv * np.sqrt(J / t) / t,
        rtol=1e-9,
    )


@pytest.mark.slow
def test_derivatives_are_those_of_differences():
    def value(t, Nv):
        gel = Gel(Nv, 0.3)
        J = surface_volume_ratio(t, -0.05, gel)
        return surface_stability(
            jnp.stack([t, J / t]), osmotic(J, -0.05, gel), bulk_stiffness(J, gel), gel
        )

    at, value = (0.8, 4e-3), jax.jit(value)
    slopes = jax.jit(jax.grad(value, argnums=(0, 1)))(*at)
    for number, slope in enumerate(slopes):
        step = 1e-5 * at[number]
        ends = [
            value(*(a + side * step * (number == k) for k, a in enumerate(at))) for side in (-1, 1)
        ]
        assert float(slope) == pytest.approx(float(ends[1] - ends[0]) / (2 * step), rel=1e-7)
