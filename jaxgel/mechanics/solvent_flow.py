"""The flow of solvent through a gel.

Solvent moves down the gradient of mu, see ``materials.transport``. A virtual potential with the
values v at places, see `solvent`, gives

    sum_a v_a flow_a = integral of grad v . M grad mu,

so that flow_a is what leaves place a for the others, and the sum over all places vanishes. If mu
jumps from one place to the next the mobility changes by a multiple. So the gradient is not that of
mu but of what mu moves: along the normal of a layer that is held sideways the stretch is
proportional to the areal stretch A, M to (J - 1) / A^2, and

    M grad mu = D A^2 F^-1 F^-T grad w,      w = integral of (J - 1) / A^2 dmu,

with the values of w at the places, and A and F at the quadrature point. In a smooth state both are
the same.

After mu of a bath has changed it has changed in a layer below the surface that is thinner than the
cells, and a gradient between the surface and the first group is too small. So a group at the
distance d from wetted sides of length l takes up

    l dJ D_m / d (c - 1)

besides: what a half-space takes up at the time t after the change, see ``materials.layer_uptake``,
over what goes through a layer of that thickness. With X = d / sqrt(pi D_m t)

    c = 1 + X exp(-a / X - (a^2 / 2 - 1 / pi^2) / X^2),   a = 1 - 1 / pi,

or with a linear pressure (1 + X^6)^(1/6). In the first layers of a half-space the mean of a cell
has risen by dJ / (pi X), so that c = X / (1 - 1 / (pi X)), to which the exponent belongs; in finite
volumes it is good to 0.02 for all X. A group of a cell that is cut may lie next to the surface,
while mu falls off over all of its volume: d is at least that of a whole cell with the same volume
along the sides.

What such a layer brings to one side of a patch with a linear pressure would dry its other side, if
it worked on the linear part of J as it does later, and below J = 1 nothing is a state. So after mu
of a bath has risen that part of the flow has the share

    1 / (1 + (h^2 / (60 D t))^2)

with half the side h of the patch: 1 once the layer is thicker than a few tenths of h, and little
before, when J changes alike on the patch.
"""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float, Scalar
from ..discretisation import Body
from ..materials import LocalGel, elementwise, gel_at_points, gel_in_groups, layer_uptake
from .patchwise import over_patches
from .solvent import MOMENTS, Solvent
from .volumes import (
    all_volumes,
    axial_stretch,
    bare,
    by_block,
    cofactors,
    deformation_gradients,
    of_groups,
    volume_law,
)

POINTS = 4  # of an integral over mu
# of half the side of a patch: a layer that leaves half of the flow to the linear part of J
THIN = 0.13
# distance from the surface over the thickness of a whole cell, of its middle, and of the nearer
# groups of a linear patch of the half of it that they stand for
MIDDLE, NEAR = 0.5, 1 - 1 / np.sqrt(3)
SMOOTH = 0.1  # difference of two distances, over one of them, below which the larger is smooth
BELOW = 1 - 1 / np.pi  # by which c - 1 is less than X in thin layers
NO_LAYER = 0.01  # X below which c - 1 is 0 in double precision


class Bath(NamedTuple):
    """The bath at the wetted parts of the boundary; a pytree."""

    mu: Float[Array, " b"]
    """Chemical potential of each part, kT."""
    rate: Float[Array, " b"]
    """Mean of 1 / sqrt(t) over the changes of mu a time t ago, 0 if it has never changed."""
    rising: Float[Array, " b"]
    """The same of changes that raise mu."""


def potentials(m: Float[Array, " g"], model: Body) -> Float[Array, " g"]:
    """Mu (g,) of the volume groups, kT, from its unknowns ``m`` (g,), see `solvent`.

    Of held groups the mean of their patch.
    """
    parts = []
    for block, own in zip(model.blocks, by_block(m, model), strict=True):
        held = jnp.broadcast_to(own[:, :1], (len(own), block.n_groups - block.carrying))
        carrying = own[:, : MOMENTS.shape[1]] @ MOMENTS.T if block.carrying > 1 else own[:, :1]
        parts.append(jnp.concatenate([carrying, held], axis=1))
    return of_groups(parts, model)


def moments(values: Float[Array, " g"], model: Body) -> Float[Array, " g"]:
    """Sums (g,) of ``values`` (g,) by unknowns of mu: transpose of `potentials`.

    The groups carry volume and work on these unknowns.
    """
    parts = []
    for block, own in zip(model.blocks, by_block(values, model), strict=True):
        sums = own[:, : block.carrying] @ (MOMENTS if block.carrying > 1 else MOMENTS[:1, :1])
        parts.append(jnp.pad(sums, ((0, 0), (0, block.n_groups - sums.shape[1]))))
    return of_groups(parts, model)


@functools.partial(jax.tree_util.register_dataclass, data_fields=["work", "slopes"], meta_fields=[])
@dataclasses.dataclass(frozen=True, eq=False)
class Carried:
    """What mu at the places of each patch moves: per block (c, b), see `carried`."""

    work: tuple
    """w, kT."""
    slopes: tuple
    """dw/dmu."""


def carried(
    p: Float[Array, " g"],
    values: Float[Array, " v"],
    model: Body,
    gel: LocalGel,
    solvent: Solvent,
    *,
    reverse: bool = False,
) -> Carried:
    """`Carried` at pressures ``p`` (g,) and mu ``values`` (v,) at places, by patch means.

    A patch has its mean pressure and the gel of its first point. w is the integral of (J - 1) / A^2
    dmu up to each place at the patch's pressure, with A = J over the axial stretch, but for a
    constant. It is taken over 1 / A, in which it is that of a polynomial if the gel is one of Flory
    and Rehner: no layer is too steep for it.
    """
    points, weights = np.polynomial.legendre.leggauss(POINTS)

    def of_patches(p, gel, values):
        law = volume_law(model, gel, values)
        A = law.areal_stretch(p)
        start = jnp.mean(1 / A, axis=1, keepdims=True)
        at = [1 / (start + (1 / A - start) * (1 + point) / 2) for point in points]
        parts = [
            weight / 2 * law.swelling(one) * law.stiffness(one)
            for weight, one in zip(weights, at, strict=True)
        ]
        return (start - 1 / A) * sum(parts) / axial_stretch(model), law.swelling(A) / A**2

    found = []
    for number, (block, on_block, pressure) in enumerate(
        zip(model.blocks, solvent.blocks, by_block(p, model), strict=True)
    ):
        mean = jnp.mean(pressure[:, : block.carrying], axis=1, keepdims=True)
        there = jax.tree.map(
            lambda v, block=block: jnp.broadcast_to(v, block.weight.shape)[:, :1],
            gel_at_points(gel, number),
        )
        found.append(
            over_patches(
                of_patches, (mean, there, values[on_block.places]), block.count, reverse=reverse
            )
        )
    return Carried(*zip(*found, strict=True))


class Flow(NamedTuple):
    """What flows, see `flow`; a pytree."""

    leaving: Float[Array, " v"]
    """Flow out of every place, mm^2 per unit of time."""
    squares: tuple[Array, ...]
    """Per block (c, 2, 2): patch means of F^T F."""
    rates: "FlowRates | None"
    """If asked for."""


class FlowRates(NamedTuple):
    """Derivatives of the flow at the quadrature points, times their weights; a pytree.

    If mu at the places of a patch changes, its mean, and its nodes, then w at the places changes by
    dw/dmu (dmu + dp / l3 - dmu of the mean) with the patch's mean pressure p at which p = l3
    (dphi/dJ - mu), and the flow at a point by by_gradient grad dw + by_stretch dF.
    """

    by_gradient: tuple
    """Per block (c, q, 2, 2): by the gradient of w."""
    by_stretch: tuple
    """Per block (c, q, 2, 2, 2): by the deformation gradient."""
    F: tuple
    """Per block (c, q, 2, 2): the deformation gradient itself."""


def flow(
    x: Float[Array, "n 2"],
    carried: Carried,
    model: Body,
    solvent: Solvent,
    D: Scalar,
    *,
    rates: bool = False,
    reverse: bool = False,
) -> Flow:
    """`Flow` at positions ``x``; linear in ``carried.work``. With `FlowRates` if asked for.

    That of a layer thinner than the cells is left out. It has no ``reverse`` derivatives unless
    these are asked for, nor has what is ``carried``.
    """

    def of_patches(block, on_block, work):
        F = deformation_gradients(x, block)
        turned, scale = cofactors(F), D * block.weight
        metric = scale[:, :, None, None] * jnp.einsum("cqki,cqkj->cqij", turned, turned)
        gradient = jnp.einsum("cqbi,cb->cqi", on_block.dpsi, work)
        flux = jnp.einsum("cqij,cqj->cqi", metric, gradient)
        volume = jnp.sum(block.weight, axis=1)
        square = jnp.einsum("cq,cqki,cqkj->cij", block.weight, F, F)
        found = (
            jnp.einsum("cqbi,cqi->cb", on_block.dpsi, flux),
            square / jnp.where(volume > 0, volume, 1.0)[:, None, None],
        )
        if not rates:
            return found
        by_stretch = jax.vmap(jax.vmap(jax.jacfwd(_turned)))(F, gradient)
        return *found, metric, scale[..., None, None, None] * by_stretch, F

    total, found = jnp.zeros(len(model.carries) + len(solvent.wetting.node_parts)), []
    for block, on_block, work in zip(model.blocks, solvent.blocks, carried.work, strict=True):
        leaving, *others = over_patches(
            of_patches, (bare(block), on_block, work), block.count, reverse=reverse
        )
        total = total.at[on_block.places].add(leaving)
        found.append(others)
    squares, *others = zip(*found, strict=True)
    return Flow(total, squares, FlowRates(*others) if rates else None)


def _turned(F, gradient):
    """A^2 F^-1 F^-T times a gradient (2,) at one point."""
    turned = cofactors(F)
    return turned.T @ (turned @ gradient)


def places(
    m: Float[Array, " g"], bath: Float[Array, " b"], model: Body, solvent: Solvent
) -> Float[Array, " v"]:
    """Mu (v,) at all places, kT, from its unknowns and the ``bath`` (b,)."""
    return jnp.concatenate([potentials(m, model), bath[solvent.wetting.node_parts]])


def layer_flow(
    square: Float[Array, " e"],
    mu: Float[Array, " e"],
    model: Body,
    gel: LocalGel,
    solvent: Solvent,
    bath: Bath,
    D: Scalar,
) -> Float[Array, " e"]:
    """Inflow of layers thinner than the cells into wetted groups (e,), besides `flow`.

    mm^2 per unit of time; the groups have wetted sides. ``square`` (e,) is the square of the
    stretch along the sides, see `along_sides`, ``mu`` (e,) that of the groups.
    """
    wet = solvent.wetting
    real = wet.length > 0
    bath_mu, along = (
        jnp.where(real, bath.mu[wet.group_parts], -1.0),
        jnp.sqrt(jnp.where(real, square, 1.0)),
    )

    def uptake(mu, bath, along, gel):
        return jnp.stack(layer_uptake(mu, bath, along, gel, model.axial_stretch, D))

    local = jax.tree.map(
        lambda v: in_wet_groups(v, solvent, 1.0) if jnp.ndim(v) else v, gel_in_groups(gel)
    )
    change, D_m = elementwise(
        uptake, jnp.where(real, mu, -1.0), bath_mu, along, local, signature="()->(k)"
    ).T
    length = jnp.where(real, wet.length, 1.0)
    thickness = in_wet_groups(all_volumes(model), solvent, 1.0) / length
    depth = _larger(thickness * jnp.where(wet.linear, NEAR, MIDDLE), wet.depth)
    ratio = depth * bath.rate[wet.group_parts] / jnp.sqrt(jnp.pi * D_m)
    excess = jnp.where(wet.linear, jnp.power(1 + ratio**6, 1 / 6) - 1, _excess(ratio))
    return jnp.where(real, length * change * D_m / depth * excess, 0.0)


def linear_share(model: Body, solvent: Solvent, bath: Bath, D: Scalar) -> Float[Array, " g"]:
    """Share (g,) of the flow on the unknowns of mu: 1 on means, less on linear parts.

    Less while layers are thin.
    """
    parts = []
    for block, on_block in zip(model.blocks, solvent.blocks, strict=True):
        side = jnp.sum(block.weight, axis=1) / 4 * (THIN * bath.rising[on_block.part]) ** 2 / D
        linear = jnp.broadcast_to(1 / (1 + side[:, None] ** 2), (len(side), block.n_groups - 1))
        parts.append(jnp.concatenate([jnp.ones((len(side), 1)), linear], axis=1))
    return of_groups(parts, model)


def _larger(first, second):
    """The larger of two distances; smooth where both are the same, and there 2.5 % more.

    They are the same in a whole cell.
    """
    above, width = second - first, SMOOTH * first
    between = (above + width) ** 2 / (4 * width)
    return first + jnp.where(jnp.abs(above) < width, between, jnp.maximum(above, 0.0))


def _excess(ratio):
    """By the ``ratio`` X what c is above 1: X - a + 1 / (pi^2 X) + ..., of thick layers 0."""
    inverse = 1 / jnp.maximum(ratio, NO_LAYER)
    return ratio * jnp.exp(-(BELOW + (BELOW**2 / 2 - 1 / np.pi**2) * inverse) * inverse)


def in_wet_groups(
    values: Float[Array, "g ..."], solvent: Solvent, fill: float
) -> Float[Array, "e ..."]:
    """Values (e, ...) of the groups with wetted sides; ``fill`` for padding."""
    return values.at[solvent.wetting.groups].get(mode="fill", fill_value=fill)


def along_sides(squares: tuple[Array, ...], model: Body, solvent: Solvent) -> Float[Array, " e"]:
    """Mean square (e,) of the stretch along wetted sides of each group; 1 for padding.

    From the ``squares`` of a `Flow`.
    """
    of_blocks = [
        jnp.broadcast_to(square[:, None], (*block.groups.shape, 2, 2))
        for square, block in zip(squares, model.blocks, strict=True)
    ]
    wet = solvent.wetting
    found = jnp.einsum(
        "eij,eij->e", in_wet_groups(of_groups(of_blocks, model), solvent, 1.0), wet.directions
    )
    return jnp.where(wet.length > 0, found, 1.0)
