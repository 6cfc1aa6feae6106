"""Bath: chemical potential of a wetted part over time; for the parts see ``mechanics.solvent``."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._primitives import differentiated_value
from .._tracing import is_traced
from .._types import Array, Chemical, Float, Scalar
from .._validation import finite_numbers
from ..controls import Setting, check_values


@dataclasses.dataclass(frozen=True)
class Bath:
    """Chemical potential of a bath from time 0 on: constant, or linear between given times.

    The user makes it for `swell`. Before its first time it has its first value, and beyond its last
    time its last one. The step from the potential of the gel at the start to the first value is a
    jump at time 0. JAX differentiates by `mu` and `times`.

    >>> ramp = Bath([-1.0, -0.1], times=[0.0, 0.1])
    >>> [round(float(ramp.at(t)), 12) for t in (0.0, 0.05, 2.0)]
    [-1.0, -0.55, -0.1]
    """

    mu: Scalar | Sequence[Scalar] | Float[Array, " j"]
    """Chemical potential, kT, or its values; at most 0, that of the pure solvent."""
    times: Sequence[Scalar] | Float[Array, " j"] | None = None
    """Times of the values, rising from 0 or later, in the unit of time of D; None for one value."""

    def __post_init__(self) -> None:
        times = [0.0] if self.times is None else self.times
        if is_traced((times, self.mu)):
            object.__setattr__(self, "mu", jnp.atleast_1d(jnp.asarray(self.mu, dtype=float)))
            object.__setattr__(self, "times", jnp.asarray(times, dtype=float))
            return
        times = check_values(times, "bath.times", "time", rising=True)
        mu = finite_numbers(
            np.atleast_1d(np.asarray(self.mu, dtype=float)), (len(times),), "bath.mu"
        )
        if times[0] < 0:
            raise ValueError(
                f"bath.times: {times[0]:g} is not accepted, a bath begins at time 0 or later"
            )
        if max(mu) > 0:
            raise ValueError(
                f"bath.mu: {max(mu):g} is not accepted, it must be at most 0 kT, that of the pure "
                "solvent"
            )
        object.__setattr__(self, "mu", tuple(map(float, mu)))
        object.__setattr__(self, "times", tuple(map(float, times)))

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times above 0 at which its slope changes."""
        times = self.numbers
        return tuple(times[times > 0].tolist()) if len(times) > 1 else ()

    @property
    def numbers(self) -> Float[np.ndarray, " j"]:
        """Its times, also if JAX differentiates by these."""
        return np.asarray(differentiated_value(self.times))

    def at(self, t: Float[Array, "..."] | Scalar) -> Float[Array, "..."] | Scalar:
        """Chemical potentials (...), kT, at times ``t``."""
        return _xp(t, self.times, self.mu).interp(t, self.times, self.mu)

    def inverse_root_age(
        self,
        t: Float[Array, "..."] | Scalar,
        start: Scalar,
        *,
        rising: bool = False,
        share: Float[Array, "..."] | Scalar = 1.0,
    ) -> Float[Array, "..."]:
        """Means (...) of 1 / sqrt(t - s) over the changes at s < ``t``, from ``start``, kT.

        The mean with ``rising`` is over changes that raise mu; 0 without changes. That of the jump
        at time 0 counts ``share`` times, see `march.jump_share`.
        """
        xp = _xp(t, self.times, self.mu, start)

        def size(change):
            return xp.where(change > 0, change, 0.0) if rising else abs(change)

        jump = size(self.mu[0] - start)
        rates, total = jump * share / xp.sqrt(t), jump
        for k in range(len(self.mu) - 1):
            first, last, change = (
                self.times[k],
                self.times[k + 1],
                size(self.mu[k + 1] - self.mu[k]),
            )
            total = total + change * xp.clip((t - first) / (last - first), 0.0, 1.0)
            rates = rates + 2 * change / (last - first) * (root(t - first) - root(t - last))
        return xp.where(total > 0, rates / xp.where(total > 0, total, 1.0), 0.0)


def root(values: Float[Array, "..."] | Scalar) -> Float[Array, "..."] | Scalar:
    """Square roots (...); 0 with derivatives 0 for what is not positive."""
    xp = _xp(values)
    return xp.where(values > 0, xp.sqrt(xp.where(values > 0, values, 1.0)), 0.0)


def _xp(*values):
    return jnp if is_traced(values) else np


def values_of(
    baths: Sequence[Bath],
    start: Sequence[Scalar],
    t: Float[Array, "..."] | Scalar,
    share: Float[Array, "..."] | Scalar = 1.0,
) -> tuple[Float[Array, "... b"], Float[Array, "... b"], Float[Array, "... b"]]:
    """Potentials (..., b), kT, of baths at ``t``, `inverse_root_age`, and that of rises.

    The times are t, with the ``share`` of jumps; rises are changes that raise mu.
    """
    own = list(zip(baths, start, strict=True))
    rates, rising = (
        [bath.inverse_root_age(t, first, rising=only, share=share) for bath, first in own]
        for only in (False, True)
    )
    columns = [bath.at(t) for bath in baths], rates, rising
    xp = _xp(columns)
    return tuple(xp.stack(column, axis=-1) for column in columns)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Time:
    """Time as what drives a path: the control of the states of transient swelling."""

    times: Float[Array, " j"]
    """Times between which the mean chemical potential of all baths is linear."""
    mu: Float[Array, " j"]
    """Its values, kT."""
    parts: Float[Array, "b j"] | None = None
    """Values of the bath of each wetted part; None if not known."""
    D: Scalar = 1.0
    """Diffusivity of the solvent, mm^2 per unit of time."""
    wetted: tuple[str | int, ...] = dataclasses.field(default=(), metadata={"static": True})
    """The wetted parts of the boundary: numbers of holes, names of free edges."""
    unit: str = dataclasses.field(default="", metadata={"static": True})
    """Of the times; empty for one that D defines."""
    name: ClassVar[str] = "t"
    scale: ClassVar[float] = 1.0

    def __call__(self, value: Chemical, gel: Any) -> Setting:
        """The gel at rest in the mean bath at a time ``value``."""
        return Setting(jnp.interp(value, self.times, self.mu), gel)


def time_in(baths: Mapping[str | int, Bath], D: Scalar = 1.0, unit: str = "") -> Time:
    """`Time` of the baths of the wetted parts, with the diffusivity ``D``."""
    times = np.unique(np.concatenate([bath.numbers for bath in baths.values()]))
    tables = [(bath.mu, bath.times) for bath in baths.values()]
    mean, parts = (_compiled_values if is_traced(tables) else _values)(tables, times)
    return Time(times, mean, parts, D, tuple(baths), unit)


def _values(tables, times):
    """Mean (j,) of several baths of (mu, times) each, and their values (b, j), at these times."""
    mu = [Bath(*table).at(times) for table in tables]
    xp = _xp(mu)
    return xp.mean(xp.stack(mu), axis=0), xp.stack(mu)


_compiled_values = compiled()(_values)


def moved_times(
    t: Float[Array, " k"], baths: Sequence[Bath], numbers: Sequence[Float[Array, " _"]]
) -> Float[Array, " k"]:
    """Times ``t`` (k,); those at kinks of the ``baths``, by ``numbers``, are the baths' own.

    These are the numbers of their times.
    """
    if not is_traced([bath.times for bath in baths]):
        return t
    moved = jnp.asarray(t)
    for bath, own in zip(baths, numbers, strict=True):
        for k, number in enumerate(own):
            moved = jnp.where((t == number) & (t > 0), bath.times[k], moved)
    return moved
