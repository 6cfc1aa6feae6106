"""Inverse design: parameters, objectives and constraints of a swollen path, searched with exact gradients and verified."""

from .criteria import DRY, Constraint, bound, misfit, porosity, value_at, weighted_sum
from .optimisation import Design, Outcome, optimise
from .optimisers import METHODS
from .problem import DesignProblem
from .search import FEASIBLE, read_log
from .verification import intervals, verify

__all__ = [
    "DRY",
    "FEASIBLE",
    "METHODS",
    "Constraint",
    "Design",
    "DesignProblem",
    "Outcome",
    "bound",
    "intervals",
    "misfit",
    "optimise",
    "porosity",
    "read_log",
    "value_at",
    "verify",
    "weighted_sum",
]
