"""Going on with an interrupted run from what its folder holds, to the same numbers as without the interruption.

The predictor of `sweep` extrapolates through the states before; the search for the lowest modes starts from the last ones; chosen steps
know how far to go next. All of that is in ``states.npz``, so the states that follow are the same to the bit on the same machine and
versions, and to round-off on another one.
"""

from importlib.metadata import version
from pathlib import Path as File

from . import cases
from .recorder import NUMERICAL, Recorder
from .results import load_run, read_summary, rebuilt


def resumed(folder):
    """The `Recorder` of an interrupted run, its case in ``case`` and the accepted steps in ``steps``; none where it had just begun.

    Raises ValueError for a folder that was not written by ``jaxgel run``, or not by this version, and for files that do not fit together.
    """
    summary = read_summary(folder)
    if not (File(folder) / "states.npz").is_file():
        case = cases.from_table(summary["options"], summary["case"])
        return Recorder(folder, case, case.model(), case.gel, seconds=summary["wall_seconds"])
    case, model, steps = rebuilt(load_run(folder))
    mu, (first, last), given = [step.mu for step in steps], case.sweep.ends, case.sweep.given
    if mu != case.sweep.values[: len(mu)] if given else not (mu[0] == first and mu[-1] <= last):
        raise ValueError(f"folder: the mu in {str(folder)!r} are not those of the case in its summary.json; run the case again")
    return Recorder(folder, case, model, case.gel, steps=steps, seconds=summary["wall_seconds"])


def other_versions(folder):
    """One line that names the packages whose versions differ from those that wrote the folder, empty where none do."""
    before = read_summary(folder)["versions"]
    differing = [name for name in NUMERICAL if before.get(name) != version(name)]
    now = ", ".join(f"{name} {before.get(name)} -> {version(name)}" for name in differing)
    return f"written with other versions, so the numbers agree to round-off only: {now}" if differing else ""
