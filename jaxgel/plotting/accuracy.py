"""Figures of error bars: curves with bands, and the contributions of uncertain inputs."""

import matplotlib.pyplot as plt
import numpy as np

from ..observables import QUANTITIES
from ..verification import Accuracy, Uncertainty
from .style import COLOURS, WALL, length_unit, quantity_of, styled

COLUMNS = 4  # of panels


@styled
def plot_accuracy(found: Accuracy) -> np.ndarray:
    """Axes, one per quantity: values with error bands, and grey lines of the other clouds.

    The values are those on the path's cloud.
    """
    names, x = list(found.bars), np.asarray(found.path.value, dtype=float)
    rows = -(-len(names) // COLUMNS)
    across = min(len(names), COLUMNS)
    axes = np.atleast_1d(
        plt.subplots(rows, across, figsize=(2.1 * across, 1.9 * rows), layout="constrained")[1]
    ).ravel()
    unit, driven = length_unit(found.path.model.cloud), quantity_of(found.path.control)
    for ax, name in zip(axes, names, strict=False):
        bars = found.bars[name]
        ax.plot(x, bars.values.T, color=WALL, linewidth=0.5, alpha=0.7)
        ax.fill_between(
            x,
            bars.own - bars.error,
            bars.own + bars.error,
            color=COLOURS[0],
            alpha=0.25,
            linewidth=0,
        )
        ax.plot(x, bars.own, color=COLOURS[0])
        ax.set(xlabel=driven.axis_label(), ylabel=QUANTITIES[name].axis_label(unit))
    for ax in axes[len(names) :]:
        ax.remove()
    return axes[: len(names)]


@styled
def plot_contributions(found: Uncertainty, *, most: int = 10) -> np.ndarray:
    """Axes, one per number: standard deviations by each of its ``most`` important inputs alone."""
    count = len(found.names)
    axes = np.atleast_1d(
        plt.subplots(
            1,
            count,
            figsize=(2.9 * count, 0.6 + 0.19 * min(most, len(found.inputs))),
            layout="constrained",
        )[1]
    )
    for ax, name, value, parts, deviation in zip(
        axes, found.names, found.values, found.contributions, found.deviations, strict=True
    ):
        quantity = QUANTITIES.get(name)
        scale, unit = (quantity.scale, quantity.shown_unit()) if quantity else (1.0, "")
        order = np.argsort(-np.abs(parts), kind="stable")[:most][::-1]
        colours = [COLOURS[0] if parts[i] >= 0 else COLOURS[1] for i in order]
        ax.barh([found.inputs[i] for i in order], scale * np.abs(parts[order]), color=colours)
        label = quantity.label if quantity else name
        ax.set(xlabel=f"standard deviation ({unit})" if unit else "standard deviation")
        ax.set_title(f"{label}: {scale * value:.4g} ± {scale * deviation:.2g} {unit}".rstrip())
    return axes
