"""Compiled programs of clouds that are no longer in use: JAX keeps every one, and a process has only so many memory mappings.

XLA maps each part of each program by itself, thousands for the sweep and the gradient of one cloud. Linux allows a process
65530 by default; one more, and it crashes.
"""

import pathlib
import sys

CROWDED = 0.5  # of the mappings that a process may have


def release_programs() -> None:
    """Let go of all compiled programs of jaxgel's functions; those still needed are compiled again at their next call."""
    for name, module in list(sys.modules.items()):
        if name == __package__ or name.startswith(f"{__package__}."):
            for value in list(vars(module).values()):
                if hasattr(value, "clear_cache"):
                    value.clear_cache()


def mappings() -> tuple[int, int]:
    """How many memory mappings this process has and how many it may have; (0, 1) where the system does not tell, as on macOS."""
    try:
        limit = int(pathlib.Path("/proc/sys/vm/max_map_count").read_text())
        with pathlib.Path("/proc/self/maps").open("rb") as lines:
            return sum(1 for _ in lines), limit
    except (OSError, ValueError):
        return 0, 1


def release_programs_where_crowded() -> None:
    """`release_programs` where a process has used more than ``CROWDED`` of its mappings."""
    used, limit = mappings()
    if used > CROWDED * limit:
        release_programs()
