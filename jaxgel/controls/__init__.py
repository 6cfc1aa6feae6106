"""What drives a sweep: the chemical potential, a parameter of the gel such as temperature, the edges, or loads."""

from .edges import DIRECTIONS, Load, Stretch
from .gels import DrivenParameter
from .registry import CONTROLS, Kind, chi, driven, pH, salt, temperature
from .setting import Changes, ChemicalPotential, Control, Driven, Setting, changes_of, check_control, check_fields, check_is_control
from .values import check_values, turning_points

__all__ = [
    "CONTROLS",
    "DIRECTIONS",
    "Changes",
    "ChemicalPotential",
    "Control",
    "Driven",
    "DrivenParameter",
    "Kind",
    "Load",
    "Setting",
    "Stretch",
    "changes_of",
    "check_control",
    "check_fields",
    "check_is_control",
    "check_values",
    "chi",
    "driven",
    "pH",
    "salt",
    "temperature",
    "turning_points",
]
