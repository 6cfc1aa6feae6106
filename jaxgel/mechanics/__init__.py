"""Mechanics: the energy of a swollen gel, its contact and loads, its degrees of freedom, and its tangent."""

from .assembly import factorised_tangent, tangent
from .contact import RANGE, STIFFNESS, closest, contact_energy, contact_force, pair_energy, step_limit, touches, with_contact
from .dofs import check_edges, check_room, free_dofs, gather, prescribed_motion, restrict, scatter, start_positions, with_free_values
from .energy import (
    all_volumes,
    by_block,
    curvature,
    deformation_gradients,
    energy_at,
    network_energy,
    residual,
    total_energy,
    volume_ratios,
)
from .loads import Loads, load_vector
from .mixed import ROUND_OFF, Linearisation, condensed_rhs, linearise, pressure_step, state_pressure
from .operators import ROTATION, Operators, area_form_entries, precomputed_operators
from .outlines import crosses, outline_loops, overlaps
from .pairs import contact_pairs, node_pairs, tangent_pattern
from .problem import Problem, prepare
from .tangent_operator import STATES_TOGETHER, TangentOperator, is_sparse, tangent_product

__all__ = [
    "RANGE",
    "ROTATION",
    "ROUND_OFF",
    "STATES_TOGETHER",
    "STIFFNESS",
    "Linearisation",
    "Loads",
    "Operators",
    "Problem",
    "TangentOperator",
    "all_volumes",
    "area_form_entries",
    "by_block",
    "check_edges",
    "check_room",
    "closest",
    "condensed_rhs",
    "contact_energy",
    "contact_force",
    "contact_pairs",
    "crosses",
    "curvature",
    "deformation_gradients",
    "energy_at",
    "factorised_tangent",
    "free_dofs",
    "gather",
    "is_sparse",
    "linearise",
    "load_vector",
    "network_energy",
    "node_pairs",
    "outline_loops",
    "overlaps",
    "pair_energy",
    "precomputed_operators",
    "prepare",
    "prescribed_motion",
    "pressure_step",
    "residual",
    "restrict",
    "scatter",
    "start_positions",
    "state_pressure",
    "step_limit",
    "tangent",
    "tangent_pattern",
    "tangent_product",
    "total_energy",
    "touches",
    "volume_ratios",
    "with_contact",
    "with_free_values",
]
