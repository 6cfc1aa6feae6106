"""``jaxgel uncertainty``: standard deviations of a case's numbers from those of its inputs."""

import sys
from argparse import Namespace
from pathlib import Path as File

import numpy as np

from .._validation import did_you_mean
from ..cases import (
    RESPONSES,
    load_case,
    sampled_deviations,
    uncertain_inputs,
    uncertain_samples,
    uncertainty_of,
)
from ..io import open_folder, write_csv, write_json
from ..observables import QUANTITIES
from ..verification import Uncertainty
from .environment import DONE, INTERRUPTED, prepare_device
from .parser import changes
from .runs import printer
from .studies import run_points

SHOWN = 6  # inputs of the printed table


def uncertainty(args: Namespace) -> int:
    """Propagate the standard deviations of a case's inputs; check them by samples if asked.

    They are printed, written and drawn.
    """
    prepare_device(args.device)
    case, say = load_case(args.case, changes(args)), printer(args)
    inputs = uncertain_inputs(case, dict(map(_entry, args.uncertain)) if args.uncertain else None)
    names = args.quantities.split(",") if args.quantities else list(RESPONSES)
    folder = open_folder(args.out or File("out") / f"{case.name}-uncertainty")
    found = uncertainty_of(case, inputs, names)
    last = f"{case.sweep.control} = {case.sweep.numbers[-1]:g}"
    say(
        f"{case.name} at {last}: {len(found.inputs)} uncertain inputs, standard deviations to "
        "first order"
    )
    for name in names:
        say(_line(found, name))
    _write(found, folder, case.table())
    if case.output.figures:
        from ..plotting import plot_contributions, save_figure

        save_figure(plot_contributions(found)[0].figure, folder / "contributions.png")
    code = DONE
    if args.samples:
        code = _sampled(args, case, inputs, names, found, folder)
    say(f"contributions of all inputs in {folder / 'uncertainty.csv'}")
    return code


def _entry(word):
    """Name and value of ``NAME=VALUE``."""
    name, _, value = word.partition("=")
    if not (name and value):
        raise ValueError(f"uncertain: {word!r} is not of the form NAME=DEVIATION, such as Nv=5%")
    return name, value


def _line(found: Uncertainty, name: str):
    """Value, deviation and the inputs that contribute most, of one quantity."""
    scale, unit, k = QUANTITIES[name].scale, QUANTITIES[name].read_unit, found.names.index(name)
    unit = f" {unit}".rstrip()
    ranked = found.ranked(name)
    parts = ", ".join(f"{inp} {100 * share:.0f} %" for inp, share in ranked[:SHOWN])
    rest = f", {len(ranked) - SHOWN} others" if len(ranked) > SHOWN else ""
    return (
        f"  {name:16} {scale * found.values[k]:.5g} +- {scale * found.deviations[k]:.2g}{unit}; "
        f"of the variance: {parts or 'none'}{rest}"
    )


def _write(found, folder, options):
    """uncertainty.csv with a row for every quantity and input, uncertainty.json."""
    rows = []
    for k, name in enumerate(found.names):
        scale = QUANTITIES[name].scale
        for i, inp in enumerate(found.inputs):
            slope, part = scale * found.slopes[k, i], scale * found.contributions[k, i]
            rows.append(
                [name, QUANTITIES[name].read_unit, inp, found.input_deviations[i], slope, part]
            )
    write_csv(
        folder / "uncertainty.csv",
        ["quantity", "unit", "input", "input deviation", "slope", "contribution"],
        rows,
    )
    numbers = {
        name: {
            "value": float(v * QUANTITIES[name].scale),
            "deviation": float(d * QUANTITIES[name].scale),
            "unit": QUANTITIES[name].read_unit,
        }
        for name, v, d in zip(found.names, found.values, found.deviations, strict=True)
    }
    write_json(folder / "uncertainty.json", {"options": options, "quantities": numbers})


def _sampled(args, case, inputs, names, found, folder):
    """Sweep samples of the inputs and print their deviations beside first order; the exit code."""
    unknown = [name for name in names if QUANTITIES[name].column is None]
    if unknown:
        known = [q.name for q in QUANTITIES.values() if q.column]
        raise ValueError(
            f"quantities: {unknown[0]!r} is in no column of history.csv, samples have none; "
            f"{did_you_mean(unknown[0], known)}"
        )
    study = uncertain_samples(case, inputs, args.samples)
    code, rows = run_points(
        study, folder / "samples", args, resume=(folder / "samples" / "map.json").exists()
    )
    if code == INTERRUPTED:
        return code
    sampled = sampled_deviations(rows, {name: QUANTITIES[name].column for name in names})
    for k, name in enumerate(names):
        mean, deviation, count = sampled[name]
        scale = QUANTITIES[name].scale
        ratio = (
            f"{found.deviations[k] / deviation:.3f}"
            if np.isfinite(deviation) and deviation > 0
            else "-"
        )
        printer(args)(
            f"  {name:16} {scale * mean:.5g} +- {scale * deviation:.2g} over {count} samples; "
            f"first order over samples {ratio}"
        )
    if code != DONE:
        print("jaxgel: some samples did not end; points.csv says why", file=sys.stderr)
    return code
