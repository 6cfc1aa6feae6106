"""A parameter map: which points in the space of a case's parameters are swept.

Besides the sections of a case (see `cases`), or ``case`` = a built-in name or the path of a case file, a map's TOML file has

    [[parameters]]   of (a parameter of the holes, angle_deg, Nv, chi or mu_end); optional: name, holes, link, see `parameters`; and its
                     values: lower and upper, with number for a grid, or values = [list] for a grid
    [map]            samples = "grid" (every combination, the last parameter varies first) or "sobol"; points, a number, and seed (0)
                     for "sobol"
"""

import dataclasses
import itertools
from pathlib import Path as File

import numpy as np

from .._validation import listed, tabled, whole, word
from ..io import one_line, read_record
from ..materials import check_gel
from .case import Case
from .parameters import FIELDS, PARAMETER, VALUE, all_different, gel_of, numbers, parameter, plate_of, sobol, study_case, study_table

SAMPLES = ("grid", "sobol")
BOUNDS, VALUES = PARAMETER | {"lower": VALUE, "upper": VALUE}, {"values": listed({}, least=1)}
NUMBER = {"number": whole(2) | {"$comment": "a grid takes it with lower and upper, or values = [list] instead"}}
GRID = {
    "type": "object",
    "if": {"required": ["values"]},
    "then": tabled(PARAMETER | VALUES, ["of"]),
    "else": tabled(BOUNDS | NUMBER | VALUES, ["of", "number", "lower", "upper"]),
}
SOBOL = tabled({"samples": word(SAMPLES), "points": whole(1), "seed": whole(0, None)}, ["points"])
MAP = "map.json"
FORMAT = 2  # of map.json and point.json


@dataclasses.dataclass(frozen=True, eq=False)
class MapStudy:
    """The points of a parameter map."""

    name: str
    """The file's name without its ending."""
    case: Case
    """The case whose parameters are varied."""
    parameters: list
    """Dicts of `parameters.parameter`, what is varied."""
    points: list
    """Dicts, name of a parameter -> its value, a number or a list of them."""
    table: dict
    """The study as a table that `map_from_table` reads; JSON can hold it."""

    def at(self, values: dict) -> Case:
        """The `Case` of a point; ValueError for a gel or mu that cannot be used."""
        values = {name: np.asarray(value, dtype=float) for name, value in values.items()}
        case, source = self.case, self.case.source
        plate = case.plate
        if any(p["holes"] for p in self.parameters):
            plate = plate_of(plate, self.parameters)(values)
            source = source | {"moved": [{key: np.asarray(v).tolist() for key, v in hole.theta.items()} for hole in plate.holes]}
        gel = gel_of(case.gel, self.parameters)
        gel = gel({name: float(value) for name, value in values.items() if value.ndim == 0}) if callable(gel) else gel
        check_gel(gel)
        ends = [float(values[p["name"]]) for p in self.parameters if p["of"] == "mu_end"]
        options = dataclasses.replace(case.sweep, mu_end=ends[0]) if ends else case.sweep
        return dataclasses.replace(case, plate=plate, source=source, gel=gel, sweep=options)


def load_map(file: File | str) -> MapStudy:
    """The `MapStudy` of a TOML file; ValueError, one line, for a file that cannot be read and for every wrong entry."""
    return map_from_table(*study_table(file))


def resumed_map(folder: File | str) -> MapStudy:
    """The `MapStudy` whose map.json lies in a folder; ValueError where there is none or it is damaged."""
    file = File(folder) / MAP
    record = read_record(file, FORMAT) or {}
    try:
        study = map_from_table(record["study"], str(record["name"]))
        return dataclasses.replace(study, points=list(record["points"]))
    except (ValueError, KeyError, TypeError, AttributeError) as problem:
        raise ValueError(f"folder: {str(file)!r} is missing, damaged or not of this version of jaxgel: {one_line(problem)}") from None


def map_from_table(table: dict, name: str) -> MapStudy:
    """The `MapStudy` of a table as described at the top of this module; ValueError names the section and key of a wrong entry."""
    for i, entry in enumerate(table["parameters"]) if isinstance(table.get("parameters"), list) else ():
        if isinstance(entry, dict) and entry.get("of") in [*FIELDS]:
            raise ValueError(f"parameters[{i}].of: {entry['of']!r} is not accepted in a map, which varies numbers; a design study takes it")
    sobol = isinstance(table.get("map"), dict) and table["map"].get("samples") == "sobol"
    parameter_rule = tabled(BOUNDS | NUMBER | VALUES, ["of"]) if sobol else GRID
    sections = {"map": SOBOL if sobol else tabled({"samples": word(SAMPLES)}), "parameters": listed(parameter_rule, least=1)}
    case = study_case(table, name, sections)
    own = {"mu_end": case.sweep.mu_end} if case.sweep.control == "mu" and case.sweep.mu is None else {}
    varied = table["parameters"]
    parameters = all_different([parameter(f"parameters[{i}]", entry, case, own) for i, entry in enumerate(varied)])
    options = {"samples": "grid"} | ({"seed": 0} if sobol else {}) | table.get("map", {})
    if not sobol:
        axes = [_axis(f"parameters[{i}]", entry, p) for i, (entry, p) in enumerate(zip(varied, parameters, strict=True))]
        points = [{p["name"]: value for p, value in zip(parameters, point, strict=True)} for point in itertools.product(*axes)]
    else:
        points = _sobol(varied, parameters, options)
    table = {"map": options, "parameters": varied} | case.table()
    return MapStudy(name, case, parameters, points, table)


def _axis(where, entry, p):
    """Values of a parameter on a grid, as lists or numbers."""
    shape = np.shape(p["own"])
    if "values" in entry:
        return [numbers(f"{where}.values", value, shape).tolist() for value in entry["values"]]
    return np.linspace(*_bounds(where, entry, shape), entry["number"]).tolist()


def _sobol(varied, parameters, options):
    """Points of a scrambled Sobol sequence between the bounds, one dimension for each component of a parameter."""
    for i, entry in enumerate(varied):
        if "number" in entry or "values" in entry or not entry.keys() >= {"lower", "upper"}:
            raise ValueError(f"parameters[{i}]: number and values belong to a grid; Sobol samples take lower and upper")
    bounds = [_bounds(f"parameters[{i}]", e, np.shape(p["own"])) for i, (e, p) in enumerate(zip(varied, parameters, strict=True))]
    lower, upper = (np.concatenate([np.ravel(side) for side in sides]) for sides in zip(*bounds, strict=True))
    samples = lower + (upper - lower) * sobol(len(lower), options["points"], options["seed"])
    cuts = np.cumsum([np.size(p["own"]) for p in parameters])[:-1]
    return [
        {p["name"]: part.reshape(np.shape(p["own"])).tolist() for p, part in zip(parameters, np.split(sample, cuts), strict=True)}
        for sample in samples
    ]


def _bounds(where, entry, shape):
    lower, upper = (numbers(f"{where}.{key}", entry[key], shape) for key in ("lower", "upper"))
    if not np.all(lower <= upper):
        raise ValueError(f"{where}.upper: {entry['upper']!r} is not above lower = {entry['lower']!r}")
    return lower, upper
