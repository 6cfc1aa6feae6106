"""Total energy of a model as one pure function of the nodal positions, and its residual.

Energies are in kT/v times mm^2, forces in kT/v times mm. Index letters as in ``discretisation``. A free axial stretch l3 in generalised
plane strain is a function of the positions, as the thickness of a film is: the energy is the least over l3, and its derivatives follow.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax

from .._types import Array, Float, Scalar
from ..discretisation import Model
from ..materials import (
    Gent,
    LocalGel,
    balanced_stretch,
    elementwise,
    gel_at_points,
    gel_in_groups,
    neo_hookean,
    network_at,
    rises_always,
    stretch_near,
    value,
)
from .contact import contact_energy
from .volumes import (
    all_volumes,
    carries_volume,
    gradients_by_block,
    held_stretch,
    ratios_of,
    ratios_that_carry,
    volume_energy,
    volume_ratios,
)

LEAST_WORK = 1e-4  # of the axial force of the dry network: pressures that push with less do so in no state of equilibrium


def total_energy(
    x: Float[Array, "n 2"], model: Model, gel: LocalGel, mu: Scalar, loads: Float[Array, "n 2"], pressure: Float[Array, " g"] | None = None
) -> Float[Array, ""]:
    """Total energy (), kT/v mm^2, at nodal positions ``x`` (n, 2): free energy of the gel less the work of dead ``loads`` (n, 2).

    It includes the self-contact of a model that has it.
    The weak form of Deng et al. (2020), Eqs. (3) and (10), is its first variation. NaN where a volume ratio is not above 1.
    For derivatives at an equilibrium, its ``pressure`` (g,) says more of the volume ratios than ``x``: see `ratios_that_carry`.
    """
    gradients = gradients_by_block(x, model)
    J = ratios_of(gradients, x, model)
    axial, near = held_stretch(model), None
    if pressure is not None:
        near = stretch_of_pressure(x, J, pressure, model, gel) if axial is None else axial
        J = ratios_that_carry(J, pressure, model, gel, mu, near)
    axial = _relaxed_stretch(gradients, J, model, gel, mu, near) if axial is None else axial
    touch = contact_energy(x, model) if model.contact is not None else 0.0
    return _network_energy(gradients, model, gel, axial) + volume_energy(J, model, gel, mu, axial) - jnp.sum(loads * x) + touch


def curvature(
    x: Float[Array, "n 2"], v: Float[Array, "n 2"], model: Model, gel: LocalGel, mu: Scalar, loads: Float[Array, "n 2"]
) -> Float[Array, ""]:
    """Second derivative () of the total energy along the field ``v`` (n, 2), at ``x`` (n, 2): v . K v."""

    def along(t):
        return total_energy(x + t * v, model, gel, mu, loads)

    return jax.jvp(lambda t: jax.jvp(along, (t,), (1.0,))[1], (0.0,), (1.0,))[1]


def network_energy(x: Float[Array, "n 2"], model: Model, gel: LocalGel, axial: Scalar = 1.0) -> Float[Array, ""]:
    """Energy () of the network alone, kT/v mm^2, at the ``axial`` stretch."""
    return _network_energy(gradients_by_block(x, model), model, gel, axial)


def _network_energy(gradients, model, gel, axial):
    return _integrated_network(gel, gradients, [block.weight for block in model.blocks], axial)


def _integrated_network(gel, gradients, weights, axial):
    network, total = network_at(gel, axial), 0.0
    for number, (F, weight) in enumerate(zip(gradients, weights, strict=True)):
        total += jnp.sum(weight * elementwise(network, F, gel_at_points(gel, number), "(i,j)->()"))
    return total


# --- the axial stretch -------------------------------------------------------------------------------------------------------


def axial_stretch(x: Float[Array, "n 2"], model: Model, gel: LocalGel, mu: Scalar, pressure: Float[Array, " g"] | None = None) -> Scalar:
    """Axial stretch of a plate with the nodal positions ``x`` (n, 2): the held one, or that at which no axial force acts.

    1 in plane strain, and for a film, whose thickness is not one number. In a poor solvent the force may vanish at several stretches: the
    ``pressure`` (g,) of the state says which is meant, by default the least.
    """
    held = held_stretch(model)
    if held is not None:
        return held
    A = volume_ratios(x, model)
    near = None if pressure is None else stretch_of_pressure(x, A, pressure, model, gel)
    return _relaxed_stretch(gradients_by_block(x, model), A, model, gel, mu, near)


def _relaxed_stretch(gradients, A, model, gel, mu, near=None):
    """The free axial stretch () at the areal stretches ``A`` (g,): all l3 A are above 1. The least, or in a poor solvent one ``near``."""
    V, gel_there = jnp.where(carries_volume(model), all_volumes(model), 0.0), gel_in_groups(gel)
    least = jnp.min(jnp.where(V > 0, A, jnp.inf))
    of = _network_parts(gradients, model, gel), jnp.where(V > 0, A, lax.stop_gradient(least)), V, gel_there, mu
    rises, most = rises_always(gel_there), _largest_stretch(gradients, gel)

    def least_root():
        return balanced_stretch(_energy_at_stretch, of, 1 / least, 1 / least, most, rises)

    def nearest():
        return stretch_near(_energy_at_stretch, of, near)

    if near is None:
        return least_root()
    return nearest() if rises is False else lax.cond(rises, least_root, nearest)


def stretch_of_pressure(
    x: Float[Array, "n 2"], A: Float[Array, " g"], p: Float[Array, " g"], model: Model, gel: LocalGel
) -> Float[Array, ""]:
    """The free axial stretch () at the areal stretches ``A`` (g,) and pressures ``p`` (g,), without derivatives: any pair has one.

    At an equilibrium that of `axial_stretch`: the network's axial force balances that of the pressures, -sum V A p / l3, which must be
    above 0 and is taken for ``LEAST_WORK`` of the dry network's where it is not.
    """
    x, A, p, model, gel = lax.stop_gradient((x, A, p, model, gel))
    V = jnp.where(carries_volume(model), all_volumes(model), 0.0)
    gradients = gradients_by_block(x, model)
    stiffness = _axial_stiffness(model, gel)
    work = jnp.maximum(-jnp.sum(V * A * p), LEAST_WORK * stiffness)
    if gel.network is neo_hookean:
        return jnp.sqrt(work / stiffness)
    parts = _network_parts(gradients, model, gel)
    return balanced_stretch(_energy_against_pressure, (parts, work), 0.0, 1.0, _largest_stretch(gradients, gel))


def _largest_stretch(gradients, gel):
    """The stretch () at which the network's energy ends."""
    if not isinstance(gel.network, Gent):
        return jnp.inf
    return jnp.min(jnp.stack([jnp.min(gel.network.largest_axial(F)) for F in gradients]))


def _axial_stiffness(model, gel):
    """Sum of w Nv (), kT/v mm^2: the axial stiffness of the dry network."""
    return sum(jnp.sum(block.weight * value(gel_at_points(gel, number).Nv)) for number, block in enumerate(model.blocks))


def _network_parts(gradients, model, gel):
    """What the network's energy by l3 needs: for a sum of squares its stiffness, else the gel, deformation gradients and weights."""
    if gel.network is neo_hookean:
        return _axial_stiffness(model, gel)
    return gel, gradients, [block.weight for block in model.blocks]


def _network_at_stretch(axial, parts):
    return _integrated_network(*parts, axial) if isinstance(parts, tuple) else parts * axial**2 / 2


def _energy_at_stretch(axial, of):
    """Energy () of a plate by its axial stretch, at given areal stretches."""
    parts, A, V, gel, mu = of
    swelling = elementwise(lambda J, gel: gel.volumetric(J, gel) - mu * J, axial * A, gel)
    return _network_at_stretch(axial, parts) + jnp.sum(V * swelling)


def _energy_against_pressure(axial, of):
    """The network's energy () less the ``work`` of the pressures, whose axial force is work / l3."""
    parts, work = of
    return _network_at_stretch(axial, parts) - work * jnp.log(axial)


residual: Callable[..., Array] = jax.grad(total_energy)
"""Residual (n, 2) of the total energy, kT/v mm: zero on the free degrees of freedom at equilibrium."""
energy_at = jax.jit(total_energy)
"""Compiled `total_energy`."""


def hessian_product(
    x: Float[Array, "n 2"],
    v: Float[Array, "n 2"],
    model: Model,
    gel: LocalGel,
    mu: Scalar,
    loads: Float[Array, "n 2"],
    pressure: Float[Array, " g"] | None = None,
) -> Float[Array, "n 2"]:
    """Product (n, 2) of the Hessian of the total energy at ``x`` (n, 2) with the field ``v`` (n, 2), kT/v mm; differentiable by all."""
    return jax.jvp(lambda x: residual(x, model, gel, mu, loads, pressure), (x,), (v,))[1]
