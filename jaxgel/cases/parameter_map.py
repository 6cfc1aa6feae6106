"""Parameter maps: grids and samples of points in the space of a case's parameters.

Besides the sections of a case (see `cases`), or ``case`` = a built-in name or the path of a case
file, a map's TOML file has

    [[parameters]]   of (a parameter of the holes, angle_deg, Nv, chi or mu_end); optional: name,
                     holes, link, see `parameters`; and its values: lower and upper, with number for
                     a grid, or values = [list] for a grid
    [map]            samples = "grid" (every combination, the last parameter varies first), "sobol"
                     or "file"; points, a number, and seed (0) for "sobol"; points = "samples.csv"
                     for "file", a table with a column for each component of a parameter (see
                     `components`) and a row for each point, see `salib`; gradients = true for the
                     derivatives of ``RESPONSES`` (see `response`) with respect to every component,
                     columns of points.csv
"""

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path as File

import numpy as np

from .._types import Float
from .._validation import FLAG, TEXT, listed, tabled, whole, word
from ..io import one_line, read_record
from ..materials import check_gel
from .case import Case
from .parameters import (
    FIELDS,
    MOST_COLUMNS,
    PARAMETER,
    VALUE,
    all_different,
    components,
    gel_of,
    numbers,
    parameter,
    plate_of,
    sobol,
    study_case,
    study_table,
)
from .salib import check_bounds, read_samples

SAMPLES = ("grid", "sobol", "file")
BOUNDS, VALUES = PARAMETER | {"lower": VALUE, "upper": VALUE}, {"values": listed({}, least=1)}
NUMBER = {
    "number": whole(2)
    | {"$comment": "a grid takes it with lower and upper, or values = [list] instead"}
}
GRID = {
    "type": "object",
    "if": {"required": ["values"]},
    "then": tabled(PARAMETER | VALUES, ["of"]),
    "else": tabled(BOUNDS | NUMBER | VALUES, ["of", "number", "lower", "upper"]),
}
OPTIONS = {"samples": word(SAMPLES), "gradients": FLAG}
MAPS = {
    "grid": tabled(OPTIONS),
    "sobol": tabled(OPTIONS | {"points": whole(1), "seed": whole(0, None)}, ["points"]),
    "file": tabled(
        OPTIONS
        | {"points": TEXT | {"$comment": "it names a CSV file with a column for each parameter"}},
        ["points"],
    ),
}  # samples -> rule of the section [map]
MAP = "map.json"
Vector = Sequence[float] | Float[np.ndarray, " d"]
FORMAT = 2  # of map.json and point.json


@dataclasses.dataclass(frozen=True, eq=False)
class MapStudy:
    """The points of a parameter map."""

    name: str
    """The file's name without its ending."""
    case: Case
    """The case whose parameters are varied."""
    parameters: list
    """Dicts of `parameters.parameter` with bounds ``lower`` and ``upper``, arrays."""
    points: list
    """Dicts, name of a parameter -> its value, a number or a list of them."""
    table: dict
    """The study as a table that `map_from_table` reads; JSON can hold it."""

    @property
    def names(self) -> list[str]:
        """Names (d) of the components of all parameters, as in points.csv."""
        return list(components({p["name"]: p["own"] for p in self.parameters}))

    @property
    def bounds(self) -> Float[np.ndarray, "d 2"]:
        """Lower and upper bound (d, 2) of every component."""
        ends = [
            components({p["name"]: p[end] for p in self.parameters}) for end in ("lower", "upper")
        ]
        return np.column_stack([list(end.values()) for end in ends])

    @property
    def gradients(self) -> bool:
        """Whether points.csv has derivatives."""
        return self.table["map"].get("gradients", False)

    def check_components(self) -> None:
        """ValueError, one line, for a parameter of more components than a table shows."""
        for p in self.parameters:
            if np.size(p["own"]) > MOST_COLUMNS:
                text = (
                    f"its {np.size(p['own'])} components are not accepted for samples of a file, "
                    "gradients and jaxgel serve"
                )
                raise ValueError(f"parameters: {p['name']}: {text}; give at most {MOST_COLUMNS}")

    def point(self, vector: Vector) -> dict:
        """The point with these components (d,).

        ValueError, one line, for one that is not finite or out of its bounds.
        """
        vector = np.asarray(vector, dtype=float)
        check_bounds("", self.names, vector, self.bounds)
        return _points(self.parameters, vector[None])[0]

    def at(self, values: dict) -> Case:
        """The `Case` of a point; ValueError for a gel or mu that cannot be used."""
        values = {name: np.asarray(value, dtype=float) for name, value in values.items()}
        case, source = self.case, self.case.source
        plate = case.plate
        if any(p["holes"] for p in self.parameters):
            plate = plate_of(plate, self.parameters)(values)
            source = source | {
                "moved": [
                    {key: np.asarray(v).tolist() for key, v in hole.theta.items()}
                    for hole in plate.holes
                ]
            }
        gel = gel_of(case.gel, self.parameters)
        gel = (
            gel({name: float(value) for name, value in values.items() if value.ndim == 0})
            if callable(gel)
            else gel
        )
        check_gel(gel)
        ends = [float(values[p["name"]]) for p in self.parameters if p["of"] == "mu_end"]
        options = dataclasses.replace(case.sweep, mu_end=ends[0]) if ends else case.sweep
        return dataclasses.replace(case, plate=plate, source=source, gel=gel, sweep=options)


def load_map(file: File | str) -> MapStudy:
    """The `MapStudy` of a TOML file.

    ValueError, one line, for a file that cannot be read and for every wrong entry.
    """
    return map_from_table(*study_table(file))


def load_parameters(file: File | str) -> MapStudy:
    """The `MapStudy` of a TOML file without points: parameters and their bounds.

    Its section [map] may be missing.
    """
    table, name = study_table(file)
    entries = table["parameters"] if isinstance(table.get("parameters"), list) else []
    bounded = not any(
        isinstance(entry, dict) and entry.keys() & {"number", "values"} for entry in entries
    )
    return map_from_table(
        ({"map": {"samples": "sobol", "points": 1}} if bounded else {}) | table, name, []
    )


def resumed_map(folder: File | str) -> MapStudy:
    """The `MapStudy` whose map.json lies in a folder.

    ValueError if there is none or it is damaged.
    """
    file = File(folder) / MAP
    record = read_record(file, FORMAT) or {}
    try:
        return map_from_table(record["study"], str(record["name"]), list(record["points"]))
    except (ValueError, KeyError, TypeError, AttributeError) as problem:
        raise ValueError(
            f"folder: {str(file)!r} is missing, damaged or not of this version of jaxgel: "
            f"{one_line(problem)}"
        ) from None


def map_from_table(table: dict, name: str, points: list[dict] | None = None) -> MapStudy:
    """The `MapStudy` of a table as described at the top of this module.

    ValueError names the section and key of a wrong entry. ``points``, if given, are those of the
    study in place of the table's, whose file is then not read.
    """
    for i, entry in (
        enumerate(table["parameters"]) if isinstance(table.get("parameters"), list) else ()
    ):
        if isinstance(entry, dict) and entry.get("of") in [*FIELDS]:
            raise ValueError(
                f"parameters[{i}].of: {entry['of']!r} is not accepted in a map, which varies "
                "numbers; a design study takes it"
            )
    samples = table["map"].get("samples") if isinstance(table.get("map"), dict) else None
    samples = samples if samples in SAMPLES else "grid"
    parameter_rule = GRID if samples == "grid" else tabled(BOUNDS | NUMBER | VALUES, ["of"])
    case = study_case(
        table, name, {"map": MAPS[samples], "parameters": listed(parameter_rule, least=1)}
    )
    own = (
        {"mu_end": case.sweep.mu_end}
        if case.sweep.control == "mu" and case.sweep.mu is None
        else {}
    )
    varied = table["parameters"]
    parameters = all_different(
        [parameter(f"parameters[{i}]", entry, case, own) for i, entry in enumerate(varied)]
    )
    options = (
        {"samples": "grid"} | ({"seed": 0} if samples == "sobol" else {}) | table.get("map", {})
    )
    if options.get("gradients") and case.sweep.imperfection:
        size = f"sweep.imperfection = {case.sweep.imperfection:g}"
        raise ValueError(
            f"map.gradients: True is not accepted with {size}, whose load has no derivative; "
            "leave one of the two out"
        )
    axes = [
        _axis(f"parameters[{i}]", entry, p, samples)
        for i, (entry, p) in enumerate(zip(varied, parameters, strict=True))
    ]
    ends = [{"lower": np.min(axis, axis=0), "upper": np.max(axis, axis=0)} for axis in axes]
    parameters = [p | bounds for p, bounds in zip(parameters, ends, strict=True)]
    file = options["points"] if samples == "file" else ""
    options |= {"points": File(file).name} if file else {}
    study = MapStudy(
        name, case, parameters, points or [], {"map": options, "parameters": varied} | case.table()
    )
    if samples == "file" or study.gradients:
        study.check_components()
    if points is not None:
        return study
    if samples == "grid":
        names = [p["name"] for p in parameters]
        return dataclasses.replace(
            study,
            points=[dict(zip(names, point, strict=True)) for point in itertools.product(*axes)],
        )
    if samples == "file":
        matrix = read_samples(file, study.names, study.bounds)
    else:
        lower, upper = (
            np.concatenate([np.ravel(p[end]) for p in parameters]) for end in ("lower", "upper")
        )
        matrix = lower + (upper - lower) * sobol(len(lower), options["points"], options["seed"])
    return dataclasses.replace(study, points=_points(parameters, matrix))


def _axis(where, entry, p, samples):
    """Values of a parameter on a grid, as lists or numbers.

    Its lower and upper bound for other samples.
    """
    shape = np.shape(p["own"])
    if samples != "grid" and (
        "number" in entry or "values" in entry or not entry.keys() >= {"lower", "upper"}
    ):
        kind = {"sobol": "Sobol samples", "file": "samples of a file"}[samples]
        raise ValueError(
            f"{where}: number and values belong to a grid; {kind} take lower and upper"
        )
    if "values" in entry:
        return [numbers(f"{where}.values", value, shape).tolist() for value in entry["values"]]
    lower, upper = (numbers(f"{where}.{key}", entry[key], shape) for key in ("lower", "upper"))
    if not np.all(lower <= upper):
        raise ValueError(
            f"{where}.upper: {entry['upper']!r} is not above lower = {entry['lower']!r}"
        )
    return np.linspace(lower, upper, entry.get("number", 2)).tolist()


def _points(parameters, matrix):
    """Points of a matrix (p, d) with a column for each component of a parameter."""
    cuts = np.cumsum([np.size(p["own"]) for p in parameters])[:-1]
    return [
        {
            p["name"]: part.reshape(np.shape(p["own"])).tolist()
            for p, part in zip(parameters, np.split(row, cuts), strict=True)
        }
        for row in matrix
    ]
