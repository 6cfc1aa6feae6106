"""Equilibrium: one state at one value of the control, its status, and its derivative."""

from .bordered_newton import Conditions, solve_bordered, solve_pinned
from .derivatives import first_order_only, no_tangents, with_derivatives_of, without_derivatives
from .implicit import state_tangents
from .newton import (
    CONSTRAINT_TOLERANCE,
    MAX_ITERATIONS,
    TOLERANCE,
    advanced,
    assess_equilibrium,
    iterate,
    solve,
    starting,
    with_own_factor,
)
from .relaxation import relax, relax_along
from .state import Stability, State, accepted, acting_problem, control_force, dry_state, of_control, pressure_rate
from .status import NEARLY_SINGULAR, StateNotFound, Status, for_derivatives, of_outlines, remedy

__all__ = [
    "CONSTRAINT_TOLERANCE",
    "MAX_ITERATIONS",
    "NEARLY_SINGULAR",
    "TOLERANCE",
    "Conditions",
    "Stability",
    "State",
    "StateNotFound",
    "Status",
    "accepted",
    "acting_problem",
    "advanced",
    "assess_equilibrium",
    "control_force",
    "dry_state",
    "first_order_only",
    "for_derivatives",
    "iterate",
    "no_tangents",
    "of_control",
    "of_outlines",
    "pressure_rate",
    "relax",
    "relax_along",
    "remedy",
    "solve",
    "solve_bordered",
    "solve_pinned",
    "starting",
    "state_tangents",
    "with_derivatives_of",
    "with_own_factor",
    "without_derivatives",
]
