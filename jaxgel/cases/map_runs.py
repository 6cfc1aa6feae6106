"""Runs of a parameter map: one sweep at each of its points, on any ``concurrent.futures.Executor``.

Its folder holds map.json (the study and its points), points.csv (one row for each point that has ended) and a folder for each point
in the format of a run, 0000, 0001 ..., with point.json (its row) once it has ended; jaxgel plot draws one of
them. All points share the cloud of the study's own plate, placed on their holes, and with it all compiled programs: put the case in the
middle of its parameters' range. A point too far away for that, where outlines move by more than about a third of the spacing, gets a cloud
of its own (``own_cloud`` in its row), and costs its compilation and about 0.2 GB of memory for programs; `Workers` then take a new process.

A cluster under MPI (mpi4py) runs a map by ``mpiexec -n 65 python -m mpi4py.futures script.py`` with the script

    from mpi4py.futures import MPIPoolExecutor
    from jaxgel.cases import load_map, run_map

    if __name__ == "__main__":
        with MPIPoolExecutor() as executor:
            run_map(load_map("study.toml"), "out/study", executor)

Its processes, and those of Dask, must see the folder; let each use one thread (OMP_NUM_THREADS=1, NPROC=1; a
gradient would need two).
"""

import collections
import concurrent.futures
import csv
import functools
import io
import json
import math
import time
from pathlib import Path as File
from typing import Any

import numpy as np
from tqdm import tqdm

from ..io import Recorder, interruptible, open_folder, write_atomically
from ..observables import COLUMNS
from .parameter_map import FORMAT, MAP, MapStudy, map_from_table, resumed_map

POINT, TABLE = "point.json", "points.csv"
TRIES = 3  # times that a point is begun, as its process may be killed
LAST = COLUMNS[COLUMNS.index("energy") :]  # columns of history.csv of which points.csv has the last state's


def run_map(
    study: MapStudy, folder: File | str, executor: concurrent.futures.Executor, *, resume: bool = False, quiet: bool = True
) -> list[dict[str, Any]]:
    """Run the points of a `MapStudy` on an executor and write its folder; the list of rows of points.csv, dicts, by point.

    Points that have ended, complete, stopped early or failed, are not run again; ``resume`` says that there may be such. A call that
    ends with an exception was lost by the executor, as a point's own are in its row: it is submitted again, and after ``TRIES`` times
    the point's row says "lost". Ctrl-C (KeyboardInterrupt) ends the calls under way and leaves what has ended. ValueError for
    a study whose plate cannot be discretised, and for a folder with another map, or with this one if not resumed.
    """
    study.case.cloud()
    folder = open_folder(folder)
    _begin(study, folder, resume)
    rows = {k: row for k in range(len(study.points)) if (row := _ended(folder / _name(k))) is not None}
    text, tries, under_way = json.dumps({"name": study.name, "study": study.table}), collections.Counter(), {}

    def submit(k):
        tries[k] += 1
        under_way[executor.submit(run_point, text, study.points[k], str(folder / _name(k)))] = k

    def show():
        _write_table(study, rows, folder)
        bar.n = len(rows)
        bar.refresh()

    with tqdm(total=len(study.points), unit="point", disable=True if quiet else None, leave=False) as bar, interruptible() as stop_if_asked:
        show()
        try:
            for k in range(len(study.points)):
                if k not in rows:
                    submit(k)
            while under_way:
                for future in concurrent.futures.wait(under_way, return_when=concurrent.futures.FIRST_COMPLETED)[0]:
                    k = under_way.pop(future)
                    row = _outcome(future, tries[k])
                    if row is None:
                        submit(k)
                    else:
                        rows[k] = row
                stop_if_asked()
                show()
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            raise
    return [rows[k] for k in sorted(rows)]


def run_point(text: str, values: dict, folder: str) -> dict:
    """Sweep one point, write its folder and return its row, a dict; what goes wrong in the point itself is part of the row.

    ``text`` is JSON with the study's name and table, ``values`` a point. For an executor's processes.
    """
    study, cloud = _prepared(text)
    began, recorder, own, place = time.perf_counter(), None, False, open_folder(folder)
    (place / POINT).unlink(missing_ok=True)
    try:
        case = study.at(values)
        model = case.model(cloud)
        own = model.cloud.topology is not cloud.topology
        recorder = Recorder(place, case, model, case.gel, durable=False)
        path = case.path(model, on_step=recorder)
        status, reason = "complete" if path.stop.ok else "stopped", path.stop_text
    except (OSError, MemoryError):
        raise  # not the point's fault
    except Exception as problem:
        status, reason = "failed", " ".join(str(problem).split()) or type(problem).__name__
    if recorder is not None:
        recorder.finish(status, reason)
    row = dict(status=status, own_cloud=own, **_last_state(recorder), seconds=round(time.perf_counter() - began, 3), reason=reason)
    _write_json(place / POINT, {"format": FORMAT, "values": values, "row": row})
    return row


@functools.lru_cache(maxsize=1)
def _prepared(text):
    """Study and cloud, made once in a process, so that its compiled programs serve all points."""
    record = json.loads(text)
    study = map_from_table(record["study"], record["name"])
    return study, study.case.cloud()


def _last_state(recorder):
    """Part of a row: how far the sweep came and what its last state is."""
    records = recorder.records if recorder is not None else []
    last = {name: float(records[-1][1][name]) if records else None for name in ("mu", *LAST)}
    iterations = sum(int(step.newton_iterations) for step, _, _ in records)
    last = {name: value if value is not None and math.isfinite(value) else None for name, value in last.items()}
    return dict(mu_reached=last.pop("mu"), states=len(records), newton_iterations=iterations, **last)


def _name(k):
    return f"{k:04d}"


def _begin(study, folder, resume):
    """Write map.json, or see that it is this study's."""
    record = {"format": FORMAT, "name": study.name, "study": study.table, "points": study.points}
    file = folder / MAP
    if file.exists():
        if not resume:
            raise ValueError(f"out: {str(folder)!r} holds a map already; resume it (--resume), or give another folder")
        known = resumed_map(folder)
        if (known.table, known.points) != (study.table, study.points):
            raise ValueError(f"out: {MAP} in {str(folder)!r} is of another study; give another folder")
    else:
        _write_json(file, record)


def _ended(folder):
    """Row of a point that has ended, or None."""
    try:
        record = json.loads((folder / POINT).read_bytes())
        return record["row"] if record["format"] == FORMAT else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _outcome(future, tries):
    """Row of a call that has ended; None where the executor lost it and it is to be tried again."""
    try:
        return future.result()
    except Exception as problem:
        reason = f"its process was lost {tries} times: {' '.join(str(problem).split()) or type(problem).__name__}"
        return None if tries < TRIES else dict(status="lost", own_cloud=False, **_last_state(None), seconds=None, reason=reason)


def _write_table(study, rows, folder):
    """points.csv, whole or not at all."""
    table = io.StringIO(newline="")
    writer = csv.writer(table, lineterminator="\n")
    parameters = [(p["name"], component) for p in study.parameters for component in _components(p)]
    columns = ("mu_reached", "states", "newton_iterations", *LAST, "seconds", "reason")
    writer.writerow(["point", "status", *(name + "".join(f"_{i}" for i in component) for name, component in parameters), *columns])
    for k, row in sorted(rows.items()):
        point = {name: np.asarray(value) for name, value in study.points[k].items()}
        varied = [float(point[name][component]) for name, component in parameters]
        writer.writerow([k, row["status"], *varied, *("" if row[name] is None else row[name] for name in columns)])
    write_atomically(folder / TABLE, lambda stream: stream.write(table.getvalue().encode()))


def _write_json(file, record):
    encoded = json.dumps(record, indent=1, allow_nan=False).encode()
    write_atomically(file, lambda stream: stream.write(encoded))


def _components(p):
    return list(np.ndindex(np.shape(p["own"])))
