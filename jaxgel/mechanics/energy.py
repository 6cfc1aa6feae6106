"""Total energy of a model as one pure function of the nodal positions, and its residual.

Energies are in kT/v times mm^2, forces in kT/v times mm. Index letters as in ``discretisation``.
The derivative of the energy of a state by the axial stretch of generalised plane strain is the
axial force, kT/v times mm^2.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from .._compiled import compiled
from .._types import Array, Chemical, Float
from ..discretisation import Body
from ..materials import LocalGel, elementwise, gel_at_points, network_at
from .contact import contact_energy
from .patchwise import over_patches
from .volumes import (
    bare,
    contents,
    deformation_gradients,
    ratios_of,
    ratios_that_carry,
    volume_energy,
)


def total_energy(
    x: Float[Array, "n 2"],
    model: Body,
    gel: LocalGel,
    mu: Chemical,
    loads: Float[Array, "n 2"],
    pressure: Float[Array, " g"] | None = None,
) -> Float[Array, ""]:
    """Total energy (), kT/v mm^2, at nodal ``x`` (n, 2): free energy less work of ``loads``.

    The free energy of the gel; dead loads (n, 2). It includes the contact of a model that has it.
    The weak form of Deng et al. (2020), Eqs. (3) and (10), is its first variation. NaN if a volume
    ratio is not above 1. For derivatives at an equilibrium, its ``pressure`` (g,) says more of the
    volume ratios than ``x``: see `ratios_that_carry`.
    """
    network, J = _network_and_ratios(x, model, gel)
    if pressure is not None:
        J = ratios_that_carry(J, pressure, model, gel, mu)
    return (
        network + volume_energy(J, model, gel, mu) - jnp.sum(loads * x) + contact_energy(x, model)
    )


def curvature(
    x: Float[Array, "n 2"],
    v: Float[Array, "n 2"],
    model: Body,
    gel: LocalGel,
    mu: Chemical,
    loads: Float[Array, "n 2"],
) -> Float[Array, ""]:
    """Second derivative () of the total energy along the field ``v`` (n, 2), at ``x`` (n, 2): v .

    K v.
    """

    def along(t):
        return total_energy(x + t * v, model, gel, mu, loads)

    return jax.jvp(lambda t: jax.jvp(along, (t,), (1.0,))[1], (0.0,), (1.0,))[1]


def network_energy(x: Float[Array, "n 2"], model: Body, gel: LocalGel) -> Float[Array, ""]:
    """Energy () of the network alone, kT/v mm^2."""
    return _network_and_ratios(x, model, gel)[0]


def _network_and_ratios(x, model, gel):
    """Energy () of the network, and the volume ratios (g,)."""
    network, energies, parts = network_at(gel, model.axial_stretch), [], []

    def of_patches(block, gel):
        F = deformation_gradients(x, block)
        return jnp.sum(
            block.weight * elementwise(network, F, gel, signature="(i,j)->()"), axis=1
        ), contents(F, x, block)

    for number, block in enumerate(model.blocks):
        energy, content = over_patches(
            of_patches, (bare(block), gel_at_points(gel, number)), block.count
        )
        energies.append(jnp.sum(energy))
        parts.append(content)
    return sum(energies), ratios_of(parts, model)


residual: Callable[..., Array] = jax.grad(total_energy)
"""Residual (n, 2) of the total energy, kT/v mm: zero at equilibrium.

Only the free degrees of freedom count.
"""
energy_at = compiled()(total_energy)
"""Compiled `total_energy` of a model and its own sizes."""


def hessian_product(
    x: Float[Array, "n 2"],
    v: Float[Array, "n 2"],
    model: Body,
    gel: LocalGel,
    mu: Chemical,
    loads: Float[Array, "n 2"],
    pressure: Float[Array, " g"] | None = None,
) -> Float[Array, "n 2"]:
    """Product (n, 2) of the Hessian at ``x`` (n, 2) with ``v`` (n, 2), kT/v mm; differentiable.

    It is differentiable by all arguments.
    """
    return jax.jvp(lambda x: residual(x, model, gel, mu, loads, pressure), (x,), (v,))[1]
