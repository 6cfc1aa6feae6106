"""observables."""

from .areas import area_reduction, area_reduction_per_hole, aspect_ratio, dry_outlines, outlines
from .fields import FIELDS, cauchy_stress, cell_volumes, deformed_vertices, field_on_triangles, field_values, free_stretch, volume_ratio
from .gaps import min_gap
from .quantities import CURVES
from .rotation import core_rotation, is_flat, rotation_angle
from .surface import CREASE_RATIO, WRINKLE_RATIO, mean_surface_ratios, surface_ratio, surface_ratios
from .table import COLUMNS, SELF_CONTACT, events, history

__all__ = [
    "COLUMNS",
    "CREASE_RATIO",
    "CURVES",
    "FIELDS",
    "SELF_CONTACT",
    "WRINKLE_RATIO",
    "area_reduction",
    "area_reduction_per_hole",
    "aspect_ratio",
    "cauchy_stress",
    "cell_volumes",
    "core_rotation",
    "deformed_vertices",
    "dry_outlines",
    "events",
    "field_on_triangles",
    "field_values",
    "free_stretch",
    "history",
    "is_flat",
    "mean_surface_ratios",
    "min_gap",
    "outlines",
    "rotation_angle",
    "surface_ratio",
    "surface_ratios",
    "volume_ratio",
]
