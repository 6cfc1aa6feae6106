"""Curves of a path's quantities."""

import itertools
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from .._types import Array, Bool, Float
from .._validation import one_of
from ..continuation import Path
from ..observables import CREASE_RATIO, QUANTITIES, SELF_CONTACT, events, history
from .style import COLOURS, LINE, SHADE, WALL, length_unit, quantity_of, styled

_PLOTTED = [(*quantity.plotted, quantity.name) for quantity in QUANTITIES.values() if quantity.plotted]
CURVES = {figure: {name: text for of, text, name in _PLOTTED if of == figure} for figure, *_ in _PLOTTED}
"""Figure of curves -> name in ``QUANTITIES`` of each curve, and its words in the legend; the first one labels the axis."""
AGAINST = ("mu", "free_stretch")  # besides another control
RISES, FALLS = ">", "<"  # markers of states where the control turns: the way that it goes
MARKS = {"bifurcation": ":", "leap": (0, (1, 3)), "crease": "-.", "wrinkle": (0, (5, 1, 1, 1, 1, 1)), "contact": "--", "self-contact": "-"}


@styled
def plot_curve(
    path: Path, quantity: str, *, ax: Axes | None = None, against: str | None = None, table: dict[str, Any] | None = None
) -> Axes:
    """Axes with one quantity of ``CURVES`` ("J", "area_reduction", "rotation", "min_gap", "surface_ratio", "surface_stability")
    of every state.

    ``against`` is the name of the control, by default, "mu" or "free_stretch"; ``table`` saves computing `history` again. Where the control
    turns, markers point the way that it goes, and what comes after the first turn is paler. Raises ValueError for other names.
    """
    driven = quantity_of(path.control)
    axis = {name: QUANTITIES[name] for name in AGAINST} | {driven.name: driven}
    against = driven.name if against is None else against
    one_of("quantity", quantity, CURVES)
    one_of("against", against, axis)
    ax = plt.subplots(figsize=(3.6, 2.6), layout="constrained")[1] if ax is None else ax
    table = history(path) if table is None else table
    curves, unit = {QUANTITIES[name]: text for name, text in CURVES[quantity].items()}, length_unit(path.model.cloud)
    unstable, ways = np.asarray(table["negative_pivots"]) > 0, _ways(path.value)
    for (curve, text), colour in zip(curves.items(), COLOURS, strict=False):
        y = curve.scale * np.asarray(table[curve.column])
        for number, (way, marker) in enumerate(ways):
            _draw_branch(ax, np.asarray(table[against])[way], y[way], unstable[way], colour, text, marker, after_turn=number > 0)
    if quantity == "J" and len(ways) == 1:
        ax.fill_between(table[against], table["J_min"], table["J_max"], color=COLOURS[0], alpha=0.25, linewidth=0, label="all cells")
    if quantity == "surface_ratio":
        ax.axhline(CREASE_RATIO, color=WALL, linewidth=0.7, linestyle=(0, (1, 1)), label="crease limit")
    if quantity == "surface_stability":
        ax.axhline(0.0, color=WALL, linewidth=0.7, linestyle=(0, (3, 2)), label="wrinkle limit")
    _mark_events(ax, table, against)
    ax.set(xlabel=axis[against].axis_label(unit), ylabel=next(iter(curves)).axis_label(unit))
    ax.margins(x=0.02)
    if len(ax.get_legend_handles_labels()[1]) > 1:
        ax.legend(frameon=False, fontsize=7.5)
    return ax


@styled
def plot_curves(path: Path, *, axes: Any = None, table: dict[str, Any] | None = None) -> np.ndarray:
    """A (6, 2) array of axes: every quantity of ``CURVES`` against the control on the left and the free-swelling stretch on the right.

    One column where there is no such stretch, as for a gel that varies over the plate, or where it does not change. ``table`` saves
    computing `history` again.
    """
    table = history(path) if table is None else table
    stretch = np.asarray(table["free_stretch"])
    known = np.isfinite(stretch).any() and (len(path) == 1 or np.ptp(stretch[np.isfinite(stretch)]) > 0)
    columns = [quantity_of(path.control).name, *["free_stretch"] * bool(known)]
    if axes is None:
        size = (3.45 * len(columns), 10.4)
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
    for _, marker in dict.fromkeys((number > 0, marker) for number, (_, marker) in enumerate(_ways(path.value)) if marker != "o"):
        text = {RISES: "control rises", FALLS: "control falls"}[marker]
        marks.append(Line2D([], [], color=LINE, linestyle="none", marker=marker, markersize=4.0, label=text))
    if SELF_CONTACT in table["status"]:
        marks.append(Rectangle((0, 0), 1, 1, color=SHADE, label="invalid after self-contact"))
    if marks:
        axes[0, 0].figure.legend(handles=marks, loc="outside upper center", ncols=len(marks), frameon=False, fontsize=7.5)
    return axes


def _ways(values: Float[Array, " k"]) -> list[tuple[slice, str]]:
    """The states between two turns of the control, the turning ones in both, and their marker: a dot where it does not turn."""
    numbers = np.asarray(values, dtype=float)
    turns = (np.flatnonzero(np.diff(np.sign(np.diff(numbers)))) + 1).tolist()
    if not turns:
        return [(slice(None), "o")]
    ends = [0, *turns, len(numbers) - 1]
    return [(slice(a, b + 1), RISES if numbers[b] > numbers[a] else FALLS) for a, b in itertools.pairwise(ends)]


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
    """One way of a curve, solid where both ends of a piece are stable and dashed elsewhere, with a marker per state, hollow if unstable."""
    dashed = unstable.copy()
    dashed[1:] |= unstable[:-1]
    dashed[:-1] |= unstable[1:]
    size = {"marker": marker, "markersize": 2.0 if marker == "o" else 3.2, "alpha": 0.55 if after_turn else 1.0}
    ax.plot(x, np.where(unstable, np.nan, y), color=colour, label=None if after_turn else label, **size)
    ax.plot(x, np.where(dashed, y, np.nan), color=colour, linestyle="--", alpha=size["alpha"])
    ax.plot(x[unstable], y[unstable], color=colour, linestyle="none", markerfacecolor="white", **size)


def _mark_events(ax: Axes, table: dict[str, Any], against: str) -> None:
    """Vertical lines at the events of a table, shade from the first self-contact on."""
    x = np.asarray(table[against])
    for event in events(table):
        at = x[event["state"]]
        ax.axvline(at, color=WALL, linewidth=0.9, linestyle=MARKS[event["event"]], zorder=0.5)
        if event["event"] == "self-contact":
            ax.axvspan(np.min(x[event["state"] :]), np.max(x[event["state"] :]), color=SHADE, linewidth=0, zorder=0)
