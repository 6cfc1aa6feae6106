"""Uncertain inputs of a case: the section ``uncertainty``, standard deviations to first order, and samples that check them.

An entry is a number of the gel or a parameter of the holes, of all of them, each with an error of its own, or of one, as
"holes[1].semi_axes". Its value is the standard deviation of independent normal errors, a number in the parameter's unit or "5 %" of it.
"""

import dataclasses
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from .._types import Float
from .._validation import did_you_mean, is_number
from ..bifurcation import problem_by_options, sweep_by_options
from ..observables import CURVES, OF_EQUILIBRIA
from ..verification import Uncertainty, uncertainty
from .case import Case
from .parameter_map import MapStudy, map_from_table
from .parameters import GEL, gel_of, parameter, plate_of, sobol

QUANTITIES = ("rotation", "core_rotation", "area_reduction")
"""Quantities that get a standard deviation unless others are asked for."""
ONE_HOLE = re.compile(r"holes\[(\d+)\]\.(\w+)")


@dataclasses.dataclass(frozen=True, eq=False)
class UncertainInput:
    """One input with independent errors in its components."""

    parameter: dict
    """The dict of `parameters.parameter`."""
    deviation: Float[np.ndarray, "..."]
    """Standard deviation of every component, in the parameter's unit."""


def uncertain_inputs(case: Case, entries: dict[str, Any] | None = None) -> list[UncertainInput]:
    """The uncertain inputs of a case, by its section ``uncertainty`` or other ``entries`` in its place; ValueError for a wrong one."""
    entries = case.uncertainty if entries is None else entries
    if not entries:
        raise ValueError("uncertainty: is missing; give the standard deviation of an input, as Nv = '5 %' or semi_axes = 0.1")
    found: dict[str, UncertainInput] = {}
    for key, value in entries.items():
        one = ONE_HOLE.fullmatch(key)
        of, where = (one[2], int(one[1])) if one else (key, None)
        chosen = [{"of": of, "name": key}]
        if of not in GEL:
            known = [k for k, hole in enumerate(case.plate.holes) if ("angle" if of == "angle_deg" else of) in hole.theta]
            if where is not None and where not in known:
                raise ValueError(f"uncertainty: {key!r} is unknown; {did_you_mean(key, [f'holes[{k}].{of}' for k in known] or [*GEL])}")
            chosen = [{"of": of, "name": f"holes[{k}].{of}", "holes": [k]} for k in (known if where is None else [where])] or chosen
        for entry in chosen:
            made = parameter(f"uncertainty.{key}", entry, case)
            if made["name"] in found:
                raise ValueError(f"uncertainty: {made['name']} is given twice; keep one of the two")
            found[made["name"]] = UncertainInput(made, _deviation(f"uncertainty.{key}", value, made["own"]))
    return list(found.values())


def _deviation(where, value, own):
    """Standard deviation of the components of a parameter with its ``own`` values."""
    share = str(value).strip().removesuffix("%").strip() if str(value).strip().endswith("%") else None
    word = str(value) if share is None else share
    if isinstance(value, bool) or not is_number(word) or not 0 < float(word) < np.inf:
        raise ValueError(f"{where}: {value!r} is not a positive number, nor a share as '5 %'")
    own = np.asarray(own, dtype=float)
    return np.full(own.shape, float(word)) if share is None else np.abs(own) * float(word) / 100


def uncertainty_of(case: Case, inputs: list[UncertainInput], quantities: Sequence[str] = QUANTITIES) -> Uncertainty:
    """`verification.uncertainty` of quantities, in the units that studies use, at the last state of a case's sweep.

    ValueError for a case that swells in time, a sweep with an imperfection, and a quantity without derivative or without value.
    """
    case.check_equilibrium("uncertainty")
    for name in quantities:
        if name not in CURVES or name in OF_EQUILIBRIA:
            raise ValueError(f"quantities: {name!r} has no derivative here; {did_you_mean(name, CURVES)}")
    if case.sweep.imperfection:
        raise ValueError(
            f"sweep.imperfection: {case.sweep.imperfection:g} is not accepted here, as its load has no derivative; set it to 0"
        )
    parameters = [one.parameter for one in inputs]
    plate, gel, cloud = plate_of(case.plate, parameters), gel_of(case.gel, parameters), case.cloud()

    def numbers(values):
        model = case.discretisation.model(cloud.at(plate(values)))
        problem = problem_by_options(model, gel(values) if callable(gel) else gel, case.sweep, loads=case.loads.of(model))
        last = sweep_by_options(problem, case.sweep)[-1:]
        return {name: CURVES[name](last)[0] for name in quantities}

    own = {one.parameter["name"]: one.parameter["own"] for one in inputs}
    found = uncertainty(numbers, own, {one.parameter["name"]: one.deviation for one in inputs})
    missing = [name for name, value in zip(found.names, found.values, strict=True) if not np.isfinite(value)]
    if missing:
        raise ValueError(f"quantities: {missing[0]!r} has no value at the last state of this case; give others")
    return found


def uncertain_samples(case: Case, inputs: list[UncertainInput], number: int, *, seed: int = 0) -> MapStudy:
    """A `MapStudy` whose points are ``number`` samples of normally distributed inputs, from a scrambled Sobol sequence."""
    from scipy.special import ndtri

    sizes = [np.size(one.deviation) for one in inputs]
    errors = ndtri(np.clip(sobol(sum(sizes), number, seed), 1e-9, 1 - 1e-9))
    points = []
    for sample in errors:
        parts = np.split(sample, np.cumsum(sizes)[:-1])
        errors_of = zip(inputs, parts, strict=True)
        points.append(
            {
                one.parameter["name"]: (one.parameter["own"] + one.deviation * np.reshape(p, np.shape(one.deviation))).tolist()
                for one, p in errors_of
            }
        )
    varied = [_entry(one) for one in inputs]
    table = {"map": {"samples": "sobol", "points": number, "seed": seed}, "parameters": varied} | case.table()
    return map_from_table(table, f"{case.name}-samples", points)


def _entry(one):
    """An entry of a map's ``parameters`` that spans four standard deviations either way."""
    made = one.parameter
    ends = {key: (made["own"] + sign * 4 * one.deviation).tolist() for key, sign in (("lower", -1), ("upper", 1))}
    holes = {"holes": made["holes"]} if made["holes"] else {}
    return {"of": "angle_deg" if made["degrees"] else made["of"], "name": made["name"]} | holes | ends


def sampled_deviations(rows: list[dict[str, Any]], columns: dict[str, str]) -> dict[str, tuple[float, float, int]]:
    """Mean, standard deviation and number of samples of quantities (name -> column) over the rows of points.csv that are complete."""
    complete = [row for row in rows if row["status"] == "complete"]
    values = {name: np.array([row[column] for row in complete if row[column] is not None]) for name, column in columns.items()}
    return {name: (float(v.mean()), float(v.std(ddof=1)), len(v)) if len(v) > 1 else (np.nan, np.nan, len(v)) for name, v in values.items()}
