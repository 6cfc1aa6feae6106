"""Total energy of a model as one pure function of the nodal positions, and its residual.

Energies are in kT/v times mm^2, forces in kT/v times mm. Index letters as in ``discretisation``; ``g`` is a volume group: a cell
(method "mixed") or a single quadrature point (method "displacement"). Quantities of all groups are one vector, block after block.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._types import Array, Float, Scalar
from ..discretisation import CellBlock, Model, in_plane
from ..materials import Gel, bulk_stiffness, osmotic
from .contact import contact_energy


def deformation_gradients(x: Float[Array, "n 2"], block: CellBlock) -> jax.Array:
    """Deformation gradients (c, q, 2, 2) at the quadrature points of a block for nodal positions ``x`` (n, 2)."""
    return in_plane(jnp.einsum("cai,cqaj->cqij", x[block.nodes], block.dphi), axis=2)


def group_volumes(block: CellBlock, method: str) -> Float[Array, "c g"]:
    """Dry volumes (c, g) of a block's volume groups, mm^2; 0 for padding."""
    return jnp.sum(block.weight, axis=1, keepdims=True) if method == "mixed" else block.weight


def volume_ratios(x: Float[Array, "n 2"], model: Model) -> Float[Array, " g"]:
    """Mean volume ratios (g,) of all volume groups; 2 for padding."""
    return _volume_ratios(_gradients(x, model), model)


def _gradients(x, model):
    """Per block the ``deformation_gradients``."""
    return [deformation_gradients(x, block) for block in model.blocks]


def _volume_ratios(gradients, model):
    ratios = []
    for F, block in zip(gradients, model.blocks, strict=True):
        volume, J = group_volumes(block, model.method), 0.5 * jnp.sum(F * _cofactors(F), axis=(2, 3))
        if model.method == "mixed":
            J = jnp.sum(block.weight * J, axis=1, keepdims=True) / volume
        ratios.append(jnp.where(volume > 0, J, 2.0).ravel())
    return jnp.concatenate(ratios)


def _cofactors(F):
    """Cofactors (..., 2, 2) of matrices (..., 2, 2), without taking these apart: derivatives of single entries would be padded."""
    return jnp.array([[1.0, -1.0], [-1.0, 1.0]]) * F[..., ::-1, ::-1]


def all_volumes(model: Model) -> Float[Array, " g"]:
    """Dry volumes (g,) of all volume groups, mm^2; 0 for padding."""
    return jnp.concatenate([group_volumes(block, model.method).ravel() for block in model.blocks])


def by_block(values: Float[Array, " g"], model: Model) -> list[jax.Array]:
    """Values (g,) of all volume groups as arrays (c, g) per block."""
    shapes = [(len(b.weight), 1) if model.method == "mixed" else b.weight.shape for b in model.blocks]
    cuts = np.cumsum([rows * columns for rows, columns in shapes])[:-1]
    return [part.reshape(shape) for part, shape in zip(jnp.split(values, cuts), shapes, strict=True)]


def total_energy(
    x: Float[Array, "n 2"], model: Model, gel: Gel, mu: Scalar, loads: Float[Array, "n 2"], pressure: Float[Array, " g"] | None = None
) -> Float[Array, ""]:
    """Total energy (), kT/v mm^2, at nodal positions ``x`` (n, 2): free energy of the gel less the work of dead ``loads`` (n, 2).

    It includes the self-contact of a model that has it.
    The weak form of Deng et al. (2020), Eqs. (3) and (10), is its first variation. NaN where a volume ratio is not above 1.
    For derivatives at an equilibrium, its ``pressure`` (g,) says more of the volume ratios than ``x``: see `_with_pressure_of`.
    """
    gradients = _gradients(x, model)
    J = _volume_ratios(gradients, model)
    J = J if pressure is None else _with_pressure_of(J, pressure, model, gel, mu)
    swelling = jax.vmap(lambda J: gel.volumetric(J, gel) - mu * (J - 1))(J)
    touch = contact_energy(x, model) if model.contact is not None else 0.0
    return _network_energy(gradients, model, gel) + jnp.sum(all_volumes(model) * swelling) - jnp.sum(loads * x) + touch


def _with_pressure_of(J, pressure, model, gel, mu):
    """The volume ratios (g,) that carry the ``pressure`` (g,), with the derivatives of those near them, ``J`` (g,).

    Newton's method ends where these agree to 1e-11 of the swelling J - 1; multiplied by the bulk stiffness that is 1e-8 of the pressure,
    which mixed second derivatives would show.
    """
    stiffness = bulk_stiffness(J, gel)
    real = (all_volumes(model) > 0) & (stiffness > 0)
    return J + lax.stop_gradient(jnp.where(real, (pressure - osmotic(J, mu, gel)) / jnp.where(real, stiffness, 1.0), 0.0))


def curvature(
    x: Float[Array, "n 2"], v: Float[Array, "n 2"], model: Model, gel: Gel, mu: Scalar, loads: Float[Array, "n 2"]
) -> Float[Array, ""]:
    """Second derivative () of the total energy along the field ``v`` (n, 2), at ``x`` (n, 2): v . K v."""

    def along(t):
        return total_energy(x + t * v, model, gel, mu, loads)

    return jax.jvp(lambda t: jax.jvp(along, (t,), (1.0,))[1], (0.0,), (1.0,))[1]


def network_energy(x: Float[Array, "n 2"], model: Model, gel: Gel) -> Float[Array, ""]:
    """Energy () of the network alone, kT/v mm^2."""
    return _network_energy(_gradients(x, model), model, gel)


def _network_energy(gradients, model, gel):
    density = jax.vmap(jax.vmap(lambda F: gel.network(F, gel)))
    return sum(jnp.sum(block.weight * density(F)) for F, block in zip(gradients, model.blocks, strict=True))


residual: Callable[..., Array] = jax.grad(total_energy)
"""Residual (n, 2) of the total energy, kT/v mm: zero on the free degrees of freedom at equilibrium."""
energy_at = jax.jit(total_energy)
"""Compiled `total_energy`."""
