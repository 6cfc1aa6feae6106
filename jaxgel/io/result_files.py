"""Files of a loop, of ``jaxgel waves`` and of ``jaxgel accuracy``."""

from pathlib import Path as File
from typing import Any

import numpy as np

from .._deprecated import old_arguments
from ..bifurcation import Loop
from ..observables import QUANTITIES, history
from ..verification import Accuracy
from ..waves import LatticeOnset
from .files import write_atomically, write_csv, write_json


def write_loop(loop: Loop, folder: File, options: dict[str, Any]) -> None:
    """``loop.json`` with the jumps of a loop, and ``loop.csv`` with its states, in a folder.

    The table has the way, "up", "down" or "unstable", the value of the control, and the columns of
    `history`.
    """
    control = loop.up.control
    record = {
        "options": options,
        "control": control.name,
        "unit": control.unit,
        "width": None if loop.width is None else float(loop.width),
        "fold_up": _point_entry(loop.fold_up),
        "fold_down": _point_entry(loop.fold_down),
        "jumps_up": [_point_entry(point) for point in loop.jumps_up],
        "jumps_down": [_point_entry(point) for point in loop.jumps_down],
        "unlocated": list(loop.unlocated),
        "joined": bool(loop.joined),
        "stop": loop.stop_text,
        "text": loop.text,
    }
    write_json(folder / "loop.json", record)
    columns, rows = [], []
    for way, path in (("up", loop.up), ("down", loop.down), ("unstable", loop.unstable)):
        if path is not None:
            table = {name: column for name, column in history(path).items() if name != control.name}
            columns = ["way", control.name, *table]
            rows += [
                [way, *row] for row in zip(np.asarray(path.value), *table.values(), strict=True)
            ]
    write_csv(folder / "loop.csv", columns, rows)


def _point_entry(point):
    return (
        None
        if point is None
        else {"value": float(point.value), "kind": point.kind, "text": point.text}
    )


@old_arguments
def write_waves(onset: LatticeOnset | None, folder: File, options: dict[str, Any]) -> None:
    """``waves.json`` with the onset, null without one.

    Then also ``zone.csv``, the lowest eigenvalue by wave vector, and ``onset.npz``. The latter has
    the state and the wave.
    """
    write_json(folder / "waves.json", {"options": options, "onset": _onset_entry(onset)})
    if onset is not None:
        write_csv(
            folder / "zone.csv",
            ["kx", "ky", "eigenvalue"],
            np.column_stack([onset.zone, onset.eigenvalues]).tolist(),
        )
        arrays = {"x": np.asarray(onset.x), "modes": onset.modes, "wave_vector": onset.wave_vector}
        write_atomically(folder / "onset.npz", lambda stream: np.savez(stream, **arrays))


def _onset_entry(onset):
    if onset is None:
        return None
    names = ("kind", "periods", "slope", "text")
    return {"mu": float(onset.mu), "wave_vector": onset.wave_vector.tolist()} | {
        name: getattr(onset, name) for name in names
    }


def write_accuracy(found: Accuracy, folder: File, options: dict[str, Any]) -> None:
    """``accuracy.csv`` with a row for every state and quantity, ``accuracy.json`` with clouds.

    Values are in the unit that people read; those on the clouds come last, coarsest first. A number
    that is not known is empty, or null.
    """
    control, clouds = found.path.control, [f"on {nodes} nodes" for nodes in found.nodes]
    columns = [control.name, "quantity", "unit", "value", "error", "extrapolated", "order", *clouds]
    rows = []
    for k, value in enumerate(np.asarray(found.path.value)):
        for name, bars in found.bars.items():
            numbers = (
                bars.own[k],
                bars.error[k],
                bars.extrapolated[k],
                bars.order[k],
                *bars.values[:, k],
            )
            rows.append(
                [
                    float(value),
                    name,
                    QUANTITIES[name].read_unit,
                    *(float(n) if np.isfinite(n) else None for n in numbers),
                ]
            )
    write_csv(folder / "accuracy.csv", columns, rows)
    record = {
        "options": options,
        "spacings": found.spacings.tolist(),
        "nodes": found.nodes.tolist(),
        "ended": list(found.ended),
        "states": [dict(zip(columns, row, strict=True)) for row in rows],
    }
    write_json(folder / "accuracy.json", record)
