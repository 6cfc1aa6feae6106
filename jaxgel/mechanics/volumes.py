"""Volume groups: parts of patches with one volume ratio J, and their pressures.

Index letters as in ``discretisation``; quantities of all groups are one vector (g,), block after
block. A group that carries volume follows the `VolumeLaw` of the plate's kinematics; J is then its
areal stretch, which is the volume ratio in plane strain. A held group is a moment of J without a
pressure; it is penalised with the stiffness of the network, p = HELD Nv J, so that its energy is
HELD Nv/2 V J^2. The chemical potential is one number, or one for each group (g,).
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from .._compiled import compiled
from .._tracing import everywhere
from .._types import Array, Chemical, Float, Scalar
from ..discretisation import Body, PatchBlock
from ..materials import LocalGel, VolumeLaw, gel_in_groups, rises_always, takes_solvent
from .patchwise import over_patches

# bulk stiffness, over the network's Nv, up to which the pressure of a group is linearised about its
# own volume ratio
SOFT = 10.0
ROUNDED = 1e-12  # by which a volume ratio at the end of a range may have been rounded below it
HELD = 2.0  # stiffness that penalises the moments of J without a pressure, over the network's Nv


def axial_stretch(model: Body) -> Scalar:
    """Axial stretch () of the plate.

    The number 1.0 in plane strain and for a film, whose thickness is not one number.
    """
    return 1.0 if model.axial_stretch is None else model.axial_stretch


def volume_law(model: Body, gel: Any, mu: Scalar | Float[Array, "..."]) -> VolumeLaw:
    """Law of a gel on the plate with parameters and ``mu`` as numbers or arrays of places.

    Places may be of any kind.
    """
    return VolumeLaw(gel, mu, model.axial_stretch, film=model.film)


def deformation_gradients(x: Float[Array, "n 2"], block: PatchBlock) -> Array:
    """Deformation gradients (c, q, 2, 2) at a block's quadrature points for nodal ``x`` (n, 2)."""
    return jnp.einsum("cai,cqaj->cqij", local_positions(x, block.nodes), block.dphi)


def local_positions(x: Float[Array, "n 2"], nodes: Array) -> Float[Array, "c a 2"]:
    """Positions of the patches' ``nodes`` from their mean, against round-off of (x / spacing)^2."""
    return x[nodes] - jnp.mean(x[nodes], axis=1, keepdims=True)


def gradients_by_block(x: Float[Array, "n 2"], model: Body) -> list[Array]:
    """Per block the `deformation_gradients`."""
    return [deformation_gradients(x, block) for block in model.blocks]


def cofactors(F: Float[Array, "*b 2 2"]) -> Float[Array, "*b 2 2"]:
    """Cofactors of 2 x 2 matrices as whole arrays.

    Derivatives of single entries would be padded.
    """
    return jnp.array([[1.0, -1.0], [-1.0, 1.0]]) * F[..., ::-1, ::-1]


def group_volumes(block: PatchBlock) -> Float[Array, "c g"]:
    """Dry volumes (c, g) of a block's volume groups, mm^2; 0 for padding.

    A held group counts the whole patch.
    """
    return jnp.sum(block.weight, axis=1, keepdims=True) / np.where(
        _carries(block), block.carrying, 1
    )


def _carries(block):
    """Which groups (g,) of a patch carry its volume."""
    return np.arange(block.n_groups) < block.carrying


@compiled()
def all_volumes(model: Body) -> Float[Array, " g"]:
    """Dry volumes (g,) of all volume groups, mm^2; 0 for padding."""
    return of_groups([group_volumes(block) for block in model.blocks], model)


def by_block(values: Float[Array, " g"], model: Body) -> list[Array]:
    """Values (g,) of all volume groups as arrays (c, g) per block; 0 for padding."""
    values = jnp.asarray(values)
    return [values.at[block.groups].get(mode="fill", fill_value=0) for block in model.blocks]


def of_groups(parts: list[Array], model: Body) -> Float[Array, "g ..."]:
    """The values (g, ...) of all volume groups from arrays (c, g, ...) per block."""
    total = jnp.zeros((len(model.carries), *parts[0].shape[2:]))
    for block, part in zip(model.blocks, parts, strict=True):
        total = total.at[block.groups].add(part, mode="drop")  # set has no reverse derivatives
    return total


@compiled()
def volume_ratios(x: Float[Array, "n 2"], model: Body) -> Float[Array, " g"]:
    """Volume ratios (g,) of all volume groups, moments of J of stabilisation groups.

    2 for padding.
    """

    def of_patches(block):
        return contents(deformation_gradients(x, block), x, block)

    return ratios_of(
        [over_patches(of_patches, (bare(block),), block.count) for block in model.blocks], model
    )


def bare(block: PatchBlock) -> PatchBlock:
    """The arrays of a block, each of which has a row for every patch."""
    return dataclasses.replace(block, count=None)


def ratios_of(parts: list[Array], model: Body) -> Float[Array, " g"]:
    """`volume_ratios` from the `contents` of the blocks."""
    volumes = all_volumes(model)
    return jnp.where(
        volumes > 0, of_groups(parts, model) / jnp.where(volumes > 0, volumes, 1.0), 2.0
    )


def contents(
    F: Float[Array, "c q 2 2"], x: Float[Array, "n 2"], block: PatchBlock
) -> Float[Array, "c g"]:
    """Volumes V J (c, g) of a block's groups, mm^2."""
    J = block.weight * 0.5 * jnp.sum(F * cofactors(F), axis=(2, 3))
    y = jnp.einsum("csra,cai->csri", block.contour, local_positions(x, block.nodes))
    area = jnp.sum(y[:, 0, :, 0] * y[:, 1, :, 1] - y[:, 0, :, 1] * y[:, 1, :, 0], axis=1)
    return jnp.einsum("cq,cqg->cg", J, block.group_weight) + area[:, None] * contour_shares(block)


def contour_shares(block: PatchBlock) -> Float[np.ndarray, " g"]:
    """Share (g,) of the area inside the contour that each group of a patch has."""
    return _carries(block) / block.carrying


def at_points(values: Float[Array, "c g"], block: PatchBlock) -> Float[Array, "c q"]:
    """A patch's field at the quadrature points of a block from values in the volume groups.

    It is volume ratio or pressure.
    """
    own = jnp.where(_carries(block), values, 0.0)
    return (
        jnp.einsum("cqg,cg->cq", block.group_weight, own) + (own @ contour_shares(block))[:, None]
    )


# --- the pressure of a group ----------------------------------------------------------------------


def ratio_at(
    p: Float[Array, " g"],
    model: Body,
    gel: LocalGel,
    mu: Chemical,
    largest: Float[Array, "..."] | None = None,
) -> Float[Array, " g"]:
    """Volume ratio J*(p) at which each group carries the pressure ``p``, kT/v; every p is feasible.

    ``largest`` as of `VolumeLaw.areal_stretch`.
    """
    gel = gel_in_groups(gel)
    star = volume_law(model, gel, mu).areal_stretch(jnp.where(model.carries, p, -1.0), largest)
    return jnp.where(model.carries, star, p / (HELD * gel.Nv))


def pressure_at(
    J: Float[Array, " g"], model: Body, gel: LocalGel, mu: Chemical
) -> Float[Array, " g"]:
    """Pressure of each group at ``J``, kT/v; nan if a group of gel with volume has J <= 1.

    J is its volume ratio.
    """
    gel = gel_in_groups(gel)
    return jnp.where(
        model.carries, volume_law(model, gel, mu).pressure(_feasible(J, model)), HELD * gel.Nv * J
    )


def stiffness_at(
    J: Float[Array, " g"], model: Body, gel: LocalGel, mu: Chemical
) -> Float[Array, " g"]:
    """Stiffness dp/dJ of each group at its volume ratio ``J``, kT/v."""
    gel = gel_in_groups(gel)
    return jnp.where(
        model.carries, volume_law(model, gel, mu).stiffness(_feasible(J, model)), HELD * gel.Nv
    )


def volume_energy(
    J: Float[Array, " g"], model: Body, gel: LocalGel, mu: Chemical
) -> Float[Array, ""]:
    """Energy () of all volume groups, kT/v mm^2."""
    gel = gel_in_groups(gel)
    density = jnp.where(
        model.carries,
        volume_law(model, gel, mu).energy(_feasible(J, model)),
        HELD * gel.Nv / 2 * J**2,
    )
    return jnp.sum(all_volumes(model) * density)


def linearised_about(
    p: Float[Array, " g"], J: Float[Array, " g"], model: Body, gel: LocalGel, mu: Chemical
) -> tuple[Float[Array, " g"], Float[Array, " g"]]:
    """Linearisation points J0 (g,) of the pressures, and these there less ``p`` (g,), kT/v.

    J0 are volume ratios. While the gel is stiff that is J*(p), which every p has. From the end of
    the stiff range on, where dp/dJ falls to ``SOFT`` Nv, it is the volume ratio ``J`` (g,) itself,
    or that end for a smaller J with a p that is too large for the stiff range: beyond the spinodal
    of a gel in a poor solvent J*(p) would be that of another phase. There dp/dJ is of the order of
    Nv, or negative. Films are never stiff. In good solvents, and in elastomers, it is J*(p)
    everywhere.
    """
    there = gel_in_groups(gel)
    swells = model.carries & (all_volumes(model) > 0) & takes_solvent(there)
    rises = rises_always(there)

    def of_any():
        end = volume_law(model, there, mu).stiff_until(least_stiffness(there))
        star = ratio_at(p, model, gel, mu, end)
        beyond = (end < J) | (end > 0) & ((1 + ROUNDED) * star >= end)
        soft = swells & jnp.logical_not(rises) & beyond  # it may rise in this sheet of a batch
        about = jnp.where(soft, jnp.maximum(J, end), star)
        return about, jnp.where(soft, pressure_at(about, model, gel, mu) - p, 0.0)

    def of_good():
        star = ratio_at(p, model, gel, mu)
        return star, jnp.zeros_like(star)

    return of_any() if rises is False else lax.cond(everywhere(rises), of_good, of_any)


def least_stiffness(gel: Any) -> Float[Array, "..."]:
    """Stiffness dp/dJ (...), kT/v, below which a gel is soft; 0 if no gel of the plate ever is.

    See `linearised_about`.
    """
    return jnp.where(rises_always(gel), 0.0, SOFT * gel.Nv)


def swelling_of(J: Float[Array, " g"], model: Body, gel: LocalGel) -> Float[Array, " g"]:
    """Scale of each group's ``J`` accuracy: J - 1 in a gel, J in films, elastomers; 0 if held."""
    return jnp.where(model.carries, volume_law(model, gel_in_groups(gel), 0.0).swelling(J), 0.0)


def _feasible(J, model):
    """Volume ratios of groups with volume; elsewhere one at which every energy is finite."""
    return jnp.where(model.carries & (all_volumes(model) > 0), J, 2.0 / axial_stretch(model))


def ratios_that_carry(
    J: Float[Array, " g"], pressure: Float[Array, " g"], model: Body, gel: LocalGel, mu: Chemical
) -> Float[Array, " g"]:
    """Volume ratios (g,) of the ``pressure`` (g,), with derivatives of those near ``J`` (g,).

    Newton's method ends if these agree to 1e-11 of the swelling J - 1; multiplied by the bulk
    stiffness that is 1e-8 of the pressure, which mixed second derivatives would show. A group that
    is soft, see `linearised_about`, has its own volume ratio.
    """
    # before, not after: what has no derivative is not differentiated
    fixed = lax.stop_gradient((J, model, gel, mu))
    stiffness, there = stiffness_at(*fixed), gel_in_groups(fixed[2])
    real = (all_volumes(fixed[1]) > 0) & (stiffness > least_stiffness(there))
    away = lax.stop_gradient(pressure) - pressure_at(*fixed)
    return J + jnp.where(real, away / jnp.where(real, stiffness, 1.0), 0.0)
