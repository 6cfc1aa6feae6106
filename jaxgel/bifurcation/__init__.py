"""Bifurcations: critical points, branch switching, deflation, imperfections, barriers, loops."""

from .._deprecated import old_names
from .barriers import Barrier, barrier
from .branches import continue_branch, switch_branch
from .critical import critical_points, ends_of, located
from .deflation import find_states_by_deflation
from .imperfections import imperfection, problem_by_options, sweep_by_options
from .loops import Loop, loop
from .points import CriticalPoint
from .search import PointNotLocated, folds

__all__ = [
    "Barrier",
    "CriticalPoint",
    "Loop",
    "PointNotLocated",
    "barrier",
    "continue_branch",
    "critical_points",
    "ends_of",
    "find_states_by_deflation",
    "folds",
    "imperfection",
    "located",
    "loop",
    "problem_by_options",
    "sweep_by_options",
    "switch_branch",
]

__getattr__ = old_names(__name__)
