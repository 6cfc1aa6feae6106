"""equilibrium."""

from .bordered_newton import Conditions, mu_force, solve_bordered
from .implicit import known, only_first, state_tangents
from .incremental import incremental_step, prepare_incremental
from .newton import CONSTRAINT_TOLERANCE, MAX_ITERATIONS, TOLERANCE, free_rhs, linearised, solve, solve_traced, tangent_at, with_own_factor
from .pinned import solve_pinned
from .problem import acting, dry_state, overlaps, prepare, touches
from .relaxation import relax, relax_along
from .state import Equilibrium, Status, Step, advice
from .weak import prepare_walls, wall_step

__all__ = [
    "CONSTRAINT_TOLERANCE",
    "MAX_ITERATIONS",
    "TOLERANCE",
    "Conditions",
    "Equilibrium",
    "Status",
    "Step",
    "acting",
    "advice",
    "dry_state",
    "free_rhs",
    "incremental_step",
    "known",
    "linearised",
    "mu_force",
    "only_first",
    "overlaps",
    "prepare",
    "prepare_incremental",
    "prepare_walls",
    "relax",
    "relax_along",
    "solve",
    "solve_bordered",
    "solve_pinned",
    "solve_traced",
    "state_tangents",
    "tangent_at",
    "touches",
    "wall_step",
    "with_own_factor",
]
