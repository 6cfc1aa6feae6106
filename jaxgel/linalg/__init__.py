"""Sparse symmetric matrices: patterns, multifrontal factors, solutions, eigenvalues."""

from .dissection import dissect
from .eigen import Factorised, columnwise, inverse_iteration, lowest_mode, lowest_of_factor, nearest_modes, network_matrix, rayleigh_ritz
from .factors import Bordered, Factor, SingularTangent, factor, solve_near_factor
from .kept_factors import RECENT_FACTORS, FactorCache, Kept, remember, solve_near
from .multifrontal import factorise
from .pattern import SOLVERS, Pattern, analyse

__all__ = [
    "RECENT_FACTORS",
    "SOLVERS",
    "Bordered",
    "Factor",
    "FactorCache",
    "Factorised",
    "Kept",
    "Pattern",
    "SingularTangent",
    "analyse",
    "columnwise",
    "dissect",
    "factor",
    "factorise",
    "inverse_iteration",
    "lowest_mode",
    "lowest_of_factor",
    "nearest_modes",
    "network_matrix",
    "rayleigh_ritz",
    "remember",
    "solve_near",
    "solve_near_factor",
]
