"""The quantities of a path by name."""

from ..continuation import lowest_eigenvalue
from .areas import area_reduction
from .gaps import gap
from .rotation import core_rotation, rotation_angle
from .surface import crease_indicator, surface_ratio

CURVES = {
    "rotation": rotation_angle,
    "core_rotation": core_rotation,
    "area_reduction": area_reduction,
    "surface_ratio": surface_ratio,
    "crease_indicator": crease_indicator,
    "gap": gap,
    "lowest_eigenvalue": lowest_eigenvalue,
}
"""Quantities of a path by name; each gives (k,) values."""
