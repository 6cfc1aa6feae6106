"""What drives a sweep: the chemical potential, a parameter of the gel such as temperature, the edges, or loads."""

from .edges import DIRECTIONS, Load, Stretch
from .gels import DrivenParameter, chi, driven, pH, salt, temperature
from .setting import (
    Control,
    Driven,
    Setting,
    adds_loads,
    check_control,
    check_fields,
    control_name,
    drives_stiffness,
    edge_motion,
    moves_edges,
    scale_of,
    setting_of,
    unit_of,
)
from .values import Values, check_values, turning_points

__all__ = [
    "DIRECTIONS",
    "Control",
    "Driven",
    "DrivenParameter",
    "Load",
    "Setting",
    "Stretch",
    "Values",
    "adds_loads",
    "check_control",
    "check_fields",
    "check_values",
    "chi",
    "control_name",
    "driven",
    "drives_stiffness",
    "edge_motion",
    "moves_edges",
    "pH",
    "salt",
    "scale_of",
    "setting_of",
    "temperature",
    "turning_points",
    "unit_of",
]
