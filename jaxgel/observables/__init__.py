"""What is read off the states of a path: rotation, hole areas, volume ratios, stresses, surface stretch, gaps, and their table."""

from .areas import area_reduction, area_reduction_per_hole, aspect_ratio, deformed_boundary, dry_outlines, free_edge_misfit, outlines
from .fields import (
    cauchy_stress,
    cell_volumes,
    deformed_vertices,
    free_stretch,
    macroscopic_deformation,
    membrane_stress,
    parameter_values,
    thickness_stretch,
    volume_ratio,
)
from .gaps import SELF_CONTACT, gap, min_gap
from .quantities import BY_COLUMN, COLUMNS, CURVES, OF_CELLS, OF_POSITIONS, QUANTITIES, Quantity, columns_of, control_quantity
from .rotation import core_rotation, is_flat, rotation_angle
from .states import States, state_at
from .surface import CREASE_RATIO, crease_indicator, mean_surface_ratios, surface_ratio, surface_ratios
from .table import events, history
from .triangles import FIELDS, field_on_triangles, field_values
from .wrinkling import surface_stability

__all__ = [
    "BY_COLUMN",
    "COLUMNS",
    "CREASE_RATIO",
    "CURVES",
    "FIELDS",
    "OF_CELLS",
    "OF_POSITIONS",
    "QUANTITIES",
    "SELF_CONTACT",
    "Quantity",
    "States",
    "area_reduction",
    "area_reduction_per_hole",
    "aspect_ratio",
    "cauchy_stress",
    "cell_volumes",
    "columns_of",
    "control_quantity",
    "core_rotation",
    "crease_indicator",
    "deformed_boundary",
    "deformed_vertices",
    "dry_outlines",
    "events",
    "field_on_triangles",
    "field_values",
    "free_edge_misfit",
    "free_stretch",
    "gap",
    "history",
    "is_flat",
    "macroscopic_deformation",
    "mean_surface_ratios",
    "membrane_stress",
    "min_gap",
    "outlines",
    "parameter_values",
    "rotation_angle",
    "state_at",
    "surface_ratio",
    "surface_ratios",
    "surface_stability",
    "thickness_stretch",
    "volume_ratio",
]
