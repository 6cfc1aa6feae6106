"""Shared parts of the paper's comparison: entries of the report, and sweeps of several items.

An item is a function ``(runs) -> Entry``; its figure and rows are written by `runs`.
"""

import dataclasses
import functools
import json
from collections.abc import Callable
from importlib.resources import files
from typing import Any

import numpy as np

from ..cases import GRID, SIDE, sample
from ..cloud import Cloud, make_cloud
from ..continuation import Path, sweep
from ..discretisation import Model, discretise
from ..equilibrium import Observer
from ..mechanics import Problem
from .newton import scheme_path
from .scheme import make_scheme

FINITE_ELEMENTS = json.loads(
    files("jaxgel.paper").joinpath("finite_elements.json").read_text(encoding="utf-8")
)
"""Values of another method, quoted in the report.

``about`` says how they were made, ``spread`` stands for the error of its neighbours.
"""
# Okabe and Ito
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
DETAILED = [-4.9678, -3.9678, -2.9678, -2.4678, -1.9678, -1.4678, -1.1678, -0.95, -0.9178]
BEYOND = [-0.8, -0.6678, -0.5678, -0.45, -0.4, -0.36, -0.327, -0.2978, -0.2678, -0.244, -0.23]
"""Chemical potentials, kT, of the patterns and of the holes' closing."""
TURNING = [
    -4.9678, -3.9678, -3.4678, -2.9678, -2.4678, -1.9678, -1.7, -1.4678, -1.3, -1.2, -1.1678, -1.1,
    -1.05, -1.0, -0.95, -0.9178,
]  # fmt: skip
TURNING += [-0.89, -0.86, -0.83, -0.8]
"""Those of the ellipses' rotation."""
CLOSING = {
    3: ("stable", [-4.9678, -2.9678, -1.9678, -1.4678, -1.3, -1.2, -1.1, -1.0, -0.9178]),
    4: ("stable", [mu for mu in DETAILED + BEYOND if mu <= -0.2678]),
    7: ("symmetric", DETAILED + BEYOND),
    9: ("symmetric", [-4.9678, -2.9678, -1.9678, -1.4678, -1.3, -1.1678, -1.05, -0.9178]),
}
"""Branch and chemical potentials of samples that are followed with contact."""


@dataclasses.dataclass(frozen=True)
class Number:
    """One line of an item's table: a quantity by the paper, by this run and by a reference."""

    what: str
    """The quantity, with its unit and mu."""
    ours: float | str
    """Value of this run."""
    paper: float | str | None = None
    """Value that the paper prints; None for none."""
    reference: float | str | None = None
    """Value by finite elements or a closed form; None for none."""
    digits: str = ".4g"
    """Format specification of the values that are numbers."""
    error: float | None = None
    """Error bar of this run's value, from several clouds, see `verification.error_bars`.

    None for none.
    """

    def cells(self) -> list[str]:
        """The line as texts: quantity, paper, this run, reference, and difference.

        It is that of this run to the reference, else to the paper.
        """
        known = self.paper if self.reference is None else self.reference
        values = [
            "" if v is None else v if isinstance(v, str) else f"{v:{self.digits}}"
            for v in (self.paper, self.ours, self.reference)
        ]
        values[1] += "" if self.error is None else f" ± {self.error:.2g}"
        comparable = (
            not isinstance(self.ours, str)
            and not isinstance(known, str)
            and known
            and np.isfinite(self.ours)
        )
        off = f"{100 * (self.ours / known - 1):+.2g} %" if comparable else ""
        return [self.what, *values, "0" if comparable and self.ours == known else off]


@dataclasses.dataclass(frozen=True)
class Entry:
    """One item of the report."""

    title: str
    """Table or figure, and what it shows."""
    paper: str
    """What the paper says, in a sentence."""
    numbers: list[Number]
    """Table of the item."""
    rows: list[dict[str, Any]]
    """The CSV file: dictionaries with the same keys."""
    figure: Any
    """The Matplotlib figure."""
    reference: str = "finite elements"
    """Name of the references in the table."""


class Runs:
    """Clouds, models and sweeps that items share: each is computed once, at its first use."""

    def __init__(self, on_state: Callable[[str], Any] = lambda _: None) -> None:
        self.on_state, self._kept = on_state, {}

    def once(self, key: Any, compute: Callable[[], Any]) -> Any:
        """The result of ``compute``, called once for each ``key``."""
        if key not in self._kept:
            self._kept[key] = compute()
        return self._kept[key]

    def path(
        self,
        name: str,
        mu: Any,
        *,
        contact: bool,
        spacing: float | None = None,
        branch: str = "symmetric",
    ) -> Path:
        """Path of a sample at ``mu`` (k,) on a cloud of a spacing, mm, by default the paper's.

        With ``contact`` or until outlines overlap.
        """

        def compute():
            model = self.model(name, spacing)
            problem, observer = (
                Problem(model, model.cloud.plate.gel, contact=contact),
                self.observer(f"{name}, {model.n_nodes} nodes"),
            )
            return sweep(
                problem, list(mu), branch=branch, until_contact=not contact, observer=observer
            )

        return self.once((name, tuple(mu), contact, spacing, branch), compute)

    def model(self, name: str, spacing: float | None = None) -> Model:
        """Model of a sample."""
        return self.once(("model", name, spacing), lambda: discretise(self.cloud(name, spacing)))

    def cloud(self, name: str, spacing: float | None = None) -> Cloud:
        """Cloud of a sample."""
        return self.once(
            ("cloud", name, spacing), lambda: make_cloud(sample(name), spacing=spacing)
        )

    def observer(self, name: str) -> Observer:
        """Observer of a sweep with this name in the progress that is shown."""
        return Observer(accepted=lambda state: self.on_state(f"{name}, mu = {state.mu:.4f}"))

    def stopping(self, number: int, intervals: int = GRID) -> Path:
        """Symmetric path of sample ``number`` as in the paper, without contact, until overlap.

        The paper has 40 ``intervals`` of background nodes; on other clouds the path ends at the
        last of ``TURNING``. The symmetry of samples 1-3 does not forbid their rotation.
        """
        mu = TURNING if number <= 3 else DETAILED
        mu = mu + [value for value in BEYOND if value > mu[-1]] if intervals == GRID else mu
        return self.path(f"sample-{number}", mu, contact=False, spacing=SIDE / intervals)

    def touching(self, number: int, intervals: int = GRID, last: float = 0.0) -> Path:
        """Path of sample ``number`` with contact at the values of ``CLOSING`` up to ``last``."""
        branch, mu = CLOSING[number]
        mu = [value for value in mu if value <= last]
        return self.path(
            f"sample-{number}", mu, contact=True, spacing=SIDE / intervals, branch=branch
        )

    def stiff(self, number: int) -> Path:
        """Path of sample ``number`` in the paper's discretisation; it locks, but goes far.

        Displacements alone at its Gauss points.
        """

        def compute():
            name = f"sample-{number}"
            scheme, mu = (
                make_scheme(self.cloud(name), basis="quadratic", kind="imls"),
                [mu for mu in DETAILED + BEYOND if mu <= -0.2678],
            )
            observer = self.observer(f"{name}, {len(scheme.cloud.nodes)} nodes")
            return scheme_path(
                scheme, scheme.cloud.plate.gel, mu, until_overlap=True, observer=observer
            )

        return self.once(("stiff", number), compute)

    def stable(self, number: int) -> Path:
        """Path of sample ``number`` without contact on the stable branch."""
        return self.path(
            f"sample-{number}", [-4.9678, -2.9678, -1.9678, -1.4678], contact=False, branch="stable"
        )

    def shown(self, number: int, mu: float) -> Path:
        """Path that shows sample ``number`` at ``mu``, or at its last state before.

        With contact if outlines overlap before, and in the paper's own discretisation if the
        converged branch ends before.
        """
        path = self.stopping(number)
        if path.mu[-1] < mu:
            path = self.touching(number) if number in CLOSING else self.stiff(number)
        return path


def at(path: Any, mu: float) -> int:
    """Number of the state of a path at ``mu``, or of the last one if the path ends before."""
    return int(np.argmin(np.abs(np.minimum(mu, path.mu[-1]) - np.asarray(path.mu))))


def crossing(x: Any, y: Any, value: float) -> float:
    """The x () at which a growing y (k,) first reaches ``value``; nan if never.

    Interpolated.
    """
    x, y = np.asarray(x), np.asarray(y)
    above = np.flatnonzero(y >= value)
    if len(above) == 0 or above[0] == 0:
        return float("nan")
    k = above[0]
    return float(x[k - 1] + (value - y[k - 1]) / (y[k] - y[k - 1]) * (x[k] - x[k - 1]))


def or_none(value: float) -> float | str:
    """The value, or "none" if it is not finite."""
    return value if np.isfinite(value) else "none"


def rows(columns: dict[str, Any], **fixed: Any) -> list[dict[str, Any]]:
    """A dictionary for each of the k entries of ``columns`` (name -> (k,)), after ``fixed``."""
    return [
        fixed | dict(zip(columns, values, strict=True))
        for values in zip(*(np.asarray(v).tolist() for v in columns.values()), strict=True)
    ]


@functools.cache
def pyplot() -> Any:
    """Matplotlib's pyplot without a screen."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def unstable_from(path: Path) -> float:
    """The first mu of a path with an unstable state; nan without one."""
    unstable = np.asarray(path.negative_pivots) > 0
    return float(path.mu[np.argmax(unstable)]) if unstable.any() else float("nan")
