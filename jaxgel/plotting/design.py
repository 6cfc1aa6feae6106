"""The figures of a design: start and optimum swollen, the objective, and its history.

The quantity or the switches of the objective, and the history of the search. And the optima of
several searches.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from .._types import Bool, Float
from ..continuation import Path
from ..design import FEASIBLE, Design
from ..observables import QUANTITIES, Quantity, free_edge_misfit, parameter_values
from .patterns import PARAMETERS, draw_cells, plot_pattern
from .style import COLOURS, LINE, WALL, length_unit, quantity_of, styled

LONG_NAME = 20  # letters of an entry from which on a legend has one to a line


@styled
def draw_study(study: Any, design: Design, start: Path, best: Path) -> Figure:
    """Figure of a `cases.Study`: paths ``start`` and ``best``, objective, and history.

    The paths are drawn at their last state. Fields of the gel that were varied are drawn on the dry
    plate in between, before and after, with their scale.
    """
    names = [of for of, _ in study.fields.values()]
    heights, rows = (1.15, *[1.0] * (1 + len(names))), 2 + len(names)
    figure, axes = plt.subplots(
        rows, 2, figsize=(6.3, 2.8 * rows), layout="constrained", height_ratios=heights
    )
    for ax, path, title in zip(axes[0], (start, best), ("start", "optimum"), strict=True):
        plot_pattern(path, ax=ax, field=None)
        ax.set_title(f"{title}, {ax.get_title()}")
        if "outline" in study.aim:
            draw_target(ax, np.array(study.aim["outline"]))
    for row, name in zip(axes[1:-1], names, strict=True):
        draw_fields(row, name, start, best)
    if len(study.aim["targets"]) < 2 and (study.aim["of"] in QUANTITIES or "outline" in study.aim):
        draw_curve(axes[-1, 0], study, start, best)
    else:
        draw_reported(axes[-1, 0], study, design, best)
    draw_history(axes[-1, 1], design)
    return figure


def draw_target(ax: Axes, outline: Float[np.ndarray, "m 2"]) -> None:
    """The line that free edges are to follow, mm, on axes that then hold all of it."""
    limits = [np.array(limits) for limits in (ax.get_xlim(), ax.get_ylim())]
    ax.plot(*outline.T, color=COLOURS[1], linewidth=1.0, linestyle=(0, (4, 2)))
    for set_limits, (low, high), line in zip(
        (ax.set_xlim, ax.set_ylim), limits, outline.T, strict=True
    ):
        set_limits(
            min(low, 1.02 * line.min() - 0.02 * line.max()),
            max(high, 1.02 * line.max() - 0.02 * line.min()),
        )


def draw_fields(axes: Sequence[Axes], name: str, start: Path, best: Path) -> Sequence[Axes]:
    """Two axes with the gel's parameter ``name`` on the dry start and optimum, to one scale."""
    values = [np.asarray(parameter_values(path)[name]) for path in (start, best)]
    scale = min(v.min() for v in values), max(v.max() for v in values)
    scale = scale if scale[0] < scale[1] else (0.9 * scale[0], 1.1 * scale[1])
    for ax, path, of_cells, title in zip(
        axes, (start, best), values, ("start", "optimum"), strict=True
    ):
        cells = draw_cells(ax, path.model.cloud, of_cells, scale)
        ax.set_title(f"{title}, dry plate")
    axes[0].figure.colorbar(cells, ax=axes[-1], label=PARAMETERS.get(name, name), shrink=0.85)
    return axes


def draw_curve(ax: Axes, study: Any, start: Path, best: Path) -> Axes:
    """Axes with the quantity of the first objective on both paths, and its target.

    The start's and the optimum's path of the study.
    """
    quantity = (
        _misfit(study.aim["outline"]) if "outline" in study.aim else QUANTITIES[study.aim["of"]]
    )
    if "hole" in study.aim:
        label = f"{quantity.label} of hole {study.aim['hole']}"
        quantity = dataclasses.replace(quantity, label=label, function=study.aim["quantity"])
    for path, name, colour, line in (
        (start, "start", COLOURS[1], "--"),
        (best, "optimum", COLOURS[0], "-"),
    ):
        ax.plot(
            path.value,
            quantity.scale * np.asarray(quantity.function(path)),
            line,
            color=colour,
            label=name,
        )
    wanted = np.isfinite(study.aim["values"])
    if wanted.any():
        ax.plot(
            study.aim["control"][wanted],
            quantity.scale * study.aim["values"][wanted],
            "o",
            mfc="none",
            ms=4,
            color=LINE,
            label="target",
        )
    ax.set(
        xlabel=quantity_of(start.control).axis_label(),
        ylabel=quantity.axis_label(length_unit(start.model.cloud)),
    )
    ax.legend(frameon=False, fontsize=7.5)
    return ax


def draw_reported(ax: Axes, study: Any, design: Design, best: Path) -> Axes:
    """Axes with the objective's switches or times per evaluation, targets dashed.

    Squares are on the optimum's fresh cloud.
    """
    k = np.arange(1, len(design.history) + 1)
    for (name, target), colour in zip(
        study.aim["targets"].items(), itertools.cycle(COLOURS), strict=False
    ):
        values = [row["reported"].get(name, np.nan) for row in design.history]
        ax.plot(k, values, marker="o", ms=3.0, color=colour, label=name.replace("_", " "))
        ax.plot(
            k[-1] + 1,
            float(study.problem.reported[name](best)),
            "s",
            ms=5.0,
            mfc="none",
            color=colour,
        )
        if np.isfinite(target):
            ax.axhline(target, color=colour, linewidth=0.8, linestyle="--")
    of_energy = study.aim["of"] == "barrier"
    ax.set(xlabel="evaluation (square: fresh cloud)")
    ax.locator_params(axis="x", integer=True)
    ax.set(
        ylabel=r"barrier ($kT/v\,$mm$^2$)" if of_energy else quantity_of(best.control).axis_label()
    )
    beside = 2 if max(map(len, study.aim["targets"])) < LONG_NAME else 1
    ax.legend(
        frameon=False, fontsize=7.5, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=beside
    )
    return ax


def _misfit(outline):
    """The `Quantity` of a path's free edges beside an outline."""
    text = "root mean square distance of the free edges from their target"
    return Quantity(
        "free_edge",
        lambda path: np.sqrt(free_edge_misfit(path, np.array(outline))),
        "mm",
        "distance from the target",
        text,
    )


def draw_history(ax: Axes, design: Design) -> Axes:
    """Axes with the objective per evaluation: filled if feasible, hollow if not.

    Ticks on the axis if invalid.
    """
    k, rows = np.arange(1, len(design.history) + 1), design.history
    value = np.array([np.nan if row["value"] is None else row["value"] for row in rows])
    feasible, invalid = (
        np.array([row["feasible"] for row in rows]),
        np.array([bool(row["invalid"]) for row in rows]),
    )
    ax.plot(k[feasible], value[feasible], "o", ms=3.5, color=COLOURS[0], label="feasible")
    hollow = ~feasible & ~invalid
    if hollow.any():
        ax.plot(
            k[hollow], value[hollow], "o", ms=3.5, mfc="none", color=COLOURS[1], label="infeasible"
        )
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
    for number in (
        np.flatnonzero(np.diff([row["cloud"] for row in rows]) > 0) if len(rows) > 1 else ()
    ):
        ax.axvline(number + 1.5, color=WALL, linewidth=0.6, linestyle=":")
    positive = value[np.isfinite(value)]
    if (
        positive.size
        and positive.min() > FEASIBLE * positive.max()
        and positive.max() > 30 * positive.min()
    ):
        ax.set_yscale("log")
    ax.set(xlabel="evaluation (dotted: new cloud)", ylabel="objective")
    ax.locator_params(axis="x", integer=True)
    # inside the axes the legend would hide points
    above = dict(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    ax.legend(frameon=False, fontsize=7.5, columnspacing=1.0, handletextpad=0.3, **above)
    return ax


@styled
def draw_optima(
    names: Sequence[str],
    shares: Float[np.ndarray, "s d"],
    values: Float[np.ndarray, " s"],
    start_values: Float[np.ndarray, " s"],
    feasible: Bool[np.ndarray, " s"],
) -> Figure:
    """Figure of the best designs of s searches: their d numbers, ``names``, and their objective.

    The numbers are ``shares`` of their bounds' ranges, on one axis each; a design is a line across
    them in the colour of its objective, dashed if it is not ``feasible``. Beside them the objective
    at each start and at the best design, in the order of the latter.
    """
    figure, (map_of, ranks) = plt.subplots(
        1, 2, figsize=(6.3, 3.0), layout="constrained", width_ratios=(1.7, 1.0)
    )
    low, high = float(values.min()), float(values.max())
    scale = ScalarMappable(Normalize(low, high if high > low else low + 1.0), "cividis")
    columns = np.arange(len(names))
    for share, value, met in zip(shares, values, feasible, strict=True):
        colour, line = scale.to_rgba(value), "-" if met else (0, (3, 2))
        map_of.plot(columns, share, color=colour, linewidth=0.8, linestyle=line, alpha=0.8)
    map_of.vlines(columns, 0.0, 1.0, color=WALL, linewidth=0.6)
    map_of.set_xticks(columns, names, rotation=30 if len(names) > 3 else 0)
    map_of.set(ylim=(-0.03, 1.03), ylabel="share of the bounds' range", title="best designs")
    figure.colorbar(scale, ax=map_of, label="objective")
    order = np.argsort(values)
    rank = np.arange(1, len(order) + 1)
    ranks.plot(rank, start_values[order], ".", ms=2.5, color=WALL, label="at the start")
    met = feasible[order]
    ranks.plot(rank[met], values[order][met], "o", ms=3.0, color=COLOURS[0], label="best")
    if not met.all():
        ranks.plot(
            rank[~met],
            values[order][~met],
            "o",
            ms=3.0,
            mfc="none",
            color=COLOURS[1],
            label="infeasible",
        )
    ranks.set(xlabel="search, by its best", ylabel="objective")
    ranks.locator_params(axis="x", integer=True)
    above = dict(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    ranks.legend(frameon=False, fontsize=7.5, columnspacing=0.8, handletextpad=0.1, **above)
    return figure
