"""Curves of a path's quantities."""

import itertools
from collections.abc import Collection
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from .._types import Array, Bool, Float
from .._validation import one_of
from ..continuation import Path
from ..observables import (
    COLUMNS,
    CREASE_RATIO,
    IN_TIME,
    OF_OBSTACLES,
    QUANTITIES,
    SELF_CONTACT,
    columns_of,
    events,
    history,
    is_in_time,
)
from ..transient import Time
from .style import COLOURS, LINE, SHADE, WALL, length_unit, quantity_of, styled


def _figures(columns: Collection[str]) -> dict[str, dict[str, str]]:
    """Figure of curves with ``columns`` -> name in ``QUANTITIES``, and legend texts."""
    plotted = [
        (*quantity.plotted, quantity.name)
        for quantity in QUANTITIES.values()
        if quantity.plotted and quantity.column in columns
    ]
    return {
        figure: {name: text for of, text, name in plotted if of == figure} for figure, *_ in plotted
    }


CURVES = _figures(COLUMNS)
"""Figure of curves -> name in ``QUANTITIES`` of each curve, and its words in the legend.

The first one labels the axis.
"""
FURTHER = _figures((*OF_OBSTACLES, *IN_TIME))
"""Further figures, of plates with obstacles and of transient swelling."""
ROUNDING = 1e-9  # range of values on an axis that is round-off alone
SCALES = ("linear", "log", "sqrt")  # of a time; other abscissas are linear
AGAINST = ("mu", "free_stretch")  # besides another control
RISES, FALLS = ">", "<"  # markers of states where the control turns: the way that it goes
MARKS = {
    "bifurcation": ":",
    "leap": (0, (1, 3)),
    "snap-through": (0, (8, 2)),
    "crease": "-.",
    "wrinkle": (0, (5, 1, 1, 1, 1, 1)),
    "contact": "--",
    "self-contact": "-",
}


@styled
def plot_curve(
    path: Path,
    quantity: str,
    *,
    ax: Axes | None = None,
    against: str | None = None,
    scale: str | None = None,
    table: dict[str, Any] | None = None,
) -> Axes:
    """Axes with one quantity of ``CURVES`` of every state.

    "J", "area_reduction", "rotation", "min_gap", "surface_ratio", "surface_stability"; also
    "obstacle_force" of plates with obstacles, and "uptake" in transient swelling. ``against`` is
    the name of the control, by default, "mu" or "free_stretch". ``scale`` is that of the abscissa:
    "linear", or of the time "log", the default, or "sqrt", its square root, in which diffusion
    begins as a straight line. ``table`` saves computing `history` again. If the control turns,
    markers point the way that it goes, and what comes after the first turn is paler. Raises
    ValueError for other names.
    """
    driven = quantity_of(path.control)
    axis = {name: QUANTITIES[name] for name in AGAINST} | {driven.name: driven}
    against = driven.name if against is None else against
    figures = _figures_of(path)
    one_of("quantity", quantity, figures)
    one_of("against", against, axis)
    scale = _checked_scale(scale, path, against)
    ax = plt.subplots(figsize=(3.6, 2.6), layout="constrained")[1] if ax is None else ax
    table = history(path) if table is None else table
    curves, unit = (
        {QUANTITIES[name]: text for name, text in figures[quantity].items()},
        length_unit(path.model.cloud),
    )
    unstable, ways = np.asarray(table["negative_pivots"]) > 0, _ways(path.value)
    x, ranges = np.asarray(table[against], dtype=float), []
    x = np.sqrt(x) if scale == "sqrt" else x
    for (curve, text), colour in zip(curves.items(), COLOURS, strict=False):
        y = curve.scale * np.asarray(table[curve.column])
        ranges.append(y[np.isfinite(y)])
        for number, (way, marker) in enumerate(ways):
            _draw_branch(
                ax, x[way], y[way], unstable[way], colour, text, marker, after_turn=number > 0
            )
    if quantity == "J" and len(ways) == 1:
        ax.fill_between(
            x,
            table["J_min"],
            table["J_max"],
            color=COLOURS[0],
            alpha=0.25,
            linewidth=0,
            label="all cells",
        )
    if quantity == "surface_ratio":
        ax.axhline(
            CREASE_RATIO, color=WALL, linewidth=0.7, linestyle=(0, (1, 1)), label="crease limit"
        )
    if quantity == "surface_stability":
        ax.axhline(0.0, color=WALL, linewidth=0.7, linestyle=(0, (3, 2)), label="wrinkle limit")
    _mark_events(ax, table, x)
    label = _root_label(path.control.unit) if scale == "sqrt" else axis[against].axis_label(unit)
    ax.set(
        xlabel=label,
        ylabel=next(iter(curves)).axis_label(unit),
        xscale="log" if scale == "log" else "linear",
    )
    ax.margins(x=0.02)
    values = np.concatenate(ranges)
    if len(values) and np.ptp(values) < ROUNDING:
        ax.set_ylim(values[0] - 1, values[0] + 1)
    if len(ax.get_legend_handles_labels()[1]) > 1:
        ax.legend(frameon=False, fontsize=7.5)
    return ax


@styled
def plot_curves(
    path: Path, *, axes: Any = None, scale: str | None = None, table: dict[str, Any] | None = None
) -> np.ndarray:
    """Axes (6, 2): ``CURVES`` against the control (left) and the free-swelling stretch (right).

    One column if there is no such stretch, as for a gel that varies over the plate, or if it does
    not change. With obstacles the force on them is a further row. In transient swelling one column,
    against time, with the uptake as a further row; ``scale`` is that of the time, see `plot_curve`.
    ``table`` saves computing `history` again.
    """
    table = history(path) if table is None else table
    columns, figures = [quantity_of(path.control).name], _figures_of(path)
    if not is_in_time(path) and _stretch_changes(table):
        columns.append("free_stretch")
    if axes is None:
        size = (3.45 * len(columns), 10.4 / len(CURVES) * len(figures))
        axes = plt.subplots(
            len(figures),
            len(columns),
            figsize=size,
            sharex="col",
            sharey="row",
            layout="constrained",
            squeeze=False,
        )[1]
    for row, quantity in zip(axes, figures, strict=True):
        for ax, against in zip(row, columns, strict=True):
            plot_curve(
                path,
                quantity,
                ax=ax,
                against=against,
                scale=scale if against == columns[0] else None,
                table=table,
            )
            ax.label_outer()
        for ax in row[1:]:
            if ax.get_legend() is not None:
                ax.get_legend().remove()
    marks = [
        Line2D([], [], color=WALL, linewidth=0.9, linestyle=MARKS[e], label=e)
        for e in dict.fromkeys(e["event"] for e in events(table))
    ]
    if np.any(np.asarray(table["negative_pivots"]) > 0):
        marks.append(Line2D([], [], color=LINE, linestyle="--", label="unstable branch"))
    for _, marker in dict.fromkeys(
        (number > 0, marker)
        for number, (_, marker) in enumerate(_ways(path.value))
        if marker != "o"
    ):
        text = {RISES: "control rises", FALLS: "control falls"}[marker]
        marks.append(
            Line2D([], [], color=LINE, linestyle="none", marker=marker, markersize=4.0, label=text)
        )
    if SELF_CONTACT in table["status"]:
        marks.append(Rectangle((0, 0), 1, 1, color=SHADE, label="invalid after self-contact"))
    if marks:
        axes[0, 0].figure.legend(
            handles=marks, loc="outside upper center", ncols=len(marks), frameon=False, fontsize=7.5
        )
    return axes


def _figures_of(path: Path) -> dict[str, dict[str, str]]:
    """The figures of curves of a path."""
    columns = columns_of(path.model.cloud.plate, path.control.name)
    return CURVES | {
        figure: curves
        for figure, curves in FURTHER.items()
        if QUANTITIES[next(iter(curves))].column in columns
    }


def _stretch_changes(table: dict[str, Any]) -> bool:
    """Whether the free-swelling stretch is known and not the same in all states."""
    stretch = np.asarray(table["free_stretch"])
    return bool(
        np.isfinite(stretch).any()
        and (len(stretch) == 1 or np.ptp(stretch[np.isfinite(stretch)]) > 0)
    )


def _checked_scale(scale: str | None, path: Path, against: str) -> str:
    """The scale of the abscissa; ValueError for one that the quantity ``against`` does not have."""
    of_time = against == Time.name and is_in_time(path)
    if scale is None:
        return "log" if of_time else "linear"
    one_of("scale", scale, SCALES if of_time else SCALES[:1])
    return scale


def _root_label(unit: str) -> str:
    """Label of an axis for the square root of a time in this ``unit``."""
    return r"$\sqrt{t}$" + rf" ($\mathrm{{{unit}}}^{{1/2}}$)" * bool(unit)


def _ways(values: Float[Array, " k"]) -> list[tuple[slice, str]]:
    """States between two turns of the control, and their marker: a dot without a turn.

    The turning ones are in both.
    """
    numbers = np.asarray(values, dtype=float)
    turns = (np.flatnonzero(np.diff(np.sign(np.diff(numbers)))) + 1).tolist()
    if not turns:
        return [(slice(None), "o")]
    ends = [0, *turns, len(numbers) - 1]
    return [
        (slice(a, b + 1), RISES if numbers[b] > numbers[a] else FALLS)
        for a, b in itertools.pairwise(ends)
    ]


def _draw_branch(
    ax: Axes,
    x: Float[np.ndarray, " k"],
    y: Float[np.ndarray, " k"],
    unstable: Bool[np.ndarray, " k"],
    colour: str,
    label: str,
    marker: str,
    after_turn: bool,
) -> None:
    """One way of a curve, solid if stable, else dashed; a marker per state, hollow if unstable.

    A piece is solid if both ends are stable.
    """
    dashed = unstable.copy()
    dashed[1:] |= unstable[:-1]
    dashed[:-1] |= unstable[1:]
    size = {
        "marker": marker,
        "markersize": 2.0 if marker == "o" else 3.2,
        "alpha": 0.55 if after_turn else 1.0,
    }
    ax.plot(
        x, np.where(unstable, np.nan, y), color=colour, label=None if after_turn else label, **size
    )
    ax.plot(x, np.where(dashed, y, np.nan), color=colour, linestyle="--", alpha=size["alpha"])
    ax.plot(
        x[unstable], y[unstable], color=colour, linestyle="none", markerfacecolor="white", **size
    )


def _mark_events(ax: Axes, table: dict[str, Any], x: Float[np.ndarray, " k"]) -> None:
    """Vertical lines at a table's events, states at ``x``, shade from the first self-contact on."""
    for event in events(table):
        at = x[event["state"]]
        ax.axvline(at, color=WALL, linewidth=0.9, linestyle=MARKS[event["event"]], zorder=0.5)
        if event["event"] == "self-contact":
            ax.axvspan(
                np.min(x[event["state"] :]),
                np.max(x[event["state"] :]),
                color=SHADE,
                linewidth=0,
                zorder=0,
            )
