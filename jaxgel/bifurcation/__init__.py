"""Bifurcations: critical points of a branch, folds, the branches that leave, further states, imperfections."""

from .barriers import Barrier, barrier
from .branches import continue_branch, switch_branch
from .critical import critical_points, located
from .deflation import find_states_by_deflation
from .imperfections import imperfection, imperfection_load, points_by_options, sweep_by_options
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
    "find_states_by_deflation",
    "folds",
    "imperfection",
    "imperfection_load",
    "located",
    "loop",
    "points_by_options",
    "sweep_by_options",
    "switch_branch",
]
