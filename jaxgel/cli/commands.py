"""What each command of the command line does: its arguments in, an exit code out."""

import collections
import dataclasses
import sys
from pathlib import Path as File

import numpy as np

from .._validation import did_you_mean
from ..cases import OutputOptions, from_table, load_case, load_path, sample, sample_names
from ..io import Progress, Recorder, interruptible, load_run, open_folder, write_points
from ..observables import events

DONE, UNUSABLE, STOPPED, INTERRUPTED, UNREAD = 0, 2, 3, 130, 141
OPTIONS = {
    "sweep": ("mu_start", "mu_end", "steps", "branch", "imperfection", "contact"),
    "discretisation": ("spacing", "nodes_per_hole", "across", "basis", "dmax", "method", "quadrature", "solver"),
}


def run(args):
    """``jaxgel run``: sweep a case and write its folder."""
    case = load_case(args.case, _changes(args))
    folder = open_folder(args.out or File("out") / case.name)
    say = _silent if args.quiet else print
    model, d = case.model(), case.discretisation
    say(f"{case.name}: {len(model.cloud.nodes)} nodes, {model.n_points} quadrature points, {d.basis} basis, {d.method} method")
    return _run(Recorder(folder, case, model, case.gel), args)


def _run(recorder, args):
    """Sweep what is left of a case, draw and report; the exit code."""
    say, output = _silent if args.quiet else print, recorder.case.output
    output = dataclasses.replace(output, figures=False, animation=False) if args.no_plots else output
    try:
        path = _sweep(recorder, args.quiet)
    except KeyboardInterrupt:
        recorder.finish("interrupted", "stopped by the user")
        _report(recorder, say)
        return INTERRUPTED
    except Exception as problem:
        recorder.finish("failed", " ".join(str(problem).split()) or type(problem).__name__)
        raise
    recorder.finish("complete" if path.stop.ok else "stopped", path.stop_text, path.stop)
    say("drawing" if output.figures else "writing", "the results")
    _draw(path, recorder.folder, recorder.table, output)
    _report(recorder, say)
    if not path.stop.ok:
        print(f"jaxgel: the sweep stopped early: {path.stop_text}", file=sys.stderr)
    return DONE if path.stop.ok else STOPPED


def _changes(args):
    """Sections and entries of a case that the options replace."""
    given = vars(args)
    changes = {section: {key: given[key] for key in keys if given.get(key) is not None} for section, keys in OPTIONS.items()}
    return changes | ({"output": {"figures": False, "animation": False}} if given.get("no_plots") else {})


def _sweep(recorder, quiet):
    """The path of a case, recorded and shown while it grows, from the steps on that the recorder has."""
    case = recorder.case
    with Progress(case.sweep.ends, quiet) as progress, interruptible() as stop_if_asked:

        def on_step(step):
            recorder(step)
            progress.show(recorder.records[-1][1])
            stop_if_asked()

        return case.path(recorder.model, on_step=on_step, before=recorder.steps)


def plot(args):
    """``jaxgel plot``: draw the figures of a run's folder again."""
    folder = File(args.folder)
    table = load_run(folder).history
    path, out = load_path(folder), open_folder(args.out) if args.out else folder
    _draw(path, out, table, OutputOptions())
    if args.mp4:
        from ..plotting import animate_pattern

        animate_pattern(path, out / "pattern.mp4")
    return DONE


def outline(args):
    """``jaxgel outline``: write the outline of a case or a run, dry or, of a run, at the accepted state nearest to ``--mu``."""
    from ..io import FORMATS, dry_gel, swollen_gel, write_outline

    is_run = File(args.source).is_dir()
    if args.mu is not None and not is_run:
        raise ValueError(f"--mu: {args.source!r} is a case; the states at some mu are in a run's folder")
    if args.format not in FORMATS:
        raise ValueError(f"--format: {args.format!r} is unknown; {did_you_mean(args.format, FORMATS)}")
    if args.mu is not None:
        path = load_path(args.source)
        name, gel = File(args.source).name, swollen_gel(path, int(np.abs(np.asarray(path.mu) - args.mu).argmin()))
    else:
        summary = load_run(args.source).summary if is_run else None
        case = from_table(summary["options"], summary["case"]) if summary else load_case(args.source)
        name, gel = case.name, dry_gel(case.plate)
    print(write_outline(gel, args.out or f"{name}.{args.format}", args.height))
    return DONE


def export(args):
    """``jaxgel export``: write a run's folder as netCDF."""
    from ..io import export

    print(export(args.folder, args.out))
    return DONE


def view(args):
    """``jaxgel view``: write one HTML page of a run's folder."""
    from ..cases import write_page

    print(write_page(args.folder, args.out))
    return DONE


def critical(args):
    """``jaxgel critical``: locate the bifurcations and folds of a case's symmetric branch, and draw their modes."""
    case = load_case(args.case, _changes(args))
    folder = open_folder(args.out or File("out") / f"{case.name}-critical")
    say, model = _silent if args.quiet else print, case.model()
    say(f"{case.name}: {len(model.cloud.nodes)} nodes, searching from mu = {case.sweep.ends[0]:g} to {case.sweep.ends[1]:g}")
    points = case.critical_points(model, most=args.most)
    write_points(points, folder, case.table())
    for point in points:
        say(f"mu = {point.mu:.7f}: {point.text}")
    if not points:
        say("the symmetric branch is stable and does not fold back")
    elif case.output.figures:
        _draw_modes(model, points, folder)
    say(f"{len(points)} critical points in {folder}")
    return DONE


def _draw_modes(model, points, folder):
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    from ..plotting import plot_modes

    figure = plot_modes(model, points)[0].figure
    figure.savefig(folder / "modes.png")
    plt.close(figure)


def check_grad(args):
    """``jaxgel check-grad``: Taylor test of a case's gradients, as a table."""
    from .taylor_test import OBJECTIVES, check_gradient, failures, write_table

    case = load_case(args.case, _changes(args))
    folder = open_folder(args.out or File("out") / case.name)
    try:
        rows = check_gradient(case, states=args.states, quiet=args.quiet)
    except ArithmeticError as problem:
        print(f"jaxgel: {problem}", file=sys.stderr)
        return STOPPED
    write_table(rows, folder)
    say = _silent if args.quiet else print
    say(f"{'objective':<15} {'family':<10} {'slope':>10}  {'remainder at h = 1, 1/2, 1/4 ...':<50} {'rate':>6}")
    for row in rows:
        remainders = " ".join(f"{r:9.2e}" for r in row.remainders)
        say(f"{row.objective:<15} {row.family:<10} {row.slope:10.3e}  {remainders:<50} {row.rate:6.3f}")
    left_out = [name for name in OBJECTIVES if name not in {row.objective for row in rows}]
    if left_out:
        say(f"left out, without a value or a derivative at the last state: {', '.join(left_out)}")
    failed = failures(rows)
    if failed:
        named = ", ".join(f"{objective} by {family}" for objective, family in failed)
        print(f"jaxgel: the remainder does not fall as h^2: {named}", file=sys.stderr)
    return STOPPED if failed else DONE


def design(args):
    """``jaxgel design``: search the best holes of a study, verify them, and write the study's folder."""
    from ..cases import load_study

    study = load_study(args.study)
    return _design(study, args.out or File("out") / study.name, args)


def resume(args):
    """``jaxgel resume``: continue what was interrupted in a folder, a run, a design or a map by the file that it holds."""
    resumable = {"design.json": _resume_design, "map.json": _resume_map, "summary.json": _resume_run}
    for name, go_on in resumable.items():
        if (File(args.folder) / name).is_file():
            return go_on(args)
    raise ValueError(
        f"folder: {args.folder!r} holds none of {', '.join(resumable)}; expected a folder written by jaxgel run, design or map"
    )


def _resume_run(args):
    from ..cases import other_versions, resumed

    say, warning, recorder = _silent if args.quiet else print, other_versions(args.folder), resumed(args.folder)
    say(f"{recorder.case.name}: goes on after {len(recorder.steps)} states")
    if warning:
        say(warning)
    return _run(recorder, args)


def _resume_map(args):
    from ..cases import resumed_map

    return _map(resumed_map(args.folder), args.folder, args, resume=True)


def _resume_design(args):
    from ..cases import resumed_study

    return _design(resumed_study(args.folder), args.folder, args, resume=True)


def map_points(args):
    """``jaxgel map``: sweep the points of a study on the processes of this machine or of a cluster."""
    from ..cases import load_map

    study = load_map(args.study)
    return _map(study, args.out or File("out") / study.name, args, resume=args.resume)


def _map(study, folder, args, resume):
    from .._threads import usable_cores
    from ..cases import TABLE, Workers, dask_executor, run_map

    if args.workers == 0:
        raise ValueError("workers: 0 is not accepted, it must be at least 1")
    try:
        with dask_executor(args.scheduler) if args.scheduler else Workers(args.workers or usable_cores()) as executor:
            rows = run_map(study, folder, executor, resume=resume, quiet=args.quiet)
    except KeyboardInterrupt:
        print("jaxgel: interrupted; jaxgel resume goes on", file=sys.stderr)
        return INTERRUPTED
    counts = collections.Counter(row["status"] for row in rows)
    text = f"{len(rows)} points: {', '.join(f'{n} {status}' for status, n in counts.items())}; see {File(folder) / TABLE}"
    complete = counts["complete"] == len(rows)
    (_silent if args.quiet else print)(text) if complete else print(f"jaxgel: {text}", file=sys.stderr)
    return DONE if complete else STOPPED


def _design(study, folder, args, resume=False):
    import matplotlib as mpl

    mpl.use("Agg")  # before pyplot, which would look for a screen
    from ..cases import run_study

    say = _silent if args.quiet else print
    found, verified = run_study(study, open_folder(folder), resume=resume or getattr(args, "resume", False), quiet=args.quiet)
    if verified is None:
        print("jaxgel: interrupted; jaxgel resume goes on", file=sys.stderr)
        return INTERRUPTED
    say(f"{study.name}: {len(found.history)} evaluations; {found.text}")
    for name, value in found.parameters.items():
        say(f"{name:<12} {np.array2string(value, precision=4, separator=', ')}")
    for name in ("start", "best"):
        v = verified[name]
        say(f"{name} on a fresh cloud of {v['nodes']} nodes: objective {v['value']:.6g}; {v['reason']}")
    say(f"results in {folder}")
    valid = found.feasible and verified["best"]["valid"]
    if not valid:
        reason = verified["best"]["reason"] if found.feasible else "no design met all constraints"
        print(f"jaxgel: the design is not usable: {reason}", file=sys.stderr)
    return DONE if valid else STOPPED


def doctor(_):
    """``jaxgel doctor``: versions, float64, threads, and an audit of the compiled kernels."""
    import time

    import jax

    from .doctor import SIZES, audit, describe

    print(*describe(), f"audit at {', '.join(f'{n:,}' for n in SIZES)} points, compiled against one operation at a time:", sep="\n")
    began, failed = time.perf_counter(), []
    for found in audit():
        print(f"  {found.name:<50} {found.difference:8.1e}{'' if found.ok else f'  WRONG at {found.points:,} points'}", flush=True)
        failed += [] if found.ok else [found.name]
    faster = "" if jax.config.jax_compilation_cache_dir else "; with JAX_COMPILATION_CACHE_DIR set, the next audit compiles nothing"
    print(f"audited in {time.perf_counter() - began:.1f} s{faster}")
    if failed:
        print(f"jaxgel: this installation computes wrongly: {', '.join(failed)}; install another jaxlib", file=sys.stderr)
    return STOPPED if failed else DONE


def init(args):
    """``jaxgel init``: a commented case file to start from, with an example's or a built-in case's numbers."""
    from ..cases import case_text, example, explicit

    case = explicit(load_case(args.sample)) if args.sample else example()
    file = File(f"{args.name or (args.sample or 'case')}.toml".replace(".toml.toml", ".toml"))
    try:
        with file.open("x", encoding="utf-8") as stream:
            stream.write(case_text(case))
    except FileExistsError:
        raise ValueError(f"name: {str(file)!r} is there already; remove it or choose another name") from None
    except OSError as problem:
        raise ValueError(f"name: cannot write {str(file)!r}: {problem.strerror}") from None
    print(f"wrote {file}; jaxgel run {file} swells it")
    return DONE


def schema(_):
    """``jaxgel schema``: the JSON schema of a case file."""
    import json

    from ..cases import case_schema

    print(json.dumps(case_schema(), indent=1, ensure_ascii=False))
    return DONE


def paper(args):
    """``jaxgel paper``: the paper's table and figures, with a report."""
    from ..paper import REPORT, run_paper

    say = _silent if args.quiet else print
    try:
        failed = run_paper(args.items, args.out, quiet=args.quiet, say=say)
    except KeyboardInterrupt:
        print(f"jaxgel: interrupted; finished items are in {args.out}, jaxgel paper goes on", file=sys.stderr)
        return INTERRUPTED
    say(f"report in {File(args.out) / REPORT}")
    if failed:
        print(f"jaxgel: not computed: {', '.join(failed)}; the report says why", file=sys.stderr)
    return STOPPED if failed else DONE


def list_samples(_):
    """``jaxgel samples``: one line per built-in case."""
    for name in sample_names():
        plate = sample(name)
        kinds = sorted({type(hole).__name__.lower() for hole in plate.holes})
        holes = f"{len(plate.holes)} holes ({', '.join(kinds)})" if kinds else "no hole"
        print(f"{name:10s} {plate.width:g} x {plate.height:g} {plate.unit}, {holes}, Nv {plate.gel.Nv:g}, chi {plate.gel.chi:g}")
    return DONE


def _draw(path, folder, table, output):
    """What the `sections.OutputOptions` want of figures, animation and ParaView files of a path with the history ``table``, in a folder."""
    import matplotlib as mpl

    mpl.use("Agg")  # before pyplot, which would look for a screen
    import matplotlib.pyplot as plt

    from ..io import write_series
    from ..plotting import animate_pattern, plot_curves, plot_patterns

    if output.paraview:
        write_series(path, folder, table=table)
    figures = {"pattern.png": lambda: plot_patterns(path), "curves.png": lambda: plot_curves(path, table=table)} if output.figures else {}
    for name, draw in figures.items():
        figure = np.ravel(draw())[0].figure
        figure.savefig(folder / name)
        plt.close(figure)
    if output.animation:
        animate_pattern(path, folder / "pattern.gif")


def _report(recorder, say, most_rows=9):
    """Print a table of at most ``most_rows`` states, the events, and where the files are."""
    table = recorder.table
    k = len(recorder.records)
    if k:
        say(f"{'mu':>8} {'stretch':>8} {'rotation':>9} {'core':>8} {'area red.':>9} {'J mean':>7} {'gap':>7}  status")
        say(f"{'kT':>8} {'':>8} {'deg':>9} {'deg':>8} {'%':>9} {'':>7} {recorder.model.cloud.topology.plate.unit:>7}")
    for i in np.unique(np.linspace(0, k - 1, min(k, most_rows)).round().astype(int)) if k else ():
        row = {name: column[i] for name, column in table.items()}
        unstable = ", unstable" if row["negative_pivots"] else ""
        say(
            f"{row['mu']:8.4f} {row['free_stretch']:8.4f} {row['rotation_deg']:9.3f} {row['core_rotation_deg']:8.3f}"
            f" {100 * row['area_reduction']:9.3f} {row['J_mean']:7.4f} {row['min_gap']:7.3f}  {row['status']}{unstable}"
        )
    for event in events(table):
        say(f"{event['event']}: {event['text']}")
    say(f"{k} states in {recorder.folder}")


def _silent(*_):
    pass
