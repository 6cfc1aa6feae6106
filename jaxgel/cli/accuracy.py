"""``jaxgel accuracy``: error bars of a case's numbers."""

from argparse import Namespace
from pathlib import Path as File

import numpy as np

from .._validation import one_of
from ..cases import DIFFERENTIABLE, accuracy_of, load_case, point_accuracy_of, slope_accuracy_of
from ..io import open_folder, write_accuracy, write_csv
from ..observables import QUANTITIES, state_at
from ..verification import ACCURACY, FEWEST
from .environment import DONE, STOPPED
from .parser import changes
from .runs import printer, watched

STATES = 3  # printed unless others are asked for


def accuracy(args: Namespace) -> int:
    """Sweep a case on several clouds; print error bars at some states, write and draw all."""
    case, say = load_case(args.case, changes(args)), printer(args)
    names = args.quantities.split(",") if args.quantities else ACCURACY
    for name in names:
        one_of("quantities", name, QUANTITIES)
    folder, model = open_folder(args.out or File("out") / f"{case.name}-accuracy"), case.model()
    control = case.problem(model).control
    turns = case.sweep.turns if case.time is None else (0.0, case.time.last)
    with watched(turns, control, args.quiet) as observer:
        path = case.path(model, observer=observer)
        states = [state_at(path, value) for value in args.at] if args.at else _evenly(len(path))
        found = accuracy_of(case, path, quantities=names, observer=observer)
    write_accuracy(found, folder, case.table())
    if case.output.figures:
        from ..plotting import plot_accuracy, save_figure

        save_figure(plot_accuracy(found)[0].figure, folder / "accuracy.png")
    say(
        f"{case.name} on clouds of {', '.join(map(str, found.nodes))} nodes; values are those on "
        f"{model.n_nodes}"
    )
    for k in states:
        say(f"{control.name} = {float(path.value[k]):.4f} {control.unit}".rstrip())
        say(f"  {'':26} {'value':>11} {'error':>10} {'extrapolated':>13} {'order':>6}")
        for name in names:
            say(_line(name, found.bars[name], k))
    if args.points:
        _points(args, case, control, folder)
    if args.gradient:
        _slopes(args, case, names, folder)
    say(f"{len(path)} states in {folder}")
    if len(found.nodes) < FEWEST:
        say(
            f"no error bars: they need {FEWEST} clouds, and others than these {len(found.nodes)} "
            "cannot be made; use a smaller spacing"
        )
    return DONE if path.stop.ok else STOPPED


def _points(args, case, control, folder):
    """Print and write the error bars of the critical points that the option names."""
    say, rows = printer(args), []
    with watched(case.sweep.turns, control, args.quiet) as observer:
        found = point_accuracy_of(case, args.points.split(","), observer=observer)
    say("critical points")
    say(f"  {'':26} {'value':>11} {'error':>10} {'extrapolated':>13}")
    for name, bars in found.items():
        value, error, limit = (
            float(numbers[0]) for numbers in (bars.own, bars.error, bars.extrapolated)
        )
        say(
            f"  {f'{name} ({control.unit})' if control.unit else name:26} {value:11.5g} "
            f"{error:10.2g} {limit:13.5g}"
        )
        rows.append([name, control.unit, value, error, limit])
    write_csv(folder / "points.csv", ["point", "unit", "value", "error", "extrapolated"], rows)


def _slopes(args, case, names, folder):
    """Print and write error bars of the derivatives by the inputs that the option names."""
    found = slope_accuracy_of(
        case, args.gradient.split(","), [name for name in names if name in DIFFERENTIABLE]
    )
    say, rows = printer(args), []
    say(f"derivatives at {case.sweep.control} = {case.sweep.numbers[-1]:g}")
    say(f"  {'':44} {'value':>11} {'error':>10} {'extrapolated':>13}")
    for (name, which), bars in found.items():
        value, error, limit = (
            QUANTITIES[name].scale * float(numbers[0])
            for numbers in (bars.own, bars.error, bars.extrapolated)
        )
        say(f"  {f'd {name} / d {which}':44} {value:11.4g} {error:10.2g} {limit:13.4g}")
        rows.append([name, QUANTITIES[name].read_unit, which, value, error, limit])
    write_csv(
        folder / "slopes.csv", ["quantity", "unit", "input", "slope", "error", "extrapolated"], rows
    )


def _evenly(count):
    """Numbers of the states that are printed: evenly spaced, with the last one."""
    return sorted({round(share * (count - 1)) for share in np.arange(1, STATES + 1) / STATES})


def _line(name, bars, k):
    """One quantity at state k."""
    unit = QUANTITIES[name].read_unit
    label = f"{name} ({unit})" if unit else name
    order = f"{bars.order[k]:6.1f}" if np.isfinite(bars.order[k]) else f"{'-':>6}"
    return (
        f"  {label:26} {bars.own[k]:11.5g} {bars.error[k]:10.2g} {bars.extrapolated[k]:13.5g} "
        f"{order}"
    )
