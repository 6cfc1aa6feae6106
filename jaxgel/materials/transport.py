"""Transport of solvent at one material point: its mobility, and the uptake of thin wetted layers.

Solvent moves down the gradient of the chemical potential mu: the flux through the dry area is -M
grad mu with the mobility M = D (J - 1) F^-1 F^-T, gradients on the dry plate (Hong, Zhao, Zhou &
Suo 2008). D is the diffusivity of the solvent, mm^2 per unit of time. Between a surface and the gel
below it, which holds it sideways, a layer swells along its normal alone: the stretch n follows mu
by

    mu = [dnetwork/dn + (dphi/dn)] / (t l3),   J = n t l3,   diffusivity  D (J - 1) / n^2  dmu/dJ

with the stretch t along the surface and l3 out of plane. After a jump of mu at its surface a
half-space takes up 2 dJ sqrt(D_m time / pi), where D_m is a mean of the diffusivity between both
states, weighted towards the surface (Crank, The Mathematics of Diffusion, 1975).
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import lax

from .._types import Array, Float, Scalar
from .gel import network_at
from .laws import VolumeLaw

# exponents of the distance from the inner state, over the jump, by which the mean diffusivity is
# weighted
SWELLING, DRYING = 2 / 3, 0.85
POINTS = 5  # of a mean over the jump
HALVINGS = 60  # of the range of ln(J - 1) in which the stretch of a layer is looked for
RANGE = (-40.0, 12.0)  # of ln(J - 1)


def layer_potential(
    normal: Scalar, along: Scalar, gel: Any, axial: Scalar | None = None
) -> Float[Array, ""]:
    """Chemical potential (), kT, of a layer of stretches ``normal`` and ``along`` a surface.

    It is a free surface; ``axial`` is out of plane.
    """
    network, law, held = (
        network_at(gel, axial),
        VolumeLaw(gel, 0.0, axial),
        1.0 if axial is None else axial,
    )
    stress = jax.grad(lambda n: network(jnp.diag(jnp.stack([n, along])), gel))(normal)
    return (stress + along * law.pressure(normal * along)) / (held * along)


def layer_stretch(
    mu: Scalar, along: Scalar, gel: Any, axial: Scalar | None = None
) -> Float[Array, ""]:
    """Stretch () normal to the surface at which a layer has the chemical potential ``mu`` (), kT.

    The inverse of `layer_potential`.
    """
    fixed = lax.stop_gradient((mu, along, gel, axial))

    def halved(_, ends):
        mu, along, gel, axial = fixed
        middle = (ends[0] + ends[1]) / 2
        below = layer_potential(_stretch_of(jnp.exp(middle), along, axial), along, gel, axial) < mu
        return jnp.where(below, middle, ends[0]), jnp.where(below, ends[1], middle)

    low, high = lax.fori_loop(0, HALVINGS, halved, tuple(jnp.asarray(end, float) for end in RANGE))
    # a number; the step of Newton's method gives it its derivatives
    found = _stretch_of(jnp.exp((low + high) / 2), along, axial)
    value, slope = jax.value_and_grad(layer_potential)(lax.stop_gradient(found), along, gel, axial)
    return lax.stop_gradient(found) + (mu - value) / lax.stop_gradient(slope)


def _stretch_of(swelling, along, axial):
    return (1 + swelling) / (along * (1.0 if axial is None else axial))


def layer_diffusivity(
    normal: Scalar, along: Scalar, gel: Any, axial: Scalar | None, D: Scalar
) -> Float[Array, ""]:
    """Diffusivity () along the normal of a layer, mm^2 per unit of time, on the dry plate.

    The solvent is that of a layer with these stretches.
    """
    held = along * (1.0 if axial is None else axial)
    slope = jax.grad(layer_potential)(normal, along, gel, axial) / held
    return D * (normal * held - 1) / normal**2 * slope


def layer_uptake(
    mu: Scalar, bath: Scalar, along: Scalar, gel: Any, axial: Scalar | None, D: Scalar
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Jump dJ () of a surface from ``mu`` to the ``bath``, kT, and mean diffusivity D_m ().

    dJ is that of the volume ratio. Solvent then goes through the dry surface at the rate dJ
    sqrt(D_m / (pi t)).
    """
    inner, outer = (layer_stretch(at, along, gel, axial) for at in (mu, bath))
    change = along * (1.0 if axial is None else axial) * (outer - inner)

    def mean(exponent):
        points, weights = scipy.special.roots_jacobi(POINTS, 0.0, exponent)  # on [-1, 1]
        at = inner + (outer - inner) * (points + 1) / 2
        values = jax.vmap(lambda normal: layer_diffusivity(normal, along, gel, axial, D))(at)
        return values @ (weights / np.sum(weights))

    return change, jnp.where(change > 0, mean(SWELLING), mean(DRYING))
