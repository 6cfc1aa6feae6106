"""The command waves."""

import dataclasses
from argparse import Namespace
from pathlib import Path as File

from ..cases import load_case
from ..continuation import sweep
from ..io import open_folder, write_waves
from ..waves import dispersion, lattice_onset, primitive_cell, translations
from .environment import DONE
from .inputs import changes
from .runs import printer

BELOW = 1e-3  # kT: how far below the onset the bands are, where no mu is given


def waves(args: Namespace) -> int:
    """``jaxgel waves``: the onset of a periodic case's infinite lattice, and the bands of one of its states."""
    case, say = load_case(args.case, changes(args)), printer(args)
    if case.loads.body_force or case.loads.traction:
        raise ValueError("loads: are not accepted here, waves are those of a cell without loads")
    cell = primitive_cell(case.plate)
    folder = open_folder(args.out or File("out") / f"{case.name}-waves")
    nx, ny = translations(case.plate)
    if cell is not case.plate:
        say(f"{case.name} consists of {nx} x {ny} equal cells, {cell.width:g} x {cell.height:g} {cell.unit}, one of which is looked at")
    case = dataclasses.replace(case, plate=cell, source=case.source)
    model, (first, last) = case.model(), case.sweep.ends
    say(f"{case.name}: {model.n_nodes} nodes, mu from {first:g} to {last:g}, {args.divisions} divisions of the zone")
    onset = lattice_onset(model, case.gel, mu=(first, last), divisions=args.divisions)
    say("every wave is stable" if onset is None else f"mu = {float(onset.mu):.7f}: {onset.text}")
    at = args.mu if args.mu is not None else last if onset is None else float(onset.mu) - BELOW
    if not at > first:
        raise ValueError(f"mu: {at:g} kT is not above the first of the sweep, {first:g}")
    bands = dispersion(sweep(model, case.gel, mu=[first, at], branch="symmetric"), bands=args.bands)
    write_waves(bands, onset, folder, case.table())
    for low, high in bands.gaps:
        say(f"no waves between the frequencies {low:.4g} and {high:.4g} at mu = {at:g}")
    if case.output.figures:
        _draw(bands, onset, model, folder)
    say(f"bands at mu = {at:.7g} in {folder}")
    return DONE


def _draw(bands, onset, model, folder):
    import matplotlib as mpl

    mpl.use("Agg")
    from ..plotting import plot_bands, plot_lattice, plot_zone, save_figure

    save_figure(plot_bands(bands).figure, folder / "bands.png")
    if onset is not None:
        save_figure(plot_zone(onset, model).figure, folder / "zone.png")
        save_figure(plot_lattice(onset, model).figure, folder / "pattern.png")
