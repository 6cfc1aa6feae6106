"""Sparse symmetric matrices: patterns, multifrontal factors, solutions, eigenvalues."""

from .._deprecated import old_names
from .blocks import BlockFactor, Diagonal
from .dissection import dissect
from .eigen import (
    Factorised,
    inverse_iteration,
    lowest_mode,
    lowest_of_factor,
    nearest_modes,
    network_matrix,
    rayleigh_ritz,
)
from .elimination import (
    BlockElimination,
    BlockPattern,
    Elimination,
    Factors,
    block_elimination_of,
    elimination_of,
    is_definite,
)
from .factors import Bordered, Factor, SingularTangent, columnwise, factor
from .kept_factors import RECENT_FACTORS, FactorCache
from .multifrontal import factorise
from .pattern import Pattern, analyse

__all__ = [
    "RECENT_FACTORS",
    "BlockElimination",
    "BlockFactor",
    "BlockPattern",
    "Bordered",
    "Diagonal",
    "Elimination",
    "Factor",
    "FactorCache",
    "Factorised",
    "Factors",
    "Pattern",
    "SingularTangent",
    "analyse",
    "block_elimination_of",
    "columnwise",
    "dissect",
    "elimination_of",
    "factor",
    "factorise",
    "inverse_iteration",
    "is_definite",
    "lowest_mode",
    "lowest_of_factor",
    "nearest_modes",
    "network_matrix",
    "rayleigh_ritz",
]

__getattr__ = old_names(__name__)
