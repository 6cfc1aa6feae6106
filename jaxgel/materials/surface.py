"""Surfaces without load: their volume ratio and their stability to short waves.

Waves are short if they are so beside all lengths of the plate. About a half-plane y < 0 with the
principal stretches l1 along its surface and l2 normal to it, the nominal stress of a gradient H of
displacements is A:H, where A_ijkl = d2W / dF_ij dF_kl. With the moduli

    a1 = A1111, a2 = A2222, b = A1122,   c1 = A1212, c2 = A2121, d = A1221,
    g = sqrt(a1 a2), h = sqrt(c1 c2),

and displacements (u, i v) exp(ikx) that decay into the half-plane, the tractions of the surface are
k Z (u, v). The symmetric Z obeys the Riccati equation (Z - R)^T T^-1 (Z - R) = Q with T =
diag(c1, a2), Q = diag(a1, c2) and R = [[0, -d], [b, 0]]. So Z is R + T^1/2 O Q^1/2 with a rotation
O, whose angle makes Z symmetric: sin = -(b + d) / (g + h), which exists if the material is strongly
elliptic. That gives

    Z11 Z22 = g h [(g + h)^2 - (b + d)^2] / (g + h)^2,   Z12 = (b h - d g) / (g + h),
    det Z = [h (g^2 - b^2) + g (h^2 - d^2)] / (g + h).

All short waves cost energy as long as Z is positive definite. Its end, det Z = 0, is Biot's surface
instability; the condition is that of Dowaikh & Ogden (1991), Int. J. Eng. Sci. 29, and, for a gel,
of Kang & Huang (2010), J. Mech. Phys. Solids 58.
"""

from typing import Any

import jax
import jax.numpy as jnp

from .._types import Array, Float, Scalar
from .composite import takes_solvent
from .gel import neo_hookean, network_at
from .swelling import Numbers, branch_ends, first_root, rises_always


def surface_volume_ratio(
    tangential: Numbers, mu: Numbers, gel: Any, axial: Scalar | None = None
) -> Float[Array, "..."]:
    """Volume ratio J (...) at a traction-free surface of ``tangential`` stretch (...).

    Held at ``axial`` out of plane, or 1. The root of dW/dJ = 0 that is connected with the dry
    state, see `volume_ratio_at`; the normal stretch is J / (tangential axial).
    """
    if axial is None:
        return _first_root(_at_surface, mu, gel, tangential)
    return _first_root(_at_held_surface, mu, gel, tangential, axial)


def film_edge_volume_ratio(tangential: Numbers, mu: Numbers, gel: Any) -> Float[Array, "..."]:
    """The same at a film's edge, in uniaxial stress: normal stretch sqrt(J / tangential).

    The stretch of the thickness is the same.
    """
    return _first_root(_at_film_edge, mu, gel, tangential)


def _first_root(energy, mu, gel, *stretches):
    # other networks may lock, which ends the search
    rises = rises_always(gel) if gel.network is neo_hookean else False
    end = branch_ends(energy, gel, *stretches, rises=rises)
    return first_root(energy, takes_solvent(gel) * mu, end, gel, *stretches)


def _at_surface(J, gel, tangential):
    return gel.network(jnp.diag(jnp.stack([tangential, J / tangential])), gel) + gel.volumetric(
        J, gel
    )


def _at_held_surface(J, gel, tangential, axial):
    return gel.network(
        jnp.diag(jnp.stack([tangential, J / (tangential * axial)])), gel, axial
    ) + gel.volumetric(J, gel)


def _at_film_edge(J, gel, tangential):
    return gel.Nv * J / tangential + gel.volumetric(J, gel)


def surface_stability(
    stretches: Float[Array, " 2"],
    pressure: Scalar,
    stiffness: Scalar,
    gel: Any,
    axial: Scalar | None = None,
) -> Float[Array, ""]:
    """Stability () of a surface to short waves, det Z / (Z11 Z22 + Z12^2), at ``stretches``.

    These are (2,), along and normal to it. 1 if displacements along and normal to the surface do
    not couple, as in the dry state of a stiff gel; below 0 the surface wrinkles; -1 if the gel
    itself is unstable, not strongly elliptic, as within the miscibility gap of a poor solvent. The
    scale of energies does not matter. ``pressure`` and ``stiffness`` (kT/v) are w' and w'' of a
    `VolumeLaw`, in plane strain `osmotic` and `bulk_stiffness`; ``axial`` is the stretch out of
    plane at which the gel is held, if that is not 1. The network must be isotropic.

    >>> from jaxgel.materials import Gel, bulk_stiffness
    >>> gel, J = Gel(Nv=1e-3, chi=0.1), 3.317  # a layer on a rigid base, swollen to its onset
    >>> stretches, pressure = jnp.array([1.0, J]), -gel.Nv * J  # without traction
    >>> stability = surface_stability(stretches, pressure, bulk_stiffness(J, gel), gel)
    >>> print(f"{abs(stability):.3f}")
    0.000
    """
    A = jax.hessian(lambda F: network_at(gel, axial)(F, gel))(jnp.diag(stretches))
    along, normal = stretches
    n1, n2, n12 = A[0, 0, 0, 0], A[1, 1, 1, 1], A[0, 0, 1, 1] + pressure
    a1, a2, b = (
        n1 + stiffness * normal**2,
        n2 + stiffness * along**2,
        n12 + stiffness * along * normal,
    )
    c1, c2, d = A[0, 1, 0, 1], A[1, 0, 1, 0], A[0, 1, 1, 0] - pressure
    convex = (jnp.stack([a1, a2, c1, c2]) > 0).all()
    g, h = (jnp.sqrt(jnp.where(convex, square, 1.0)) for square in (a1 * a2, c1 * c2))
    # g^2 - b^2, in which the square of the stiffness cancels: it is a million times the network's
    normals = (
        n1 * n2 - n12**2 + stiffness * (n1 * along**2 + n2 * normal**2 - 2 * along * normal * n12)
    )
    shears = c1 * c2 - d**2
    product = g * h * (normals + shears + 2 * (g * h - b * d)) / (g + h) ** 2
    elliptic = convex & (product > 0)
    scale = jnp.where(elliptic, product + ((b * h - d * g) / (g + h)) ** 2, 1.0)
    return jnp.where(elliptic, (h * normals + g * shears) / (g + h) / scale, -1.0)
