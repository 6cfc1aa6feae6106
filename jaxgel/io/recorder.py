"""Files of a run, written while the sweep goes on: table, states and summary.

And those of critical points. Every file is complete at any moment: it is written beside its final
place and moved there, or appended row by row. Whatever stops a run, Ctrl-C or a loss of power, the
finished states stay readable and `jaxgel resume` goes on from them. Nothing is pickled.
"""

import collections
import csv
import functools
import json
import os
import platform
import shutil
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path as File
from typing import Any

import numpy as np

from .._deprecated import old_arguments
from .._sizes import rung
from ..bifurcation import CriticalPoint
from ..continuation import OF_SOLVENT, Path
from ..equilibrium import State, Status
from ..mechanics import Problem
from ..observables import SELF_CONTACT, columns_of, events, history, outlines
from ..verification import resolution
from .files import open_folder, write_atomically, write_csv, write_json
from .run import FORMAT, STEP_ARRAYS, kind_of

# packages on which the last digits depend
NUMERICAL = ("jaxgel", "jax", "jaxlib", "numpy", "scipy")
FILES = (
    "summary.json", "history.csv", "states.npz", "gel.png", "pattern.png", "curves.png",
    "pattern.gif", "pattern.mp4", "series.pvd", "obstacles.pvd", "contact.pvd", "run.nc",
)  # fmt: skip


class Recorder:
    """Writes ``summary.json``, ``history.csv`` and ``states.npz`` of a sweep while it goes.

    `Observer(accepted=recorder)`. ``problem`` is that of the ``case``, a `cases.Case`; ``notes``
    are further entries of the summary. Each step is flushed to the disk. The files are begun by
    `begin`, or by the first step. Raises ValueError if the folder cannot be written.
    """

    @old_arguments
    def __init__(
        self, folder: str | File, case: Any, problem: Problem, notes: dict[str, Any] | None = None
    ) -> None:
        self.folder, self.case, self.problem, self.model, self.control = (
            open_folder(folder),
            case,
            problem,
            problem.model,
            problem.control,
        )
        self.notes, self.resolution = notes or {}, resolution(problem.model.cloud)
        self.records = []  # (step, row, outlines) of each accepted state
        self.stored = 0  # states that are on disk for good
        self.started, self.begun = time.perf_counter(), False

    def begin(self, before: Sequence[State] = ()) -> None:
        """Begin the files, with the states ``before``.

        Without states the results of an earlier run are removed from the folder; other files stay.
        """
        self.begun = True
        if before:
            self.add(before)
        if not self.records:
            _clear(self.folder)
        self.finish("running", "the run has not ended")

    @property
    def steps(self) -> list[State]:
        """The accepted steps so far."""
        return [step for step, _, _ in self.records]

    @property
    def table(self) -> dict[str, list]:
        """The columns of ``history.csv`` so far."""
        return {name: [row[name] for _, row, _ in self.records] for name in self.columns}

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of ``history.csv``."""
        return columns_of(self.model.cloud.plate, self.control.name)

    def __call__(self, step: State) -> None:
        """Write one accepted step: first its row, then all states: never more states than rows."""
        if not self.begun:
            self.begin()
        self.add([step])
        with (self.folder / "history.csv").open("a", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerow(_csv_row(self.records[-1][1]))
            stream.flush()
            os.fsync(stream.fileno())
        self._write_states()
        self._write_summary("running", "the run has not ended", Status.INTERRUPTED)

    def add(self, steps: Sequence[State]) -> None:
        """Add accepted steps to the records.

        Those of a sweep that has ended take much less time together than one by one.
        """
        # of a number whose programs other sweeps share
        alike = [*steps, *[steps[-1]] * (rung(len(steps)) - len(steps))]
        path = Path.from_states(self.problem, alike)
        table, loops = history(path), [np.asarray(loop) for loop in outlines(path)]
        for k, step in enumerate(steps):
            row = {name: column[k] for name, column in table.items()}
            if self.records and self.records[-1][1]["status"] == SELF_CONTACT:
                row["status"] = SELF_CONTACT
            self.records.append((step, row, [loop[k] for loop in loops]))

    def finish(self, status: str, text: str, stop: Status = Status.INTERRUPTED) -> None:
        """Complete the files with ``status``, the reason as ``text``, and its `Status`.

        "complete", "stopped", "interrupted" or "failed".
        """
        if not self.begun:
            self.begin()
        if len(self.records) > self.stored:  # Ctrl-C may have come between the row and its states
            self._write_states()
        self._write_history()
        self._write_summary(status, text, stop)

    def _write_states(self) -> None:
        write_atomically(
            self.folder / "states.npz", lambda stream: np.savez(stream, **self._states())
        )
        self.stored = len(self.records)

    def _states(self) -> dict[str, np.ndarray]:
        steps = self.steps
        arrays = {name: np.array([getattr(step, name) for step in steps]) for name in STEP_ARRAYS}
        arrays |= {
            name: np.array([getattr(step, name) for step in steps])
            for name in OF_SOLVENT
            if getattr(steps[0], name) is not None
        }
        arrays["status"] = np.array([step.status.name for step in steps])
        arrays["symmetry"] = np.array([step.symmetry for step in steps])
        arrays["nodes"] = np.asarray(self.model.cloud.nodes)
        for i, loops in enumerate(zip(*(loops for _, _, loops in self.records), strict=True)):
            arrays[f"outline_{i}"] = np.array(loops)
        return arrays

    def _write_history(self) -> None:
        write_csv(
            self.folder / "history.csv", self.columns, [_csv_row(row) for _, row, _ in self.records]
        )

    def _write_summary(self, status: str, text: str, stop: Status) -> None:
        table = self.table
        summary = {
            "format": FORMAT,
            "case": self.case.name,
            "options": self.case.table(),
            "versions": _versions(),
            "nodes": len(self.model.cloud.nodes),
            "cells": int(self.model.n_cells),
            "quadrature_points": int(self.model.n_points),
            "status": status,
            "reason": text,
            "stop": stop.name,
            "wall_seconds": round(time.perf_counter() - self.started, 3),
            "states": len(self.records),
            "newton_per_state": round(float(np.mean(table["newton_iterations"])), 2)
            if self.records
            else None,
            "resolution": self.resolution.table() | {"warnings": self.resolution.warnings},
            "symmetry": dict(collections.Counter(step.symmetry for step in self.steps)),
            "control": {"name": self.control.name, "unit": self.control.unit},
            "value_reached": float(self.steps[-1].value) if self.records else None,
            "mu_reached": float(table["mu"][-1]) if self.records else None,
            "events": events(table) + self._last_event(stop),
        } | self.notes
        encoded = json.dumps(summary, indent=1, allow_nan=False, ensure_ascii=False).encode()
        write_atomically(self.folder / "summary.json", lambda stream: stream.write(encoded))

    def _last_event(self, stop: Status) -> list[dict[str, Any]]:
        """The loss of stability that ended swelling in time, as in `events`, if it did.

        Its state is the next one, which the run does not have.
        """
        if stop is not Status.LOST_STABILITY:
            return []
        k, before = len(self.records), float(self.steps[-1].value)
        t = self.case.times(self.problem)[k - 1]
        text = (
            f"the state becomes unstable, with which the run ends, between t = {before:.4g} and "
            f"{t:.4g}"
        )
        return [{"event": "bifurcation", "state": k, "t": t, "t_before": before, "text": text}]


@functools.cache
def _versions():
    """Versions of what the last digits depend on."""
    return {name: version(name) for name in NUMERICAL} | {
        "python": platform.python_version(),
        "platform": platform.platform(),
    }


def _clear(folder: File) -> None:
    for name in FILES:
        (folder / name).unlink(missing_ok=True)
        (folder / f"{name}.part").unlink(missing_ok=True)
    if (folder / "vtu").is_dir():
        shutil.rmtree(folder / "vtu")


def _csv_row(row: dict[str, Any]) -> list[str]:
    kinds = {name: kind_of(name) for name in row}
    return [
        repr(kinds[name](value)) if kinds[name] is not str else value for name, value in row.items()
    ]


def write_points(
    points: list[CriticalPoint], folder: File, options: dict[str, Any], control: str = "mu"
) -> None:
    """``critical.json``, ``critical.csv`` and ``critical.npz`` of critical points in a folder.

    One entry per point; states and modes are in the last. ``control`` is the name under which the
    points' values are written before their mu, if that is another.
    """
    own = ("mu", "kind", "multiplicity", "unstable", "slope", "curvature", "imperfection", "text")
    rows = [
        {control: point.value} | {name: getattr(point, name) for name in own} for point in points
    ]
    names = tuple(dict.fromkeys((control, *own)))
    entries = [
        {k: None if v != v else v for k, v in row.items()} | {"symmetries": p.symmetries}
        for row, p in zip(rows, points, strict=True)
    ]
    write_json(folder / "critical.json", {"options": options, "points": entries})
    write_csv(folder / "critical.csv", names, [list(row.values()) for row in rows])
    arrays = {
        f"{name}_{k}": getattr(point, name)
        for k, point in enumerate(points)
        for name in ("x", "modes")
    }
    write_atomically(folder / "critical.npz", lambda stream: np.savez(stream, **arrays))
