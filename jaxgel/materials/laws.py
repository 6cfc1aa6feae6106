"""Constitutive laws of the volume ratio: pressure and stiffness from one energy.

They are those of a gel or an elastomer. A is the areal stretch, the determinant of the in-plane
deformation gradient, l3 the stretch out of plane and J = l3 A the volume ratio. The energy per dry
volume besides that of the in-plane network, in kT/v, is with phi(J) = volumetric(J) - mu (J - 1),
see ``gel``, and elastic(J) in elastomers, see ``composite``,

    w(A) = phi(l3 A)                                      at a given l3,
    w(A) = min over l3 of [Nv/2 (l3^2 - 1) + phi(l3 A)]   in a film.

The given l3 is 1 in plane strain, and the axial stretch in generalised plane strain. A film is in
plane stress: no stress acts through the thickness.

p = dw/dA is the pressure, d2w/dA2 the stiffness. A film's network is neo-Hookean, whose energy is a
sum over the directions. Its pressure is -Nv J^2 / A^3, negative, and its A may be below 1.
"""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp

from .._compiled import compiled
from .._types import Array, Float, Scalar
from .composite import takes_solvent
from .fields import elementwise
from .swelling import (
    LARGEST_SWELLING,
    Numbers,
    branch_ends,
    first_root,
    least_volume_ratio,
    rises_always,
    stiff_until,
    volume_ratio_at,
)

# of Nv: a film's pressure that is not below this is taken for it, as none at or above zero exists
SLACK = 1e-9


@functools.partial(
    jax.tree_util.register_dataclass, data_fields=["gel", "mu", "axial"], meta_fields=["film"]
)
@dataclasses.dataclass(frozen=True, eq=False)
class VolumeLaw:
    """Law of a gel or an elastomer in one kinematics; a pytree.

    Its functions are elementwise, with parameters and ``mu`` of each place.

    >>> from jaxgel.materials import Gel
    >>> law = VolumeLaw(Gel(Nv=1e-3, chi=0.1), -1.0, film=True)
    >>> round(float(law.areal_stretch(law.pressure(1.2))), 12)
    1.2
    """

    gel: Any
    """Gel, whose parameters are numbers or arrays that broadcast with the areal stretches."""
    mu: Numbers
    """Chemical potential (...), kT."""
    axial: Scalar | None = None
    """Stretch out of plane () at which the plate is held.

    None in plane strain (it is 1) and for a film.
    """
    film: bool = False
    """Whether the plate is a film."""

    @property
    def _held(self):
        return 1.0 if self.axial is None else self.axial

    @compiled()
    def energy(self, A: Numbers) -> Float[Array, "..."]:
        """Energy w (...), kT/v, at the areal stretch ``A`` (...)."""
        if self.film:
            return _film_energy(A, self.gel, self.mu)
        return _free_part(self._held * jnp.asarray(A, float), self.gel, self.mu)

    @compiled()
    def pressure(self, A: Numbers) -> Float[Array, "..."]:
        """Pressure dw/dA (...), kT/v, at the areal stretch ``A`` (...)."""
        return _derivative(self.energy, A)

    @compiled()
    def stiffness(self, A: Numbers, J: Numbers | None = None) -> Float[Array, "..."]:
        """Stiffness d2w/dA2 (...), kT/v, at the areal stretch ``A`` (...).

        Of a film with the volume ratio ``J`` if that is given.
        """
        if not self.film:
            return _derivative(self.pressure, A)
        J = self.volume_ratio(A) if J is None else J
        A, J = jnp.broadcast_arrays(jnp.asarray(A, float), J)

        def condensed(A, J, gel, mu):
            (AA, AJ), (_, JJ) = jax.hessian(_film_energy_at, argnums=(0, 1))(A, J, gel, mu)
            # J follows A; the derivative of the pressure would differentiate the root once more
            return AA - AJ**2 / JJ

        return elementwise(condensed, A, J, self.gel, self.mu)

    @compiled()
    def volume_ratio(self, A: Numbers) -> Float[Array, "..."]:
        """Volume ratio J (...) at the areal stretch ``A`` (...) > 0.

        That of a film in a poor solvent is the root on the side of the dry state while there is
        one, and the swollen one beyond: films that are swollen at an ``A`` at which they can be
        collapsed, too, are left out.
        """
        return (
            _film_volume_ratio(A, self.gel, self.mu)
            if self.film
            else self._held * jnp.asarray(A, float)
        )

    @compiled()
    def areal_stretch(self, p: Numbers, largest: Numbers | None = None) -> Float[Array, "..."]:
        """Areal stretch A (...) of the pressure ``p`` (...): the inverse of `pressure`.

        Finite for every p. On the side of the dry state, see `volume_ratio_at`, up to the A that is
        ``largest`` (...) if that is known; without meaning for a film. With A^3 = -Nv J^2 / p the
        condition on the J of a film is phi'(J) + (Nv p^2 / J)^(1/3) = 0; that of an elastomer
        increases with J from 1/2 on.
        """
        if not self.film:
            largest = None if largest is None else self._held * largest
            return (
                volume_ratio_at(jnp.asarray(p, float) / self._held, self.mu, self.gel, largest)
                / self._held
            )
        gel, target = self.gel, takes_solvent(self.gel) * self.mu
        p = jnp.minimum(jnp.asarray(p, float), -SLACK * gel.Nv)
        rises = rises_always(gel)
        # far from there the slope falls to 0, not to a mu below it
        below = jnp.all((target < 0) | ~takes_solvent(gel))
        rises = rises if rises is False else rises & below
        end = branch_ends(_at_pressure, gel, p, rises=rises)
        J = first_root(
            _at_pressure, target, end, gel, p, least=jnp.maximum(least_volume_ratio(gel), 0.5)
        )
        return jnp.cbrt(-gel.Nv * J**2 / p)

    @compiled()
    def swelling(self, A: Numbers) -> Float[Array, "..."]:
        """Scale of the accuracy of ``A`` (...): J - 1 in a gel, J in elastomers, A in films.

        A is the areal stretch.
        """
        A = jnp.asarray(A, float)
        return A if self.film else self._held * A - least_volume_ratio(self.gel)

    @compiled()
    def stiff_until(self, stiffness: Numbers) -> Float[Array, "..."]:
        """Areal stretch (...) up to which the law is stiffer than ``stiffness`` (...), kT/v.

        See `swelling.stiff_until`; 0 for a film.
        """
        return jnp.zeros(()) if self.film else stiff_until(stiffness, self.gel) / self._held


def _derivative(function, x):
    """Derivative (...) of an elementwise function at ``x`` (...)."""
    x = jnp.asarray(x, float)
    return jax.jvp(function, (x,), (jnp.ones_like(x),))[1]


def _free_part(J, gel, mu):
    """Energy phi (...), kT/v, at the volume ratio ``J`` (...)."""
    return elementwise(
        lambda J, gel, mu: gel.volumetric(J, gel) - takes_solvent(gel) * mu * (J - 1), J, gel, mu
    )


def _film_energy_at(A, J, gel, mu):
    """Energy () of a film with the areal stretch ``A`` () and the volume ratio ``J`` ()."""
    return _at_stretch(J, gel, A) - gel.Nv / 2 - takes_solvent(gel) * mu * (J - 1)


@jax.custom_jvp
def _film_energy(A, gel, mu):
    return elementwise(_film_energy_at, A, _film_volume_ratio(A, gel, mu), gel, mu)


@_film_energy.defjvp
def _film_energy_jvp(primals, tangents):
    """At fixed J, in which the energy is stationary (envelope theorem)."""
    J = _film_volume_ratio(*primals)
    return jax.jvp(
        lambda A, gel, mu: elementwise(_film_energy_at, A, J, gel, mu), primals, tangents
    )


def _film_volume_ratio(A, gel, mu):
    """J (...) of a film, see `VolumeLaw.volume_ratio`."""
    A, target = jnp.asarray(A, float), takes_solvent(gel) * mu
    end = branch_ends(_at_stretch, gel, A, rises=rises_always(gel))
    beyond = target >= elementwise(jax.grad(_at_stretch), *jax.lax.stop_gradient((end, gel, A)))
    return first_root(_at_stretch, target, jnp.where(beyond, 1 + LARGEST_SWELLING, end), gel, A)


def _at_stretch(J, gel, A):
    """Energy () of a film with the areal stretch ``A`` () less that of the solvent."""
    return gel.volumetric(J, gel) + gel.Nv / 2 * (J / A) ** 2


def _at_pressure(J, gel, p):
    """The same with the pressure ``p`` (), less p A."""
    return gel.volumetric(J, gel) + 1.5 * jnp.cbrt(gel.Nv * p**2) * jnp.cbrt(J) ** 2
