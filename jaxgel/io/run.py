"""A run's folder read back: summary, table and states."""

import csv
import dataclasses
import json
from pathlib import Path as File
from typing import Any

import numpy as np

from .._deprecated import old_arguments
from .._types import Float
from ..continuation import OF_SOLVENT, SCALARS
from ..equilibrium import Status
from ..observables import BY_COLUMN, COLUMNS, IN_TIME, OF_CELLS, OF_OBSTACLES
from .files import guarded, read_arrays

FORMAT = 4  # raised when the meaning of a file changes
# whose names are stored
STEP_ARRAYS = tuple(name for name in (*SCALARS, "x", "pressure") if name != "status")
ENTRIES = {
    "case": str,
    "options": dict,
    "versions": dict,
    "status": str,
    "reason": str,
    "stop": str,
    "wall_seconds": float,
    "control": dict,
    "events": list,
}
"""Entries of summary.json that are read, with their types."""


def kind_of(column: str) -> type:
    """Type of the values of a column."""
    return BY_COLUMN[column].kind if column in BY_COLUMN else float


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """A run's folder as read from disk; k states of n nodes."""

    folder: File
    """Where it lies."""
    summary: dict[str, Any]
    """Content of ``summary.json``."""
    history: dict[str, Any]
    """Columns of ``history.csv``: name -> (k,) array, status a list of texts; nan if missing.

    A missing column of texts has empty ones.
    """
    states: dict[str, np.ndarray]
    """Arrays of ``states.npz``: mu, x, pressure, nodes, outlines, and the rest of each step.

    mu (k,), x (k, n, 2) mm, pressure (k, g) kT/v, nodes (n, 2) mm, outline_0 ... (k, m, 2) mm;
    value (k,) of the control; of swelling in time potential (k, g) kT and supplied (k, b) mm^2 too.
    """

    @property
    def control(self) -> tuple[str, str]:
        """Name and unit of the control."""
        return control_in(self.summary)

    @property
    def value(self) -> Float[np.ndarray, " k"]:
        """Values of the control."""
        return self.states["value"]

    @property
    def mu(self) -> Float[np.ndarray, " k"]:
        """Chemical potential in kT."""
        return self.states["mu"]

    @property
    def x(self) -> Float[np.ndarray, "k n 2"]:
        """Deformed node positions in mm."""
        return self.states["x"]

    @property
    def outlines(self) -> list[Float[np.ndarray, "k _ 2"]]:
        """Deformed outlines (k, m, 2) of the holes, mm, closed loops as `observables.outlines`."""
        return [
            self.states[f"outline_{i}"]
            for i in range(len(self.states))
            if f"outline_{i}" in self.states
        ]


@old_arguments
def load_run(folder: str | File) -> Run:
    """The `Run` in a folder written by `Recorder`, finished or not.

    Nothing in it is executed or unpickled. Raises ValueError for a folder without a run, and a file
    that is damaged, foreign or too large.
    """
    folder = File(folder)
    summary = read_summary(folder)
    control = control_in(summary)[0]
    table = guarded(folder / "history.csv", lambda content: _read_history(content, control))
    states = folder / "states.npz"
    states = guarded(states, _read_states) if table["mu"].size and states.is_file() else None
    if states is None:
        raise ValueError(
            f"folder: {str(folder)!r} holds no accepted state; its run ended as "
            f"{summary['status']!r}: {summary['reason']}"
        )
    # a run killed between two files leaves one row more in history.csv
    k = min(len(states["mu"]), len(table["mu"]))
    for name, column in (("mu", "mu"), ("value", control)):
        if not np.array_equal(states[name][:k], table[column][:k]):
            raise ValueError(
                f"folder: history.csv and states.npz in {str(folder)!r} are of different runs: "
                f"their {column} differ"
            )
    states = {name: a if name == "nodes" else a[:k] for name, a in states.items()}
    return Run(folder, summary, {name: column[:k] for name, column in table.items()}, states)


def control_in(summary: dict[str, Any]) -> tuple[str, str]:
    """Name and unit of the control of a run with that ``summary``."""
    return summary["control"]["name"], summary["control"]["unit"]


@old_arguments
def read_summary(folder: str | File) -> dict[str, Any]:
    """Content of the ``summary.json`` of a run's folder, a dict; ValueError as for `load_run`."""
    if not (File(folder) / "summary.json").is_file():
        raise ValueError(
            f"folder: {str(folder)!r} holds no summary.json; expected a folder written by jaxgel "
            "run"
        )
    return guarded(File(folder) / "summary.json", _read_summary)


def _read_summary(content: bytes) -> dict[str, Any]:
    summary = json.loads(content)
    if not isinstance(summary, dict) or summary.get("format") != FORMAT:
        found = summary.get("format") if isinstance(summary, dict) else None
        raise ValueError(f"format {found}, this version reads {FORMAT}: run the case again")
    for key, kind in ENTRIES.items():
        if not isinstance(summary.get(key), kind):
            raise ValueError(f"{key} is not of type {kind.__name__}")
    if not all(isinstance(summary["control"].get(part), str) for part in ("name", "unit")):
        raise ValueError("control has no name or unit")
    if summary["stop"] not in Status.__members__:
        raise ValueError(f"stop {summary['stop']!r} is no status")
    return summary


def _read_history(content: bytes, control: str) -> dict[str, Any]:
    lines = content.decode().splitlines(keepends=True)
    # the last row may have been cut off with the machine
    complete = [line for line in lines if line.endswith("\n")]
    header, *rows = csv.reader(complete) if complete else [[]]
    if any(len(row) != len(header) for row in rows):
        raise ValueError(f"a row has not {len(header)} columns")
    known = dict.fromkeys(
        (
            control,
            *COLUMNS,
            *(name for name in (*OF_CELLS, *OF_OBSTACLES, *IN_TIME) if name in header),
        )
    )
    kinds = {name: kind_of(name) for name in known}
    missing = next(
        (
            name
            for name in known
            if name not in header and (name in (control, "mu", "status") or kinds[name] is int)
        ),
        None,
    )
    if missing is not None:
        raise ValueError(f"it has no column {missing}")
    fills = {str: "", float: "nan"}
    table = {
        name: [row[header.index(name)] for row in rows]
        if name in header
        else [fills[kinds[name]]] * len(rows)
        for name in known
    }
    return {
        name: c if kinds[name] is str else np.array(c, dtype=float).astype(kinds[name])
        for name, c in table.items()
    }


def _read_states(content: bytes) -> dict[str, np.ndarray]:
    arrays = read_arrays(content)
    missing = [name for name in (*STEP_ARRAYS, "status", "symmetry", "nodes") if name not in arrays]
    if missing or arrays["x"].ndim != 3 or arrays["pressure"].ndim != 2:
        raise ValueError(
            f"it has no {missing[0]}" if missing else "x or pressure is no array of states"
        )
    (k, n, _), groups = arrays["x"].shape, arrays["pressure"].shape[1]
    shapes = dict.fromkeys((*STEP_ARRAYS, "status", "symmetry"), (k,)) | {
        "x": (k, n, 2),
        "pressure": (k, groups),
        "nodes": (n, 2),
    }
    solvent = {
        "potential": (k, groups),
        "supplied": (k, *arrays.get("supplied", arrays["pressure"]).shape[1:2]),
    }
    shapes |= {name: solvent[name] for name in OF_SOLVENT if name in arrays}
    shapes |= {
        name: (k, *a.shape[1:2], 2) for name, a in arrays.items() if name.startswith("outline_")
    }
    for name, shape in shapes.items():
        if arrays[name].shape != shape or arrays[name].dtype.kind not in "bfiU":
            raise ValueError(f"{name} has shape {arrays[name].shape}, expected {shape}")
    for name in ("mu", "value", "x", "pressure", *OF_SOLVENT):
        if name in shapes and not np.isfinite(arrays[name]).all():
            raise ValueError(f"{name} is not finite")
    if (
        not np.all(np.diff(arrays["value"]))
        or not set(arrays["status"]) <= Status.__members__.keys()
    ):
        raise ValueError("a value of the control is repeated, or a status is unknown")
    return {name: arrays[name] for name in shapes}
