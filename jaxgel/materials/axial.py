"""The axial stretch that no force holds: where the derivative of an energy by it vanishes, in generalised plane strain.

One stretch l3 of the thickness belongs to a whole plate, so that it is found for the energy of the plate and not of a material point.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from .._types import Array, Bool, Float, Scalar
from .swelling import LARGEST_SWELLING, _volume_ratio, branch_ends

POLISHED = 3  # steps that take a stretch of Newton's accuracy to round-off
MARGIN = 1e-9  # of a stretch at which an energy ends: how far from it the search stays


@functools.partial(jax.jit, static_argnums=0)
def balanced_stretch(
    energy: Callable, of: Any, low: Scalar, scale: Scalar, most: Scalar = math.inf, rises: Bool[Array, ""] | bool = True
) -> Float[Array, ""]:
    """The stretch l () > ``low`` at which d ``energy(l, of)``/dl vanishes, with all derivatives by ``of``, a pytree of numbers.

    The slope comes from -inf at ``low`` and increases to the root, or ``rises`` is false: then its first increasing part is searched.
    ``scale`` is a typical size of l - low, and ``most`` the stretch at which the energy ends. ``energy`` stands at the top of a module.
    """
    end = math.log(LARGEST_SWELLING)
    if rises is not True:
        end = branch_ends(lambda *_: (_Placed(energy), (of, low, scale)), jnp.zeros(()), (), rises)
    end = jnp.minimum(end, jnp.log(((1 - MARGIN) * most - low) / scale))
    return _balanced(energy, of, *jax.lax.stop_gradient((low, scale, end)))


@functools.partial(jax.custom_jvp[Any], nondiff_argnums=(0,))
def stretch_near(energy: Callable[..., Any], of: Any, near: Scalar) -> Float[Array, ""]:
    """The stretch l () at which d ``energy(l, of)``/dl vanishes, by Newton's method from one ``near`` it. Derivatives by ``of``."""
    slope = jax.value_and_grad(jax.grad(energy))

    def step(_, stretch):
        force, stiffness = slope(stretch, of)
        return stretch - force / stiffness

    return jax.lax.fori_loop(0, POLISHED, step, near)


@stretch_near.defjvp
def _stretch_near_jvp(energy, primals, tangents):
    of, near = primals
    l3 = stretch_near(energy, of, near)
    return l3, _rate(energy, l3, of, tangents[0])


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _balanced(energy, of, low, scale, end):
    return _Placed.stretch(_volume_ratio(_Placed(energy), 0.0, (of, low, scale), end)[0], low, scale)


@_balanced.defjvp
def _balanced_jvp(energy, primals, tangents):
    l3 = _balanced(energy, *primals)
    return l3, _rate(energy, l3, primals[0], tangents[0])


def _rate(energy, l3, of, of_dot):
    """E_l(l, of) = 0 gives E_ll dl = -d E_l at fixed l."""
    slope = jax.grad(energy)
    change = jax.jvp(lambda of: slope(l3, of), (of,), (of_dot,))[1]
    return -change / jax.grad(slope)(l3, of)


@dataclasses.dataclass(frozen=True)
class _Placed:
    """The energy as a function of J > 1 with the stretch low + scale (J - 1): what the search for a volume ratio takes."""

    energy: Callable

    def __call__(self, J, at):
        of, low, scale = at
        return self.energy(self.stretch(J, low, scale), of)

    @staticmethod
    def stretch(J, low, scale):
        return low + scale * (J - 1)
