"""An interrupted run, continued."""

import dataclasses
from importlib.metadata import version
from pathlib import Path as File
from typing import Any

import numpy as np

from ..continuation import Path
from ..discretisation import Model
from ..equilibrium import Stability, State, Status
from ..io import NUMERICAL, STEP_ARRAYS, Recorder, load_run, read_summary
from ..mechanics import all_volumes, free_dofs
from .case import Case, from_table


def resumed(folder: File | str) -> Recorder:
    """The `Recorder` of an interrupted run, begun with its accepted states; none if it had no state yet.

    Raises ValueError for a folder that was not written by ``jaxgel run``, or not by this version, and for files that do not fit together.
    """
    summary = read_summary(folder)
    if not (File(folder) / "states.npz").is_file():
        case = from_table(summary["options"], summary["case"])
        return _begun(folder, case, case.model(), [], summary)
    case, model, steps = rebuilt(load_run(folder))
    if not _are_of([step.value for step in steps], case.sweep):
        name = case.sweep.control
        raise ValueError(f"folder: the {name} in {str(folder)!r} are not those of the case in its summary.json; run the case again")
    return _begun(folder, case, model, steps, summary)


def _begun(folder, case, model, steps, summary):
    recorder = Recorder(folder, case, model, case.gel)
    recorder.begin(steps, summary["wall_seconds"])
    return recorder


def _are_of(values, options):
    """Whether a sweep of the `SweepOptions` begins with these values of its control."""
    if options.given:
        return values == options.values[: len(values)]
    low, high = min(options.turns), max(options.turns)
    return values[0] == options.turns[0] and all(low <= value <= high for value in values)


def other_versions(folder: File | str) -> str:
    """One line that names the packages whose versions differ from those that wrote the folder, empty where none do."""
    before = read_summary(folder)["versions"]
    differing = [name for name in NUMERICAL if before.get(name) != version(name)]
    now = ", ".join(f"{name} {before.get(name)} -> {version(name)}" for name in differing)
    return f"written with other versions, so the numbers agree to round-off only: {now}" if differing else ""


def load_path(folder: File | str) -> Path:
    """The `path.Path` of a run's folder, to the bit, on the model built again from the options in its ``summary.json``.

    Raises ValueError as `load_run`, and when the model differs from the stored one (written by another version).
    """
    run = load_run(folder)
    case, model, steps = rebuilt(run)
    stop, text = Status[run.summary["stop"]], run.summary["reason"]
    return Path.from_states(model, case.gel, steps, control=case.control(model), stop=stop, stop_text=text)


def rebuilt(run: Any) -> tuple[Case, Model, list[State]]:
    """The `cases.Case` of a `Run`, its model with contact, and the accepted `State`s; ValueError where they do not fit together."""
    case = from_table(run.summary["options"], run.summary["case"])
    if (case.sweep.control, "value" in run.states) != (run.control[0], run.control[0] != "mu"):
        raise ValueError(f"folder: the control of the run in {str(run.folder)!r} is not that of its case; run the case again")
    model, states = case.model(), run.states
    nodes, modes = np.asarray(model.cloud.nodes), states.get("modes")
    fits = nodes.shape == states["nodes"].shape and np.abs(nodes - states["nodes"]).max() <= 1e-9
    fits = fits and states["pressure"].shape[1] == len(all_volumes(model)) and len(states["x"][0]) == len(nodes)
    if not (fits and (modes is None or len(modes) == len(free_dofs(model.lists.topology)))):
        raise ValueError(f"folder: the nodes in {str(run.folder)!r} are not those of this version of jaxgel; run the case again")
    steps = [_step(states, i) for i in range(len(run.mu))]
    stability = dataclasses.replace(steps[-1].stability, vectors=modes)
    return case, model, [*steps[:-1], dataclasses.replace(steps[-1], stability=stability, rate=states.get("rate"))]


def _step(states, i):
    """The accepted step ``i`` of the arrays of ``states.npz``."""
    values = {name: states[name][i] if states[name].ndim > 1 else states[name][i].item() for name in STEP_ARRAYS}
    stability = Stability(np.array([values.pop("lowest_eigenvalue")]), None, values.pop("negative_pivots"))
    apart = int(states["apart"][i])  # -1, 0, 1: not looked at, contact acts, contact does not act
    status, active = Status[str(states["status"][i])], None if apart < 0 else not apart
    control = states["value"][i].item() if "value" in states else None
    return State(**values, control=control, stability=stability, status=status, contact_active=active, symmetry=str(states["symmetry"][i]))
