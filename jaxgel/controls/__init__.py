"""Controls of a sweep: chemical potential, gel parameters such as temperature, edges, loads."""

from .._deprecated import old_names
from .edges import DIRECTIONS, Load, Punch, Stretch
from .gels import DrivenParameter
from .registry import CONTROLS, Kind, chi, driven, pH, salt, temperature
from .setting import (
    Changes,
    ChemicalPotential,
    Control,
    Driven,
    Setting,
    changes_of,
    check_control,
    check_fields,
    check_is_control,
)
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
    "Punch",
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

__getattr__ = old_names(__name__)
