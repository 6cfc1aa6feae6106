"""Figs. 6-11 of Deng et al. (2020): patterns of the nine samples."""

import dataclasses

import numpy as np

from ..continuation import Path
from ..discretisation import make_probe
from ..observables import (
    FIELDS,
    area_reduction,
    core_rotation,
    field_values,
    outlines,
    rotation_angle,
)
from .items import FINITE_ELEMENTS, Entry, Number, Runs, at, pyplot, rows, unstable_from
from .newton import SchemePath

ROTATION, WIDTHS, BOW = "midline_rotation_deg", "axes_over_diagonals", "pillar_bow_mm"
TEXTS = {
    ROTATION: "midline rotation, degrees",
    WIDTHS: "width along the axes over that along the diagonals",
    BOW: "pillar off its line, mm",
}
"""Columns of the CSV files, and what they are."""


@dataclasses.dataclass(frozen=True)
class Patterns:
    """One of the figures: states of samples side by side."""

    title: str
    """What it shows."""
    paper: str
    """What the paper says of it."""
    quantities: tuple[str, ...]
    """Which numbers its table has: ``ROTATION``, ``WIDTHS``, ``BOW``."""
    states: tuple[tuple[str, int, float], ...]
    """Method of ``Runs``, sample and mu of each pattern."""
    columns: int = 4
    """Patterns in a row."""


STAGES = (-4.9678, -0.9178, -0.6678, -0.2678)
FIGURES = {
    6: Patterns(
        "sample 1 at growing chemical potential",
        (
            "No visible deformation at mu = -4.9678; then the ellipses change and the plate "
            "rotates anticlockwise."
        ),
        (ROTATION,),
        tuple(("stopping", 1, mu) for mu in (-4.9678, -1.9678, -1.4678, -0.9178)),
    ),
    7: Patterns(
        "samples 1, 2, 3 at mu = -0.9178; with contact if outlines overlap before",
        "The vertical pillars buckle, in sample 3 more than in samples 1 and 2.",
        (ROTATION, BOW),
        tuple(("shown", n, -0.9178) for n in (1, 2, 3)),
        columns=3,
    ),
    8: Patterns(
        "sample 4 at growing chemical potential; above on the symmetric branch, the last in the "
        "paper's own discretisation; below on the "
        "stable branch",
        "Circles at mu = -4.9678, lozenges at -0.6678, almost squares at -0.2678 (a circle has "
        "the width ratio 1, a lozenge 1.41, a "
        "square 0.71).",
        (WIDTHS,),
        (
            *(("stopping", 4, mu) for mu in STAGES[:3]),
            ("stiff", 4, STAGES[3]),
            *(("touching", 4, mu) for mu in STAGES),
        ),
    ),
    9: Patterns(
        "samples 4, 5, 6 at mu = -0.95 on the symmetric branch, with contact if outlines overlap "
        "before and in the paper's own "
        "discretisation if the branch ends before; last, sample 4 on the stable branch",
        "Symmetric patterns; the pillars' centre lines stay straight; sample 6 deforms most.",
        (BOW,),
        (*(("shown", n, -0.95) for n in (4, 5, 6)), ("touching", 4, -0.95)),
    ),
    10: Patterns(
        "sample 7 at growing chemical potential, symmetric branch with contact",
        (
            "The four sides of the squares deform inward (mu = -4.9678 to -0.5678), later more "
            "near the walls than near the midlines."
        ),
        (WIDTHS,),
        tuple(("touching", 7, mu) for mu in (-4.9678, -0.9178, -0.5678, -0.2678)),
    ),
    11: Patterns(
        "samples 7, 8, 9 at mu = -0.9178 on the symmetric branch, with contact if outlines "
        "overlap before and in the paper's own "
        "discretisation if the branch ends before; last, sample 7 on the stable branch",
        (
            "Symmetric patterns; the pillars' centre lines stay straight; the sides of sample 9 "
            "deform most."
        ),
        (BOW,),
        (*(("shown", n, -0.9178) for n in (7, 8, 9)), ("stable", 7, -1.4678)),
    ),
}


def draw_patterns(runs: Runs, number: int) -> Entry:
    """Figure ``number`` of ``FIGURES``."""
    of = FIGURES[number]
    paths = [
        getattr(runs, how)(n, mu) if how == "shown" else getattr(runs, how)(n)
        for how, n, mu in of.states
    ]
    shown = [(path, at(path, mu)) for path, (_, _, mu) in zip(paths, of.states, strict=True)]
    columns = {id(path): _columns(path) for path in paths}
    numbers, table = [], []
    for path, k in shown:
        name = _name(path)
        known = FINITE_ELEMENTS["sample-1"] if name == "sample-1" else {"mu": [], "rotation": []}
        reference = dict(zip(known["mu"], known["rotation"], strict=True)).get(float(path.mu[k]))
        for what in of.quantities:
            value = float(columns[id(path)][what][k])
            numbers.append(
                Number(
                    f"{name}{_how(path)}, mu = {path.mu[k]:.4f}: {TEXTS[what]}",
                    value,
                    None,
                    reference if what == ROTATION else None,
                )
            )
    for i, path in enumerate({id(path): path for path in paths}.values(), start=1):
        name, states = _name(path), {k for other, k in shown if other is path}
        critical = FINITE_ELEMENTS.get(name, {}).get("critical_mu")
        numbers.append(
            Number(f"{name}{_how(path)}: unstable from mu", unstable_from(path), None, critical)
        )
        pictured = [int(k in states) for k in range(len(path))]
        how = dict(
            contact="on" if path.model.contact is not None else "stop",
            method="displacement" if _locks(path) else "mixed",
        )
        table += rows(columns[id(path)] | {"shown": pictured}, path=i, case=name, **how)
    return Entry(f"Fig. {number}: {of.title}", of.paper, numbers, table, _figure(shown, of.columns))


def _columns(path):
    return {
        "mu": path.mu,
        ROTATION: rotation_angle(path),
        "core_rotation_deg": core_rotation(path),
        "area_reduction": area_reduction(path),
        WIDTHS: axes_over_diagonals(path),
        BOW: bow(path),
        "negative_pivots": path.negative_pivots,
    }


def _name(path):
    return path.model.cloud.topology.plate.name


def _locks(path):
    return isinstance(path, SchemePath)


def _how(path):
    """How a path goes beyond the branch of the converged model without contact."""
    return (
        " with contact"
        if path.model.contact is not None
        else " in the paper's own discretisation"
        if _locks(path)
        else ""
    )


def _figure(shown, columns):
    """The patterns of (path, state) pairs, with ``columns`` in a row."""
    from ..plotting import plot_pattern

    fields = [field_values(path[[k]], "stretch") for path, k in shown]
    # corners would take the whole scale
    limits = float(min(map(np.min, fields))), float(max(np.percentile(f, 99) for f in fields))
    lines = len(shown) // columns
    size = (2.15 * columns + 0.9, 2.6 * lines)
    figure, axes = pyplot().subplots(
        lines, columns, figsize=size, layout="constrained", squeeze=False, sharex=True, sharey=True
    )
    for ax, (path, k) in zip(axes.flat, shown, strict=True):
        plot_pattern(path, k, ax=ax, limits=limits, colorbar=False)
        ax.label_outer()
        ax.set_title(
            (
                rf"{_name(path).replace('-', ' ')}{' (locks)' if _locks(path) else ''}, $\mu = "
                rf"{path.mu[k]:.4f}$"
            ),
            fontsize=8,
        )
    coloured = next(c for c in axes.flat[0].collections if c.get_array() is not None)
    figure.colorbar(coloured, ax=axes, label=FIELDS["stretch"], shrink=0.85, extend="max")
    return figure


def bow(path: Path) -> np.ndarray:
    """Largest distance (k,) of the vertical pillar's centre line x = 0 from a straight line, mm."""
    y = np.linspace(-0.5, 0.5, 201) * path.model.cloud.topology.plate.height
    probe = make_probe(path.model, np.stack([np.zeros_like(y), y], axis=1))
    lines = np.stack([np.asarray(probe.position(np.asarray(x))) for x in path.x])
    fits = [np.polyval(np.polyfit(line[:, 1], line[:, 0], 1), line[:, 1]) for line in lines]
    return np.abs(lines[:, :, 0] - fits).max(axis=1)


def axes_over_diagonals(path: Path) -> np.ndarray:
    """Width (k,) of the first hole along the axes over that along the diagonals."""
    wanted = np.arange(8) * np.pi / 4 - np.pi
    ratios = []
    for loop in np.asarray(outlines(path)[0]):
        offset = loop - loop.mean(axis=0)
        angle, radius = np.arctan2(offset[:, 1], offset[:, 0]), np.linalg.norm(offset, axis=1)
        order = np.argsort(angle)
        r = np.interp(wanted, angle[order], radius[order], period=2 * np.pi)
        ratios.append(r[::2].sum() / r[1::2].sum())
    return np.array(ratios)
