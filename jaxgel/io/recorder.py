"""What the commands leave in a folder while they go: the table, states and summary of a sweep, and the critical points of a branch.

Every file is complete at any moment: it is written beside its final place and moved there, or appended row by row. So whatever
stops a run, Ctrl-C or a lost machine, the finished states stay readable, and `restart` goes on from them. Nothing is pickled.
"""

import csv
import functools
import io
import json
import os
import platform
import shutil
import time
from importlib.metadata import version

import numpy as np

from ..continuation import Path
from ..equilibrium import Status
from ..mechanics import with_contact
from ..observables import COLUMNS, SELF_CONTACT, events, history, outlines
from .files import open_folder, write_atomically
from .run import FORMAT, INTEGER_COLUMNS, OF_LAST, STEP_ARRAYS

NUMERICAL = ("jaxgel", "jax", "jaxlib", "numpy", "scipy")  # packages on which the last digits depend
FILES = ("summary.json", "history.csv", "states.npz", "pattern.png", "curves.png", "pattern.gif", "pattern.mp4", "series.pvd", "run.nc")


class Recorder:
    """Writes ``summary.json``, ``history.csv`` and ``states.npz`` of a sweep while it goes; pass it as ``on_step``.

    ``case`` is the `cases.Case` behind ``model`` and ``gel``; ``steps`` are those that an interrupted run left after ``seconds``, to go
    on from. Without them earlier results in ``folder`` are removed; other files stay. Without ``durable`` the steps wait for the disk at
    `finish` only, for sweeps that are begun again where the machine is lost. Raises ValueError when the folder cannot be written.
    """

    def __init__(self, folder, case, model, gel, *, steps=(), seconds=0.0, durable=True):
        self.folder, self.case, self.model, self.gel = open_folder(folder), case, of_case(model, case), gel
        self.records = []  # (step, row, outlines) of each accepted state
        self.stored = 0  # states that are on disk for good
        self.started, self.durable = time.perf_counter() - seconds, durable
        if not steps:
            _clear(self.folder)
        for step in steps:
            self._take(step)
        self._write_history()
        self.finish("running", "the sweep has not ended")

    @property
    def steps(self):
        """The accepted steps so far."""
        return [step for step, _, _ in self.records]

    @property
    def table(self):
        """The columns of ``history.csv`` so far."""
        return {name: [row[name] for _, row, _ in self.records] for name in COLUMNS}

    def __call__(self, step):
        """Take one accepted step to disk: first its row, then all states, so that these are never ahead."""
        row = self._take(step)
        with (self.folder / "history.csv").open("a", newline="") as stream:
            _csv_writer(stream).writerow(_csv_row(row))
            stream.flush()
            if self.durable:
                os.fsync(stream.fileno())
        self._write_states(durable=self.durable)
        self._write_summary("running", "the sweep has not ended", Status.INTERRUPTED, durable=self.durable)

    def _take(self, step):
        """The row of a step, which joins the records."""
        one = Path.from_states(self.model, self.gel, [step], stop=step.status)
        row = {name: column[0] for name, column in history(one).items()}
        if self.records and self.records[-1][1]["status"] == SELF_CONTACT:
            row["status"] = SELF_CONTACT
        self.records.append((step, row, [np.asarray(loop)[0] for loop in outlines(one)]))
        return row

    def finish(self, status, text, stop=Status.INTERRUPTED):
        """Close the record with ``status`` "complete", "stopped", "interrupted" or "failed", the reason as ``text``, and its `Status`."""
        if len(self.records) > self.stored:  # Ctrl-C may have come between the row and its states
            self._write_states(durable=True)
        self._write_history()
        self._write_summary(status, text, stop)

    def _write_states(self, *, durable):
        write_atomically(self.folder / "states.npz", lambda stream: np.savez(stream, **self._states()), durable=durable)
        self.stored = len(self.records) if durable else 0

    def _states(self):
        steps = self.steps
        arrays = {name: np.array([getattr(step, name) for step in steps]) for name in STEP_ARRAYS}
        arrays["status"] = np.array([step.status.name for step in steps])
        arrays["apart"] = np.array([-1 if step.contact_active is None else not step.contact_active for step in steps], dtype=np.int8)
        arrays |= {name: np.asarray(own) for name in OF_LAST if (own := getattr(steps[-1], name)) is not None}
        arrays["nodes"] = np.asarray(self.model.cloud.nodes)
        for i, loops in enumerate(zip(*(loops for _, _, loops in self.records), strict=True)):
            arrays[f"outline_{i}"] = np.array(loops)
        return arrays

    def _write_history(self):
        def write(stream):
            text = io.StringIO(newline="")
            writer = _csv_writer(text)
            writer.writerow(COLUMNS)
            writer.writerows(_csv_row(row) for _, row, _ in self.records)
            stream.write(text.getvalue().encode())

        write_atomically(self.folder / "history.csv", write)

    def _write_summary(self, status, text, stop, *, durable=True):
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
            "mu_reached": float(table["mu"][-1]) if self.records else None,
            "events": events(table),
        }
        encoded = json.dumps(summary, indent=1, allow_nan=False, ensure_ascii=False).encode()
        write_atomically(self.folder / "summary.json", lambda stream: stream.write(encoded), durable=durable)


@functools.cache
def _versions():
    return {name: version(name) for name in NUMERICAL} | {"python": platform.python_version(), "platform": platform.platform()}


def _clear(folder):
    for name in FILES:
        (folder / name).unlink(missing_ok=True)
        (folder / f"{name}.part").unlink(missing_ok=True)
    if (folder / "vtu").is_dir():
        shutil.rmtree(folder / "vtu")


def _csv_writer(stream):
    return csv.writer(stream, lineterminator="\n")


def _csv_row(row):
    return [str(int(v)) if n in INTEGER_COLUMNS else v if n == "status" else repr(float(v)) for n, v in row.items()]


def write_points(points, folder, options):
    """``critical.json`` and ``critical.csv`` with one entry per point, ``critical.npz`` with states and modes, in a folder."""
    names = ("mu", "kind", "multiplicity", "unstable", "slope", "curvature", "imperfection", "text")
    rows = [{name: getattr(point, name) for name in names} for point in points]
    entries = [
        {k: None if v != v else v for k, v in row.items()} | {"symmetries": p.symmetries} for row, p in zip(rows, points, strict=True)
    ]
    text = json.dumps({"options": options, "points": entries}, indent=1, allow_nan=False, ensure_ascii=False)
    write_atomically(folder / "critical.json", lambda stream: stream.write(text.encode()))
    table = io.StringIO(newline="")
    writer = csv.DictWriter(table, names)
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(folder / "critical.csv", lambda stream: stream.write(table.getvalue().encode()))
    arrays = {f"{name}_{k}": getattr(point, name) for k, point in enumerate(points) for name in ("x", "modes")}
    write_atomically(folder / "critical.npz", lambda stream: np.savez(stream, **arrays))


def of_case(model, case):
    """The model with the contact that the sweep of the case gives it."""
    return with_contact(model, case.gel) if case.sweep.contact == "on" else model
