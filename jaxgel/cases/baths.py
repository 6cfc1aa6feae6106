"""Baths of a case in time: wetted parts of the boundary and their chemical potentials."""

from typing import Any

from ..continuation import SweepOptions
from ..geometry import EDGES, Plate
from ..transient import Bath, BathOptions

WETTING = ("wet", "bath")  # entries of a hole, and tables by edges of the plate
STARTING = ("mu_start", "branch", "contact")  # entries of ``sweep`` that swelling in time takes


def check_time(table: dict[str, Any]) -> None:
    """Raise ValueError, one line, for entries of a case's table that do not go with ``time``.

    Entries that need it are refused without it.
    """
    if "time" not in table:
        where = next((where for where, entry in _entries(table) if entry), None)
        if where is not None:
            raise ValueError(
                f"{where}: goes with swelling in time; add [time] and [bath], or remove it"
            )
        return
    for key, value in table.get("sweep", {}).items():
        if key not in STARTING or (key == "contact" and value != "off"):
            known = "mu_start and branch" if key != "contact" else "contact = 'off'"
            raise ValueError(
                f"sweep.{key}: {value!r} does not go with [time], in which the bath drives; it "
                f"takes {known}"
            )
    for where, entry in _entries(table):
        if not entry.get("wet", True) and "bath" in entry:
            raise ValueError(f"{where}: give one of wet = false and bath, not both")


def start_entries(table: dict[str, Any]) -> dict[str, Any]:
    """The section ``sweep`` of the equilibrium at which swelling in time starts."""
    given = table.get("sweep", {})
    start = given.get("mu_start", SweepOptions().mu_start)
    return {
        "mu_start": start,
        "mu": [start],
        "contact": "off",
        "branch": given.get("branch", SweepOptions().branch),
    }


def baths(
    source: dict[str, Any], plate: Plate, options: BathOptions, start: float, end: float
) -> dict[str | int, Bath]:
    """The `Bath` of each wetted hole and free edge of a gel that is first at ``start``, kT.

    Holes by number, edges by name. ``source`` has the sections of the case that say what differs
    from the ``options``. ValueError, one line, for an edge that is not free, a table that ends
    before the time ``end``, and if nothing is wetted.
    """
    entries = dict(_entries(source))
    parts = {
        f"plate.{edge}": edge for edge, condition in plate.edges.items() if condition == "free"
    }
    for where in entries:
        if where.startswith("plate.") and where not in parts:
            edge = where.removeprefix("plate.")
            key = next(iter(entries[where]))
            raise ValueError(
                f"plate.{key}.{edge}: the edge is {plate.edges[edge]}, only a free edge is wetted"
            )
    found = {}
    for where, part in ({f"holes[{i}]": i for i in range(len(plate.holes))} | parts).items():
        entry = entries.get(where, {})
        if entry.get("wet", True):
            found[part] = _bath(where, entry.get("bath"), options, start, end)
    if not found:
        raise ValueError("bath: nothing is wetted; the plate needs a hole or a free edge that is")
    return found


def _bath(where, table, options, start, end):
    if table is None:
        return options.bath(start, end)
    try:
        own = BathOptions(
            **{
                key: tuple(value) if isinstance(value, list) else value
                for key, value in table.items()
            }
        )
        return own.bath(start, end)
    except ValueError as problem:
        raise ValueError(f"{where}.{problem}") from None


def _entries(table):
    """What says of each part of the boundary how it is wetted, and where it stands.

    Edges as ``plate.top``.
    """
    holes, plate = table.get("holes", []), table["plate"]
    yield from (
        (f"holes[{i}]", {key: hole[key] for key in WETTING if key in hole})
        for i, hole in enumerate(holes)
    )
    edges = {
        edge: {key: plate[key][edge] for key in WETTING if edge in plate.get(key, {})}
        for edge in EDGES
    }
    yield from ((f"plate.{edge}", entry) for edge, entry in edges.items() if entry)
