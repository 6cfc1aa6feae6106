"""The shape functions compared in the paper: the package's and two without interpolation.

Sources: Belytschko, Lu & Gu (1994) for the MLS; Bai et al. (2012) for the improved complex variable
MLS.
"""

import jax.numpy as jnp
from jax import lax

from .. import discretisation
from .._types import Array, Float, Inexact, Scalar
from .._validation import one_of

INTERPOLATING = discretisation.KINDS
KINDS = (*INTERPOLATING, "icvmls", "mls")


def shape_functions(
    x: Float[Array, "2"],
    neighbours: Float[Array, "a 2"],
    support: Float[Array, " a"] | Scalar,
    *,
    basis: str = "quadratic",
    kind: str = "iicvmls",
) -> Inexact[Array, " a"]:
    """`jaxgel.shape_functions` (n,) at ``x`` (2,) with two further ``kind``s.

    They do not interpolate:

    - ``"icvmls"``: basis (1, z) or (1, z, z^2); complex, acting on u1 + i u2;
    - ``"mls"``: real basis.
    """
    one_of("kind", kind, KINDS)
    if kind in INTERPOLATING:
        return discretisation.shape_functions(x, neighbours, support, basis=basis, kind=kind)
    one_of("basis", basis, discretisation.BASES)
    degree, support = (
        discretisation.BASES.index(basis) + 1,
        jnp.broadcast_to(support, neighbours.shape[:1]),
    )
    # phi does not depend on the scale of the basis, so neither does its derivative
    scale = lax.stop_gradient(jnp.max(support))
    w, r = (
        cubic_spline_weight(jnp.sum((neighbours - x) ** 2, axis=1), support),
        (neighbours - x) / scale,
    )
    if kind == "icvmls":
        p = jnp.stack([lax.complex(r[:, 0], r[:, 1]) ** k for k in range(degree + 1)]).T
    else:
        p = discretisation.monomials(r[:, 0], r[:, 1], degree).T
    weighted = w[:, None] * p.conj()
    return weighted @ discretisation.definite_inverse((weighted.T @ p).T)[:, 0]


def cubic_spline_weight(
    distance_squared: Float[Array, "..."], support: Float[Array, "..."] | Scalar
) -> Float[Array, "..."]:
    """Cubic spline weight of the element-free Galerkin method of d^2: 2/3 at d = 0, C2.

    0 from d = ``support`` on.
    """
    inside = distance_squared < support**2
    s = discretisation.safe_sqrt(jnp.where(inside, distance_squared, 0.0)) / jnp.where(
        support > 0, support, 1.0
    )
    near = 2 / 3 - 4 * s**2 + 4 * s**3
    return jnp.where(inside, jnp.where(s < 0.5, near, 4 / 3 * (1 - s) ** 3), 0.0)
