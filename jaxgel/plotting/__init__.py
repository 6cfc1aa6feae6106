"""Figures of paths, modes and designs."""

from .._deprecated import old_names
from .accuracy import plot_accuracy, plot_contributions
from .animation import animate_pattern
from .curves import CURVES, plot_curve, plot_curves
from .design import draw_optima, draw_study
from .loops import plot_loop
from .patterns import plot_gel, plot_modes, plot_pattern, plot_patterns
from .style import STYLE, add_warning, colour_scale, save_figure
from .wave_figures import plot_lattice, plot_zone

__all__ = [
    "CURVES",
    "STYLE",
    "add_warning",
    "animate_pattern",
    "colour_scale",
    "draw_optima",
    "draw_study",
    "plot_accuracy",
    "plot_contributions",
    "plot_curve",
    "plot_curves",
    "plot_gel",
    "plot_lattice",
    "plot_loop",
    "plot_modes",
    "plot_pattern",
    "plot_patterns",
    "plot_zone",
    "save_figure",
]

__getattr__ = old_names(__name__)
