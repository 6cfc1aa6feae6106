"""How far numbers can be trusted: what a cloud resolves, and error bars from several clouds."""

from .accuracy import ACCURACY, Accuracy, accuracy
from .convergence import FEWEST, ErrorBars, GridConvergence, error_bars, grid_convergence_index
from .resolution import Resolution, resolution

__all__ = [
    "ACCURACY",
    "FEWEST",
    "Accuracy",
    "ErrorBars",
    "GridConvergence",
    "Resolution",
    "accuracy",
    "error_bars",
    "grid_convergence_index",
    "resolution",
]
