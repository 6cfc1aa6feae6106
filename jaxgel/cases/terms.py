"""Terms of a study that are numbers of a run, and where in a sweep or time a term counts."""

import operator
from collections.abc import Callable
from typing import Any

from .._types import Array, Float
from ..continuation import Path
from ..controls import CONTROLS
from ..design import SWITCHES, time_of
from ..observables import CURVES, OF_EQUILIBRIA, area_reduction_per_hole
from .case import Case

BARRIER = "barrier"  # the switch at a value of its own
IN_TIME = ("at_time", "time_to")
# of a path, whose loads are those of its model; None for the chemical potential
CONTROL_OF = operator.attrgetter("control")
FREE_EDGE = "free_edge"  # what an outline is given for
# (k, holes) values of those that a single hole has, too
PER_HOLE = {"area_reduction": area_reduction_per_hole}


def check_place(where: str, entry: dict[str, Any], case: Case) -> None:
    """Raise ValueError, one line, for an entry whose hole or place in the sweep is wrong.

    The place may be in time. The entry is one of the objective or the constraints; what it needs
    may be missing, or not be accepted.
    """
    of, needed = entry["of"], bool(entry.keys() & {"goal", "target", "outline"})
    if "hole" in entry and of not in PER_HOLE:
        raise ValueError(f"{where}.hole: does not go with {of!r}; remove it")
    if entry.get("hole", 0) >= max(len(case.plate.holes), 1):
        raise ValueError(
            f"{where}.hole: {entry['hole']} is not the number of a hole, 0 to "
            f"{len(case.plate.holes) - 1}"
        )
    if case.time is None:
        foreign = next((key for key in IN_TIME if key in entry), None)
        if foreign is not None:
            raise ValueError(
                f"{where}.{foreign}: goes with swelling in time; add [time] and [bath], or give at"
            )
        if needed and of not in SWITCHES and "at" not in entry:
            raise ValueError(
                f"{where}: at is missing; give the value of the sweep at which the quantity counts"
            )
        return
    if of in SWITCHES or of in OF_EQUILIBRIA:
        raise ValueError(
            f"{where}.of: {of!r} is for equilibria, it does not go with [time]; remove [time] and "
            "[bath]"
        )
    foreign = next((key for key in ("at", "curve", "line", "from", "to") if key in entry), None)
    if foreign is not None:
        raise ValueError(f"{where}.{foreign}: does not go with [time]; give {' or '.join(IN_TIME)}")
    given = [key for key in IN_TIME if key in entry]
    if len(given) == 2:
        raise ValueError(f"{where}: give one of at_time and time_to, not both")
    if needed and not given:
        raise ValueError(
            f"{where}: at_time is missing; give the time at which the quantity counts, or "
            "time_to, the value to reach"
        )
    if given and of not in CURVES and (of != FREE_EDGE or given == ["time_to"]):
        raise ValueError(f"{where}.{given[0]}: does not go with {of!r}; remove it")
    if entry.get("at_time", 0.0) > case.time.last:
        raise ValueError(
            f"{where}.at_time: {entry['at_time']:g} is not in the run, 0 ... {case.time.last:g}"
        )


def quantity_of(entry: dict[str, Any]) -> tuple[str, Callable[[Path], Float[Array, " k"]] | None]:
    """(name, function of the path) of an entry's quantity, or its ``hole``'s; None without path."""
    of = entry["of"]
    if "hole" not in entry:
        return of, CURVES.get(of)
    return f"{of} of hole {entry['hole']}", lambda path: PER_HOLE[of](path)[:, entry["hole"]]


def time_to_of(entry: dict[str, Any]) -> tuple[str, Callable[[Path], Float[Array, ""]]]:
    """(name, function of the path) of an entry: the time at which its quantity reaches a value."""
    (name, quantity), value = quantity_of(entry), float(entry["time_to"])
    return f"time to {name} = {value:g}", time_of(quantity, value, name)


def switch_of(
    where: str, entry: dict[str, Any], case: Case
) -> tuple[str, Callable[[Path], Float[Array, ""]]]:
    """(name, function of the path) of an entry that is a switch; ValueError for a wrong one.

    The entry is one of the objective or the constraints.
    """
    of, sweep = entry["of"], case.sweep
    foreign = next(
        (key for key in ("curve", "line", "from", "to", *["at"] * (of != BARRIER)) if key in entry),
        None,
    )
    if foreign is not None:
        raise ValueError(
            f"{where}.{foreign}: does not go with {of!r}, a number of the whole sweep; give goal "
            "or target, or a limit"
        )
    first, last = sweep.ends
    if first == last:
        raise ValueError(
            f"{where}.of: {of!r} needs a sweep from one value to another, and this one has "
            f"{first:g} only"
        )
    if of != "onset" and sweep.branch != "stable":
        raise ValueError(
            f"sweep.branch: {sweep.branch!r} is not accepted with {of!r}, a loop follows the "
            "stable branch"
        )
    driven = (
        sweep.ends,
        CONTROL_OF,
        None if CONTROLS[sweep.control].multiplies_loads else case.loads,
    )
    if of != BARRIER:
        return of, SWITCHES[of](*driven)
    if "at" not in entry:
        raise ValueError(
            f"{where}: at is missing; give the value of the sweep's control at which the barrier "
            "counts"
        )
    at = float(entry["at"])
    if not min(first, last) < at < max(first, last):
        raise ValueError(
            f"{where}.at: {at:g} is not between the ends of the sweep, {first:g} and {last:g}"
        )
    return f"{of} at {at:g}", SWITCHES[of](at, *driven)
