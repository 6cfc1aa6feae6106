"""Equilibrium: one state at one value of the control, its status, and its derivative."""

from .._deprecated import old_names
from .bordered_newton import Conditions, solve_bordered, solve_pinned
from .derivatives import first_order_only, no_tangents, without_derivatives
from .implicit import state_tangents
from .motions import Motions, moved
from .newton import NEWTON, Correction, Newton, advanced, iterate, solve, starting, with_own_factor
from .observer import UNOBSERVED, Observer
from .relaxation import relax, relax_along
from .state import (
    Stability,
    State,
    accepted,
    acting_problem,
    as_number,
    control_force,
    control_rates,
    dry_state,
    linearised,
    pressure_rate,
    touching,
)
from .status import (
    NEARLY_SINGULAR,
    Change,
    StateNotFound,
    Status,
    for_derivatives,
    of_iterate,
    of_outlines,
    remedy,
)
from .traced import Iterate, first_iterate, solve_traced

__all__ = [
    "NEARLY_SINGULAR",
    "NEWTON",
    "UNOBSERVED",
    "Change",
    "Conditions",
    "Correction",
    "Iterate",
    "Motions",
    "Newton",
    "Observer",
    "Stability",
    "State",
    "StateNotFound",
    "Status",
    "accepted",
    "acting_problem",
    "advanced",
    "as_number",
    "control_force",
    "control_rates",
    "dry_state",
    "first_iterate",
    "first_order_only",
    "for_derivatives",
    "iterate",
    "linearised",
    "moved",
    "no_tangents",
    "of_iterate",
    "of_outlines",
    "pressure_rate",
    "relax",
    "relax_along",
    "remedy",
    "solve",
    "solve_bordered",
    "solve_pinned",
    "solve_traced",
    "starting",
    "state_tangents",
    "touching",
    "with_own_factor",
    "without_derivatives",
]

__getattr__ = old_names(__name__)
