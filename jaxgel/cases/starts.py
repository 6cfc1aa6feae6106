"""Searches of a study from several starts: starts.json, the table of optima and its picture.

Start 1 has the study's own values. The others are the first points of a scrambled Sobol sequence
within the bounds whose plates can be made and meet the constraints on the dry plate. The searches
run on any ``concurrent.futures.Executor``, as the points of a map do (see `map_runs`), but their
gradients need two threads of XLA (OMP_NUM_THREADS=1, NPROC=2). On devices they run in this process,
and one compiled program evaluates their designs in batches, see `design.Together`.
"""

import dataclasses
import functools
import json
import time
from concurrent.futures import Executor
from pathlib import Path as File
from typing import Any

import numpy as np
from tqdm import tqdm

from .._validation import Inadmissible
from ..continuation import Device
from ..design import FEASIBLE, Design, Outcome, Together
from ..io import (
    failure,
    one_line,
    open_folder,
    read_record,
    run_calls,
    write_atomically,
    write_csv,
    write_json,
)
from .parameters import components, sobol
from .study import Study, study_from_table

OPTIMA, PICTURE = "starts.csv", "optima.png"
STARTS, START = "starts.json", "start.json"
FORMAT = 1  # of starts.json and start.json
DRAWS = 50  # points of the sequence, for each start, among which valid plates are looked for
COLUMNS = (
    "start",
    "outcome",
    "start_value",
    "best_value",
    "feasible",
    "evaluations",
    "distance",
    "seconds",
    "reason",
)


def run_start(text: str, folder: str, member: Any = None) -> dict[str, Any]:
    """Run or continue one of several searches in its folder.

    A dict of ``outcome``, ``reason``, ``seconds`` and ``design``. ``text`` is JSON with the study's
    name and table; ``design`` has the fields of `Design`, and is None if the search failed, for the
    ``reason`` given. For an executor's processes, or as a ``member`` of searches in this one.
    """
    record, place, began = json.loads(text), open_folder(folder), time.perf_counter()
    outcome, reason, design = "failed", "", None
    try:
        found = study_from_table(record["study"], record["name"]).run(
            place, resume=(place / "design.json").exists(), member=member
        )
        if found.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt
        outcome, design = str(found.outcome), dataclasses.asdict(found)
        design["parameters"] = {
            name: np.asarray(value).tolist() for name, value in found.parameters.items()
        }
    except (OSError, MemoryError):
        raise  # not the start's fault
    except Exception as problem:
        reason = failure(problem, place)
    result = dict(
        outcome=outcome, reason=reason, seconds=round(time.perf_counter() - began, 3), design=design
    )
    write_json(place / START, {"format": FORMAT, "study": record["study"], "result": result})
    return result


def draw_starts(study: Study, *, quiet: bool = True) -> list[dict[str, Any]]:
    """Start values (name -> number or list) of every search of a study, its own first.

    With a progress bar unless ``quiet``. ValueError if too few are valid plates.
    """
    problem, starts, reason = study.problem, [study.problem.start], ""
    tried = DRAWS * (study.starts - 1)
    points = sobol(len(problem.vector), tried, study.seed) if tried else ()
    with tqdm(
        total=study.starts, initial=1, desc="valid starts", disable=quiet or None, leave=False
    ) as bar:
        for point in points:
            if len(starts) == study.starts:
                break
            parameters = problem.parameters(point)
            try:
                problem.check_dry(parameters)
                starts.append(parameters)
                bar.update()
            except Inadmissible as invalid:
                reason = one_line(invalid)
    if len(starts) < study.starts:
        raise ValueError(
            f"search.starts: {study.starts} is too many, only {len(starts) - 1} of {tried} draws "
            "within the bounds are valid plates "
            f"(the last that is not: {reason}); give fewer starts or other bounds"
        )
    return [{name: np.asarray(value).tolist() for name, value in start.items()} for start in starts]


def _on(executor):
    """Function like `run_calls` that runs `run_start` on an executor."""
    return functools.partial(run_calls, run_start, executor=executor, unit="start")


def _together(study, devices):
    """Function like `_on` for searches in this process, evaluated by one program."""

    def run(calls, *, ended, write, quiet, **_):
        problem, results = study.problem, dict(ended)
        left = {key: call for key, call in calls.items() if key not in results}
        write(results)
        if left:
            cloud = problem.make_cloud(problem.plate(problem.start))
            searches = {key: functools.partial(run_start, *call) for key, call in left.items()}
            found = Together(problem, cloud, devices).run(searches)
            for key, result in tqdm(
                found, total=len(left), unit="start", disable=True if quiet else None, leave=False
            ):
                results[key] = result
                write(results)
        return results

    return run


def best_of_starts(
    study: Study,
    folder: File,
    devices: list[Device],
    executor: Executor,
    *,
    resume: bool,
    quiet: bool,
) -> tuple[Study, Design]:
    """The study of the best of several searches, and its `Design`.

    They run together on the ``devices``, or without these on the ``executor``.
    """
    run = _together(study, devices) if devices else _on(executor)
    starts = dict(enumerate(_begin(study, folder, resume, bool(devices), quiet), start=1))
    tables = {k: _from_start(study.table, start) for k, start in starts.items()}
    places = {k: folder / "starts" / f"{k:03d}" for k in starts}
    records = {k: read_record(place / START, FORMAT) or {} for k, place in places.items()}
    results = run(
        {
            k: (json.dumps({"name": study.name, "study": table}), str(places[k]))
            for k, table in tables.items()
        },
        ended={
            k: record["result"] for k, record in records.items() if record.get("study") == tables[k]
        },
        lost=lambda reason: dict(outcome="lost", reason=reason, seconds=None, design=None),
        write=lambda results: _write_table(study.problem, starts, results, folder),
        quiet=quiet,
    )
    best = _best(study.problem, results)
    if best is None:
        raise ValueError(
            f"search.starts: none of {len(starts)} is a valid design; start 1: "
            f"{results[1]['reason']}; see {folder / OPTIMA}"
        )
    if study.case.output.figures:
        _draw_optima(study.problem, results, folder)
    found = dict(results[best]["design"])
    found |= dict(
        outcome=Outcome(found["outcome"]),
        parameters={name: np.asarray(v) for name, v in found["parameters"].items()},
    )
    return study_from_table(tables[best], study.name), Design(**found)


def _begin(study, folder, resume, together, quiet=True):
    """Start values of all searches, those of starts.json if it has them, otherwise drawn.

    All are in starts.json then, and whether the searches share a cloud, as those ``together`` do.
    """
    file, starts = folder / STARTS, []
    if file.exists():
        if not resume:
            raise ValueError(
                f"out: {str(folder)!r} holds searches already; resume them (--resume), or give "
                "another folder"
            )
        known = read_record(file, FORMAT) or {}
        if _without_effort(known.get("study", {})) != _without_effort(
            json.loads(json.dumps(study.table))
        ):
            raise ValueError(
                f"out: {STARTS} in {str(folder)!r} is damaged or of another study; give another "
                "folder"
            )
        if known.get("together", False) != together:
            raise ValueError(
                f"out: the searches in {str(folder)!r} share "
                + ("no cloud; resume them without" if together else "a cloud; resume them with")
                + " --device"
            )
        starts = known["starts"][: study.starts]
    if len(starts) < study.starts:
        starts += draw_starts(study, quiet=quiet)[len(starts) :]
    record = {"format": FORMAT, "name": study.name, "study": study.table, "starts": starts}
    write_json(file, record | {"together": together})
    return starts


def _without_effort(table):
    """A study's table without the entries that may change when its searches are resumed.

    These are their number, evaluations, verification and figures.
    """
    search = {
        key: value
        for key, value in table.get("search", {}).items()
        if key not in ("starts", "evaluations")
    }
    return {key: value for key, value in table.items() if key not in ("verification", "output")} | {
        "search": search
    }


def _from_start(table, start):
    """The table of a study, as JSON gives it, of a single search from these start values."""
    search = {key: value for key, value in table["search"].items() if key not in ("starts", "seed")}
    parameters = [
        entry | {"start": start[entry.get("name", entry["of"])]} for entry in table["parameters"]
    ]
    return json.loads(json.dumps(table | {"search": search, "parameters": parameters}))


def _best(problem, results):
    """Number of the search with the best design, if possible feasible; None if all failed.

    Otherwise it has the least violation.
    """

    def worth(k):
        found = results[k]["design"]
        return max(problem.violation(found["constraints"]), FEASIBLE), -found[
            "value"
        ] if problem.maximise else found["value"]

    return min(
        (k for k in sorted(results) if results[k]["design"] is not None), key=worth, default=None
    )


def _write_table(problem, starts, results, folder):
    """starts.csv: a row for every completed search, with start values and best parameters."""
    best, names = _best(problem, results), components(starts[1])
    rows = []
    for k, result in sorted(results.items()):
        row, found, start = (
            dict.fromkeys(COLUMNS) | {"start": k} | result,
            result["design"],
            components(starts[k]),
        )
        own = dict.fromkeys(names) if found is None else components(found["parameters"])
        if found is not None:
            distance = problem.distance(found["parameters"], results[best]["design"]["parameters"])
            row |= dict(
                start_value=found["history"][0]["value"],
                best_value=found["value"],
                distance=round(distance, 6),
            )
            row |= dict(feasible=found["feasible"], evaluations=len(found["history"]))
        rows.append(
            [
                *(row[name] for name in COLUMNS),
                *(values[name] for values in (start, own) for name in names),
            ]
        )
    write_csv(
        folder / OPTIMA,
        [*COLUMNS, *(f"start_{name}" for name in names), *(f"best_{name}" for name in names)],
        rows,
    )


def _draw_optima(problem, results, folder):
    """optima.png: the best designs of all searches that have one; fields are left out."""
    from ..plotting import draw_optima

    designs = [result["design"] for _, result in sorted(results.items()) if result["design"]]
    lower, upper = (
        components({name: sides[end] for name, sides in problem.bounds.items()}) for end in (0, 1)
    )
    if not lower:
        return
    low, high = np.array(list(lower.values())), np.array(list(upper.values()))
    best = [components(design["parameters"]) for design in designs]
    found = np.array([[own[name] for name in lower] for own in best])
    figure = draw_optima(
        list(lower),
        (found - low) / (high - low),
        np.array([design["value"] for design in designs]),
        np.array([design["history"][0]["value"] for design in designs], dtype=float),
        np.array([design["feasible"] for design in designs]),
    )
    write_atomically(folder / PICTURE, lambda stream: figure.savefig(stream, format="png"))
