"""Commands on a case: run, critical, loop and check-grad."""

import collections
import contextlib
import dataclasses
import math
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path as File

import numpy as np

from .._validation import one_of
from ..cases import Case, OutputOptions, load_case, path_of, recorder_of, uncertain_inputs
from ..continuation import Path
from ..controls import Control
from ..equilibrium import Change, Observer
from ..io import Progress, Recorder, interruptible, open_folder, write_csv, write_loop, write_points
from ..materials import varies
from ..observables import OF_POSITIONS, events
from ..symmetry import NAMES
from ..verification import resolution
from .environment import DONE, INTERRUPTED, STOPPED
from .parser import changes

ROWS_MAX = 9  # of the printed table of states


def run(args: Namespace) -> int:
    """``jaxgel run``: sweep a case, or let it swell in time, and write its folder."""
    case = load_case(args.case, changes(args))
    if case.uncertainty:
        uncertain_inputs(case)  # ValueError for an entry that cannot be used
    folder = open_folder(args.out or File("out") / case.name)
    say = printer(args)
    model = case.model()
    say(
        f"{case.name}: {len(model.cloud.nodes)} nodes, {model.n_points} quadrature points, "
        f"{model.basis} basis"
    )
    recorder = recorder_of(folder, case, case.problem(model))
    for line in recorder.resolution.warnings:
        print(f"jaxgel: warning: {line}", file=sys.stderr)
    recorder.begin()
    return run_recorded(recorder, args)


def run_recorded(recorder: Recorder, args: Namespace) -> int:
    """Compute what is left of a case, draw and report; the exit code."""
    say, output = printer(args), recorder.case.output
    if recorder.notes.get("t_resolved"):
        say(
            f"the boundary layer is resolved from {_time(recorder, recorder.notes['t_resolved'])} "
            "on"
        )
    output = (
        dataclasses.replace(output, figures=False, animation=False) if args.no_plots else output
    )
    try:
        path = _computed(recorder, args.quiet)
    except KeyboardInterrupt:
        recorder.finish("interrupted", "stopped by the user")
        _report(recorder, say)
        return INTERRUPTED
    except Exception as problem:
        recorder.finish("failed", " ".join(str(problem).split()) or type(problem).__name__)
        raise
    recorder.finish("complete" if path.stop.ok else "stopped", path.stop_text, path.stop)
    say("drawing" if output.figures else "writing", "the results")
    draw(path, recorder.folder, recorder.table, output)
    _report(recorder, say)
    if not path.stop.ok:
        print(f"jaxgel: the run stopped early: {path.stop_text}", file=sys.stderr)
    return DONE if path.stop.ok else STOPPED


def _computed(recorder, quiet):
    """The path of a case, recorded and shown while it grows, from the recorder's last step on."""
    done = [state.value for state in recorder.steps]
    with (
        Progress(quiet=quiet, done=done, **_way(recorder)) as progress,
        interruptible() as stop_if_asked,
    ):

        def on_step(step):
            progress.show(step)  # before the table, whose programs take a second to load
            recorder(step)
            progress.show(step, recorder.records[-1][1]["rotation_deg"])
            stop_if_asked()

        return path_of(recorder, Observer(accepted=on_step))


@contextlib.contextmanager
def watched(turns: Sequence[float], control: Control, quiet: bool) -> Iterator[Observer]:
    """An observer of a search along a ``control``: progress, and an end by Ctrl-C."""
    with (
        Progress(turns, quiet, name=control.name, unit=control.unit) as progress,
        interruptible() as stop_if_asked,
    ):

        def accepted(state):
            progress.show(state)
            stop_if_asked()

        yield Observer(accepted=accepted)


def _way(recorder):
    """What `Progress` shows of a recorder's control; of time in decades after the first step."""
    case, control = recorder.case, {"name": recorder.control.name, "unit": recorder.control.unit}
    if case.time is None:
        return control | {"turns": case.sweep.turns}
    times = case.times(recorder.problem)
    return control | {
        "turns": (0.0, times[-1]),
        "scale": lambda t: math.log1p(t / times[0]),
        "digits": ".4g",
    }


def _time(recorder, t):
    return f"{recorder.control.name} = {t:.3g} {recorder.control.unit}".rstrip()


def draw(path: Path, folder: File, table: dict, output: OutputOptions) -> None:
    """Write figures, animation and ParaView files of a path by `sections.OutputOptions`.

    They go into a folder; ``table`` is the history.
    """
    from ..io import write_series

    if output.paraview:
        write_series(path, folder, table=table)
    if not (output.figures or output.animation):
        return  # without importing Matplotlib
    from ..plotting import (
        add_warning,
        animate_pattern,
        plot_curves,
        plot_gel,
        plot_patterns,
        save_figure,
    )

    figures = (
        {
            "pattern.png": lambda: plot_patterns(path),
            "curves.png": lambda: plot_curves(path, table=table),
        }
        if output.figures
        else {}
    )
    if output.figures and varies(path.gel):
        figures["gel.png"] = lambda: plot_gel(path)
    coarse = resolution(path.model.cloud).warnings
    for name, draw in figures.items():
        figure = np.ravel(draw())[0].figure
        if coarse:
            add_warning(figure, coarse[0])
        save_figure(figure, folder / name)
    if output.animation:
        animate_pattern(path, folder / "pattern.gif")


def _report(recorder, say):
    """Print a table of at most ``ROWS_MAX`` states, the events, and where the files are."""
    table = recorder.table
    k, name, unit = len(recorder.records), recorder.control.name, recorder.control.unit
    wide, digits = max(8, len(name)), ".4f" if recorder.case.time is None else ".4g"
    if k:
        say(
            f"{name:>{wide}} {'free str.':>9} {'rotation':>9} {'core':>8} {'area red.':>9} "
            f"{'J mean':>7} {'gap':>7}  status"
        )
        say(
            f"{unit:>{wide}} {'':>9} {'deg':>9} {'deg':>8} {'%':>9} {'':>7} "
            f"{recorder.model.cloud.topology.plate.unit:>7}"
        )
    left = _after_jumps(table["switched"]) if k else []
    for i in np.unique(np.linspace(0, k - 1, min(k, ROWS_MAX)).round().astype(int)) if k else ():
        row = {name: column[i] for name, column in table.items()}
        marks = (", unstable" if row["negative_pivots"] else "") + left[i]
        say(
            f"{row[name]:{wide}{digits}} {row['free_stretch']:9.4f} {row['rotation_deg']:9.3f} "
            f"{row['core_rotation_deg']:8.3f}"
            f" {100 * row['area_reduction']:9.3f} {row['J_mean']:7.4f} {row['min_gap']:7.3f}  "
            f"{row['status']}{marks}"
        )
    for event in events(table):
        say(f"{event['event']}: {event['text']}")
    for symmetry, count in collections.Counter(state.symmetry for state in recorder.steps).items():
        if symmetry not in ("", NAMES[()]):
            say(
                f"{count} states have the symmetry {symmetry} and were found on a part of the plate"
            )
    resolved = recorder.notes.get("t_resolved")
    early = sum(0 < state.value < resolved for state in recorder.steps) if resolved else 0
    if early:
        say(
            f"{early} states are before {_time(recorder, resolved)}: their uptake is an estimate, "
            "a finer cloud has it right sooner"
        )
    say(f"{k} states in {recorder.folder}")


def _after_jumps(switched):
    """Note on every state beyond a change of branch, by its reason; "" for the others."""
    said, marks = "", []
    for reason in switched:
        marks.append(said)
        said = f", after a {reason}" if reason != Change.NONE.text else said
    return marks


def equilibrium_case(args: Namespace, command: str) -> Case:
    """The case of a command on equilibria; ValueError, one line, for one that swells in time."""
    case = load_case(args.case, changes(args))
    case.check_equilibrium(command)
    return case


def critical(args: Namespace) -> int:
    """``jaxgel critical``: locate and draw bifurcations and folds of the symmetric branch."""
    case = equilibrium_case(args, "critical")
    folder = open_folder(args.out or File("out") / f"{case.name}-critical")
    say, model = printer(args), case.model()
    control, (first, last) = case.problem(model).control, case.sweep.ends
    name = control.name
    say(
        f"{case.name}: {len(model.cloud.nodes)} nodes, searching from {name} = {first:g} to "
        f"{last:g}"
    )
    unit = f" {control.unit}".rstrip()
    with watched((first, last), control, args.quiet) as observer:
        points = case.critical_points(model, most=args.most, observer=observer)
    write_points(points, folder, case.table(), name)
    for point in points:
        say(f"{name} = {point.value:.7f}{unit}: {point.text}")
    if not points:
        say("the symmetric branch is stable and does not fold back")
    elif case.output.figures:
        from ..plotting import plot_modes, save_figure

        save_figure(plot_modes(model, points, control=control)[0].figure, folder / "modes.png")
    say(f"{len(points)} critical points in {folder}")
    return DONE


def loop(args: Namespace) -> int:
    """``jaxgel loop``: a case's stable branch up and down, its jumps and its unstable branch."""
    case, say = equilibrium_case(args, "loop"), printer(args)
    one_of("quantity", args.quantity, OF_POSITIONS)
    folder = open_folder(args.out or File("out") / f"{case.name}-loop")
    model, (first, last) = case.model(), case.sweep.ends
    control = case.problem(model).control
    with watched((first, last, first), control, args.quiet) as observer:
        found = case.loop(model, observer=observer)
    write_loop(found, folder, case.table())
    if case.output.figures:
        from ..plotting import plot_loop, save_figure

        save_figure(plot_loop(found, args.quantity).figure, folder / "loop.png")
    say(f"{case.name}: {len(model.cloud.nodes)} nodes, {found}")
    say(f"{len(found.jumps_up)} jumps up and {len(found.jumps_down)} down in {folder}")
    if not found.up.stop.ok or found.down is None or not found.down.stop.ok:
        print(f"jaxgel: the loop stopped early: {found.stop_text}", file=sys.stderr)
        return STOPPED
    return DONE


def check_grad(args: Namespace) -> int:
    """``jaxgel check-grad``: Taylor test of a case's gradients, as a table."""
    from .taylor_test import OBJECTIVES, check_gradient

    case = load_case(args.case, changes(args))
    folder = open_folder(args.out or File("out") / case.name)
    try:
        rows = check_gradient(case, states=args.states, quiet=args.quiet)
    except ArithmeticError as problem:
        print(f"jaxgel: {problem}", file=sys.stderr)
        return STOPPED
    columns = (
        "objective",
        "family",
        "slope",
        "difference quotient",
        "remainder at h = 1",
        "remainder at h = 0.5",
        "rate",
    )
    table = [
        [row.objective, row.family, row.slope, row.difference, *row.remainders, f"{row.rate:.4f}"]
        for row in rows
    ]
    write_csv(folder / "check-grad.csv", columns, table)
    say = printer(args)
    say(
        f"{'objective':<15} {'family':<16} {'slope':>11} {'difference':>11}  "
        f"{'remainder at h = 1, 1/2':<22} {'rate':>6}"
    )
    for row in rows:
        remainders = " ".join(f"{r:9.2e}" for r in row.remainders)
        say(
            f"{row.objective:<15} {row.family:<16} {row.slope:11.4e} {row.difference:11.4e}  "
            f"{remainders:<22} {row.rate:6.3f}"
        )
    left_out = [name for name in OBJECTIVES if name not in {row.objective for row in rows}]
    if left_out:
        say(f"left out, without a value or a derivative at the last state: {', '.join(left_out)}")
    failed = [f"{row.objective} by {row.family}" for row in rows if not row.ok]
    if failed:
        print(
            (
                "jaxgel: the remainder does not fall as h^2, nor is the derivative the "
                f"difference quotient: {', '.join(failed)}"
            ),
            file=sys.stderr,
        )
    return STOPPED if failed else DONE


def printer(args: Namespace) -> Callable:
    """`print`, or a function that prints nothing if the command is to be quiet."""
    return (lambda *_: None) if args.quiet else print
