"""Continuation: many states along a branch, and their stability."""

from .autodiff import IllPosedDerivative, SweepFailed, is_traced
from .eigenvalue import lowest_eigenvalue
from .follow import Following
from .options import BRANCHES, CONTACT, SweepOptions
from .path import Path
from .stability import ACCURACY, StabilityAnalysis, oriented
from .sweeps import sweep, values_of

__all__ = [
    "ACCURACY",
    "BRANCHES",
    "CONTACT",
    "Following",
    "IllPosedDerivative",
    "Path",
    "StabilityAnalysis",
    "SweepFailed",
    "SweepOptions",
    "is_traced",
    "lowest_eigenvalue",
    "oriented",
    "sweep",
    "values_of",
]
