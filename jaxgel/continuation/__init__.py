"""Continuation: many states along a branch, and their stability."""

from .autodiff import IllPosedDerivative, SweepFailed, is_traced
from .eigenvalue import lowest_eigenvalue
from .follow import Following
from .options import BRANCHES, CONTACT, SweepOptions, check_mu
from .path import Path
from .stability import ACCURACY, StabilityAnalysis, oriented
from .sweeps import sweep

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
    "check_mu",
    "is_traced",
    "lowest_eigenvalue",
    "oriented",
    "sweep",
]
