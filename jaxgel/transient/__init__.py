"""Time: a gel in a bath swells as fast as the solvent moves."""

from .bath import Bath, Time
from .swelling import TimeSteps, swell

__all__ = ["Bath", "Time", "TimeSteps", "swell"]
