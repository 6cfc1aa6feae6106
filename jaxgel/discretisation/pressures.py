"""Volume groups of a patch: weights from J at the quadrature points to their volume ratios.

Index letters: ``c`` patch, ``q`` quadrature point, ``g`` volume group of a patch. With the moments
J_i of J over a patch for the orthonormal polynomials 1, psi_1, psi_2 of first degree, a patch with
a linear pressure carries the volume ratios

    J_g = J_0 +- J_1 +- J_2

at the four points where psi_1 and psi_2 are +-1, each for a quarter of its volume: the rule of
integration that is exact for the products of linear functions, and next to which the axes of the
plate are equal. A patch with a constant pressure carries J_0. What these do not see of J is held:
by the moments of the next degree, in groups of their own.
"""

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._types import Array, Float

# of psi_1 and psi_2 at the four points of a linear pressure
SIGNS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@compiled(static=("linear",))
def group_weights(
    points: Float[Array, "c q 2"], weight: Float[Array, "c q"], linear: bool
) -> Float[Array, "c q g"]:
    """Weights W: V J of a group is a share of V plus sum_q w_q W_qg J_q; see `n_carrying`.

    V is the patch's volume in the share. The first groups carry the volume, the others are held;
    their weights are of unit mean square.
    """
    volume = jnp.sum(weight, axis=1)
    centre = jnp.einsum("cq,cqi->ci", weight, points) / volume[:, None]
    local = (points - centre[:, None]) / jnp.sqrt(volume)[:, None, None]
    psi = local @ _inverse_root(
        jnp.einsum("cq,cqi,cqj->cij", weight / volume[:, None], local, local)
    )
    if not linear:
        return jnp.concatenate([jnp.zeros_like(psi[..., :1]), psi], axis=2)
    lower = jnp.concatenate([jnp.ones_like(psi[..., :1]), psi], axis=2)
    upper = jnp.stack([psi[..., 0] ** 2, psi[..., 0] * psi[..., 1], psi[..., 1] ** 2], axis=2)
    share = weight / volume[:, None]
    upper = upper - jnp.einsum(
        "cqm,cmh->cqh", lower, jnp.einsum("cq,cqm,cqh->cmh", share, lower, upper)
    )
    root = jnp.linalg.cholesky(jnp.einsum("cq,cqi,cqj->cij", share, upper, upper))
    held = jnp.swapaxes(
        jax.scipy.linalg.solve_triangular(root, jnp.swapaxes(upper, 1, 2), lower=True), 1, 2
    )
    return jnp.concatenate([psi @ SIGNS.T / 4, held], axis=2)


def n_carrying(linear: bool) -> int:
    """Number of groups that carry the volume of a patch, in equal shares; the others are held."""
    return len(SIGNS) if linear else 1


def _inverse_root(A):
    """Inverse square roots (c, 2, 2) of symmetric positive matrices, isotropic near the axes.

    Next to the axes' directions none of them is preferred.
    """
    det = A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] ** 2
    s = jnp.sqrt(det)[:, None, None]
    t = jnp.sqrt(A[:, 0, 0] + A[:, 1, 1] + 2 * s[:, 0, 0])[:, None, None]
    cofactor = jnp.stack(
        [jnp.stack([A[:, 1, 1], -A[:, 0, 1]], -1), jnp.stack([-A[:, 0, 1], A[:, 0, 0]], -1)], -2
    )
    return (cofactor + s * np.eye(2)) / (t * s)  # sqrt(A) = (A + s I) / t, Cayley and Hamilton
