"""Commands that run many sweeps: design, map and paper."""

import collections
import contextlib
import csv
import functools
import sys
from argparse import Namespace
from pathlib import Path as File

import numpy as np

from .._kept import KEPT
from .._threads import usable_cores
from ..cases import OPTIMA, TABLE, MapStudy, Study, load_map, load_study, run_map, run_study
from ..io import Workers, dask_executor, open_folder
from .environment import DONE, INTERRUPTED, STOPPED, prepare_device, prepare_worker
from .runs import printer

# points of a map, or searches, in one process: the memory of a process grows with the number of its
# plates
CALLS_EACH = 50
# of XLA: a host callback waits on one for its arguments, which another one copies
GRADIENT_THREADS = 2
# columns of starts.csv
SHOWN = (
    "start",
    "start_value",
    "best_value",
    "feasible",
    "outcome",
    "evaluations",
    "distance",
    "reason",
)


def design(args: Namespace) -> int:
    """``jaxgel design``: search the best holes of a study, verify them, write its folder."""
    prepare_device(args.device)
    study = load_study(args.study)
    return run_design(study, args.out or File("out") / study.name, args)


def run_design(study: Study, folder: File | str, args: Namespace, resume: bool = False) -> int:
    """Search, verify and report a study; the exit code."""
    say, resume = printer(args), resume or getattr(args, "resume", False)
    device = getattr(args, "device", None)
    workers = _workers(args, GRADIENT_THREADS) if study.starts > 1 else contextlib.nullcontext()
    try:
        with workers as executor:
            found, verified = run_study(
                study,
                open_folder(folder),
                executor=executor,
                device=device,
                resume=resume,
                quiet=args.quiet,
            )
    except KeyboardInterrupt:
        verified = None
    if verified is None:
        again = "resume" if device is None else "design --resume --device"
        print(f"jaxgel: interrupted; jaxgel {again} goes on", file=sys.stderr)
        return INTERRUPTED
    if study.starts > 1:
        say(_optima(File(folder) / OPTIMA))
    say(f"{study.name}: {len(found.history)} evaluations; {found.text}")
    for name, value in found.parameters.items():
        text = (
            _field_text(study, name, value)
            if name in study.fields
            else np.array2string(value, precision=4, separator=", ")
        )
        say(f"{name:<12} {text}")
    for name in ("start", "best"):
        v = verified[name]
        value = "none" if v["value"] is None else f"{v['value']:.6g}{_bar(v, 'value')}"
        say(f"{name} on a fresh cloud of {v['nodes']} nodes: objective {value}; {v['reason']}")
    for name, value in found.reported.items():
        own = {key: verified[key]["reported"][name] for key in ("start", "best")}
        start, best = ("none" if number is None else f"{number:.6g}" for number in own.values())
        bar = _bar(verified["best"], "reported", name)
        say(
            f"{name:<12} {value:.6g} in the search; on a fresh cloud {best}{bar}, at the start "
            f"{start}"
        )
    if "as_made" in verified:
        say(_as_made(verified["as_made"]))
    say(f"results in {folder}")
    valid = found.feasible and verified["best"]["valid"]
    if not valid:
        reason = verified["best"]["reason"] if found.feasible else "no design met all constraints"
        print(f"jaxgel: the design is not usable: {reason}", file=sys.stderr)
    return DONE if valid else STOPPED


def _bar(found, *keys):
    """The error bar of a number of a verification, as text; empty if there is none."""
    bar = (
        functools.reduce(lambda table, key: table[key], keys, found["errors"])
        if "errors" in found
        else None
    )
    return "" if bar is None else f" +- {bar:.2g}"


def _as_made(found):
    """What the best design keeps of its value as it is made, in a line."""
    if found["mean"] is None:
        return f"as made: none of {found['samples']} samples has a value; {found['reason']}"
    rest = f", {found['invalid']} without a value ({found['reason']})" if found["invalid"] else ""
    numbers = f"{found['mean']:.6g} +- {found['deviation']:.2g}, worst {found['worst']:.6g}"
    return f"as made: objective {numbers} of {found['samples']} samples{rest}"


def _field_text(study, name, parameters):
    """What a field that was found is like, in a line."""
    of, field = study.fields[name]
    values = np.asarray(field.values(parameters))
    return (
        f"{of}: {values.shape[0]} x {values.shape[1]} pixels of {values.min():.4g} ... "
        f"{values.max():.4g}, see best.toml and {of}.png"
    )


def _optima(file):
    """The table of optima as text, without its parameters; its numbers shorter."""
    with file.open(newline="") as stream:
        rows = [{key: row[key] for key in SHOWN} for row in csv.DictReader(stream)]
    for row in rows:
        row |= {
            key: f"{float(row[key]):.6g}"
            for key in ("start_value", "best_value", "distance")
            if row[key]
        }
    lines = [
        [key.replace("_", " ") for key in SHOWN],
        *([row[key] or "-" for key in SHOWN] for row in rows),
    ]
    widths = [max(len(word) for word in column) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join([*(f"{w:>{n}}" for w, n in zip(line[:-1], widths, strict=False)), line[-1]])
        for line in lines
    )


def map_points(args: Namespace) -> int:
    """``jaxgel map``: sweep the points of a study on this machine or a cluster."""
    prepare_device(args.device)
    study = load_map(args.study)
    return run_points(study, args.out or File("out") / study.name, args, resume=args.resume)[0]


def _workers(args, threads):
    """Context with the executor that the options ask for.

    ``threads`` are those of a process on this machine.
    """
    if args.scheduler:
        return dask_executor(args.scheduler)
    return Workers(
        args.workers or usable_cores(),
        functools.partial(prepare_worker, threads, KEPT.root),
        CALLS_EACH,
    )


def run_points(
    study: MapStudy, folder: File | str, args: Namespace, resume: bool
) -> tuple[int, list[dict]]:
    """Run the points of a map and report; the exit code, and the rows of points.csv."""
    try:
        with _workers(args, GRADIENT_THREADS if study.gradients else 1) as executor:
            device = getattr(args, "device", None)
            rows = run_map(study, folder, executor, device=device, resume=resume, quiet=args.quiet)
    except KeyboardInterrupt:
        print("jaxgel: interrupted; jaxgel resume goes on", file=sys.stderr)
        return INTERRUPTED, []
    counts = collections.Counter(row["status"] for row in rows)
    text = (
        f"{len(rows)} points: {', '.join(f'{n} {status}' for status, n in counts.items())}; see "
        f"{File(folder) / TABLE}"
    )
    complete = counts["complete"] == len(rows)
    printer(args)(text) if complete else print(f"jaxgel: {text}", file=sys.stderr)
    return (DONE if complete else STOPPED), rows


def paper(args: Namespace) -> int:
    """``jaxgel paper``: the paper's table and figures, with a report."""
    import jax

    from ..paper import REPORT, run_paper

    say = printer(args)
    try:
        failed = run_paper(
            args.items, args.out, quiet=args.quiet, say=say, after_item=jax.clear_caches
        )
    except KeyboardInterrupt:
        print(
            f"jaxgel: interrupted; finished items are in {args.out}, jaxgel paper goes on",
            file=sys.stderr,
        )
        return INTERRUPTED
    say(f"report in {File(args.out) / REPORT}")
    if failed:
        print(f"jaxgel: not computed: {', '.join(failed)}; the report says why", file=sys.stderr)
    return STOPPED if failed else DONE
