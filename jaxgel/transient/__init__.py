"""Transient swelling: a gel in a bath, and the diffusion of its solvent."""

from .bath import Bath, Time
from .options import BathOptions, TimeOptions
from .run import check_numbers, check_swelling
from .swelling import TimeSteps, resolved_time, step_times, swell

__all__ = [
    "Bath",
    "BathOptions",
    "Time",
    "TimeOptions",
    "TimeSteps",
    "check_numbers",
    "check_swelling",
    "resolved_time",
    "step_times",
    "swell",
]
