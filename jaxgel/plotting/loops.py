"""The figure of a loop."""

from collections.abc import Callable

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from .._types import Array, Float
from .._validation import one_of
from ..bifurcation import Loop
from ..continuation import Path
from ..observables import OF_POSITIONS, QUANTITIES
from .style import COLOURS, LINE, WALL, length_unit, quantity_of, styled


@styled
def plot_loop(
    loop: Loop,
    quantity: str | Callable[[Path], Float[Array, " k"]],
    *,
    label: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Axes with a quantity over the control of a loop.

    It is one of ``observables.QUANTITIES``, or a function of a path with its ``label``. Stable
    states are solid, the unstable branch is dashed, dots are the limits of stability, and arrows
    the jumps from there.
    """
    ax = plt.subplots(figsize=(3.6, 2.6), layout="constrained")[1] if ax is None else ax
    if isinstance(quantity, str):
        one_of("quantity", quantity, OF_POSITIONS)
    own = QUANTITIES[quantity] if isinstance(quantity, str) else None

    def values(path):
        return np.asarray(
            quantity(path) if own is None else own.scale * np.asarray(own.of(path)), dtype=float
        )

    ways = [
        (way, points)
        for way, points in ((loop.up, loop.jumps_up), (loop.down, loop.jumps_down))
        if way is not None
    ]
    critical = np.zeros(0) if loop.critical is None else values(loop.critical)
    at = np.array([float(point.value) for point in (*loop.jumps_up, *loop.jumps_down)])
    first = 0
    for (path, points), colour, text in zip(ways, COLOURS, ("up", "down"), strict=False):
        own_at, own_critical = (
            at[first : first + len(points)],
            critical[first : first + len(points)],
        )
        x, y = _with_jumps(path, values(path), own_at, own_critical)
        ax.plot(x, y, color=colour, label=text, marker="o", markersize=2.0)
        for value, start in zip(own_at, own_critical, strict=True):
            end = values(path)[_next(path, value)]
            ax.annotate(
                "",
                (value, end),
                (value, start),
                arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 0.9},
            )
        first += len(points)
    if loop.unstable is not None:
        x, y = np.asarray(loop.unstable.value), values(loop.unstable)
        ends = [0] + ([len(critical) - 1] if loop.joined else [])
        x, y = (
            np.concatenate([inner[:1], of, inner[1:]])
            for inner, of in ((at[ends], x), (critical[ends], y))
        )
        ax.plot(x, y, color=LINE, linestyle="--", label="unstable")
    ax.plot(at, critical, color=WALL, linestyle="none", marker="o", markersize=4.0)
    ax.set(
        xlabel=quantity_of(loop.up.control).axis_label(),
        ylabel=label if own is None else own.axis_label(length_unit(loop.up.model.cloud)),
    )
    ax.legend(frameon=False, fontsize=7.5)
    return ax


def _with_jumps(path, values, at, critical):
    """Abscissas and ordinates of a way with its limits of stability, and a gap behind each."""
    x, y = list(np.asarray(path.value, dtype=float)), list(values)
    for value, end in zip(at[::-1], critical[::-1], strict=True):
        k = _next(path, value)
        x[k:k], y[k:k] = [value, np.nan], [end, np.nan]
    return x, y


def _next(path, value):
    """Number of the first state of a way behind a value."""
    forward = np.sign(float(path.value[-1]) - float(path.value[0]))
    return int(np.argmax(forward * (np.asarray(path.value) - value) > 0))
