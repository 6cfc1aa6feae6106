"""A case: what one run needs to know, from a built-in name, a TOML file, or the table stored with a run.

A table has the sections of a case file, all but ``plate`` optional:

    [plate]            sample = "sample-1", or width, height (mm), edges = {left = "roller", ...}, deformation = [[1.1, 0.0], [0.0, 1.0]]
                       (of held and periodic edges), displacement = {top = [0.0, 0.5], ...} (mm, of held edges), and other fields of
                       `geometry.Plate`
    [[holes]]          kind = "ellipse" and the hole's own parameters; as many as there are holes, none with a sample; or
                       kind = "outline", file = "hole.dxf" (.csv, .svg), see `outline_files.hole_table`
    [[moved]]          parameters that replace those of a hole, one section for each hole; the cloud is the former plate's, placed
    [gel]              Nv, chi; energy = "module:function" and numbers that the function takes, see `user_energy`
    [loads]            body_force = [x, y] (kT/v per mm), traction = {top = [x, y], ...} (kT/v)
    [sweep]            mu_start, mu_end, steps ("auto" or a number), or mu = [increasing list]; branch, imperfection, contact
    [discretisation]   spacing (mm), nodes_per_hole, across, basis, dmax, method, quadrature, solver
    [output]           figures, animation, paraview (true or false)

What an option accepts is written once, as a piece of JSON schema at its field: it is checked here and printed by `schema`.
"""

import dataclasses
import math
import sys
from pathlib import Path as File

import numpy as np

from . import holes
from .cloud import make_cloud
from .constraints import check_edges, check_room
from .discretisation import discretise
from .files import read_toml
from .geometry import Plate, check_plate
from .linear_solve import SOLVERS
from .loads import Loads
from .material import Gel, check_gel
from .messages import did_you_mean
from .placement import refreshed
from .samples import sample
from .sweep import BRANCHES, CONTACT, check_mu
from .user_energy import user_gel

HOLES = {
    kind.__name__.lower(): kind for kind in (holes.Circle, holes.Ellipse, holes.Rectangle, holes.Superellipse, holes.Fourier, holes.Polygon)
}
SECTIONS = ("plate", "holes", "moved", "gel", "loads", "sweep", "discretisation", "output")
BASES = ("linear", "quadratic")
METHODS = ("mixed", "displacement")
QUADRATURES = ("conforming", "paper")
NUMBER, POSITIVE, FLAG = {"type": "number"}, {"type": "number", "exclusiveMinimum": 0.0}, {"type": "boolean"}
PAIR = {"type": "array", "items": NUMBER, "minItems": 2, "maxItems": 2}
PLATE = {
    "width": POSITIVE,
    "height": POSITIVE,
    "edges": {"type": ["string", "object"]},
    "deformation": {"type": "array", "items": PAIR},
    "displacement": {"type": "object", "additionalProperties": PAIR},
    "spacing": POSITIVE,
    "nodes_per_hole": {"type": "integer", "minimum": 3},
    "cells": {"type": "integer", "minimum": 1},
    "core": PAIR,
    "unit": {"type": "string"},
}  # fields of `geometry.Plate`; the first two are required


def _word(choices):
    return {"type": "string", "enum": list(choices)}


def _whole(least):
    return {"type": "integer", "minimum": least}


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
    steps: str | int = _option(40, {"anyOf": [{"const": "auto"}, _whole(2)]})
    """"auto", or the number of equally spaced values with both ends included."""
    mu: tuple | None = _option(None, {"type": "array", "items": NUMBER, "minItems": 1})
    """The values themselves, increasing; then the three above are not used."""
    branch: str = _option("stable", _word(BRANCHES))
    """Branch to follow where the plate is symmetric"""
    imperfection: float = _option(0.0, NUMBER)
    """Size of the load along the first bifurcation's mode, see `branches.imperfection`; 0 for none."""
    contact: str = _option("on", _word(CONTACT))
    """Where hole boundaries meet, keep them apart, let them overlap, or stop"""

    def __post_init__(self):
        _check("sweep", self)
        if self.steps != "auto" and (type(self.steps) is not int or self.steps < 2):
            raise ValueError(f"sweep.steps: {self.steps!r} is neither 'auto' nor a whole number of at least 2")
        if self.mu is not None and not isinstance(self.mu, tuple):
            raise ValueError(f"sweep.mu: {self.mu!r} is not a list of numbers")
        for value in self.mu or ():
            _number("sweep", "mu", value)
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
    nodes_per_hole: int | None = _option(None, _whole(3))
    """Nodes on the outline of a whole hole."""
    across: int | None = _option(None, _whole(2))
    """Least number of nodes across every ligament, by local refinement."""
    basis: str = _option("quadratic", _word(BASES))
    """Basis of the shape functions"""
    dmax: float | None = _option(None, POSITIVE)
    """Support radius over spacing."""
    method: str = _option("mixed", _word(METHODS))
    """One pressure per cell, or displacement only"""
    quadrature: str = _option("conforming", _word(QUADRATURES))
    """Cells along the true outline, or the paper's"""
    solver: str = _option("auto", _word(SOLVERS))
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


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """A plate, its gel and the options of a run."""

    name: str
    """Built-in name, or the case file's name without its ending."""
    plate: Plate
    """Plate with its holes."""
    gel: Gel
    """Material."""
    loads: Loads
    """Body force and tractions."""
    sweep: SweepOptions
    """Values of mu and branch."""
    discretisation: DiscretisationOptions
    """Cloud and method."""
    output: OutputOptions
    """Files to write."""
    source: dict
    """The ``plate``, ``holes`` and ``moved`` sections that it was made from, and ``gel`` where that names an energy."""

    def model(self, cloud=None):
        """The discretised plate; ValueError for edges, a cloud or a support that the case does not allow.

        A plate whose holes have moved gets the cloud that it had before, placed, where that is good enough (see `placement.refreshed`)
        and a new one where it is not; ``cloud`` is that former one where it was made already.
        """
        check_edges(self.plate)
        check_room(self.plate)
        d = self.discretisation
        own = dict(spacing=d.spacing, nodes_per_hole=d.nodes_per_hole, across=d.across)
        cloud = make_cloud(self.plate.reference or self.plate, **own) if cloud is None else cloud
        if self.plate.reference is not None and d.quadrature == "paper":  # which cannot follow
            cloud = make_cloud(dataclasses.replace(self.plate, reference=None), **own)
        elif self.plate.reference is not None:
            check_plate(self.plate)
            cloud, _ = refreshed(cloud, self.plate, basis=d.basis, dmax=d.dmax)
        return discretise(cloud, basis=d.basis, dmax=d.dmax, method=d.method, quadrature=d.quadrature, solver=d.solver)

    def table(self):
        """The case as a table that `from_table` reads, with every default written out; JSON and TOML can hold it."""
        gel = self.source.get("gel", {}) | {"Nv": float(self.gel.Nv), "chi": float(self.gel.chi)}
        options = {section: _given(getattr(self, section)) for section in OPTIONS}
        return self.source | {"gel": gel} | {section: given for section, given in options.items() if given}


def load_case(case, changes=None):
    """The `Case` of a built-in name or of a TOML file; ``changes`` maps sections to entries that replace its own.

    Raises ValueError for an unknown name, a file that cannot be read or is not TOML, and every wrong entry.

    >>> load_case("sample-1", {"sweep": {"steps": 3}}).sweep.values
    [-4.9678, -2.9428, -0.9178]
    """
    table, name, folder = _read(case)
    for section, entries in (changes or {}).items():
        old = table.get(section, {})
        table[section] = (old if isinstance(old, dict) else {}) | entries
    return from_table(table, name, folder)


def from_table(table, name, folder="."):
    """The `Case` of a table as described at the top of this module; ValueError names the section and key of a wrong entry.

    A module that the table names is looked for in ``folder``, in the working folder and where Python looks for modules.
    """
    _known("case file", table, SECTIONS)
    plate_table, holes = _section(table, "plate"), table.get("holes", [])
    plate = _sample(plate_table, holes) if "sample" in plate_table else _plate(plate_table, holes, name)
    moved = table.get("moved", [])
    plate = _moved(plate, moved) if moved else plate
    gel_table = _section(table, "gel")
    gel = _gel(gel_table, plate.gel or Gel(), folder)
    options = {section: _options(kind, section, _section(table, section)) for section, kind in OPTIONS.items()}
    source = {"plate": plate_table} | {name: value for name, value in (("holes", holes), ("moved", moved)) if value}
    return Case(name, plate, gel, source=source | ({"gel": gel_table} if "energy" in gel_table else {}), **options)


def _read(case):
    """The table of a case, its name and its folder."""
    file = File(case)
    if file.suffix != ".toml" and not file.is_file():
        sample(case)  # raises for an unknown name
        return {"plate": {"sample": case}}, case, "."
    return _with_outlines(read_toml(file, "case"), file.parent), file.stem, file.parent


def _with_outlines(table, folder):
    """The table with the numbers of the holes that it has from drawings in place of their files, so that it needs no other file."""
    holes = table.get("holes")
    if not isinstance(holes, list) or not any(isinstance(hole, dict) and hole.get("kind") == "outline" for hole in holes):
        return table
    from .outline_files import hole_table

    drawn = [isinstance(hole, dict) and hole.get("kind") == "outline" for hole in holes]
    return table | {"holes": [hole_table(h, folder, f"holes[{i}]") if d else h for i, (h, d) in enumerate(zip(holes, drawn, strict=True))]}


def _section(table, name):
    section = table.get(name, {})
    if not isinstance(section, dict):
        raise ValueError(f"{name}: {section!r} is not a section; write [{name}]")
    return section


def _known(where, table, known):
    for key in table:
        if key not in known:
            raise ValueError(f"{where}: unknown entry {key!r}; {did_you_mean(key, known)}")


def _sample(table, holes):
    _known("plate", table, ("sample",))
    if holes:
        raise ValueError(f"holes: plate.sample = {table['sample']!r} has its own; drop one of the two")
    return sample(str(table["sample"]))


def _plate(table, holes, name):
    _known("plate", table, ("sample", *PLATE))
    for key in ("width", "height"):
        if key not in table:
            raise ValueError(f"plate: {key} is missing; give width and height in mm, or sample = a built-in name")
    if not isinstance(holes, list) or not all(isinstance(h, dict) for h in holes):
        raise ValueError("holes: not a list of sections; write [[holes]] above each hole")
    for key in PLATE.keys() & table.keys():
        _accepted("plate", key, table[key], PLATE[key])
    if not isinstance(table.get("edges", ""), str | dict):
        raise ValueError(f'plate.edges: {table["edges"]!r} is neither a condition nor a table such as {{ top = "free" }}')
    return Plate(**table, holes=[_hole(i, hole) for i, hole in enumerate(holes)], name=name)


def _gel(table, default, folder):
    own = "energy" in table
    _known("gel", table, ("Nv", "chi", "energy", *(table if own else ())))
    numbers = {"Nv": default.Nv, "chi": default.chi} | {key: value for key, value in table.items() if key != "energy"}
    numbers = {key: _number("gel", key, value) for key, value in numbers.items()}
    gel = user_gel(table["energy"], numbers, folder) if own else Gel(**numbers)
    check_gel(gel)
    return gel


def _hole(i, table):
    kind = str(table.get("kind"))
    if kind == "outline":
        raise ValueError(f"holes[{i}].kind: 'outline' belongs in a case file; name that file by case = instead of repeating its holes")
    if kind not in HOLES:
        raise ValueError(f"holes[{i}].kind: {kind!r} is unknown; {did_you_mean(kind, HOLES)}")
    fields = {f.name: f for f in dataclasses.fields(HOLES[kind])}
    entries = {key: value for key, value in table.items() if key != "kind"}
    _known(f"holes[{i}], kind {kind!r}", entries, tuple(fields))
    for key, field in fields.items():
        if key not in entries and field.default is dataclasses.MISSING:
            raise ValueError(f"holes[{i}], kind {kind!r}: {key} is missing (accepted: {', '.join(fields)})")
    try:
        return HOLES[kind](**entries)
    except ValueError as problem:
        raise ValueError(f"holes[{i}]: {problem}") from None


def _moved(plate, table):
    if not isinstance(table, list) or not all(isinstance(theta, dict) for theta in table):
        raise ValueError("moved: not a list of sections; write [[moved]] above the parameters of each hole")
    try:
        return plate.at([{name: np.asarray(value, dtype=float) for name, value in theta.items()} for theta in table])
    except (ValueError, TypeError) as problem:
        raise ValueError(f"moved: {problem}") from None


def _options(kind, section, table):
    _known(section, table, tuple(f.name for f in dataclasses.fields(kind)))
    return kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in table.items()})


def _given(options):
    return {key: list(v) if isinstance(v, tuple) else v for key, v in dataclasses.asdict(options).items() if v not in (None, {})}


def _check(section, options):
    """Raise ValueError, naming section and key, for a value that its field does not accept."""
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if value is not None or field.default is not None:
            _accepted(section, field.name, value, field.metadata["schema"])


def _accepted(section, key, value, rule):
    """Raise ValueError unless ``value`` is what the piece of JSON schema asks for; alternatives and long lists are checked elsewhere."""
    if "enum" in rule:
        _choice(section, key, value, rule["enum"])
    elif rule.get("type") == "number":
        _number(section, key, value, above=rule.get("exclusiveMinimum", -math.inf))
    elif rule.get("type") == "integer" and (type(value) is not int or value < rule["minimum"]):
        raise ValueError(f"{section}.{key}: {value!r} is not a whole number of at least {rule['minimum']}")
    elif "maxItems" in rule:
        if not isinstance(value, list) or len(value) != rule["maxItems"]:
            raise ValueError(f"{section}.{key}: {value!r} is not a list of {rule['maxItems']} numbers")
        for item in value:
            _number(section, key, item)
    elif rule.get("type") in ("boolean", "string") and type(value) is not {"boolean": bool, "string": str}[rule["type"]]:
        raise ValueError(f"{section}.{key}: {value!r} is not {'true or false' if rule['type'] == 'boolean' else 'a text'}")


def _number(section, key, value, above=-math.inf):
    known = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < math.inf
    if not known or value <= above or value > sys.float_info.max:
        wanted = "finite number" + (f" above {above:g}" if above > -math.inf else "")
        raise ValueError(f"{section}.{key}: {value!r} is not a {wanted}")
    return float(value)


def _choice(section, key, value, known):
    if value not in known:
        raise ValueError(f"{section}.{key}: {value!r} is unknown; {did_you_mean(value, known)}")
