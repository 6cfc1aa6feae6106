"""Time: a gel in a bath swells as fast as the solvent moves."""

from .bath import Bath, Time
from .options import BathOptions, TimeOptions
from .swelling import TimeSteps, check_swelling, resolved_time, step_times, swell

__all__ = ["Bath", "BathOptions", "Time", "TimeOptions", "TimeSteps", "check_swelling", "resolved_time", "step_times", "swell"]
