"""Responsive gels: PNIPAM to temperature, a polyelectrolyte to pH and salt of its bath.

PNIPAM is poly(N-isopropylacrylamide). Both differ from `Gel` in the part of the energy that depends
on J alone. `phases` finds where they have two phases.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .._compiled import compiled
from .._types import Array, Float, Scalar
from .composite import Composite
from .fields import Field
from .gel import LocalGel, neo_hookean
from .mixing import flory_huggins, flory_rehner

ZERO_CELSIUS = 273.15  # K
# (A0, B0), (A1, B1): chi_i = A_i + B_i T with T in K
PNIPAM_CONSTANTS = ((-12.947, 0.04496), (17.92, -0.0569))
MOLECULES_PER_NM3 = 0.602214076  # of 1 mol/l
NEWTON_STEPS = 7  # of the Donnan potential: one more than any bath and gel needs


def pnipam_chi(J: Float[Array, "..."] | Scalar, temperature: Scalar) -> Float[Array, "..."]:
    """Flory's parameter (...) of PNIPAM in water, chi0 + chi1 / J, at ``J`` and ``temperature``.

    J is the volume ratio (...), the temperature is in degrees Celsius.
    """
    chi0, chi1 = _chi_terms(temperature)
    return chi0 + chi1 / J


def pnipam_energy(J: Float[Array, "..."] | Scalar, gel: Any) -> Float[Array, "..."]:
    """Energy of `Pnipam` of ``J`` (...) > 1 alone, kT/v per dry volume.

    (J-1) ln(1 - 1/J) + chi (1 - 1/J) - Nv ln J with chi = chi0 + chi1/J, less the constant chi0.
    """
    chi0, chi1 = _chi_terms(gel.temperature)
    return flory_huggins(J, chi0 - chi1) - chi1 / J**2 - gel.Nv * jnp.log(J)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Pnipam:
    """A gel of poly(N-isopropylacrylamide) in water, which shrinks if heated; the user makes it.

    A pytree, as `Gel`. Energies are in kT/v with T of the gel. 0 to 100 degrees Celsius are
    accepted, at which water is liquid; no source at hand says between which temperatures the fit
    holds. The gel may have two phases at one temperature, see `coexistence`. Functions that follow
    one state, as `free_swelling`, then give the shrunken one, up to where it ends.

    Source: Cai & Suo (2011), J. Mech. Phys. Solids 59, 2259, whose constants A0 = -12.947,
    B0 = 0.04496/K, A1 = 17.92, B1 = -0.0569/K fit data of Afroze, Nies & Berghmans (2000),
    J. Mol. Struct. 554, 55, on solutions of the polymer.
    """

    Nv: Scalar | Field = 0.01
    """Chains per dry volume times solvent molecule volume (); dry shear modulus in kT/v."""
    temperature: Scalar | Field = 25.0
    """Temperature, degrees Celsius."""
    network: Callable = dataclasses.field(
        default=neo_hookean, kw_only=True, metadata={"static": True}
    )
    """Network energy (F (2, 2), gel) -> (), kT/v."""
    volumetric: Callable = dataclasses.field(
        default=pnipam_energy, kw_only=True, metadata={"static": True}
    )
    """Energy of mixing (J (), gel) -> (), kT/v."""


def ionic_energy(J: Float[Array, "..."] | Scalar, gel: Any) -> Float[Array, "..."]:
    """Energy (...) of ions and acidic groups of a `Polyelectrolyte` at ``J`` (...) > 1, kT/v.

    Per dry volume; the ions are mobile. Legendre transform with respect to the ions, which the bath
    provides. Its slope is -v (sum of c - sum of c_bath): less the osmotic pressure of the ions.
    """
    return _ionic(*_charges(J, gel))


def polyelectrolyte_energy(J: Float[Array, "..."] | Scalar, gel: Any) -> Float[Array, "..."]:
    """Energy of `Polyelectrolyte` of ``J`` (...) > 1 alone, kT/v per dry volume."""
    return flory_rehner(J, gel) + ionic_energy(J, gel)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Polyelectrolyte:
    """A gel with acidic groups in a bath of given pH and salt; the user makes it.

    A pytree, as `Gel`. It swells when the groups dissociate. Ideal mobile ions, hydrogen, a cation
    and an anion of charge one, are in Donnan equilibrium with the bath, and groups dissociate by
    the law of mass action, c_H c_A / c_AH = 10^-pKa mol/l. Hydroxide is left out, so the model is
    for 10^(pH - 14) well below the salt. `mu` is the chemical potential of the solvent above that
    in the bath: a gel in its bath has mu = 0.

    Source: Marcombe et al. (2010), Soft Matter 6, 784.
    """

    Nv: Scalar | Field = 1e-3
    """Chains per dry volume times solvent molecule volume (); dry shear modulus in kT/v."""
    chi: Scalar | Field = 0.1
    """Flory's parameter of mixing ()."""
    pH: Scalar | Field = 7.0  # noqa: N815
    """pH of the bath (), whose hydrogen ions are 10^-pH mol/l."""
    salt: Scalar | Field = 0.01
    """Cations of the salt in the bath, mol/l; its anions balance these and the hydrogen ions."""
    acid_fraction: Scalar | Field = 0.05
    """Number of acidic groups in the volume v of dry polymer ()."""
    pKa: Scalar | Field = 4.3  # noqa: N815
    """pKa of the acidic groups ()."""
    solvent_volume: Scalar | Field = 0.1
    """Volume v of a solvent molecule and of a monomer, nm^3."""
    network: Callable = dataclasses.field(
        default=neo_hookean, kw_only=True, metadata={"static": True}
    )
    """Network energy (F (2, 2), gel) -> (), kT/v."""
    volumetric: Callable = dataclasses.field(
        default=polyelectrolyte_energy, kw_only=True, metadata={"static": True}
    )
    """Energy of mixing and of the ions (J (), gel) -> (), kT/v."""


AnyGel = LocalGel | Composite
"""What may be given as the gel of a model."""


class Ions(NamedTuple):
    """What is dissolved in a `Polyelectrolyte`.

    Concentrations are per current volume of the gel.
    """

    hydrogen: Float[Array, "..."]
    """Hydrogen ions, mol/l."""
    cations: Float[Array, "..."]
    """Cations of the salt, mol/l."""
    anions: Float[Array, "..."]
    """Anions of the salt, mol/l."""
    fixed: Float[Array, "..."]
    """Dissociated groups of the network, mol/l."""
    potential: Float[Array, "..."]
    """Electric potential against the bath, kT/e: 0 or less."""


def ions(J: Float[Array, "..."] | Scalar, gel: Any) -> Ions:
    """Concentrations and Donnan potential of a `Polyelectrolyte` at the volume ratio ``J`` (...).

    >>> at = ions(20.0, Polyelectrolyte(pH=6.0, salt=0.01))
    >>> bool(abs(at.hydrogen + at.cations - at.anions - at.fixed) < 1e-15)
    True
    """
    bath, acid, shift = _charges(J, gel)
    psi = _donnan(bath, acid, shift)
    protons, more = 10.0 ** (-gel.pH), jnp.exp(psi)
    fixed = acid * jax.nn.sigmoid(-psi - shift) / (J * gel.solvent_volume * MOLECULES_PER_NM3)
    return Ions(protons * more, gel.salt * more, (gel.salt + protons) / more, fixed, -psi)


def _chi_terms(temperature):
    """chi0 and chi1."""
    kelvin = temperature + ZERO_CELSIUS
    return tuple(a + b * kelvin for a, b in PNIPAM_CONSTANTS)


def _charges(J, gel):
    """Arguments of `_ionic`: J times bath anions, acidic groups, both in v, and the shift.

    The shift is the logarithm of the ratio of undissociated to dissociated groups without a Donnan
    potential.
    """
    bath = (gel.salt + 10.0 ** (-gel.pH)) * gel.solvent_volume * MOLECULES_PER_NM3
    shift = math.log(10) * (gel.pKa - gel.pH)
    return tuple(jnp.asarray(part, float) for part in (J * bath, gel.acid_fraction, shift))


@jax.custom_jvp
def _ionic(bath, acid, shift):
    """Energy of the ions: max over psi of 2 bath (1 - cosh psi) - acid ln(1 + exp(-psi - shift)).

    psi is less the Donnan potential. ``bath`` is J times the anions of the bath and ``acid`` the
    groups, both in the volume v. This is the dual of the minimum over the amounts of all ions at
    charge balance, whose multiplier is psi. The maximum is concave, and where its slope vanishes
    charges balance: 2 bath sinh psi = acid / (1 + exp(psi + shift)).
    """
    psi = _donnan(bath, acid, shift)
    return -4 * bath * jnp.sinh(psi / 2) ** 2 - acid * jax.nn.softplus(-psi - shift)


@_ionic.defjvp
def _ionic_jvp(primals, tangents):
    """Psi is where the slope by it vanishes, so that it counts as held in first derivatives."""
    bath, acid, shift = primals
    psi = _donnan(bath, acid, shift)
    by_bath, by_acid = -4 * jnp.sinh(psi / 2) ** 2, -jax.nn.softplus(-psi - shift)
    by_shift = acid * jax.nn.sigmoid(-psi - shift)
    return _ionic(*primals), by_bath * tangents[0] + by_acid * tangents[1] + by_shift * tangents[2]


@jax.custom_jvp
@compiled()
def _donnan(bath, acid, shift):
    """Psi >= 0 at which charges balance, see `_ionic`.

    Newton's method for s = ln sinh psi in s + ln(2 bath / acid) + ln(1 + exp(shift + psi)) = 0. The
    left side is convex in s with slopes in [1, 2), and not negative at s = ln(acid / (2 bath)), all
    groups dissociated: from there the iterates fall to the root.
    """
    some = acid > 0
    highest = jnp.log(jnp.where(some, acid, 1.0)) - jnp.log(2 * bath)

    def step(_, s):
        psi = jnp.arcsinh(jnp.exp(s))
        slope = 1 + jax.nn.sigmoid(shift + psi) * jnp.tanh(psi)
        return s - (s - highest + jax.nn.softplus(shift + psi)) / slope

    start = highest + 0.0 * shift
    return jnp.where(
        some, jnp.arcsinh(jnp.exp(jax.lax.fori_loop(0, NEWTON_STEPS, step, start))), 0.0
    )


@_donnan.defjvp
def _donnan_jvp(primals, tangents):
    """2 bath sinh psi - acid a(psi + shift) = 0 with a' = -a (1 - a)."""
    bath, acid, shift = primals
    psi = _donnan(bath, acid, shift)
    dissociated = jax.nn.sigmoid(-psi - shift)
    spread = acid * dissociated * (1 - dissociated)
    change = 2 * jnp.sinh(psi) * tangents[0] - dissociated * tangents[1] + spread * tangents[2]
    return psi, -change / (2 * bath * jnp.cosh(psi) + spread)
