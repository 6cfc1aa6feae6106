"""The slope W' of a gel's energy over the volume ratio: where it turns, and what is between two such points, as numbers on the host."""

import functools
import itertools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

from .._types import Array, Float, Scalar
from .swelling import LARGEST_SWELLING, SMALLEST_SWELLING

SCAN = np.linspace(math.log(SMALLEST_SWELLING), math.log(LARGEST_SWELLING), 2048)  # of u = ln(J - 1)
CLOSEST = {"xtol": 1e-15, "rtol": 1e-14}  # of bracketed roots


class SwellingCurve:
    """W' of one gel over u = ln(J - 1), as numbers."""

    def __init__(self, energy: Callable, gel: Any) -> None:
        self._energy, self._gel = energy, jax.tree.map(lambda part: jnp.asarray(part, float), gel)
        finite = np.isfinite(self._values(SCAN)).all(axis=0)
        u = SCAN if finite.all() else self._ended(SCAN, int(np.argmin(finite)))
        self.turns = self._turning_points(u, self._values(u))
        """The u at which W' turns."""
        self.pieces = list(itertools.pairwise([u[0], *self.turns, u[-1]]))
        """Intervals of u on which W' rises or falls."""

    def _values(self, u):
        """W' and its first and second derivative by J, (3, n)."""
        return np.asarray(_derivatives(self._energy, np.atleast_1d(u), self._gel))

    def slope(self, u: float, order: int = 0) -> float:
        """W', or its derivative of an ``order``."""
        return float(self._values(u)[order, 0])

    def _ended(self, u, first):
        """The ``u`` where W' is finite and, last, the end of these, where chains are straight: below ``u[first]``."""
        finite, not_finite = u[first - 1], u[first]
        while not_finite - finite > 2e-14:  # the resolution of u
            middle = (finite + not_finite) / 2
            inside = np.isfinite(self._values(middle)).all()
            finite, not_finite = (middle, not_finite) if inside else (finite, middle)
        return np.append(u[:first], finite)

    def _zeros(self, order, u, values):
        changes = np.flatnonzero((values[:-1] < 0) != (values[1:] < 0))
        return [brentq(self.slope, u[k], u[k + 1], args=(order,), **CLOSEST) for k in changes]

    def _turning_points(self, u, values):
        """Zeros of the slope of W', also of two between neighbours of the scan: the slope is looked at where it is extremal too."""
        extremal = self._zeros(2, u, values[2])
        at, slopes = np.append(u, extremal), np.append(values[1], [self.slope(u, 1) for u in extremal])
        order = np.argsort(at)
        return self._zeros(1, at[order], slopes[order])

    def root(self, left: float, right: float, mu: float) -> float:
        """J at which W' = ``mu`` on a piece, or the end of it that is nearest."""
        mu = np.clip(mu, *sorted((self.slope(left), self.slope(right))))
        return 1 + math.exp(brentq(lambda u: self.slope(u) - mu, left, right, **CLOSEST))

    def maxwell(self, first: tuple, second: tuple) -> tuple | None:
        """The mu at which the states on two rising pieces have the same energy, and their J; None where there is none."""

        def phases(mu):
            return self.root(*first, mu), self.root(*second, mu)

        def work(mu):
            J = phases(mu)
            before, after = (float(energy_at(self._energy, ratio, self._gel)) for ratio in J)
            return after - before - mu * (J[1] - J[0])

        lowest, highest = (pick(map(self.slope, ends)) for pick, ends in ((max, (first[0], second[0])), (min, (first[1], second[1]))))
        if not work(lowest) > 0 > work(highest):
            return None
        mu = brentq(work, lowest, highest, **CLOSEST)
        return mu, phases(mu)


@functools.partial(jax.jit, static_argnums=0)
def energy_at(energy: Callable, J: Scalar, gel: Any) -> Float[Array, ""]:
    """W () at the volume ratio ``J`` () of the gel, kT/v."""
    return energy(J, gel)


@functools.partial(jax.jit, static_argnums=0)
def slope_at(energy: Callable, J: Scalar, gel: Any) -> Float[Array, ""]:
    """W' () at ``J`` (), kT/v: the chemical potential of a state that swells freely."""
    return jax.grad(energy)(J, gel)


@functools.partial(jax.jit, static_argnums=0)
def bend_at(energy: Callable, J: Scalar, gel: Any) -> Float[Array, ""]:
    """W'' () at ``J`` (), kT/v: positive where a state is stable."""
    return jax.grad(jax.grad(energy))(J, gel)


@functools.partial(jax.jit, static_argnums=0)
def _derivatives(energy, u, gel):
    """First to third derivative of W by J at u = ln(J - 1), (3, n); NaN where W is not finite."""

    def one(J):
        slope = jax.grad(energy)
        bend = jax.grad(slope)
        return jnp.where(jnp.isfinite(energy(J, gel)), jnp.stack([slope(J, gel), bend(J, gel), jax.grad(bend)(J, gel)]), jnp.nan)

    return jax.vmap(one, out_axes=1)(1 + jnp.exp(u))
