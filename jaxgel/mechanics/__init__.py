"""Mechanics: the energy of a swollen gel, its contact and loads, its degrees of freedom, and its tangent."""

from .assembly import STATES_TOGETHER, TangentOperator, factorised_tangent, is_sparse, tangent, tangent_product
from .contact import RANGE, STIFFNESS, closest, contact_energy, contact_force, pair_energy, step_limit, touches, with_contact
from .dofs import check_edges, check_room, free_dofs, gather, prescribed_motion, restrict, scatter, start_positions, with_free_values
from .energy import curvature, energy_at, hessian_product, network_energy, residual, total_energy
from .loads import Loads, load_vector
from .local_gel import localised, mean_parameter
from .mixed import ROUND_OFF, Linearisation, condensed_rhs, linearise, mu_force, pressure_step, state_pressure
from .operators import Operators, precomputed_operators
from .outlines import crosses, outline_loops, overlaps
from .pairs import contact_pairs, node_pairs, tangent_pattern
from .problem import Problem, prepare
from .volumes import (
    all_volumes,
    at_points,
    by_block,
    carries_volume,
    contents,
    deformation_gradients,
    is_film,
    pressure_at,
    pressure_rate,
    ratio_at,
    stiffness_at,
    volume_ratios,
)

__all__ = [
    "RANGE",
    "ROUND_OFF",
    "STATES_TOGETHER",
    "STIFFNESS",
    "Linearisation",
    "Loads",
    "Operators",
    "Problem",
    "TangentOperator",
    "all_volumes",
    "at_points",
    "by_block",
    "carries_volume",
    "check_edges",
    "check_room",
    "closest",
    "condensed_rhs",
    "contact_energy",
    "contact_force",
    "contact_pairs",
    "contents",
    "crosses",
    "curvature",
    "deformation_gradients",
    "energy_at",
    "factorised_tangent",
    "free_dofs",
    "gather",
    "hessian_product",
    "is_film",
    "is_sparse",
    "linearise",
    "load_vector",
    "localised",
    "mean_parameter",
    "mu_force",
    "network_energy",
    "node_pairs",
    "outline_loops",
    "overlaps",
    "pair_energy",
    "precomputed_operators",
    "prepare",
    "prescribed_motion",
    "pressure_at",
    "pressure_rate",
    "pressure_step",
    "ratio_at",
    "residual",
    "restrict",
    "scatter",
    "start_positions",
    "state_pressure",
    "step_limit",
    "stiffness_at",
    "tangent",
    "tangent_pattern",
    "tangent_product",
    "total_energy",
    "touches",
    "volume_ratios",
    "with_contact",
    "with_free_values",
]
