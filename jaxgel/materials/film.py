"""Thin films, in plane stress: the thickness follows the areal stretch so that no stress acts through it.

``F`` (2, 2) is the in-plane deformation gradient, A = det F the areal stretch, l3 the stretch of the thickness and J = A l3 the volume
ratio. For the neo-Hookean network, whose energy is a sum of squares of stretches, the energy of a film is network(F) + w(A, mu) with

    w(A, mu) = min over l3 of [Nv/2 (l3^2 - 1) + volumetric(A l3) - mu (A l3 - 1)],

a function of A alone, as ``volumetric(J) - mu (J - 1)`` is in plane strain; A may be below 1. The minimum is where
volumetric'(J) + Nv J / A^2 = mu, and the film's pressure is dw/dA = -Nv J^2 / A^3 = -Nv l3^2 / A: negative, -Nv in the dry state.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp

from .._types import Array, Float
from .composite import SLACK
from .fields import Varying, elementwise
from .gel import neo_hookean
from .swelling import LARGEST_SWELLING, Numbers, branch_ends, inverted, rises_always


def check_network(gel: Any) -> None:
    """Raise ValueError unless the gel's network is ``neo_hookean``: the energy of others is no sum over the directions."""
    if gel.network is not neo_hookean:
        raise ValueError(f"network: {gel.network!r} is not accepted in plane stress, it must be neo_hookean")


@jax.jit
def film_volume_ratio(A: Numbers, mu: Numbers, gel: Any) -> Float[Array, "..."]:
    """Volume ratio J (...) of a film at the areal stretch ``A`` (...) > 0 and ``mu`` (kT).

    In a poor solvent it is the root on the side of the dry state while there is one, and the swollen one beyond: films that are swollen at
    an ``A`` at which they can be collapsed, too, are left out.
    """
    A, mu = _together(A, mu)
    end = branch_ends(lambda A, gel: (_at_stretch, (gel, A)), A, gel, rises_always(gel))
    end = elementwise(_end_beyond, end, jax.lax.stop_gradient((Varying(A), Varying(mu), gel)))
    return inverted(lambda A, own: (_at_stretch, own[1], (own[0], A)), A, (gel, Varying(mu)), end)


@jax.jit
def film_energy(A: Numbers, mu: Numbers, gel: Any) -> Float[Array, "..."]:
    """w(A, mu) (...), in kT/v per dry volume, at the areal stretch ``A`` (...)."""

    def one(A, own):
        J, mu, gel = own
        return gel.Nv / 2 * ((J / A) ** 2 - 1) + gel.volumetric(J, gel) - mu * (J - 1)

    A, mu = _together(A, mu)
    return elementwise(one, A, (Varying(film_volume_ratio(A, mu, gel)), Varying(mu), gel))


@jax.jit
def film_pressure(A: Numbers, mu: Numbers, gel: Any) -> Float[Array, "..."]:
    """Pressure dw/dA (...), in kT/v, at the areal stretch ``A`` (...)."""
    A, mu = _together(A, mu)
    return elementwise(lambda A, own: -own[1].Nv * own[0] ** 2 / A**3, A, (Varying(film_volume_ratio(A, mu, gel)), gel))


@jax.jit
def film_stiffness(A: Numbers, mu: Numbers, gel: Any) -> Float[Array, "..."]:
    """Stiffness d2w/dA2 (...), in kT/v, at the areal stretch ``A`` (...)."""
    A, mu = _together(A, mu)
    return film_stiffness_at(A, film_volume_ratio(A, mu, gel), gel)


def film_stiffness_at(A: Numbers, J: Float[Array, "..."], gel: Any) -> Float[Array, "..."]:
    """`film_stiffness` where the volume ratio ``J`` (...) is known.

    With k = d2 volumetric / dJ2, (k + Nv/A^2) dJ = 2 Nv J/A^3 dA leaves the pressure in equilibrium with mu.
    """

    def one(A, own):
        J, gel = own
        share = gel.Nv / (A**2 * jax.grad(jax.grad(gel.volumetric))(J, gel) + gel.Nv)
        return gel.Nv * J**2 / A**4 * (3 - 4 * share)

    return elementwise(one, jnp.asarray(A, float), (Varying(J), gel))


@jax.jit
def film_stretch_at(p: Numbers, mu: Numbers, gel: Any) -> Float[Array, "..."]:
    """Areal stretch A (...) at which a film has the pressure ``p`` (...): the inverse of `film_pressure`, finite for every p.

    With A^3 = -Nv J^2 / p the condition on J is volumetric'(J) + (Nv p^2 / J)^(1/3) = mu, whose root on the side of the dry state is taken.
    """
    p, mu = _together(p, mu)
    p = elementwise(lambda p, gel: jnp.minimum(p, -SLACK * gel.Nv), p, gel)
    rises = rises_always(gel)
    rises = rises if rises is False else rises & jnp.all(mu < 0)  # far from there the slope falls to 0, not to a mu below it
    end = branch_ends(lambda p, gel: (_at_pressure, (gel, p)), p, gel, rises)
    J = inverted(lambda p, own: (_at_pressure, own[1], (own[0], p)), p, (gel, Varying(mu)), end)
    return elementwise(lambda p, own: jnp.cbrt(-own[1].Nv * own[0] ** 2 / p), p, (Varying(J), gel))


def _together(x, mu):
    return jnp.broadcast_arrays(jnp.asarray(x, float), jnp.asarray(mu, float))


def _at_stretch(J, gel_and_A):
    """Energy () of J whose slope is ``mu`` at the areal stretch A."""
    gel, A = gel_and_A
    return gel.volumetric(J, gel) + gel.Nv / 2 * (J / A) ** 2


def _end_beyond(end, own):
    """The ``end`` (), ln(J - 1), of the branch from the dry state on, or of the search where mu is above the slopes of that branch."""
    A, mu, gel = own
    return jnp.where(mu < jax.grad(_at_stretch)(1 + jnp.exp(end), (gel, A)), end, math.log(LARGEST_SWELLING))


def _at_pressure(J, gel_and_p):
    """Energy () of J whose slope is ``mu`` at the film's pressure p."""
    gel, p = gel_and_p
    return gel.volumetric(J, gel) + 1.5 * jnp.cbrt(gel.Nv * p**2) * jnp.cbrt(J) ** 2
