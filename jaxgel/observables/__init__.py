"""Observables of a path: rotation, areas, volume ratios, stresses, surface stretch, gaps, table."""

from .._deprecated import old_names
from .areas import (
    area_reduction,
    area_reduction_per_hole,
    aspect_ratio,
    deformed_boundary,
    dry_outlines,
    free_edge_misfit,
    outlines,
)
from .contact import contact_pressure, leak_area, obstacle_displacement, obstacle_force
from .fields import (
    cauchy_stress,
    cell_volumes,
    deformed_vertices,
    free_stretch,
    macroscopic_deformation,
    mean_volume_ratio,
    membrane_stress,
    parameter_values,
    thickness_stretch,
    volume_ratio,
)
from .gaps import SELF_CONTACT, gap, min_gap
from .points import deformed_mesh, displacement_at
from .quantities import (
    BY_COLUMN,
    COLUMNS,
    CURVES,
    IN_TIME,
    OF_CELLS,
    OF_EQUILIBRIA,
    OF_OBSTACLES,
    OF_POSITIONS,
    QUANTITIES,
    Quantity,
    columns_of,
    control_quantity,
)
from .rotation import core_rotation, is_flat, rotation_angle
from .solvent import (
    flux_at,
    inflow,
    is_in_time,
    potential_at,
    solvent_flux,
    solvent_potential,
    uptake,
    uptake_fraction,
)
from .states import States, state_at
from .surface import (
    CREASE_RATIO,
    crease_indicator,
    mean_surface_ratios,
    surface_ratio,
    surface_ratios,
)
from .table import events, history
from .times import at_time, time_to
from .triangles import FIELDS, field_on_triangles, field_values
from .wrinkling import surface_stability

__all__ = [
    "BY_COLUMN",
    "COLUMNS",
    "CREASE_RATIO",
    "CURVES",
    "FIELDS",
    "IN_TIME",
    "OF_CELLS",
    "OF_EQUILIBRIA",
    "OF_OBSTACLES",
    "OF_POSITIONS",
    "QUANTITIES",
    "SELF_CONTACT",
    "Quantity",
    "States",
    "area_reduction",
    "area_reduction_per_hole",
    "aspect_ratio",
    "at_time",
    "cauchy_stress",
    "cell_volumes",
    "columns_of",
    "contact_pressure",
    "control_quantity",
    "core_rotation",
    "crease_indicator",
    "deformed_boundary",
    "deformed_mesh",
    "deformed_vertices",
    "displacement_at",
    "dry_outlines",
    "events",
    "field_on_triangles",
    "field_values",
    "flux_at",
    "free_edge_misfit",
    "free_stretch",
    "gap",
    "history",
    "inflow",
    "is_flat",
    "is_in_time",
    "leak_area",
    "macroscopic_deformation",
    "mean_surface_ratios",
    "mean_volume_ratio",
    "membrane_stress",
    "min_gap",
    "obstacle_displacement",
    "obstacle_force",
    "outlines",
    "parameter_values",
    "potential_at",
    "rotation_angle",
    "solvent_flux",
    "solvent_potential",
    "state_at",
    "surface_ratio",
    "surface_ratios",
    "surface_stability",
    "thickness_stretch",
    "time_to",
    "uptake",
    "uptake_fraction",
    "volume_ratio",
]

__getattr__ = old_names(__name__)
