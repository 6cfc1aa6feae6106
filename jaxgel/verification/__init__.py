"""How far numbers can be trusted: what a cloud resolves, error bars from several clouds, and from uncertain inputs."""

from .accuracy import ACCURACY, Accuracy, accuracy
from .convergence import FEWEST, ErrorBars, GridConvergence, error_bars, grid_convergence_index
from .resolution import Resolution, resolution
from .uncertainty import Uncertainty, uncertainty

__all__ = [
    "ACCURACY",
    "FEWEST",
    "Accuracy",
    "ErrorBars",
    "GridConvergence",
    "Resolution",
    "Uncertainty",
    "accuracy",
    "error_bars",
    "grid_convergence_index",
    "resolution",
    "uncertainty",
]
