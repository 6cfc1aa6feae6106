"""The sections of a case file and what their entries accept: each written once, as a piece of JSON schema beside the entry.

`schema` joins the pieces, prints them, and `cases` checks every table against them; the sections check themselves when they are made.
"""

import dataclasses

import numpy as np

from . import holes
from .edges import CONDITIONS, EDGES
from .linear_solve import SOLVERS
from .loads import Loads
from .rules import FLAG, NUMBER, PAIR, POSITIVE, TEXT, check, listed, tabled, whole, word
from .sweep import BRANCHES, CONTACT, check_mu

HOLES = {
    kind.__name__.lower(): kind for kind in (holes.Circle, holes.Ellipse, holes.Rectangle, holes.Superellipse, holes.Fourier, holes.Polygon)
}
BASES = ("linear", "quadratic")
METHODS = ("mixed", "displacement")
QUADRATURES = ("conforming", "paper")
_CONDITION = word(CONDITIONS)
PLATE = {
    "width": POSITIVE,
    "height": POSITIVE,
    "edges": {"type": ["string", "object"], "if": {"type": "object"}, "then": tabled(dict.fromkeys(EDGES, _CONDITION)), "else": _CONDITION},
    "deformation": listed(PAIR, 2, 2),
    "displacement": tabled(dict.fromkeys(EDGES, PAIR)),
    "spacing": POSITIVE,
    "nodes_per_hole": whole(3),
    "cells": whole(1),
    "core": PAIR,
    "unit": TEXT,
}  # fields of `geometry.Plate`; the first two are required


def _option(default, rule):
    """Field of a section with what it accepts, a piece of JSON schema; None, where that is the default, stands for not given."""
    return dataclasses.field(default=default, metadata={"schema": rule})


@dataclasses.dataclass(frozen=True)
class SweepOptions:
    """The values of mu, in kT, and the branch to follow."""

    mu_start: float = _option(-4.9678, NUMBER)
    """First value."""
    mu_end: float = _option(-0.9178, NUMBER)
    """Last value."""
    steps: str | int = _option(40, {"anyOf": [{"const": "auto"}, whole(2)]})
    """"auto", or the number of equally spaced values with both ends included."""
    mu: tuple | None = _option(None, listed(NUMBER, least=1))
    """The values themselves, increasing; then the three above are not used."""
    branch: str = _option("stable", word(BRANCHES))
    """Branch to follow where the plate is symmetric"""
    imperfection: float = _option(0.0, NUMBER)
    """Size of the load along the first bifurcation's mode, see `branches.imperfection`; 0 for none."""
    contact: str = _option("on", word(CONTACT))
    """Where hole boundaries meet, keep them apart, let them overlap, or stop"""

    def __post_init__(self):
        _check("sweep", self)
        check_mu(self.values)

    @property
    def values(self):
        """What `sweep.sweep` takes as ``mu``: a list of values, or the two ends for chosen steps."""
        if self.mu is not None:
            return list(self.mu)
        return (self.mu_start, self.mu_end) if self.steps == "auto" else np.linspace(self.mu_start, self.mu_end, self.steps).tolist()

    @property
    def given(self):
        """Whether all values are known beforehand."""
        return self.mu is not None or self.steps != "auto"

    @property
    def ends(self):
        """First and last mu."""
        return (self.mu[0], self.mu[-1]) if self.mu is not None else (self.mu_start, self.mu_end)


@dataclasses.dataclass(frozen=True)
class DiscretisationOptions:
    """Choices of `cloud.make_cloud` and `discretisation.discretise`; None leaves the default of the plate or the method."""

    spacing: float | None = _option(None, POSITIVE)
    """Distance of the background nodes, mm."""
    nodes_per_hole: int | None = _option(None, whole(3))
    """Nodes on the outline of a whole hole."""
    across: int | None = _option(None, whole(2))
    """Least number of nodes across every ligament, by local refinement."""
    basis: str = _option("quadratic", word(BASES))
    """Basis of the shape functions"""
    dmax: float | None = _option(None, POSITIVE)
    """Support radius over spacing."""
    method: str = _option("mixed", word(METHODS))
    """One pressure per cell, or displacement only"""
    quadrature: str = _option("conforming", word(QUADRATURES))
    """Cells along the true outline, or the paper's"""
    solver: str = _option("auto", word(SOLVERS))
    """How linear systems are solved, see `linear_solve`"""

    def __post_init__(self):
        _check("discretisation", self)


@dataclasses.dataclass(frozen=True)
class OutputOptions:
    """What a run leaves besides its table, states and summary."""

    figures: bool = _option(True, FLAG)
    """pattern.png and curves.png."""
    animation: bool = _option(True, FLAG)
    """pattern.gif."""
    paraview: bool = _option(True, FLAG)
    """series.pvd with a vtu file per state."""

    def __post_init__(self):
        _check("output", self)


OPTIONS = {"loads": Loads, "sweep": SweepOptions, "discretisation": DiscretisationOptions, "output": OutputOptions}


def _check(section, options):
    """Raise ValueError, naming section and key, for a value that its field does not accept."""
    fields = dataclasses.fields(options)
    given = {f.name: value for f in fields if (value := getattr(options, f.name)) is not None or f.default is not None}
    check({section: given}, tabled({section: tabled({f.name: f.metadata["schema"] for f in fields})}), section)
