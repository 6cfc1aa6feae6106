"""Uncertain inputs of a case: section ``uncertainty``, first-order deviations, and samples.

An entry is a number of the gel or a parameter of the holes, of all of them, each with an error of
its own, or of one, as "holes[1].semi_axes". Its value is the standard deviation of independent
normal errors, a number in the parameter's unit or "5 %" of it.
"""

import dataclasses
import re
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._types import Array, Float
from .._validation import did_you_mean, is_number
from ..geometry import Plate
from ..materials import AnyGel, matrix_of, with_matrix
from ..verification import Uncertainty
from .case import Case
from .parameter_map import MapStudy
from .parameters import GEL, parameter, sobol
from .response import RESPONSES, Response

SPAN, ENDS = 4.0, {"lower": -1.0, "upper": 1.0}  # standard deviations
SMALLEST = 1e-9  # of a sample of the unit interval: six standard deviations
ONE_HOLE = re.compile(r"holes\[(\d+)\]\.(\w+)")


@dataclasses.dataclass(frozen=True, eq=False)
class UncertainInput:
    """One input with independent errors in its components."""

    parameter: dict
    """The dict of `parameters.parameter`."""
    deviation: Float[np.ndarray, "..."]
    """Standard deviation of every component, in the parameter's unit."""


def uncertain_inputs(case: Case, entries: dict[str, Any] | None = None) -> list[UncertainInput]:
    """Uncertain inputs of a case, by its section ``uncertainty`` or other ``entries``.

    ValueError for a wrong one.
    """
    entries = case.uncertainty if entries is None else entries
    if not entries:
        raise ValueError(
            "uncertainty: is missing; give the standard deviation of an input, as Nv = '5 %' or "
            "semi_axes = 0.1"
        )
    found: dict[str, UncertainInput] = {}
    for key, value in entries.items():
        one = ONE_HOLE.fullmatch(key)
        of, where = (one[2], int(one[1])) if one else (key, None)
        chosen = [{"of": of, "name": key}]
        if of not in GEL:
            known = [
                k
                for k, hole in enumerate(case.plate.holes)
                if ("angle" if of == "angle_deg" else of) in hole.theta
            ]
            if where is not None and where not in known:
                raise ValueError(
                    f"uncertainty: {key!r} is unknown; "
                    f"{did_you_mean(key, [f'holes[{k}].{of}' for k in known] or [*GEL])}"
                )
            chosen = [
                {"of": of, "name": f"holes[{k}].{of}", "holes": [k]}
                for k in (known if where is None else [where])
            ] or chosen
        for entry in chosen:
            made = parameter(f"uncertainty.{key}", entry, case)
            if made["name"] in found:
                raise ValueError(f"uncertainty: {made['name']} is given twice; keep one of the two")
            found[made["name"]] = UncertainInput(
                made, _deviation(f"uncertainty.{key}", value, made["own"])
            )
    return list(found.values())


def _deviation(where, value, own):
    """Standard deviation of the components of a parameter with its ``own`` values."""
    share = (
        str(value).strip().removesuffix("%").strip() if str(value).strip().endswith("%") else None
    )
    word = str(value) if share is None else share
    if isinstance(value, bool) or not is_number(word) or not 0 < float(word) < np.inf:
        raise ValueError(f"{where}: {value!r} is not a positive number, nor a share as '5 %'")
    own = np.asarray(own, dtype=float)
    return (
        np.full(own.shape, float(word))
        if share is None
        else np.asarray(np.abs(own) * float(word) / 100)
    )


def uncertainty_of(
    case: Case, inputs: list[UncertainInput], quantities: Sequence[str] = RESPONSES
) -> Uncertainty:
    """`verification.Uncertainty` of quantities at the last state of a case's sweep.

    Units are those of `observables.QUANTITIES`. ValueError for a case that swells in time, a sweep
    with an imperfection, and a quantity without value or derivative.
    """
    case.check_equilibrium("uncertainty")
    response = Response(_study(case, inputs, []), case.cloud(), quantities)
    own = tuple(float(x) for one in inputs for x in np.ravel(one.parameter["own"]))
    path = response.path(own)
    values, slopes = response.values(path), response.jacobian(own, path)
    missing = [
        name for name, row in zip(quantities, slopes, strict=True) if not np.all(np.isfinite(row))
    ]
    if missing:
        raise ValueError(
            f"quantities: {missing[0]!r} has no derivative at the last state of this case; give "
            "others"
        )
    deviations = np.concatenate([np.ravel(one.deviation) for one in inputs])
    return Uncertainty(tuple(response.study.names), deviations, tuple(quantities), values, slopes)


def uncertain_samples(
    case: Case, inputs: list[UncertainInput], number: int, *, seed: int = 0
) -> MapStudy:
    """A `MapStudy` of ``number`` scrambled Sobol samples of normally distributed inputs."""
    points = []
    for sample in normal_samples(inputs, number, seed):
        values = [
            one.parameter["own"] + error
            for one, error in zip(inputs, _errors(inputs, sample), strict=True)
        ]
        points.append(
            {
                one.parameter["name"]: np.asarray(value).tolist()
                for one, value in zip(inputs, values, strict=True)
            }
        )
    return _study(case, inputs, points, seed)


def normal_samples(
    inputs: list[UncertainInput], number: int, seed: int = 0
) -> Float[np.ndarray, "n d"]:
    """Errors of all input components in ``number`` samples of a scrambled Sobol sequence.

    Their unit is the standard deviation.
    """
    from scipy.special import ndtri

    size = sum(np.size(one.deviation) for one in inputs)
    return ndtri(np.clip(sobol(size, number, seed), SMALLEST, 1 - SMALLEST))


def made_by(
    inputs: list[UncertainInput],
) -> Callable[[Plate, AnyGel, Float[Array, " d"]], tuple[Plate, AnyGel]]:
    """Function of plate, gel and errors (d,) to both with these errors; traceable.

    The unit of the errors is the standard deviation.
    """

    def change(plate, gel, sample):
        theta: list[dict] = [{} for _ in plate.holes]
        for one, error in zip(inputs, _errors(inputs, sample), strict=True):
            of = one.parameter["of"]
            if one.parameter["holes"]:
                (k,) = one.parameter["holes"]
                theta[k][of] = plate.holes[k].theta[of] + (
                    jnp.deg2rad(error) if one.parameter["degrees"] else error
                )
            else:
                gel = with_matrix(gel, **{of: getattr(matrix_of(gel), of) + error})
        return (plate.at(theta) if any(theta) else plate), gel

    return change


def _errors(inputs, sample):
    """The errors of all inputs, in their units, of a sample (d,) in standard deviations."""
    cuts = np.cumsum([np.size(one.deviation) for one in inputs])
    parts = np.split(np.asarray(sample), cuts[:-1])
    return [
        one.deviation * part.reshape(np.shape(one.deviation))
        for one, part in zip(inputs, parts, strict=True)
    ]


def _study(case, inputs, points, seed=0):
    """The `MapStudy` of a case with these inputs within `SPAN` standard deviations."""
    parameters = [
        one.parameter
        | {end: one.parameter["own"] + sign * SPAN * one.deviation for end, sign in ENDS.items()}
        for one in inputs
    ]
    varied = [
        {"of": "angle_deg" if p["degrees"] else p["of"], "name": p["name"]}
        | ({"holes": p["holes"]} if p["holes"] else {})
        | {end: np.asarray(p[end]).tolist() for end in ENDS}
        for p in parameters
    ]
    options = {"samples": "sobol", "points": max(len(points), 1), "seed": seed}
    return MapStudy(
        f"{case.name}-samples",
        case,
        parameters,
        points,
        {"map": options, "parameters": varied} | case.table(),
    )


def sampled_deviations(
    rows: list[dict[str, Any]], columns: dict[str, str]
) -> dict[str, tuple[float, float, int]]:
    """Mean, standard deviation and count of quantities (name -> column) over complete rows.

    The rows are those of points.csv.
    """
    complete = [row for row in rows if row["status"] == "complete"]
    values = {
        name: np.array([row[column] for row in complete if row[column] is not None])
        for name, column in columns.items()
    }
    return {
        name: (float(v.mean()), float(v.std(ddof=1)), len(v))
        if len(v) > 1
        else (np.nan, np.nan, len(v))
        for name, v in values.items()
    }
