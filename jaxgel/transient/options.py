"""Options of swelling in time: the sections ``time`` and ``bath`` of case files."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from .._validation import NUMBER, POSITIVE, TEXT, check_options, listed, option, whole
from ..controls import check_values
from .bath import Bath, Time, time_in
from .swelling import TimeSteps

STEPS_PER_DECADE = 10


@dataclasses.dataclass(frozen=True)
class TimeOptions:
    """The times of the states of transient swelling, and the diffusivity of the solvent.

    Checked when they are made.
    """

    end: float | None = option(None, POSITIVE)
    """Last time."""
    steps_per_decade: int | None = option(None, whole(1, 1000), filled=STEPS_PER_DECADE)
    """Steps in each decade of time; they begin anew at kinks of the bath."""
    first: float | None = option(None, POSITIVE)
    """First step; by default a thousandth of the time in which solvent moves a node spacing."""
    times: tuple | None = option(None, listed(POSITIVE, least=1))
    """The times themselves, rising, instead of end, steps_per_decade and first."""
    D: float = option(1.0, POSITIVE)
    """Diffusivity of the solvent, mm^2 per unit of time."""
    unit: str = option("", TEXT)
    """Unit of time, such as s or h; empty for the unit that D defines."""

    def __post_init__(self) -> None:
        check_options("time", self)
        if self.times is None:
            if self.end is None:
                raise ValueError("time.end: is missing; give end, or times = [list]")
            if self.first is not None and not self.first < self.end:
                raise ValueError(f"time.first: {self.first:g} is not below time.end = {self.end:g}")
            if self.steps_per_decade is None:
                object.__setattr__(self, "steps_per_decade", STEPS_PER_DECADE)
        else:
            name = next(
                (
                    name
                    for name in ("end", "steps_per_decade", "first")
                    if getattr(self, name) is not None
                ),
                None,
            )
            if name is not None:
                raise ValueError(
                    f"time.{name}: {getattr(self, name)!r} does not go with a list of times"
                )
            check_values(self.times, "time.times", self.unit or "time", rising=True)

    @property
    def values(self) -> TimeSteps | list[float]:
        """The times as `swell` takes them."""
        if self.times is not None:
            return list(self.times)
        return TimeSteps(self.end, self.first, self.steps_per_decade)

    @property
    def refined(self) -> TimeSteps | list[float]:
        """The times with half the steps."""
        if self.times is not None:
            ends = [0.0, *self.times]
            return np.interp(
                np.arange(1, 2 * len(ends) - 1) / 2, np.arange(len(ends)), ends
            ).tolist()
        first = None if self.first is None else self.first / 2
        return TimeSteps(self.end, first, 2 * self.steps_per_decade)

    @property
    def last(self) -> float:
        """The last time."""
        return self.end if self.times is None else self.times[-1]

    def control(self, baths: Mapping[str | int, Bath]) -> Time:
        """Time as the control of a path in these baths of the wetted parts."""
        return time_in(baths, self.D, self.unit)


@dataclasses.dataclass(frozen=True)
class BathOptions:
    """The chemical potential of a bath in time; checked when it is made."""

    mu: float | tuple | None = option(None, {"anyOf": [NUMBER, listed(NUMBER, least=1)]})
    """Chemical potential of the bath, kT, or its values at the times."""
    times: tuple | None = option(None, listed(NUMBER | {"minimum": 0.0}, least=1))
    """Times of the values of mu, which is linear between them; up to the end of the run."""
    ramp: float | None = option(None, POSITIVE)
    """Time in which the bath goes from mu_start to mu, linearly; by default it jumps at time 0."""

    def __post_init__(self) -> None:
        check_options("bath", self)
        if self.mu is None:
            raise ValueError("bath.mu: is missing; give the chemical potential of the bath, kT")
        if self.ramp is not None and self.times is not None:
            raise ValueError("bath: give one of times and ramp, not both")
        if isinstance(self.mu, tuple | list) != (self.times is not None):
            text = (
                "is a list, which goes with bath.times"
                if self.times is None
                else "is a number, bath.times goes with a list"
            )
            raise ValueError(f"bath.mu: {self.mu!r} {text}")
        if self.times is not None:
            if len(self.mu) != len(self.times):
                raise ValueError(
                    f"bath.mu: has {len(self.mu)} values, bath.times has {len(self.times)}"
                )
            check_values(self.times, "bath.times", "time", rising=True)

    def bath(self, start: float, end: float) -> Bath:
        """The `Bath` of a gel in equilibrium at ``start``, kT, at first.

        ValueError for a table that ends before the time ``end``.
        """
        if self.ramp is not None:
            return Bath((start, self.mu), times=(0.0, self.ramp))
        if self.times is not None and self.times[-1] < end:
            raise ValueError(
                f"bath.times: {self.times[-1]:g} is before the last time of the run, {end:g}; "
                "give the bath's mu up to then"
            )
        return Bath(self.mu, times=self.times)
