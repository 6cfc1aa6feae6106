"""A run's folder: the table, states and summary that a sweep leaves on disk while it goes, and how they are read back.

Every file is complete at any moment: it is written beside its final place and moved there, or appended row by row. So whatever
stops a run, Ctrl-C or a lost machine, the finished states stay readable. Nothing is pickled.
"""

import csv
import dataclasses
import io
import json
import os
import platform
import shutil
import time
from importlib.metadata import version
from pathlib import Path as File

import numpy as np

from . import cases
from .contact import with_contact
from .equilibrium import Status
from .files import MAX_BYTES, guarded, open_folder, read_arrays, write_atomically
from .observables import (
    area_reduction,
    cell_volumes,
    core_rotation,
    free_stretch,
    min_gap,
    outlines,
    rotation_angle,
    surface_ratio,
    volume_ratio,
)
from .path import Path, Step

COLUMNS = (
    "mu",
    "free_stretch",
    "status",
    "newton_iterations",
    "residual",
    "energy",
    "J_min",
    "J_max",
    "J_mean",
    "area_reduction",
    "rotation_deg",
    "core_rotation_deg",
    "negative_pivots",
    "lowest_eigenvalue",
    "min_gap",
    "surface_ratio",
)
INTEGER_COLUMNS = ("newton_iterations", "negative_pivots")
CREASE_RATIO = 2.4  # ratio of the in-plane principal stretches at which a plane-strain surface creases, stretch 0.647 (Hong et al. 2009)
WRINKLE_RATIO = 3.4  # the same for wrinkles, stretch 0.544 (Biot 1963)
SELF_CONTACT = "invalid: self-contact"
IN_CONTACT = "a hole's sides touch"
SWITCHED = "switched to the stable branch"
FORMAT = 1  # raised when the meaning of a file changes
FILES = ("summary.json", "history.csv", "states.npz", "pattern.png", "curves.png", "pattern.gif", "series.pvd")


def history(path):
    """The columns of ``history.csv`` for every state of a path: a dictionary from each name in ``COLUMNS`` to (k,) values.

    Energy in kT/v mm^2, angles in degrees, gap in mm; J is the volume ratio of a cell and its mean is weighted with the dry
    volume. ``status`` is a list of texts: with contact, whether a hole's sides are within its range; without, ``"invalid: self-contact"``
    from the first state on in which a hole's boundary crosses itself.
    """
    J = np.asarray(volume_ratio(path))
    volumes = np.asarray(cell_volumes(path.model))
    gap = np.asarray(min_gap(path))
    values = {
        "mu": path.mu,
        "free_stretch": free_stretch(path),
        "status": _status_texts(path, gap),
        "newton_iterations": path.newton_iterations,
        "residual": path.residual,
        "energy": path.energy,
        "J_min": J.min(axis=1),
        "J_max": J.max(axis=1),
        "J_mean": J @ volumes / volumes.sum(),
        "area_reduction": area_reduction(path),
        "rotation_deg": rotation_angle(path),
        "core_rotation_deg": core_rotation(path),
        "negative_pivots": path.negative_pivots,
        "lowest_eigenvalue": path.lowest_eigenvalue,
        "min_gap": gap,
        "surface_ratio": surface_ratio(path),
    }
    return {name: values[name] if name == "status" else np.asarray(values[name]) for name in COLUMNS}


def events(table):
    """What happens along a path with the columns ``table`` of `history`, as a list of dictionaries in the order of mu.

    Each holds ``event`` ("bifurcation", "crease", "wrinkle", "contact" or "self-contact"), ``mu`` of the first state that shows it,
    ``mu_before`` of the state before (None where it is the first), and ``text``. A bifurcation, or fold, is a change of the negative
    pivots, or where the path left an unstable branch.
    """
    mu, pivots = np.asarray(table["mu"]), np.asarray(table["negative_pivots"])
    found = []

    def add(k, event, text):
        before = float(mu[k - 1]) if k else None
        where = f"between mu = {before:.4f} and {mu[k]:.4f}" if k else f"at or before mu = {mu[k]:.4f}"
        found.append({"event": event, "mu": float(mu[k]), "mu_before": before, "text": f"{text} {where}"})

    for k in [k for k, text in enumerate(table.get("status", ())) if text == SWITCHED]:
        add(k, "bifurcation", "the branch became unstable and the path went over to the stable one")
    for k in range(1, len(mu)):
        if pivots[k] != pivots[k - 1]:
            add(k, "bifurcation", f"negative pivots of the tangent go from {pivots[k - 1]} to {pivots[k]}")
    for name, ratio in (("crease", CREASE_RATIO), ("wrinkle", WRINKLE_RATIO)):
        for k in np.flatnonzero(np.asarray(table["surface_ratio"]) > ratio)[:1]:
            add(k, name, f"a hole's surface is compressed past the {name} limit (stretch ratio {ratio})")
    for k in [k for k, text in enumerate(table.get("status", ())) if text == IN_CONTACT][:1]:
        add(k, "contact", "a hole's sides first touch")
    for k in np.flatnonzero(np.asarray(table["min_gap"]) <= 0)[:1]:
        add(k, "self-contact", "a hole's boundary touches itself")
    return sorted(found, key=lambda e: e["mu"])


class Recorder:
    """Writes ``summary.json``, ``history.csv`` and ``states.npz`` of a sweep while it goes; pass it as ``on_step``.

    ``case`` is the `cases.Case` behind ``model`` and ``gel``. Earlier results in ``folder`` are removed, other files stay.
    Raises ValueError when the folder cannot be written.
    """

    def __init__(self, folder, case, model, gel):
        self.folder, self.case, self.model, self.gel = open_folder(folder), case, _of_case(model, case), gel
        self.records = []  # (step, row, outlines) of each accepted state
        self.started = time.perf_counter()
        _clear(self.folder)
        self._write_history()
        self._write_summary("running", "the sweep has not ended")

    @property
    def steps(self):
        """The accepted steps so far."""
        return [step for step, _, _ in self.records]

    @property
    def table(self):
        """The columns of ``history.csv`` so far."""
        return {name: [row[name] for _, row, _ in self.records] for name in COLUMNS}

    def __call__(self, step):
        """Take one accepted step to disk."""
        one = Path.from_steps(self.model, self.gel, [step], stop=step.status)
        row = {name: column[0] for name, column in history(one).items()}
        if self.records and self.records[-1][1]["status"] == SELF_CONTACT:
            row["status"] = SELF_CONTACT
        elif step.switched and row["status"] != SELF_CONTACT:
            row["status"] = SWITCHED
        self.records.append((step, row, [np.asarray(loop)[0] for loop in outlines(one)]))
        write_atomically(self.folder / "states.npz", lambda stream: np.savez(stream, **self._states()))
        with (self.folder / "history.csv").open("a", newline="") as stream:
            _csv_writer(stream).writerow(_csv_row(row))
            stream.flush()
            os.fsync(stream.fileno())
        self._write_summary("running", "the sweep has not ended")

    def finish(self, status, text):
        """Close the record with ``status`` "complete", "stopped", "interrupted" or "failed", and the reason as ``text``."""
        self._write_history()
        self._write_summary(status, text)

    def _states(self):
        steps = self.steps
        arrays = {name: np.array([getattr(step, name) for step in steps]) for name in STEP_ARRAYS}
        arrays["status"] = np.array([step.status.name for step in steps])
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

    def _write_summary(self, status, text):
        table = self.table
        summary = {
            "format": FORMAT,
            "case": self.case.name,
            "options": self.case.table(),
            "versions": {name: version(name) for name in ("jaxgel", "jax", "jaxlib", "numpy", "scipy")}
            | {"python": platform.python_version(), "platform": platform.platform()},
            "nodes": len(self.model.cloud.nodes),
            "cells": int(self.model.n_cells),
            "quadrature_points": int(self.model.n_points),
            "status": status,
            "reason": text,
            "wall_seconds": round(time.perf_counter() - self.started, 3),
            "states": len(self.records),
            "mu_reached": float(table["mu"][-1]) if self.records else None,
            "events": events(table),
        }
        encoded = json.dumps(summary, indent=1, allow_nan=False, ensure_ascii=False).encode()
        write_atomically(self.folder / "summary.json", lambda stream: stream.write(encoded))


STEP_ARRAYS = ("mu", "x", "pressure", "newton_iterations", "residual", "energy", "negative_pivots", "lowest_eigenvalue", "switched")


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """A run's folder as read from disk; k states of n nodes."""

    folder: File
    """Where it lies."""
    summary: dict
    """Content of ``summary.json``."""
    history: dict
    """Columns of ``history.csv``: name -> (k,) array, status a list of texts."""
    states: dict
    """Arrays of ``states.npz``: mu (k,), x (k, n, 2) mm, pressure (k, g) kT/v, nodes (n, 2) mm, outline_0 ... (k, m, 2) mm."""

    @property
    def mu(self):
        """(k,) chemical potential in kT."""
        return self.states["mu"]

    @property
    def x(self):
        """(k, n, 2) deformed node positions in mm."""
        return self.states["x"]

    @property
    def outlines(self):
        """(k, m, 2) deformed outline of each hole, in mm, a list of closed loops as in `observables.outlines`."""
        return [self.states[f"outline_{i}"] for i in range(len(self.states)) if f"outline_{i}" in self.states]


def load_run(folder, *, max_bytes=MAX_BYTES):
    """The `Run` in a folder written by `Recorder`, finished or not; nothing in it is executed or unpickled.

    Raises ValueError for a folder without a run, a damaged or foreign file, and one with more than ``max_bytes`` in a file.
    """
    folder = File(folder)
    if not (folder / "summary.json").is_file():
        raise ValueError(f"folder: {str(folder)!r} holds no summary.json; expected a folder written by jaxgel run")
    summary = guarded(folder / "summary.json", _read_summary, max_bytes)
    table = guarded(folder / "history.csv", _read_history, max_bytes)
    states = guarded(folder / "states.npz", _read_states, max_bytes) if table["mu"].size else None
    if states is None:
        raise ValueError(f"folder: {str(folder)!r} holds no accepted state; its run ended as {summary['status']!r}: {summary['reason']}")
    k = min(len(states["mu"]), len(table["mu"]))  # a run killed between two files leaves one row more in states.npz
    if not np.array_equal(states["mu"][:k], table["mu"][:k]):
        raise ValueError(f"folder: history.csv and states.npz in {str(folder)!r} are of different runs: their mu differ")
    states = {name: a if name == "nodes" else a[:k] for name, a in states.items()}
    return Run(folder, summary, {name: column[:k] for name, column in table.items()}, states)


def load_path(folder):
    """The `path.Path` of a run's folder, on the model built again from the options in its ``summary.json``.

    Raises ValueError as `load_run`, and when the nodes differ from the stored ones (written by another version).
    """
    run = load_run(folder)
    case = cases.from_table(run.summary["options"], run.summary["case"])
    model = _of_case(case.model(), case)
    nodes = np.asarray(model.cloud.nodes)
    if nodes.shape != run.states["nodes"].shape or np.abs(nodes - run.states["nodes"]).max() > 1e-9:
        raise ValueError(f"folder: the nodes in {str(run.folder)!r} are not those of this version of jaxgel; run the case again")
    steps = [_step(run.states, i) for i in range(len(run.mu))]
    return Path.from_steps(model, case.gel, steps, stop=steps[-1].status)


def _clear(folder):
    for name in FILES:
        (folder / name).unlink(missing_ok=True)
        (folder / f"{name}.part").unlink(missing_ok=True)
    if (folder / "vtu").is_dir():
        shutil.rmtree(folder / "vtu")


def _step(states, i):
    """The accepted step ``i`` of the arrays of ``states.npz``."""
    values = {name: states[name][i] if states[name].ndim > 1 else states[name][i].item() for name in STEP_ARRAYS}
    return Step(**values, status=Status[str(states["status"][i])])


def _status_texts(path, gap):
    """Status texts (k,) of a path, with the first self-contact and all that follows it invalid."""
    texts = [status.name.lower().replace("_", " ") for status in path.status]
    switched = getattr(path, "switched", np.zeros(len(texts), dtype=bool))
    touched = np.logical_or.accumulate(np.asarray(gap) <= 0)
    if path.model.contact is not None:
        texts = [IN_CONTACT if g < float(path.model.contact.range) else text for g, text in zip(gap, texts, strict=True)]
    return [SELF_CONTACT if t else SWITCHED if s else text for text, s, t in zip(texts, switched, touched, strict=True)]


def _of_case(model, case):
    """The model with the contact that the sweep of the case gives it."""
    return with_contact(model, case.gel) if case.sweep.contact == "on" else model


def _csv_writer(stream):
    return csv.writer(stream, lineterminator="\n")


def _csv_row(row):
    return [str(int(v)) if n in INTEGER_COLUMNS else v if n == "status" else repr(float(v)) for n, v in row.items()]


def _read_summary(content, _):
    summary = json.loads(content)
    wanted = {"format": int, "case": str, "options": dict, "status": str, "reason": str, "events": list}
    for key, kind in wanted.items():
        if not isinstance(summary[key], kind):
            raise ValueError(f"{key} is not of type {kind.__name__}")
    if summary["format"] != FORMAT:
        raise ValueError(f"format {summary['format']}, this version reads {FORMAT}")
    return summary


def _read_history(content, _):
    lines = content.decode().splitlines(keepends=True)
    complete = [line for line in lines if line.endswith("\n")]  # the last row may have been cut off with the machine
    header, *rows = csv.reader(complete)
    if tuple(header) != COLUMNS or any(len(row) != len(COLUMNS) for row in rows):
        raise ValueError(f"columns are not {', '.join(COLUMNS)}")
    columns = {name: [row[i] for row in rows] for i, name in enumerate(COLUMNS)}
    kinds = {name: int if name in INTEGER_COLUMNS else float for name in COLUMNS}
    return {name: c if name == "status" else np.array(c, dtype=float).astype(kinds[name]) for name, c in columns.items()}


def _read_states(content, max_bytes):
    arrays = read_arrays(content, max_bytes)
    (k, n, _), groups = arrays["x"].shape, arrays["pressure"].shape[1]
    shapes = dict.fromkeys((*STEP_ARRAYS, "status"), (k,)) | {"x": (k, n, 2), "pressure": (k, groups), "nodes": (n, 2)}
    shapes |= {name: (k, a.shape[1], 2) for name, a in arrays.items() if name.startswith("outline_")}
    for name, shape in shapes.items():
        if arrays[name].shape != shape or arrays[name].dtype.kind not in "bfiU":
            raise ValueError(f"{name} has shape {arrays[name].shape}, expected {shape}")
    if not np.isfinite(arrays["x"]).all():
        raise ValueError("x is not finite")
    return arrays


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
