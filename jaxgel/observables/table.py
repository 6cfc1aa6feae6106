"""The table of a path, as in ``history.csv``, and the events in it."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..continuation import Path
from ..equilibrium import Change
from ..transient import Time
from .gaps import IN_CONTACT, SWITCHED
from .quantities import BY_COLUMN, columns_of, control_quantity
from .states import of_path
from .surface import CREASE_RATIO

# of ln J: where a path that goes over to another branch changes the volume by more, the gel has
# changed its phase
LEAP = 0.2


@of_path
def history(path: Path) -> dict[str, Any]:
    """Columns of ``history.csv`` of a path's states: name -> (k,) values, texts for ``status``.

    The first is the control, by its name: ``mu``, kT, or another one before it, ``t`` in transient
    swelling. Energy in kT/v mm^2, angles in degrees, gap in mm; J is the volume ratio of a cell and
    its mean is weighted with the dry volume. The last one of transient swelling is the `uptake`,
    mm^2. What ``status`` says is in `status_texts`. ValueError for a control of a user that has the
    name of another column.
    """
    # what several columns share is kept on this copy and freed with it
    path = dataclasses.replace(path)
    name = path.control.name
    driven = control_quantity(name, path.control.unit)
    if name != "mu" and name in BY_COLUMN:
        raise ValueError(
            f"control: the name {name!r} is that of another column; give it one that is not "
            f"{', '.join(BY_COLUMN)}"
        )
    known = {name: driven} | BY_COLUMN
    values = {
        column: known[column].of(path)
        for column in columns_of(path.model.lists.topology.plate, name)
    }
    return {
        name: column if isinstance(column, list) else np.asarray(column)
        for name, column in values.items()
    }


def driven_column(table: Mapping[str, Any]) -> str:
    """Name of the column of a table of `history` that is the control."""
    return next((name for name in table if name not in BY_COLUMN), "mu")


def events(table: dict[str, Any]) -> list[dict[str, Any]]:
    """Events along a path with the ``table`` of `history`: dictionaries in order of states.

    Each holds ``event`` ("bifurcation", "snap-through", "leap", "crease", "wrinkle", "contact" or
    "self-contact"), ``state``, the first that shows it, its value of the control and that of the
    state before (None if it is the first) by the control's name, as ``mu`` and ``mu_before``, and
    ``text``. A bifurcation, or fold, is a change of the negative pivots, or if the path left an
    unstable branch.
    """
    control, pivots = driven_column(table), np.asarray(table["negative_pivots"])
    values, found = np.asarray(table[control]), []

    digits = ".4g" if control == Time.name else ".4f"

    def add(k: int, event: str, text: str) -> None:
        before = float(values[k - 1]) if k else None
        last = f"{values[k]:{digits}}"
        where = (
            f"between {control} = {before:{digits}} and {last}"
            if k
            else f"at or before {control} = {last}"
        )
        driven = {control: float(values[k]), f"{control}_before": before}
        found.append({"event": event, "state": int(k), **driven, "text": f"{text} {where}"})

    changes = {text: change for change, text in SWITCHED.items()}
    for k, status in enumerate(table.get("status", ())):
        change = next((change for text, change in changes.items() if text in status), None)
        volume = np.asarray(table.get("J_mean", np.ones(len(values))))[max(k - 1, 0) : k + 1]
        if change and (change is Change.PHASE or abs(np.log(volume[-1] / volume[0])) > LEAP):
            add(
                k,
                "leap",
                f"the gel changes its phase, mean J from {volume[0]:.3f} to {volume[-1]:.3f},",
            )
        elif change is Change.RELAXATION:
            add(k, "snap-through", "the stable branch ended and the gel relaxed to another one")
        elif change:
            add(
                k,
                "bifurcation",
                "the branch became unstable and the path went over to the stable one",
            )
    for k in range(1, len(values)):
        if pivots[k] != pivots[k - 1]:
            add(
                k,
                "bifurcation",
                f"negative pivots of the tangent go from {pivots[k - 1]} to {pivots[k]}",
            )
    for k in np.flatnonzero(np.asarray(table["surface_ratio"]) > CREASE_RATIO)[:1]:
        add(
            k,
            "crease",
            f"a hole's surface is compressed past the crease limit (stretch ratio {CREASE_RATIO})",
        )
    for k in np.flatnonzero(np.asarray(table["surface_stability"]) < 0)[:1]:
        add(k, "wrinkle", "a free surface becomes unstable to short waves")
    for k in [k for k, text in enumerate(table.get("status", ())) if IN_CONTACT in text][:1]:
        add(k, "contact", "a hole's sides first touch")
    for k in np.flatnonzero(np.asarray(table["min_gap"]) <= 0)[:1]:
        add(k, "self-contact", "a hole's boundary touches itself")
    return sorted(found, key=lambda e: e["state"])
