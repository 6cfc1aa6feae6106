"""Runs of a design study: one or several searches, and verification of the best design.

A study's folder holds best.toml (a case), verified.json, design.png (unless figures are off) and
design.json, the log of the search. A field that was found is in best.toml, a number for each pixel,
and in Nv.png or chi.png, black at its lower bound and white at its upper one; verified.json and
starts.csv leave its numbers out. With several ``starts`` in [search], starts.json (the study and
all start values), starts.csv (the table of optima, one row for each start), optima.png (its
picture, unless figures are off) and a folder for each search, starts/001, 002 ..., take the place
of design.json; such a folder has the search's own design.json and, once it has ended, start.json.
See `starts` for those.
"""

import concurrent.futures
import dataclasses
from pathlib import Path as File
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..continuation import devices_of
from ..design import Design, Outcome, read_log
from ..io import (
    InThisProcess,
    open_folder,
    read_record,
    write_atomically,
    write_grey,
    write_json,
)
from .as_made import SAMPLES, as_made
from .starts import FORMAT, STARTS, best_of_starts
from .study import Study, study_from_table
from .toml import case_text, explicit

VERIFIED = "verified.json"


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
        study, design = best_of_starts(
            study,
            open_folder(folder),
            devices,
            executor or InThisProcess(),
            resume=resume,
            quiet=quiet,
        )
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
