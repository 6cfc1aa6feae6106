"""Curves of a path's quantities."""

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from .._types import Array, Bool, Float
from .._validation import one_of
from ..continuation import Path
from ..observables import CREASE_RATIO, QUANTITIES, SELF_CONTACT, WRINKLE_RATIO, events, history
from .style import COLOURS, LINE, SHADE, WALL, length_unit, styled

CURVES = {
    "rotation": {"rotation": "midline", "core_rotation": "core"},
    "area_reduction": {"area_reduction": "all holes"},
    "J": {"J_mean": "mean"},
    "surface_ratio": {"surface_ratio": "largest"},
    "min_gap": {"min_gap": "within a hole"},
}
"""Figure of curves -> name in ``QUANTITIES`` of each curve, and its words in the legend; the first one labels the axis."""
AGAINST = ("mu", "free_stretch")
MARKS = {"bifurcation": ":", "crease": "-.", "wrinkle": (0, (5, 1, 1, 1, 1, 1)), "contact": "--", "self-contact": "-"}


@styled
def plot_curve(path: Path, quantity: str, *, ax: Axes | None = None, against: str = "mu", table: dict[str, Any] | None = None) -> Axes:
    """Axes with one quantity of ``CURVES`` ("rotation", "area_reduction", "J", "surface_ratio", "min_gap") of every state.

    ``against`` is "mu" or "free_stretch"; ``table`` saves computing `history` again. Raises ValueError for other names.
    """
    one_of("quantity", quantity, CURVES)
    one_of("against", against, AGAINST)
    ax = plt.subplots(figsize=(3.6, 2.6), layout="constrained")[1] if ax is None else ax
    table = history(path) if table is None else table
    curves, unit = {QUANTITIES[name]: text for name, text in CURVES[quantity].items()}, length_unit(path.model.cloud)
    unstable = np.asarray(table["negative_pivots"]) > 0
    for (curve, text), colour in zip(curves.items(), COLOURS, strict=False):
        _draw_branch(ax, table[against], curve.scale * np.asarray(table[curve.column]), unstable, colour, text)
    if quantity == "J":
        ax.fill_between(table[against], table["J_min"], table["J_max"], color=COLOURS[0], alpha=0.25, linewidth=0, label="all cells")
    if quantity == "surface_ratio":
        ax.axhline(CREASE_RATIO, color=WALL, linewidth=0.7, linestyle=(0, (1, 1)), label="crease limit")
        ax.axhline(WRINKLE_RATIO, color=WALL, linewidth=0.7, linestyle=(0, (3, 2)), label="wrinkle limit")
    _mark_events(ax, table, against)
    ax.set(xlabel=QUANTITIES[against].axis_label(unit), ylabel=next(iter(curves)).axis_label(unit))
    ax.margins(x=0.02)
    if len(ax.get_legend_handles_labels()[1]) > 1:
        ax.legend(frameon=False, fontsize=7.5)
    return ax


@styled
def plot_curves(path: Path, *, axes: Any = None, table: dict[str, Any] | None = None) -> np.ndarray:
    """A (5, 2) array of axes: every quantity of ``CURVES`` against mu on the left and against the free-swelling stretch on the right.

    A gel that varies over the plate has no such stretch, and one column. ``table`` saves computing `history` again.
    """
    table = history(path) if table is None else table
    columns = [name for name in AGAINST if np.isfinite(np.asarray(table[name])).any()]
    if axes is None:
        size = (3.45 * len(columns), 8.8)
        axes = plt.subplots(len(CURVES), len(columns), figsize=size, sharex="col", sharey="row", layout="constrained", squeeze=False)[1]
    for row, quantity in zip(axes, CURVES, strict=True):
        for ax, against in zip(row, columns, strict=True):
            plot_curve(path, quantity, ax=ax, against=against, table=table)
            ax.label_outer()
        for ax in row[1:]:
            if ax.get_legend() is not None:
                ax.get_legend().remove()
    marks = [
        Line2D([], [], color=WALL, linewidth=0.9, linestyle=MARKS[e], label=e) for e in dict.fromkeys(e["event"] for e in events(table))
    ]
    if np.any(np.asarray(table["negative_pivots"]) > 0):
        marks.append(Line2D([], [], color=LINE, linestyle="--", label="unstable branch"))
    if SELF_CONTACT in table["status"]:
        marks.append(Rectangle((0, 0), 1, 1, color=SHADE, label="invalid after self-contact"))
    if marks:
        axes[0, 0].figure.legend(handles=marks, loc="outside upper center", ncols=len(marks), frameon=False, fontsize=7.5)
    return axes


def _draw_branch(
    ax: Axes, x: Sequence[float] | Float[Array, " k"], y: Float[Array, " k"], unstable: Bool[np.ndarray, " k"], colour: str, label: str
) -> None:
    """One curve, solid where both ends of a piece are stable and dashed elsewhere, with a dot per state."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    dashed = unstable.copy()
    dashed[1:] |= unstable[:-1]
    dashed[:-1] |= unstable[1:]
    ax.plot(x, np.where(unstable, np.nan, y), color=colour, label=label, marker="o", markersize=2.0)
    ax.plot(x, np.where(dashed, y, np.nan), color=colour, linestyle="--")
    ax.plot(x[unstable], y[unstable], color=colour, linestyle="none", marker="o", markersize=2.0, markerfacecolor="white")


def _mark_events(ax: Axes, table: dict[str, Any], against: str) -> None:
    """Vertical lines at the events of a table, shade from the first self-contact on."""
    mu, x = np.asarray(table["mu"]), np.asarray(table[against])
    for event in events(table):
        at = x[np.searchsorted(mu, event["mu"])]
        ax.axvline(at, color=WALL, linewidth=0.9, linestyle=MARKS[event["event"]], zorder=0.5)
        if event["event"] == "self-contact":
            ax.axvspan(at, x[-1], color=SHADE, linewidth=0, zorder=0)
