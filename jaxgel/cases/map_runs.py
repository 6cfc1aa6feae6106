"""Runs of a parameter map: one sweep at each of its points, on any ``concurrent.futures.Executor``.

Its folder holds map.json (the study and its points), points.csv (one row for each point that has
ended), problem.json (the parameters as SALib describes them, see `salib`) and a folder for each
point in the format of a run, 0000, 0001 ..., with point.json (its row) once it has ended; jaxgel
plot draws one of them. All points share the cloud of the study's own plate, placed on their holes,
and with it all compiled programs: put the case in the middle of its parameters' range. A point too
far away for that, if outlines move by more than about a third of the spacing, gets a cloud of its
own, and costs its compilation and about 0.2 GB of memory for programs.

With a ``device`` a compiled program sweeps the points in batches first, see `batches`, and the host
those that it leaves; the column ``solver`` says which.

Processes of a cluster, of MPI or Dask, must have access to the folder; let each use one thread
(OMP_NUM_THREADS=1, NPROC=1; a gradient needs two).
"""

import concurrent.futures
import functools
import json
import math
import time
import warnings
from pathlib import Path as File
from typing import Any

import numpy as np
from tqdm import tqdm

from ..continuation import Path, devices_of
from ..equilibrium import Observer
from ..io import (
    Recorder,
    failure,
    interruptible,
    one_line,
    open_folder,
    read_record,
    run_calls,
    write_csv,
    write_json,
)
from ..observables import COLUMNS
from .batches import Batches
from .parameter_map import FORMAT, MAP, MapStudy, map_from_table, resumed_map
from .parameters import components
from .response import Response, derivative_columns
from .resume import path_of
from .salib import PROBLEM, salib_problem

POINT, TABLE = "point.json", "points.csv"
# columns of history.csv of which points.csv has the last state's
LAST = COLUMNS[COLUMNS.index("energy") :]


def run_map(
    study: MapStudy,
    folder: File | str,
    executor: concurrent.futures.Executor,
    *,
    device: str | None = None,
    resume: bool = False,
    quiet: bool = True,
) -> list[dict[str, Any]]:
    """Run the points of a `MapStudy` on an executor and write its folder.

    The list of rows of points.csv, dicts, by point. Points that have ended, complete, stopped early
    or failed, are not run again; ``resume`` says that there may be such. A call that ends with an
    exception was lost by the executor, as a point's own are in its row: it is submitted again, and
    after `TRIES` times the point's row says "lost". Ctrl-C (KeyboardInterrupt) ends the calls under
    way and leaves what has ended. ``device``, one of ``DEVICES``, sweeps in batches what it can.
    ValueError for a study whose plate cannot be discretised, for a folder with another map, or with
    this one if not resumed, and for a device that is not there, or a sweep not for it.
    """
    cloud, devices = study.case.cloud(), devices_of(device)
    batches = Batches(study, cloud, devices) if devices else None
    folder = open_folder(folder)
    _begin(study, folder, resume)
    write_json(folder / PROBLEM, salib_problem(study.names, study.bounds))
    records = {k: read_record(folder / _name(k) / POINT, FORMAT) for k in range(len(study.points))}
    ended = {k: record["row"] for k, record in records.items() if record and "row" in record}
    text = json.dumps({"name": study.name, "study": study.table})
    calls = {k: (text, point, str(folder / _name(k))) for k, point in enumerate(study.points)}

    def lost(reason):
        """Row of a point whose process was lost too often."""
        return _row("lost", None, reason)

    def write(rows):
        _write_table(study, rows, folder)

    if batches is not None:
        left = {k: study.points[k] for k in calls if k not in ended}
        ended |= _swept_in_batches(batches, left, folder, ended, write, quiet)
    rows = run_calls(
        run_point, calls, executor, ended=ended, lost=lost, write=write, unit="point", quiet=quiet
    )
    return [rows[k] for k in sorted(rows)]


def run_point(text: str, values: dict, folder: str) -> dict:
    """Sweep one point, write its folder and return its row, a dict.

    What goes wrong in the point itself is part of the row. ``text`` is JSON with the study's name
    and table, ``values`` a point. For an executor's processes.
    """
    study, cloud = _prepared(text)
    began, recorder, steps, place = time.perf_counter(), None, [], open_folder(folder)
    derivatives = {}
    (place / POINT).unlink(missing_ok=True)
    try:
        case = study.at(values)
        model = case.model(cloud)
        recorder = Recorder(place, case, case.problem(model))
        try:
            path = path_of(recorder, Observer(accepted=steps.append))
        finally:
            recorder.begin(steps)
        status, reason = "complete" if path.stop.ok else "stopped", path.stop_text
        if study.gradients and path.stop.ok:
            derivatives, why = _derivatives(Response(study, cloud), values, path)
            reason = "; ".join([reason, *why])
    except (OSError, MemoryError):
        raise  # not the point's fault
    except Exception as problem:
        status, reason = "failed", failure(problem, place)
    if recorder is not None:
        recorder.finish(status, reason)
    row = _row(status, recorder, reason, derivatives, "host", time.perf_counter() - began)
    write_json(place / POINT, {"format": FORMAT, "values": values, "row": row})
    return row


def _swept_in_batches(batches, points, folder, ended, write, quiet):
    """Rows of the ``points`` that a compiled program has swept to their ends, by number.

    Their folders are written batch by batch, the table with those that had ``ended`` before.
    """
    rows: dict[int, dict] = {}
    with (
        tqdm(total=len(points), unit="point", disable=True if quiet else None, leave=False) as bar,
        interruptible() as stop_if_asked,
    ):
        began = time.perf_counter()
        for found in batches.swept(points):
            each = (time.perf_counter() - began) / len(found)
            for k, point in found.items():
                if point is not None:
                    rows[k] = _written(batches.study, points[k], point, folder / _name(k), each)
                stop_if_asked()
            write(ended | rows)
            bar.update(len(found))
            began = time.perf_counter()
    return rows


def _written(study, values, point, folder, seconds):
    """The row of a `BatchPoint`, whose folder is written; ``seconds`` were spent on it."""
    place, path = open_folder(folder), point.path
    (place / POINT).unlink(missing_ok=True)
    recorder = Recorder(place, point.case, path.problem)
    recorder.begin([path[k] for k in range(len(path))])
    recorder.finish("complete", path.stop_text, path.stop)
    derivatives, reasons = {}, [path.stop_text]
    if study.gradients:
        if point.jacobian is None:
            derivatives, why = _derivatives(Response(study, path.model.cloud), values, path)
            reasons += why
        else:
            derivatives = _by_column(study.names, point.jacobian)
    reason = "; ".join(reasons)
    row = _row("complete", recorder, reason, derivatives, "program", seconds)
    write_json(place / POINT, {"format": FORMAT, "values": values, "row": row})
    return row


def _row(status, recorder, reason, derivatives=None, solver=None, seconds=None):
    """Row of a point by the recorder of its run, None if it has none."""
    return dict(
        status=status,
        **_last_state(recorder),
        **(derivatives or {}),
        solver=solver,
        seconds=None if seconds is None else round(seconds, 3),
        reason=reason,
    )


@functools.lru_cache(maxsize=1)
def _prepared(text):
    """Study and cloud, made once in a process, so that its compiled programs serve all points."""
    record = json.loads(text)
    study = map_from_table(record["study"], record["name"], [])
    return study, study.case.cloud()


def _last_state(recorder):
    """Part of a row: how far the sweep came and what its last state is."""
    records = recorder.records if recorder is not None else []
    last = {name: float(records[-1][1][name]) if records else None for name in ("mu", *LAST)}
    iterations = sum(int(step.newton_iterations) for step, _, _ in records)
    last = {
        name: value if value is not None and math.isfinite(value) else None
        for name, value in last.items()
    }
    value = float(records[-1][0].value) if records else None
    return dict(
        value_reached=value,
        mu_reached=last.pop("mu"),
        states=len(records),
        newton_iterations=iterations,
        **last,
    )


def _derivatives(
    response: Response, values: dict, path: Path
) -> tuple[dict[str, float | None], list[str]]:
    """Part of a row: the derivatives at the last state of a point's path, by column.

    And the warnings of them, each one line.
    """
    names = response.study.names
    with warnings.catch_warnings(record=True) as raised:
        warnings.simplefilter("always")
        try:
            rows = response.jacobian([*components(values).values()], path)
        except ArithmeticError as problem:
            return {}, [f"no derivatives: {one_line(problem)}"]
    return _by_column(names, rows), [one_line(warning.message) for warning in raised]


def _by_column(names, rows):
    """Derivatives (r, d) by column, None for those that are no numbers."""
    columns = derivative_columns(names).values()
    return {
        column: d if math.isfinite(d) else None
        for column, d in zip(columns, np.ravel(rows).tolist(), strict=True)
    }


def _name(k):
    return f"{k:04d}"


def _begin(study, folder, resume):
    """Write map.json, or check that it is this study's."""
    record = {"format": FORMAT, "name": study.name, "study": study.table, "points": study.points}
    file = folder / MAP
    if file.exists():
        if not resume:
            raise ValueError(
                f"out: {str(folder)!r} holds a map already; resume it (--resume), or give another "
                "folder"
            )
        known = resumed_map(folder)
        if (known.table, known.points) != (study.table, study.points):
            raise ValueError(
                f"out: {MAP} in {str(folder)!r} is of another study; give another folder"
            )
    else:
        write_json(file, record)


def _write_table(study, rows, folder):
    """points.csv, whole or not at all.

    The value reached of another control than mu comes before that of mu. Rows that an earlier
    version wrote have no value in a column that came later.
    """
    driven = () if study.case.sweep.control == "mu" else ("value_reached",)
    derivatives = derivative_columns(study.names).values() if study.gradients else ()
    columns = (
        *driven,
        "mu_reached",
        "states",
        "newton_iterations",
        *LAST,
        *derivatives,
        "solver",
        "seconds",
        "reason",
    )
    varied = {
        k: components({p["name"]: study.points[k][p["name"]] for p in study.parameters})
        for k in rows
    }
    lines = [
        [k, row["status"], *varied[k].values(), *(row.get(name) for name in columns)]
        for k, row in sorted(rows.items())
    ]
    write_csv(folder / TABLE, ["point", "status", *study.names, *columns], lines)
