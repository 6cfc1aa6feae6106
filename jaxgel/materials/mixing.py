"""Energy of mixing of polymer and solvent, and the range in which its slope increases."""

from typing import Any

import jax.numpy as jnp

from .._types import Array, Bool, Float, Scalar


def flory_huggins(J: Float[Array, "..."] | Scalar, chi: Scalar) -> Float[Array, "..."]:
    """Energy of mixing polymer and solvent, -(J-1) ln(J/(J-1)) - chi/J, in kT/v per dry volume.

    J > 1. ln(J/(J-1)) = log1p(1/(J-1)) is accurate for every J, both next to the dry state and far
    from it.
    """
    return -(J - 1) * jnp.log1p(1 / (J - 1)) - chi / J


def flory_rehner(J: Float[Array, "..."] | Scalar, gel: Any) -> Float[Array, "..."]:
    """Flory-Rehner energy of J alone: mixing, and -Nv ln J of the network; Eq. (1)."""
    return flory_huggins(J, gel.chi) - gel.Nv * jnp.log(J)


def good_solvent(
    Nv: Float[Array, "..."] | Scalar, chi: Float[Array, "..."] | Scalar
) -> Bool[Array, "..."]:
    """Whether the slope of `flory_rehner` is monotone: no spinodal, 2 chi < (1 + sqrt(Nv))^2.

    It increases with every J > 1. Its second derivative is that of Nv J^2 + (1 - 2 chi - Nv) J + 2
    chi in sign.
    """
    return 2 * chi < (1 + jnp.sqrt(Nv)) ** 2
