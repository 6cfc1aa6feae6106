"""Objectives and constraints of a study: functions of a path from the entries of its table."""

import functools
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .._types import Array, Float
from ..continuation import Path, SweepOptions
from ..design import SWITCHES, Constraint, bound, misfit, value_at
from ..io import DrawingIncomplete, read_outlines
from ..observables import free_edge_misfit
from .terms import FREE_EDGE, IN_TIME, quantity_of

LIMITS = ("above", "below", "within")
Switches = dict[str, tuple[str, Callable[[Path], Float[Array, ""]]]]
"""Place of an entry -> name and function of its number of a whole run."""


def term(
    where: str, entry: dict[str, Any], mu: Sequence[float], control: str, switches: Switches
) -> tuple[float, Callable[[Path], Float[Array, ""]]]:
    """(weight, function of the path) of a minimised entry; a negative weight maximises.

    It is an entry of the objective.
    """
    weight = float(entry.get("weight", 1.0))
    if "outline" in entry:
        misfit_of_edges = functools.partial(
            free_edge_misfit, outline=np.array(entry["outline"], dtype=float)
        )
        return weight, value_at(misfit_of_edges, place_of(where, entry, mu))
    if "curve" in entry or "line" in entry:
        return weight, misfit(
            quantity_of(entry)[1], mu, aim_of(entry, mu, control, where)["values"]
        )
    value = (
        switches[where][1]
        if where in switches
        else value_at(quantity_of(entry)[1], place_of(where, entry, mu))
    )
    if "target" in entry:
        return weight, lambda path: (value(path) - entry["target"]) ** 2
    return (-weight if entry["goal"] == "maximise" else weight), value


def constraint(
    where: str, entry: dict[str, Any], sweep: SweepOptions, switches: Switches
) -> Constraint:
    """The `Constraint` of an entry, on a number of the whole run or at one value of the control."""
    limits = {key: float(entry[key]) for key in LIMITS if key in entry}
    if where in switches:
        name, function = switches[where]
        return bound(name, of=function, **limits)
    at = place_of(where, entry, sweep.values) if entry.keys() & {"at", "at_time"} else None
    name, quantity = quantity_of(entry)
    return bound(
        name, of=quantity, at=at, control="t" if "at_time" in entry else sweep.control, **limits
    )


def aim_of(
    entry: dict[str, Any], mu: Sequence[float], control: str, where: str = "objective[0]"
) -> dict[str, Any]:
    """The entry with its target at every value ``mu`` of the ``control``, nan if it has none.

    In time at that of the target.
    """
    entry = dict(entry, quantity=quantity_of(entry)[1])
    if entry.keys() & IN_TIME:
        target = entry.get("target", np.nan)
        point = (entry["at_time"], target) if "at_time" in entry else (target, entry["time_to"])
        return dict(entry, control=np.array(point[:1]), values=np.array(point[1:]))
    at = np.array(mu)
    values = np.full(len(mu), np.nan)
    if "line" in entry:
        values = entry["line"]["slope"] * (at - entry["line"]["mu0"])
    elif "curve" in entry:
        if len(entry["curve"]) != len(mu):
            raise ValueError(
                f"{where}.curve: it is not a list of {len(mu)} numbers, one for each value of the "
                "sweep"
            )
        values = np.array(entry["curve"], dtype=float)
    elif "target" in entry and entry["of"] not in SWITCHES:
        values = np.where(
            np.abs(at - place_of(where, entry, mu)) < 1e-9, float(entry["target"]), np.nan
        )
    if entry.keys() & {"from", "to"}:
        low, high = sorted((entry.get("from", mu[0]), entry.get("to", mu[-1])))
        values = np.where((at >= low - 1e-9) & (at <= high + 1e-9), values, np.nan)
        if ("line" in entry or "curve" in entry) and not np.any(np.isfinite(values)):
            raise ValueError(
                f"{where}.from, to: no {control} of the sweep lies in {low:g} ... {high:g}"
            )
    return dict(entry, control=at, values=values)


def with_points(where: str, entry: dict[str, Any]) -> dict[str, Any]:
    """The entry of an objective with the points of its outline in place of a file.

    ValueError if it has no use for one.
    """
    if ("outline" in entry) != (entry["of"] == FREE_EDGE):
        raise ValueError(
            f"{where}.of: {entry['of']!r} does not fit; {FREE_EDGE!r} and outline belong together"
        )
    if not isinstance(entry.get("outline"), str):
        return entry
    points, *others = read_outlines(entry["outline"])
    if others:
        warnings.warn(
            f"{where}.outline: {entry['outline']!r} without {len(others)} other outlines",
            DrawingIncomplete,
            stacklevel=2,
        )
    return entry | {"outline": [*points.tolist(), points[0].tolist()]}


def place_of(where: str, entry: dict[str, Any], mu: Sequence[float]) -> float:
    """The value of the control of an entry, which must be one of the sweep's; in time the time."""
    if "at_time" in entry:
        return float(entry["at_time"])
    at = float(entry["at"])
    if min(abs(at - m) for m in mu) > 1e-9:
        raise ValueError(
            f"{where}.at: {at:g} is not one of the sweep's values "
            f"({', '.join(f'{m:g}' for m in mu)})"
        )
    return at
