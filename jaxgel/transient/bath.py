"""The bath: the chemical potential that wetted boundary has in time."""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Chemical, Float, Scalar
from .._validation import finite_numbers
from ..controls import Setting, check_values


@dataclasses.dataclass(frozen=True)
class Bath:
    """A bath with the chemical potential ``mu``, kT, from time 0 on, or with values ``mu`` at ``times``, linear in between.

    Before its first time it has its first value; the step from what the gel has at the start to that is a jump at time 0.

    >>> ramp = Bath([-1.0, -0.1], times=[0.0, 0.1])
    >>> [round(float(ramp.at(t)), 12) for t in (0.0, 0.05, 2.0)]
    [-1.0, -0.55, -0.1]
    """

    mu: Scalar | Sequence[float]
    """Chemical potential, kT, or its values."""
    times: Sequence[float] | None = None
    """Times of the values, rising from 0 or later, in the unit of time of D; None for one value."""

    def __post_init__(self) -> None:
        times = [0.0] if self.times is None else self.times
        times = check_values(times, "bath.times", "time", rising=True)
        mu = finite_numbers(np.atleast_1d(np.asarray(self.mu, dtype=float)), (len(times),), "bath.mu")
        if times[0] < 0:
            raise ValueError(f"bath.times: {times[0]:g} is not accepted, a bath begins at time 0 or later")
        object.__setattr__(self, "mu", tuple(map(float, mu)))
        object.__setattr__(self, "times", tuple(map(float, times)))

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times above 0 at which its slope changes."""
        times = np.atleast_1d(self.times)
        return tuple(times[times > 0].tolist()) if len(times) > 1 else ()

    def at(self, t: float) -> float:
        """Chemical potential, kT, at the time ``t``."""
        return float(np.interp(t, self.times, self.mu))

    def inverse_root_age(self, t: float, start: float) -> float:
        """Mean of 1 / sqrt(t - s) over the changes at times s before ``t``, from the value at the ``start``, kT; 0 without changes."""
        times, mu = (np.asarray(values) for values in (self.times, self.mu))
        jump = abs(mu[0] - start)
        rates, total = jump / np.sqrt(t), jump
        for first, last, change in zip(times[:-1], times[1:], np.diff(mu), strict=True):
            if t > first:
                part = (min(t, last) - first) / (last - first)
                total += abs(change) * part
                rates += 2 * abs(change) / (last - first) * (np.sqrt(t - first) - np.sqrt(t - min(t, last)))
        return float(rates / total) if total > 0 else 0.0


def values_of(baths: Sequence[Bath], start: Float[np.ndarray, " b"], t: float) -> tuple[Float[np.ndarray, " b"], Float[np.ndarray, " b"]]:
    """Chemical potentials (b,), kT, of several baths at the time ``t``, and their `inverse_root_age`."""
    mu = np.array([bath.at(t) for bath in baths])
    return mu, np.array([bath.inverse_root_age(t, first) for bath, first in zip(baths, start, strict=True)])


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


def time_in(baths: Sequence[Bath], wetted: tuple[str | int, ...] = (), D: Scalar = 1.0) -> Time:
    """`Time` of several baths, those of the parts ``wetted``, and the diffusivity ``D``."""
    times = np.unique(np.concatenate([bath.times for bath in baths]))
    parts = np.stack([np.interp(times, bath.times, bath.mu) for bath in baths])
    return Time(times, parts.mean(axis=0), parts, D, wetted)
