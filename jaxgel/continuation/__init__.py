"""continuation."""

from .autodiff import IllPosedDerivative
from .branches import continue_branch, imperfection, solve_from, switch
from .by_options import imperfection_load, sweep_by_options
from .critical import CriticalPoint, critical_points, folds
from .deflation import deflated
from .eigenvalue import lowest_eigenvalue
from .follow import SweepFailed
from .options import BRANCHES, CONTACT, SweepOptions, check_mu
from .path import Path
from .stability import ACCURACY, lowest_modes, nearby_modes, network_stiffness, oriented, tangent_products
from .sweeps import sweep

__all__ = [
    "ACCURACY",
    "BRANCHES",
    "CONTACT",
    "CriticalPoint",
    "IllPosedDerivative",
    "Path",
    "SweepFailed",
    "SweepOptions",
    "check_mu",
    "continue_branch",
    "critical_points",
    "deflated",
    "folds",
    "imperfection",
    "imperfection_load",
    "lowest_eigenvalue",
    "lowest_modes",
    "nearby_modes",
    "network_stiffness",
    "oriented",
    "solve_from",
    "sweep",
    "sweep_by_options",
    "switch",
    "tangent_products",
]
