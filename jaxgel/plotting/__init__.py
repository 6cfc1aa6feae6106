"""plotting."""

from .animation import animate_pattern
from .curves import CURVES, plot_curve, plot_curves
from .design import LABELS, draw_study
from .patterns import plot_modes, plot_pattern, plot_patterns
from .style import STYLE

__all__ = [
    "CURVES",
    "LABELS",
    "STYLE",
    "animate_pattern",
    "draw_study",
    "plot_curve",
    "plot_curves",
    "plot_modes",
    "plot_pattern",
    "plot_patterns",
]
