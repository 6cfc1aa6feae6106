"""The flow of solvent through a gel, and the balance of its volume groups.

Solvent moves down the gradient of mu, see ``materials.transport``. A virtual potential with the values v at places, see `solvent`, gives

    sum_a v_a flow_a = integral of grad v . M grad mu,

so that flow_a is what leaves place a for the others, and the sum over all places vanishes. M at a quadrature point has the deformation
gradient there, and the volume ratio at which the gel has the pressure and the mu of that point.

After mu of a bath has changed, it has changed in a layer below the surface that is thinner than the cells, and a gradient between the
surface and the first group is too small. So a wetted group takes up through its wetted sides of length l

    l dJ D_m / d (sqrt(1 + d^2 / (pi D_m t)) - 1),      d = V / 2l,

besides: what a half-space would take up at the time t after the change, see ``materials.layer_uptake``, over what goes through a layer of
half the cell. It falls as 1 / t, and the finer the cells the sooner.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._types import Array, Float, Scalar
from ..discretisation import Body
from ..materials import LocalGel, elementwise, gel_at_points, gel_in_groups, layer_uptake, mobility
from .operators import add_matrices
from .patchwise import added_over_patches, over_patches
from .solvent import MOMENTS, Solvent
from .volumes import all_volumes, axial_stretch, bare, by_block, cofactors, deformation_gradients, of_groups, volume_law

POINTS = 4  # of an integral over mu
NEAR = (1 - 1 / np.sqrt(3)) # distance of the groups of a linear patch
SMALL = 1e-12  # difference of mu, kT, below which a flow is none


class Bath(NamedTuple):
    """What the wetted parts of the boundary see; a pytree."""

    mu: Float[Array, " b"]
    """Chemical potential of each part, kT."""
    rate: Float[Array, " b"]
    """Mean of 1 / sqrt(t) over the changes of mu a time t ago, 0 if it has never changed."""


def potentials(m: Float[Array, " g"], model: Body) -> Float[Array, " g"]:
    """mu (g,) of the volume groups, kT, from its unknowns ``m`` (g,), see `solvent`; of held groups the mean of their patch."""
    parts = []
    for block, own in zip(model.blocks, by_block(m, model), strict=True):
        held = jnp.broadcast_to(own[:, :1], (len(own), block.n_groups - block.carrying))
        carrying = own[:, : MOMENTS.shape[1]] @ MOMENTS.T if block.carrying > 1 else own[:, :1]
        parts.append(jnp.concatenate([carrying, held], axis=1))
    return of_groups(parts, model)


def moments(values: Float[Array, " g"], model: Body) -> Float[Array, " g"]:
    """Sums (g,) of ``values`` (g,) of the carrying groups that work on the unknowns of mu: the transpose of `potentials`."""
    parts = []
    for block, own in zip(model.blocks, by_block(values, model), strict=True):
        sums = own[:, : block.carrying] @ (MOMENTS if block.carrying > 1 else MOMENTS[:1, :1])
        parts.append(jnp.pad(sums, ((0, 0), (0, block.n_groups - sums.shape[1]))))
    return of_groups(parts, model)


def flow(
    x: Float[Array, "n 2"],
    p: Float[Array, " g"],
    m: Float[Array, " g"],
    model: Body,
    gel: LocalGel,
    solvent: Solvent,
    bath: Bath,
    D: Scalar,
) -> Float[Array, " v"]:
    """Flow (v,) out of every place, mm^2 per unit of time, that of a layer thinner than the cells left out."""
    values = places(m, bath.mu, model, solvent)
    total = jnp.zeros(len(values))

    def leaving(block, on_block, p, gel, values):
        work = _transported(_at_places(p, values, block, model, gel), model, gel)[0]
        flux = jnp.einsum("cqij,cqj->cqi", _metric(x, block, D), jnp.einsum("cqbi,cb->cqi", on_block.dpsi, work))
        return jnp.einsum("cqbi,cqi->cb", on_block.dpsi, flux)

    for block, on_block, *arrays in _by_block(p, model, gel, solvent):
        arrays = bare(block), on_block, *arrays, values[on_block.places]
        total = total.at[on_block.places].add(over_patches(leaving, arrays, block.count))
    return total


def place_matrices(
    total: Float[Array, " s"],
    x: Float[Array, "n 2"],
    p: Float[Array, " g"],
    m: Float[Array, " g"],
    model: Body,
    gel: LocalGel,
    solvent: Solvent,
    bath: Bath,
    D: Scalar,
    slots: tuple,
) -> Float[Array, " s"]:
    """``total`` (s,) plus a symmetric matrix near the derivative of the `flow` by mu, the upper entries of each patch at their ``slots``
    (c, t).
    """
    values = places(m, bath.mu, model, solvent)

    def add(total, block, on_block, p, gel, values, slot):
        slope = _transported(_at_places(p, values, block, model, gel), model, gel)[1]
        dpsi = on_block.dpsi * jnp.sqrt(slope)[:, None, :, None]
        return add_matrices(total, jnp.einsum("cqai,cqij,cqbj->cab", dpsi, _metric(x, block, D), dpsi), slot)

    for (block, on_block, *arrays), slot in zip(_by_block(p, model, gel, solvent), slots, strict=True):
        arrays = bare(block), on_block, *arrays, values[on_block.places], slot
        total = added_over_patches(total, add, arrays, block.count)
    return total


def _by_block(p, model, gel, solvent):
    """Per block the block, its functions, pressures and gel at the points."""
    for number, (block, on_block, pressure) in enumerate(zip(model.blocks, solvent.blocks, by_block(p, model), strict=True)):
        shape = block.weight.shape
        yield block, on_block, pressure, jax.tree.map(lambda v, shape=shape: jnp.broadcast_to(v, shape), gel_at_points(gel, number))


def _of_patch(gel):
    """The gel at the first point of each patch (c, 1)."""
    return jax.tree.map(lambda v: v[:, :1], gel)


def _at_places(p, values, block, model, gel):
    """Areal stretches (c, b) that the gel of a patch has with its mean pressure and the mu of each place."""
    mean = jnp.mean(p[:, : block.carrying], axis=1, keepdims=True)
    return volume_law(model, _of_patch(gel), values).areal_stretch(mean)


def _transported(A, model, gel):
    """Integral of (J - 1) / A^2 dmu (c, b) up to the areal stretches ``A`` (c, b) at a given pressure, but for a constant of each patch,
    and its slope.
    """
    law, start = volume_law(model, _of_patch(gel), 0.0), jnp.mean(A, axis=1, keepdims=True)

    def slope(A):
        return law.swelling(A) / A**2

    points, weights = np.polynomial.legendre.leggauss(POINTS)
    at = [start + (A - start) * (1 + point) / 2 for point in points]
    found = sum(weight / 2 * slope(one) * law.stiffness(one) for weight, one in zip(weights, at, strict=True))
    return (A - start) * found / axial_stretch(model), slope(A)


def _metric(x, block, D):
    """D A^2 F^-1 F^-T (c, q, 2, 2) at the quadrature points times their weights, with the areal stretch A = det F."""
    turned = cofactors(deformation_gradients(x, block))
    return block.weight[:, :, None, None] * D * jnp.einsum("cqki,cqkj->cqij", turned, turned)


def places(m: Float[Array, " g"], bath: Float[Array, " b"], model: Body, solvent: Solvent) -> Float[Array, " v"]:
    """mu (v,) at all places, kT, from its unknowns and the ``bath`` (b,)."""
    return jnp.concatenate([potentials(m, model), bath[solvent.wetting.node_parts]])


def layer_flow(
    x: Float[Array, "n 2"],
    m: Float[Array, " g"],
    model: Body,
    gel: LocalGel,
    solvent: Solvent,
    bath: Bath,
    D: Scalar,
) -> Float[Array, " e"]:
    """What layers thinner than the cells bring into each group with wetted sides (e,), mm^2 per unit of time, besides `flow`."""
    wet = solvent.wetting
    blocks = [jnp.broadcast_to(_squares(x, block)[:, None], (*block.groups.shape, 2, 2)) for block in model.blocks]
    length = jnp.trace(wet.sides, axis1=1, axis2=2)
    real = length > 0
    length = jnp.where(real, length, 1.0)
    square = jnp.einsum("eij,eij->e", _of_wet(of_groups(blocks, model), wet, 1.0), wet.sides) / length
    along = jnp.sqrt(jnp.where(real, square, 1.0))
    mu, volume = _of_wet(potentials(m, model), wet, -1.0), _of_wet(all_volumes(model), wet, 1.0)
    bath_mu = jnp.where(real, bath.mu[wet.group_parts], -1.0)
    linear = _of_wet(of_groups([jnp.full(b.groups.shape, b.carrying > 1) for b in model.blocks], model), wet, 0.0) > 0
    depth = jnp.where(linear, NEAR, 0.5) * volume / length

    def uptake(mu, bath, along, gel):
        return jnp.stack(layer_uptake(mu, bath, along, gel, model.axial_stretch, D))

    local = jax.tree.map(lambda v: _of_wet(v, wet, 1.0) if jnp.ndim(v) else v, gel_in_groups(gel))
    change, D_m = elementwise(uptake, mu, bath_mu, along, local, signature="()->(k)").T
    square = (depth * bath.rate[wet.group_parts]) ** 2 / (jnp.pi * D_m)
    excess = jnp.where(linear, _over(jnp.sqrt(1 + square**2)), _over(1 + square))
    return jnp.where(real, length * change * D_m / depth * excess, 0.0)


def _over(square):
    """How much the root of ``square`` is above 1."""
    return (square - 1) / (1 + jnp.sqrt(square))


def layer_conductance(flow: Float[Array, " e"], m: Float[Array, " g"], model: Body, solvent: Solvent, bath: Bath) -> Float[Array, " g"]:
    """A conductance (g,) with which the difference of mu to the bath moves as much as the `layer_flow`; 0 where there is none."""
    wet = solvent.wetting
    difference = bath.mu[wet.group_parts] - _of_wet(potentials(m, model), wet, -1.0)
    found = jnp.where(jnp.abs(difference) > SMALL, flow / jnp.where(jnp.abs(difference) > SMALL, difference, 1.0), 0.0)
    return jnp.zeros(len(model.carries)).at[wet.groups].add(jnp.maximum(found, 0.0), mode="drop")


def _of_wet(values, wet, fill):
    """Values (e, ...) of the groups with wetted sides."""
    return values.at[wet.groups].get(mode="fill", fill_value=fill)


def _squares(x, block):
    """Mean of F^T F (c, 2, 2) over each patch."""
    F = deformation_gradients(x, block)
    volume = jnp.sum(block.weight, axis=1)
    mean = jnp.einsum("cq,cqki,cqkj->cij", block.weight, F, F)
    return mean / jnp.where(volume > 0, volume, 1.0)[:, None, None]
