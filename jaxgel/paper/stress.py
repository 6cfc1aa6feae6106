"""Stress and tangent of Deng et al. (2020), Eqs. (5)-(9), in the freely swollen reference."""

from typing import Any

import jax.numpy as jnp

from .._deprecated import old_arguments
from .._types import Array, Float, Scalar
from ..materials import flory_rehner, free_energy, free_swelling, neo_hookean


def paper_free_energy(F_prime: Float[Array, "2 2"], mu: Scalar, gel: Any) -> Float[Array, ""]:
    """Free energy (), in kT/v per volume of the freely swollen state C_mu, at F = F_mu F'; Eq. (5).

    W / J_mu, without a constant.
    """
    stretch = free_swelling(mu, gel)
    return free_energy(stretch * F_prime, mu, gel) / stretch**2


@old_arguments
def paper_stress(G: Float[Array, "2 2"], mu: Scalar, gel: Any) -> Float[Array, "2 2"]:
    """Second Piola-Kirchhoff stress S (2, 2), kT/v, in the freely swollen reference C_mu.

    Arguments:

    - `G` (2, 2): in-plane right Cauchy-Green tensor F'^T F' from C_mu, dimensionless; G33 = 1,
      since F_mu = diag(l, l, 1) has J_mu = l^2.
    - `mu` (): chemical potential, kT.
    - `gel`: a `Gel` with the default energy.

    Raises `ValueError` for another energy.

    Source: Deng et al. (2020), Eq. (6).

    >>> from jaxgel.materials import Gel
    >>> bool(abs(paper_stress(jnp.eye(2), -0.1, Gel(Nv=1e-3, chi=0.1))).max() < 1e-12)
    True
    """
    B, _, _ = _paper_coefficients(G, mu, gel)
    return gel.Nv * jnp.eye(2) + B * jnp.linalg.inv(G).T


@old_arguments
def paper_tangent(G: Float[Array, "2 2"], mu: Scalar, gel: Any) -> Float[Array, "2 2 2 2"]:
    """Tangent D_ijkl = 2 dS_ij/dG_kl (2, 2, 2, 2), kT/v, of the stress S of `paper_stress`.

    Arguments: `G`, `mu` and `gel` as for `paper_stress`.

    Raises `ValueError` for another energy.

    Source: Deng et al. (2020), Eqs. (8)-(9).

    >>> from jaxgel.materials import Gel
    >>> D = paper_tangent(jnp.eye(2), -0.1, Gel(Nv=1e-3, chi=0.1))
    >>> bool(abs(D[0, 0, 1, 1] - D[1, 1, 0, 0]) < 1e-15)
    True
    """
    B, C, J = _paper_coefficients(G, mu, gel)
    inverse = jnp.linalg.inv(G)
    return 2 * B / J**2 * cofactor_derivative() + C * jnp.einsum("ji,lk->ijkl", inverse, inverse)


def voigt(D: Float[Array, "2 2 2 2"]) -> Float[Array, "3 3"]:
    """Matrix (3, 3) of a tangent (2, 2, 2, 2) in the order 11, 22, 12.

    Components as they are: for strains with 2 E_12 in third place.
    """
    rows, columns = jnp.array([0, 1, 0]), jnp.array([0, 1, 1])
    return D[rows[:, None], columns[:, None], rows[None, :], columns[None, :]]


def _paper_coefficients(G, mu, gel):
    """B of Eq. (6), C of Eq. (8) = J' dB/dJ' - 2 B, and J'."""
    if gel.network is not neo_hookean or gel.volumetric is not flory_rehner:
        raise ValueError(
            "gel: Eqs. (6)-(9) hold for the Flory-Rehner energy only; differentiate free_energy "
            "for another"
        )
    Jm, J = free_swelling(mu, gel) ** 2, jnp.sqrt(jnp.linalg.det(G))
    logarithm = -J * jnp.log1p(1 / (Jm * J - 1))  # J' ln(1 - 1/(J_mu J'))
    mixing = gel.chi / (Jm**2 * J)
    B = (1 - gel.Nv) / Jm + logarithm + mixing - mu * J
    C = -2 * (1 - gel.Nv) / Jm + J / (Jm * J - 1) - logarithm + mu * J - 3 * mixing
    return B, C, J


def cofactor_derivative() -> Float[Array, "2 2 2 2"]:
    """Q_ijkl (2, 2, 2, 2) of Eq. (9) with G33 = 1: dcof(G)_ij/dG_kl, G_12 and G_21 together.

    cof(G)_ij = e_ik e_jl G_kl; both are varied together.
    """
    e = jnp.array([[0.0, 1.0], [-1.0, 0.0]])
    return (jnp.einsum("ik,jl->ijkl", e, e) + jnp.einsum("il,jk->ijkl", e, e)) / 2
