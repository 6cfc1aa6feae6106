"""Continuation: many states along a branch, their stability, bifurcations, folds and other branches."""

from .autodiff import IllPosedDerivative, SweepFailed, is_traced
from .branches import continue_branch, imperfection, solve_from, switch_branch
from .by_options import imperfection_load, sweep_by_options
from .critical import CriticalPoint, critical_points, folds
from .deflation import find_states_by_deflation
from .eigenvalue import lowest_eigenvalue
from .follow import Following
from .options import BRANCHES, CONTACT, SweepOptions, check_mu
from .path import Path
from .stability import ACCURACY, StabilityAnalysis, oriented
from .sweeps import sweep
from .symmetry import characters, symmetries

__all__ = [
    "ACCURACY",
    "BRANCHES",
    "CONTACT",
    "CriticalPoint",
    "Following",
    "IllPosedDerivative",
    "Path",
    "StabilityAnalysis",
    "SweepFailed",
    "SweepOptions",
    "characters",
    "check_mu",
    "continue_branch",
    "critical_points",
    "find_states_by_deflation",
    "folds",
    "imperfection",
    "imperfection_load",
    "is_traced",
    "lowest_eigenvalue",
    "oriented",
    "solve_from",
    "sweep",
    "sweep_by_options",
    "switch_branch",
    "symmetries",
]
