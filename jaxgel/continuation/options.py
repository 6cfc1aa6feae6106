"""Options of a sweep."""

import dataclasses

import numpy as np

from .._validation import NUMBER, check_options, listed, option, whole, word
from ..controls import check_values

BRANCHES = ("stable", "symmetric")
CONTACT = ("on", "off", "stop")
FORMULATIONS = ("total", "incremental")
SYMMETRY = ("auto", "off")
MAX_STEPS = 400  # accepted states of a sweep with chosen steps


@dataclasses.dataclass(frozen=True)
class SweepOptions:
    """Values of mu, in kT, and how a sweep follows its branch; checked when they are made.

    A field's ``stage`` says what takes it: "mu" is part of `values`, "loads" of the sweep's loads, and "sweep" is a keyword of `sweep`.
    """

    mu_start: float = option(-4.9678, NUMBER, "mu")
    """First value."""
    mu_end: float = option(-0.9178, NUMBER, "mu")
    """Last value."""
    steps: str | int = option(40, {"anyOf": [{"const": "auto"}, whole(2)]}, "mu")
    """"auto", or the number of equally spaced values with both ends included."""
    mu: tuple | None = option(None, listed(NUMBER, least=1), "mu")
    """The values themselves, increasing; then the three above are not used."""
    branch: str = option("stable", word(BRANCHES), "sweep")
    """Branch to follow where the plate is symmetric"""
    imperfection: float = option(0.0, NUMBER, "loads")
    """Size of the load along the first bifurcation's mode, as the displacement that it would cause, in spacings; 0 for none."""
    contact: str = option("on", word(CONTACT), "sweep")
    """Where hole boundaries meet, keep them apart, let them overlap, or stop"""
    symmetry: str = option("auto", word(SYMMETRY), "sweep")
    """Find symmetric states on a fundamental region of the plate, or all states on the whole plate"""

    def __post_init__(self) -> None:
        check_options("sweep", self)
        check_values(self.values)

    @property
    def values(self) -> list[float] | tuple[float, float]:
        """What `sweep` takes as ``mu``: a list of values, or the two ends for chosen steps."""
        if self.mu is not None:
            return list(self.mu)
        return (self.mu_start, self.mu_end) if self.steps == "auto" else np.linspace(self.mu_start, self.mu_end, self.steps).tolist()

    @property
    def given(self) -> bool:
        """Whether all values are known beforehand."""
        return self.mu is not None or self.steps != "auto"

    @property
    def ends(self) -> tuple[float, float]:
        """First and last mu."""
        return (self.mu[0], self.mu[-1]) if self.mu is not None else (self.mu_start, self.mu_end)
