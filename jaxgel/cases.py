"""A case: what one run needs to know, from a built-in name, a TOML file, or the table stored with a run.

A table has the sections of a case file, all but ``plate`` optional:

    [plate]            sample = "sample-1", or width, height (mm), edges = {left = "roller", ...}, deformation = [[1.1, 0.0], [0.0, 1.0]]
                       (of held and periodic edges) and displacement = {top = [0.0, 0.5], ...} (mm, of held edges)
    [[holes]]          kind = "ellipse" and the hole's own parameters; as many as there are holes, none with a sample
    [gel]              Nv, chi
    [loads]            body_force = [x, y] (kT/v per mm), traction = {top = [x, y], ...} (kT/v)
    [sweep]            mu_start, mu_end, steps ("auto" or a number), or mu = [increasing list]; branch, imperfection, contact
    [discretisation]   spacing (mm), nodes_per_hole, across, basis, dmax, method, quadrature
"""

import dataclasses
import math
import tomllib
from pathlib import Path as File

import numpy as np

from . import holes
from .cloud import make_cloud
from .discretisation import discretise
from .geometry import Plate, did_you_mean
from .loads import Loads
from .material import Gel, check_gel
from .samples import sample
from .sweep import BRANCHES, CONTACT, check_mu

HOLES = {
    kind.__name__.lower(): kind for kind in (holes.Circle, holes.Ellipse, holes.Rectangle, holes.Superellipse, holes.Fourier, holes.Polygon)
}
SECTIONS = ("plate", "holes", "gel", "loads", "sweep", "discretisation")
BASES = ("linear", "quadratic")
METHODS = ("mixed", "displacement")
QUADRATURES = ("conforming", "paper")


@dataclasses.dataclass(frozen=True)
class SweepOptions:
    """The values of mu, in kT, and the branch to follow."""

    mu_start: float = -4.9678
    """First value."""
    mu_end: float = -0.9178
    """Last value."""
    steps: str | int = 40
    """"auto", or the number of equally spaced values with both ends included."""
    mu: tuple | None = None
    """The values themselves, increasing; then the three above are not used."""
    branch: str = "stable"
    """"stable" or "symmetric"."""
    imperfection: float = 0.0
    """Size of the load along the first bifurcation's mode, see `branches.imperfection`; 0 for none."""
    contact: str = "on"
    """Where hole boundaries meet: "on" keeps them apart, "off" lets them overlap, "stop" ends the sweep."""

    def __post_init__(self):
        for name in ("mu_start", "mu_end", "imperfection"):
            _number("sweep", name, getattr(self, name))
        if self.steps != "auto" and (type(self.steps) is not int or self.steps < 2):
            raise ValueError(f"sweep.steps: {self.steps!r} is neither 'auto' nor a whole number of at least 2")
        if self.mu is not None and not isinstance(self.mu, tuple):
            raise ValueError(f"sweep.mu: {self.mu!r} is not a list of numbers")
        for value in self.mu or ():
            _number("sweep", "mu", value)
        check_mu(self.values)
        _choice("sweep", "branch", self.branch, BRANCHES)
        _choice("sweep", "contact", self.contact, CONTACT)

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

    spacing: float | None = None
    """Distance of the background nodes, mm."""
    nodes_per_hole: int | None = None
    """Nodes on the outline of a whole hole."""
    across: int | None = None
    """Least number of nodes across every ligament, by local refinement."""
    basis: str = "quadratic"
    """"linear" or "quadratic"."""
    dmax: float | None = None
    """Support radius over spacing."""
    method: str = "mixed"
    """"mixed" or "displacement"."""
    quadrature: str = "conforming"
    """"conforming" or "paper"."""

    def __post_init__(self):
        _choice("discretisation", "basis", self.basis, BASES)
        _choice("discretisation", "method", self.method, METHODS)
        _choice("discretisation", "quadrature", self.quadrature, QUADRATURES)
        for name in ("spacing", "dmax"):
            if getattr(self, name) is not None:
                _number("discretisation", name, getattr(self, name), above=0.0)
        for name, least in {"nodes_per_hole": 3, "across": 2}.items():
            value = getattr(self, name)
            if value is not None and (type(value) is not int or value < least):
                raise ValueError(f"discretisation.{name}: {value!r} is not a whole number of at least {least}")


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
    source: dict
    """The ``plate`` and ``holes`` sections that it was made from."""

    def model(self):
        """The discretised plate; ValueError for a cloud or support that the case does not allow."""
        d = self.discretisation
        cloud = make_cloud(self.plate, spacing=d.spacing, nodes_per_hole=d.nodes_per_hole, across=d.across)
        return discretise(cloud, basis=d.basis, dmax=d.dmax, method=d.method, quadrature=d.quadrature)

    def table(self):
        """The case as a table that `from_table` reads, with every default written out; JSON and TOML can hold it."""
        sections = {"gel": {"Nv": float(self.gel.Nv), "chi": float(self.gel.chi)}}
        sections |= {"loads": _given(self.loads)} if self.loads != Loads() else {}
        sections["sweep"] = _given(self.sweep)
        sections["discretisation"] = _given(self.discretisation)
        return self.source | sections


def load_case(case, changes=None):
    """The `Case` of a built-in name or of a TOML file; ``changes`` maps sections to entries that replace its own.

    Raises ValueError for an unknown name, a file that cannot be read or is not TOML, and every wrong entry.

    >>> load_case("sample-1", {"sweep": {"steps": 3}}).sweep.values
    [-4.9678, -2.9428, -0.9178]
    """
    table, name = _read(case)
    for section, entries in (changes or {}).items():
        old = table.get(section, {})
        table[section] = (old if isinstance(old, dict) else {}) | entries
    return from_table(table, name)


def from_table(table, name):
    """The `Case` of a table as described at the top of this module; ValueError names the section and key of a wrong entry."""
    _known("case file", table, SECTIONS)
    plate_table, holes = _section(table, "plate"), table.get("holes", [])
    plate = _sample(plate_table, holes) if "sample" in plate_table else _plate(plate_table, holes, name)
    gel_table = _section(table, "gel")
    _known("gel", gel_table, ("Nv", "chi"))
    defaults = {"Nv": plate.gel.Nv, "chi": plate.gel.chi} if plate.gel is not None else {"Nv": 1e-3, "chi": 1e-4}
    gel = Gel(**{key: _number("gel", key, value) for key, value in (defaults | gel_table).items()})
    check_gel(gel)
    options = [
        _options(kind, section, _section(table, section))
        for section, kind in (("loads", Loads), ("sweep", SweepOptions), ("discretisation", DiscretisationOptions))
    ]
    source = {"plate": plate_table} | ({"holes": holes} if holes else {})
    return Case(name, plate, gel, *options, source)


def _read(case):
    """The table of a case and its name."""
    file = File(case)
    if file.suffix != ".toml" and not file.is_file():
        sample(case)  # raises for an unknown name
        return {"plate": {"sample": case}}, case
    try:
        return tomllib.loads(file.read_text(encoding="utf-8")), file.stem
    except OSError as problem:
        raise ValueError(f"case: cannot read {str(file)!r}: {problem.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise ValueError(f"case: {str(file)!r} is not TOML: {problem}") from None


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
    _known("plate", table, ("sample", "width", "height", "edges", "deformation", "displacement"))
    for key in ("width", "height"):
        if key not in table:
            raise ValueError(f"plate: {key} is missing; give width and height in mm, or sample = a built-in name")
    if not isinstance(holes, list) or not all(isinstance(h, dict) for h in holes):
        raise ValueError("holes: not a list of sections; write [[holes]] above each hole")
    size = [_number("plate", key, table[key], above=0.0) for key in ("width", "height")]
    given = {key: table[key] for key in ("edges", "deformation", "displacement") if key in table}
    if not isinstance(table.get("edges", ""), str | dict):
        raise ValueError(f'plate.edges: {table["edges"]!r} is neither a condition nor a table such as {{ top = "free" }}')
    return Plate(*size, holes=[_hole(i, hole) for i, hole in enumerate(holes)], name=name, **given)


def _hole(i, table):
    kind = str(table.get("kind"))
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


def _options(kind, section, table):
    _known(section, table, tuple(f.name for f in dataclasses.fields(kind)))
    return kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in table.items()})


def _given(options):
    return {key: list(v) if isinstance(v, tuple) else v for key, v in dataclasses.asdict(options).items() if v is not None}


def _number(section, key, value, above=-math.inf):
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value <= above:
        wanted = "finite number" + (f" above {above:g}" if above > -math.inf else "")
        raise ValueError(f"{section}.{key}: {value!r} is not a {wanted}")
    return float(value)


def _choice(section, key, value, known):
    if value not in known:
        raise ValueError(f"{section}.{key}: {value!r} is unknown; {did_you_mean(value, known)}")
