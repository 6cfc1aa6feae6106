"""Continuation: many states along a branch, and their stability."""

from .autodiff import IllPosedDerivative, SweepFailed, first_state_failed, is_traced
from .eigenvalue import lowest_eigenvalue
from .follow import Followed, Following
from .options import SweepOptions, check_sweep
from .path import Path, check_is_path
from .predictor import extrapolated, predict
from .stability import ACCURACY, StabilityAnalysis, oriented
from .steps import given_values
from .sweeps import sweep, values_of
from .switching import across

__all__ = [
    "ACCURACY",
    "Followed",
    "Following",
    "IllPosedDerivative",
    "Path",
    "StabilityAnalysis",
    "SweepFailed",
    "SweepOptions",
    "across",
    "check_is_path",
    "check_sweep",
    "extrapolated",
    "first_state_failed",
    "given_values",
    "is_traced",
    "lowest_eigenvalue",
    "oriented",
    "predict",
    "sweep",
    "values_of",
]
