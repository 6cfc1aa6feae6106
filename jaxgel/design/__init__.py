"""Inverse design: parameters, objectives and constraints of a swollen path, searched with exact gradients and verified."""

from .criteria import DRY, OF_GEL, Constraint, bound, misfit, porosity, value_at, weighted_sum
from .optimisation import Design, Outcome, optimise
from .optimisers import METHODS, MOST_DENSE
from .printing import PIXELS, REACH, DesignField, filtered
from .problem import DesignProblem
from .search import FEASIBLE, read_log
from .verification import intervals, verify

__all__ = [
    "DRY",
    "FEASIBLE",
    "METHODS",
    "MOST_DENSE",
    "OF_GEL",
    "PIXELS",
    "REACH",
    "Constraint",
    "Design",
    "DesignField",
    "DesignProblem",
    "Outcome",
    "bound",
    "filtered",
    "intervals",
    "misfit",
    "optimise",
    "porosity",
    "read_log",
    "value_at",
    "verify",
    "weighted_sum",
]
