"""The paper's stress and tangent against automatic differentiation."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgel.materials import Gel, Gent, bulk_stiffness, flory_rehner, free_energy, free_swelling
from jaxgel.paper import paper_free_energy, paper_stress, paper_tangent, stress, voigt

EPS = np.finfo(float).eps
PAPER = Gel(Nv=1e-3, chi=1e-4)
GELS = [PAPER, Gel(1e-3, 1e-5), Gel(1e-3, 0.1), Gel(0.02, 0.45)]
MUS = [-8.0, -4.9678, -2.9678, -0.9178, -0.1688, -0.01, 0.0]


@functools.cache
def random_states(n, seed=3):
    """F' (n, 2, 2), mu (n,) and a gel (Nv, chi) each, with J_mu J' > 1.

    Every stretch is at least 0.9 of what keeps the gel swollen.
    """
    rng = np.random.default_rng(seed)
    mu = rng.uniform(-3.0, -0.01, n)
    gels = jax.vmap(Gel)(
        jnp.asarray(10 ** rng.uniform(-4, -1, n)), jnp.asarray(rng.uniform(1e-5, 0.5, n))
    )
    stretch = np.asarray(jax.vmap(free_swelling)(mu, gels))
    J = 1 + (stretch**2 - 1) * rng.uniform(0.5, 1.5, n)  # total volume ratio
    F = np.eye(2) + rng.uniform(-0.4, 0.4, (n, 2, 2))
    F *= np.sqrt(J / stretch**2 / np.linalg.det(F))[:, None, None]
    return jnp.asarray(F), jnp.asarray(mu), gels


def stress_roundoff(J, mu, gel):
    """Round-off of a stress that vanishes: of its summands, and of J in the pressure."""
    return 4 * EPS * (abs(mu) + 1 / J + gel.Nv * J + bulk_stiffness(J, gel) * J)


def test_equation_5_is_the_dry_energy_per_swollen_volume():
    """Eq. (5) as printed.

    With F33 = 1 and I = l^2 F':F' + 1 it is W / J_mu exactly, without an additive constant.
    """
    for F, mu, Nv, chi in zip(*(v[:20] for v in jax.tree.leaves(random_states(20))), strict=True):
        gel = Gel(Nv, chi)
        stretch = free_swelling(mu, gel)
        Jm, J = stretch**2, jnp.linalg.det(F)
        printed = Nv / (2 * Jm) * (Jm * jnp.sum(F**2) + 1 - 3 - 2 * jnp.log(Jm * J))
        printed += (
            -(J - 1 / Jm) * jnp.log(Jm * J / (Jm * J - 1)) - chi / (Jm**2 * J) - mu * (J - 1 / Jm)
        )
        # ln(J/(J-1)) as printed loses eps/(J-1) of its digits, times J - 1 that is eps
        np.testing.assert_allclose(paper_free_energy(F, mu, gel), printed, rtol=1e-13, atol=1e-14)
        np.testing.assert_allclose(
            paper_free_energy(F, mu, gel) * Jm, free_energy(stretch * F, mu, gel), rtol=1e-14
        )


def test_equation_6_vanishes_in_free_swelling():
    for gel in GELS:
        for mu in MUS:
            J = free_swelling(mu, gel) ** 2
            np.testing.assert_allclose(
                paper_stress(jnp.eye(2), mu, gel), 0, atol=stress_roundoff(J, mu, gel)
            )


def test_equation_6_is_the_derivative_of_equation_5():
    F, mu, gels = random_states(200)
    S = jax.jit(jax.vmap(lambda F, mu, gel: paper_stress(F.T @ F, mu, gel)))(F, mu, gels)
    P = jax.jit(jax.vmap(jax.grad(paper_free_energy)))(F, mu, gels)
    # both are sums of terms of size |mu| and |ln(1 - 1/J)| < 4 of opposite signs
    np.testing.assert_allclose(P, F @ S, atol=1e-13)


def test_equation_8_is_the_derivative_of_equation_6():
    """2 dS_ij/dG_kl by autodiff, G_12 and G_21 together, is D_ijkl to 1e-12.

    Of its largest component.
    """
    F, mu, gels = random_states(200)
    G = jnp.swapaxes(F, 1, 2) @ F
    automatic = 2 * jax.jit(jax.vmap(jax.jacfwd(paper_stress)))(G, mu, gels)
    automatic = (automatic + jnp.swapaxes(automatic, 3, 4)) / 2
    automatic = (automatic + jnp.swapaxes(automatic, 1, 2)) / 2
    D = jax.jit(jax.vmap(paper_tangent))(G, mu, gels)
    error = jnp.max(jnp.abs(automatic - D), axis=(1, 2, 3, 4)) / jnp.max(
        jnp.abs(D), axis=(1, 2, 3, 4)
    )
    assert jnp.max(error) < 1e-12
    # the minor symmetries and the major one
    for axes in [(0, 2, 1, 3, 4), (0, 1, 2, 4, 3), (0, 3, 4, 1, 2)]:
        np.testing.assert_allclose(
            D, jnp.transpose(D, axes), rtol=1e-14, atol=1e-14 * jnp.max(jnp.abs(D))
        )


def test_the_hessian_of_equation_5_is_equation_8_pushed_forward_and_the_stress():
    """d2W'/dF_iJ dF_kL = F_iP D_PJQL F_kQ + delta_ik S_JL."""
    F, mu, gels = random_states(200)

    def expected(F, mu, gel):
        D, S = paper_tangent(F.T @ F, mu, gel), paper_stress(F.T @ F, mu, gel)
        return jnp.einsum("ip,pjql,kq->ijkl", F, D, F) + jnp.einsum("ik,jl->ijkl", jnp.eye(2), S)

    hessian = jax.jit(jax.vmap(jax.hessian(paper_free_energy)))(F, mu, gels)
    error = jnp.max(jnp.abs(hessian - jax.jit(jax.vmap(expected))(F, mu, gels)), axis=(1, 2, 3, 4))
    assert jnp.max(error / jnp.max(jnp.abs(hessian), axis=(1, 2, 3, 4))) < 1e-12


def test_the_cofactor_derivative_is_equation_9():
    np.testing.assert_array_equal(
        voigt(stress.cofactor_derivative()), [[0, 1, 0], [1, 0, 0], [0, 0, -0.5]]
    )


def test_voigt_orders_11_22_12():
    D = jnp.arange(16.0).reshape(2, 2, 2, 2)
    rows = [(0, 0), (1, 1), (0, 1)]
    np.testing.assert_array_equal(voigt(D), [[D[i + j] for j in rows] for i in rows])


@pytest.mark.parametrize(
    "gel", [Gel(network=Gent(10.0)), Gel(volumetric=lambda J, gel: flory_rehner(J, gel))]
)
def test_the_paper_s_tensors_refuse_another_energy(gel):
    with pytest.raises(ValueError, match=r"gel: .*Flory-Rehner"):
        paper_stress(jnp.eye(2), -0.5, gel)
