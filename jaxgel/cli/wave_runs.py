"""The command ``jaxgel waves``: Bloch waves and the onset of an infinite lattice."""

import dataclasses
from argparse import Namespace
from pathlib import Path as File

from ..io import open_folder, write_waves
from ..materials import varies
from ..mechanics import Problem
from ..waves import lattice_onset, primitive_cell
from .environment import DONE
from .runs import equilibrium_case, printer


def waves(args: Namespace) -> int:
    """``jaxgel waves``: the onset of a periodic case's infinite lattice."""
    case, say = equilibrium_case(args, "waves"), printer(args)
    _check(case)
    cell = case.plate if varies(case.gel) else primitive_cell(case.plate)
    folder = open_folder(args.out or File("out") / f"{case.name}-waves")
    if cell is not case.plate:
        say(
            f"{case.name} consists of equal cells, {cell.width:g} x {cell.height:g} {cell.unit}, "
            "one of which is looked at"
        )
    case = dataclasses.replace(case, plate=cell)
    model, (first, last) = case.model(), case.sweep.ends
    say(
        f"{case.name}: {model.n_nodes} nodes, mu from {first:g} to {last:g}, {args.divisions} "
        "divisions of the zone"
    )
    onset = lattice_onset(Problem(model, case.gel), (first, last), divisions=args.divisions)
    say("every wave is stable" if onset is None else f"mu = {float(onset.mu):.7f}: {onset.text}")
    write_waves(onset, folder, case.table())
    if case.output.figures and onset is not None:
        _draw(onset, model, folder)
    return DONE


def _check(case):
    """ValueError for what the command does not do, before anything is computed."""
    if case.sweep.control != "mu":
        raise ValueError(
            f"sweep.control: {case.sweep.control!r} is not accepted here, waves are looked for "
            "along mu"
        )
    if case.loads.body_force or case.loads.traction:
        raise ValueError("loads: are not accepted here, waves are those of a cell without loads")
    if case.sweep.imperfection:
        raise ValueError(
            f"sweep.imperfection: {case.sweep.imperfection:g} is not accepted here, waves are "
            "those of a perfect lattice"
        )
    if case.plate.kinematics != "plane strain":
        raise ValueError(
            f"plate.kinematics: {case.plate.kinematics!r} is not accepted here; see "
            "jaxgel.lattice_onset"
        )


def _draw(onset, model, folder):
    from ..plotting import plot_lattice, plot_zone, save_figure

    save_figure(plot_zone(onset, model).figure, folder / "zone.png")
    save_figure(plot_lattice(onset, model).figure, folder / "pattern.png")
