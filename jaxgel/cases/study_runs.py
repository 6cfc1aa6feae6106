"""Runs of a design study: one or several searches, and verification of the best design.

A study's folder holds best.toml (a case), verified.json, design.png (unless figures are off) and
design.json, the log of the search. A field that was found is in best.toml, a number for each pixel,
and in Nv.png or chi.png, black at its lower bound and white at its upper one; verified.json and
starts.csv leave its numbers out. With several ``starts`` in [search], starts.json (the study and
all start values), starts.csv (the table of optima, one row for each start), optima.png (its
picture, unless figures are off) and a folder for each search, starts/001, 002 ..., take the place
of design.json; such a folder has the search's own design.json and, once it has ended, start.json.
Start 1 has the study's own values. The others are
the first points of a scrambled Sobol sequence within the bounds whose plates can be made and meet
the constraints on the dry plate.

The searches run on any ``concurrent.futures.Executor``, as the points of a map do (see `map_runs`),
but their gradients need two threads of XLA (OMP_NUM_THREADS=1, NPROC=2). With a ``device`` they run
in this process, and one compiled program evaluates their designs in batches, see `design.Together`.
"""

import concurrent.futures
import dataclasses
import functools
import json
import time
from pathlib import Path as File
from typing import Any

import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from .._validation import Inadmissible
from ..continuation import devices_of
from ..design import FEASIBLE, Design, Outcome, Together, read_log
from ..io import (
    InThisProcess,
    failure,
    one_line,
    open_folder,
    read_record,
    run_calls,
    write_atomically,
    write_csv,
    write_grey,
    write_json,
)
from .as_made import SAMPLES, as_made
from .parameters import components, sobol
from .study import Study, study_from_table
from .toml import case_text, explicit

VERIFIED, OPTIMA, PICTURE = "verified.json", "starts.csv", "optima.png"
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


def run_study(
    study: Study,
    folder: File | str,
    *,
    executor: concurrent.futures.Executor | None = None,
    device: str | None = None,
    resume: bool = False,
    quiet: bool = True,
) -> tuple[Design, dict[str, Any] | None]:
    """Search, verify on a fresh cloud, and write the folder as described at the top of this module.

    Returns the `Design` and the content of verified.json: ``start`` and ``best``, each as `verify`
    gives it. An interrupted search leaves its log alone: None in place of the content. Several
    starts run on the ``executor``, by default in this process, one after another, or together on a
    ``device`` of ``DEVICES``, and the result is that of the best of them, the others are rows of
    starts.csv; their interruption is a KeyboardInterrupt. Searches that have ended are not run
    again; ``resume`` says that there may be such. ValueError if no start is a valid design, and for
    a device and a single start.
    """
    folder, devices = File(folder), devices_of(device)
    if study.starts > 1:
        run = _run_together(study, devices) if devices else _run_on(executor or InThisProcess())
        study, design = _best_of_starts(study, open_folder(folder), run, resume, quiet)
    elif device is not None:
        raise ValueError(
            f"device: {device!r} is for several searches at once; give search.starts, or leave "
            "--device out"
        )
    else:
        design = study.run(folder, resume=resume, quiet=quiet)
    return design, None if design.outcome is Outcome.INTERRUPTED else _verified(
        study, design, folder
    )


def resumed_study(folder: File | str) -> Study:
    """The `Study` whose searches lie in a folder; ValueError if there are none."""
    record = read_record(File(folder) / STARTS, FORMAT) or read_log(folder)["record"]
    if "study" not in record:
        raise ValueError(
            f"folder: {str(folder)!r} was not written by jaxgel design; resume it where its "
            "problem was made"
        )
    return study_from_table(record["study"], str(record.get("name", "design")))


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


def draw_starts(study: Study) -> list[dict[str, Any]]:
    """Start values (name -> number or list) of every search of a study, its own first.

    ValueError if too few are valid plates.
    """
    problem, starts, reason = study.problem, [study.problem.start], ""
    tried = DRAWS * (study.starts - 1)
    for point in sobol(len(problem.vector), tried, study.seed) if tried else ():
        if len(starts) == study.starts:
            break
        parameters = problem.parameters(point)
        try:
            problem.check_dry(parameters)
            starts.append(parameters)
        except Inadmissible as invalid:
            reason = one_line(invalid)
    if len(starts) < study.starts:
        raise ValueError(
            f"search.starts: {study.starts} is too many, only {len(starts) - 1} of {tried} draws "
            "within the bounds are valid plates "
            f"(the last that is not: {reason}); give fewer starts or other bounds"
        )
    return [{name: np.asarray(value).tolist() for name, value in start.items()} for start in starts]


def _run_on(executor):
    """Function like `run_calls` that runs `run_start` on an executor."""
    return functools.partial(run_calls, run_start, executor=executor, unit="start")


def _run_together(study, devices):
    """Function like `_run_on` for searches in this process, evaluated by one program."""

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


def _best_of_starts(study, folder, run, resume, quiet):
    """The study of the best of several searches, which ``run`` runs, and its `Design`."""
    starts = dict(enumerate(_begin(study, folder, resume), start=1))
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


def _begin(study, folder, resume):
    """Start values of all searches, those of starts.json if it has them, otherwise drawn.

    All are in starts.json then.
    """
    file, starts = folder / STARTS, draw_starts(study)
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
        starts[: len(known["starts"])] = known["starts"][: len(starts)]
    write_json(file, {"format": FORMAT, "name": study.name, "study": study.table, "starts": starts})
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


def _verified(study, design, folder):
    """Verify a study's start and `Design` on fresh clouds and write both into its folder.

    The content of verified.json.
    """
    plate = study.problem.plate({name: jnp.asarray(v) for name, v in design.parameters.items()})
    pictures = {
        of: np.asarray(field.values(design.parameters[name]))
        for name, (of, field) in study.fields.items()
    }
    case = _found(study, plate, study.problem.gel_at(design.parameters), pictures)
    text = case_text(explicit(case))
    write_atomically(folder / "best.toml", lambda stream: stream.write(text.encode()))
    for of, field in study.fields.values():
        shares = (pictures[of] - field.lower) / (field.upper - field.lower)
        write_grey(shares, (plate.width, plate.height), folder / f"{of}.png")
    best, best_path = study.verify(design.parameters, scale=abs(design.history[0]["value"]))
    start, start_path = study.verify(study.problem.start, spacing=best["spacing"])
    verified = dict(
        study=study.name,
        parameters={
            name: np.asarray(v).tolist()
            for name, v in design.parameters.items()
            if name not in study.fields
        },
        search=dict(
            value=design.value,
            feasible=design.feasible,
            outcome=str(design.outcome),
            evaluations=len(design.history),
        )
        | ({"reported": design.reported} if design.reported else {}),
        start=start,
        best=best,
    )
    options = study.table.get("verification", {})
    if "uncertainty" in options:
        case = dataclasses.replace(case, plate=dataclasses.replace(plate, reference=None))
        verified["as_made"] = as_made(
            study.problem, case, options["uncertainty"], options.get("samples", SAMPLES)
        )
    write_json(folder / VERIFIED, verified)
    if study.case.output.figures:
        from ..plotting import draw_study

        figure = draw_study(study, design, start_path, best_path)
        write_atomically(folder / "design.png", lambda stream: figure.savefig(stream, format="png"))
    return verified


def _found(study, plate, gel, pictures):
    """The `cases.Case` of a concrete plate and gel, on the cloud of the verification.

    The values of its fields are given by name.
    """
    fields = {
        of: {"with_holes": True} if field.with_holes else {} for of, field in study.fields.values()
    }
    fields = {
        of: {"values": pictures[of].tolist(), "smooth": True} | moves
        for of, moves in fields.items()
    }
    source = study.case.source | (
        {"gel": study.case.source.get("gel", {}) | fields} if fields else {}
    )
    sweep = study.case.sweep.at(study.problem.mu)
    cloud = study.case.discretisation.at_spacing(float(np.min(study.verification["spacing"])))
    return dataclasses.replace(
        study.case,
        name="best",
        plate=plate,
        gel=gel,
        sweep=sweep,
        discretisation=cloud,
        source=source,
    )
