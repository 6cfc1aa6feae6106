"""mechanics."""

from .assembly import constants, constants_of, contact_pairs, crossed_entries, node_pairs, tangent, tangent_pattern
from .contact import RANGE, STIFFNESS, closest, contact_energy, contact_force, pair_energy, step_limit, with_contact
from .dofs import carried, check_edges, check_room, free_dofs, lift, picked, reduced, spread, start_positions
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
from .mixed import ROTATION, ROUND_OFF, condensed_rhs, linearise, pressure_step, state_pressure, volume_product
from .outlines import crosses, outline_loops
from .tangent_operator import TOGETHER, Products, has_products

__all__ = [
    "RANGE",
    "ROTATION",
    "ROUND_OFF",
    "STIFFNESS",
    "TOGETHER",
    "Loads",
    "Products",
    "all_volumes",
    "by_block",
    "carried",
    "check_edges",
    "check_room",
    "closest",
    "condensed_rhs",
    "constants",
    "constants_of",
    "contact_energy",
    "contact_force",
    "contact_pairs",
    "crossed_entries",
    "crosses",
    "curvature",
    "deformation_gradients",
    "energy_at",
    "free_dofs",
    "has_products",
    "lift",
    "linearise",
    "load_vector",
    "network_energy",
    "node_pairs",
    "outline_loops",
    "pair_energy",
    "picked",
    "pressure_step",
    "reduced",
    "residual",
    "spread",
    "start_positions",
    "state_pressure",
    "step_limit",
    "tangent",
    "tangent_pattern",
    "total_energy",
    "volume_product",
    "volume_ratios",
    "with_contact",
]
