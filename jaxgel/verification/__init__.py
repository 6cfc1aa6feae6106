"""Verification: resolution of a cloud, error bars from several clouds and from uncertain inputs."""

from .convergence import FEWEST, ErrorBars, GridConvergence, error_bars, grid_convergence_index
from .deviations import Uncertainty, uncertainty
from .resolved import Resolution, resolution
from .several_clouds import ACCURACY, Accuracy, accuracy, on_clouds

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
    "on_clouds",
    "resolution",
    "uncertainty",
]
