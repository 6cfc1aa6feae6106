"""The figure of a design: start and optimum swollen, the quantity of the objective, and the history of the search."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..continuation import Path
from ..design import FEASIBLE, Design
from ..observables import QUANTITIES
from .patterns import plot_pattern
from .style import COLOURS, LINE, MU, WALL, length_unit, styled


@styled
def draw_study(study: Any, design: Design, start: Path, best: Path) -> Figure:
    """Figure of a `cases.Study`: paths ``start`` and ``best`` at their last mu, the quantity of the objective, the search's history."""
    figure, axes = plt.subplots(2, 2, figsize=(6.3, 5.6), layout="constrained", height_ratios=(1.15, 1.0))
    for ax, path, title in zip(axes[0], (start, best), ("start", "optimum"), strict=True):
        plot_pattern(path, ax=ax, field=None)
        ax.set_title(f"{title}, {ax.get_title()}")
    draw_curve(axes[1, 0], study, start, best)
    draw_history(axes[1, 1], design)
    return figure


def draw_curve(ax: Axes, study: Any, start: Path, best: Path) -> Axes:
    """Axes with the quantity of the study's first objective along the start's and the optimum's path, and its target."""
    quantity = QUANTITIES[study.aim["of"]]
    for path, name, colour, line in ((start, "start", COLOURS[1], "--"), (best, "optimum", COLOURS[0], "-")):
        ax.plot(path.mu, quantity.scale * np.asarray(quantity.function(path)), line, color=colour, label=name)
    wanted = np.isfinite(study.aim["values"])
    if wanted.any():
        ax.plot(
            np.array(study.problem.mu)[wanted],
            quantity.scale * study.aim["values"][wanted],
            "o",
            mfc="none",
            ms=4,
            color=LINE,
            label="target",
        )
    ax.set(xlabel=MU, ylabel=quantity.axis_label(length_unit(start.model.cloud)))
    ax.legend(frameon=False, fontsize=7.5)
    return ax


def draw_history(ax: Axes, design: Design) -> Axes:
    """Axes with the objective of every evaluation: filled where feasible, hollow where not, ticks on the axis where invalid."""
    k, rows = np.arange(1, len(design.history) + 1), design.history
    value = np.array([np.nan if row["value"] is None else row["value"] for row in rows])
    feasible, invalid = np.array([row["feasible"] for row in rows]), np.array([bool(row["invalid"]) for row in rows])
    ax.plot(k[feasible], value[feasible], "o", ms=3.5, color=COLOURS[0], label="feasible")
    hollow = ~feasible & ~invalid
    if hollow.any():
        ax.plot(k[hollow], value[hollow], "o", ms=3.5, mfc="none", color=COLOURS[1], label="infeasible")
    if invalid.any():
        ax.plot(
            k[invalid],
            np.full(invalid.sum(), 0.02),
            "|",
            ms=7,
            color=WALL,
            transform=ax.get_xaxis_transform(),
            label="invalid, step shrunk",
        )
    for number in np.flatnonzero(np.diff([row["cloud"] for row in rows]) > 0) if len(rows) > 1 else ():
        ax.axvline(number + 1.5, color=WALL, linewidth=0.6, linestyle=":")
    positive = value[np.isfinite(value)]
    if positive.size and positive.min() > FEASIBLE * positive.max() and positive.max() > 30 * positive.min():
        ax.set_yscale("log")
    ax.set(xlabel="evaluation (dotted: new cloud)", ylabel="objective")
    above = dict(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)  # inside the axes the legend would hide points
    ax.legend(frameon=False, fontsize=7.5, columnspacing=1.0, handletextpad=0.3, **above)
    return ax
