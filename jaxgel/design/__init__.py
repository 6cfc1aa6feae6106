"""Inverse design: parameters, objectives and constraints of a path, searched and verified."""

from .criteria import (
    DRY,
    OF_GEL,
    Constraint,
    bound,
    misfit,
    porosity,
    time_of,
    value_at,
    weighted_sum,
)
from .lagrangian import Invalid
from .optimisation import Design, Outcome, optimise
from .optimisers import METHODS, MOST_DENSE
from .printing import PIXELS, REACH, DesignField, filtered
from .problem import DesignProblem
from .robust import Spread
from .search import FEASIBLE, check_path, read_log
from .switches import SWITCHES, barrier_height, fold_down, fold_up, loop_width, onset
from .together import Together
from .verification import intervals, verify

__all__ = [
    "DRY",
    "FEASIBLE",
    "METHODS",
    "MOST_DENSE",
    "OF_GEL",
    "PIXELS",
    "REACH",
    "SWITCHES",
    "Constraint",
    "Design",
    "DesignField",
    "DesignProblem",
    "Invalid",
    "Outcome",
    "Spread",
    "Together",
    "barrier_height",
    "bound",
    "check_path",
    "filtered",
    "fold_down",
    "fold_up",
    "intervals",
    "loop_width",
    "misfit",
    "onset",
    "optimise",
    "porosity",
    "read_log",
    "time_of",
    "value_at",
    "verify",
    "weighted_sum",
]
