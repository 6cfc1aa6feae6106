"""Resumption of an interrupted run."""

from importlib.metadata import version
from pathlib import Path as File

import numpy as np

from ..bifurcation import sweep_by_options
from ..continuation import OF_SOLVENT, Adaptive, Path, SweepOptions
from ..equilibrium import Observer, Status
from ..io import NUMERICAL, STEP_ARRAYS, Recorder, Run, load_run, read_summary
from ..mechanics import Problem, all_volumes
from ..transient import Time
from .case import Case, from_table


def resumed(folder: File | str) -> Recorder:
    """The `Recorder` of an interrupted run, begun with its accepted states.

    None if it had no state yet. Raises ValueError for a folder that was not written by
    ``jaxgel run``, or not by this version, and for files that do not fit together.
    """
    if (File(folder) / "states.npz").is_file():
        case, path = _rebuilt(load_run(folder))
        problem, states = case.problem(path.model), [path[k] for k in range(len(path))]
        name = problem.control.name
        if not _are_of(path.value.tolist(), case, problem):
            raise ValueError(
                f"folder: the {name} in {str(folder)!r} are not those of the case in its "
                "summary.json; run the case again"
            )
    else:
        summary = read_summary(folder)
        case, states = from_table(summary["options"], summary["case"]), []
        problem = case.problem(case.model())
    recorder = recorder_of(folder, case, problem)
    for state in states:
        # one by one, as they came, so that the rows of swelling in time are the same to the last
        # digit
        recorder.add([state])
    recorder.begin()
    return recorder


def recorder_of(folder: File | str, case: Case, problem: Problem) -> Recorder:
    """The `Recorder` of a case's ``problem``.

    ``t_resolved`` in the summary of a run in time is the case's `resolved_time`.
    """
    if case.time is None:
        return Recorder(folder, case, problem)
    resolved = case.resolved_time(problem)
    return Recorder(
        folder, case, problem, {"t_resolved": resolved if np.isfinite(resolved) else None}
    )


def path_of(recorder: Recorder, observer: Observer) -> Path:
    """`Path` of a recorder's case: the states that it has, and those that follow the last one.

    ``observer`` as in `sweep`.
    """
    problem, options, states = recorder.problem, recorder.case.sweep, recorder.steps
    if recorder.case.time is not None:
        return recorder.case.swell(
            problem, before=Path.from_states(problem, states) if states else None, observer=observer
        )
    values = _left(options, [state.value for state in states])
    if states and not values:
        return Path.from_states(problem, states)
    start = states[-1] if states else None
    rest = sweep_by_options(problem, options, values=values, start=start, observer=observer)
    return Path.from_states(
        problem,
        [*states, *(rest[k] for k in range(len(rest)))],
        stop=rest.stop,
        stop_text=rest.stop_text,
    )


def _left(options: SweepOptions, done: list[float]) -> list[float] | Adaptive | None:
    """The values that are left of a sweep after states at those ``done``; none if all are."""
    if options.given or not done:
        return options.values[len(done) :] if options.given else options.values
    goals = options.turns[1:]
    for value in done[1:]:
        goals = goals[1:] if goals and value == goals[0] else goals
    return Adaptive(done[-1], *goals) if goals else None


def _are_of(values, case, problem):
    """Whether the path of a case begins with these values of its control."""
    options = case.sweep
    if case.time is not None:
        return values == [0.0, *case.times(problem)][: len(values)]
    if options.given:
        return values == options.numbers[: len(values)]
    low, high = min(options.turns), max(options.turns)
    return values[0] == options.turns[0] and all(low <= value <= high for value in values)


def other_versions(folder: File | str) -> str:
    """One line with the packages whose versions differ from the folder's; empty if none do."""
    before = read_summary(folder)["versions"]
    differing = [name for name in NUMERICAL if before.get(name) != version(name)]
    now = ", ".join(f"{name} {before.get(name)} -> {version(name)}" for name in differing)
    return (
        f"written with other versions, so the numbers agree to round-off only: {now}"
        if differing
        else ""
    )


def load_path(folder: File | str) -> Path:
    """The `path.Path` of a run's folder on the model rebuilt from its ``summary.json``.

    Raises ValueError as `load_run`, and when the model differs from the stored one (written by
    another version).
    """
    return _rebuilt(load_run(folder))[1]


def _rebuilt(run: Run) -> tuple[Case, Path]:
    """The `cases.Case` and the `Path` of a `Run`, whose problem lacks an imperfection.

    ValueError if they do not fit together.
    """
    again = f"in {str(run.folder)!r}"
    try:
        case = from_table(run.summary["options"], run.summary["case"])
    except ValueError as problem:
        raise ValueError(
            f"folder: the case {again} is not one of this version of jaxgel: {problem}; run the "
            "case again"
        ) from None
    states = run.states
    if (case.sweep.control if case.time is None else Time.name) != run.control[0]:
        raise ValueError(
            f"folder: the control of the run {again} is not that of its case; run the case again"
        )
    model = case.model()
    nodes = np.asarray(model.cloud.nodes)
    fits = nodes.shape == states["nodes"].shape and np.abs(nodes - states["nodes"]).max() <= 1e-9
    if not (
        fits
        and states["pressure"].shape[1] == len(all_volumes(model))
        and len(states["x"][0]) == len(nodes)
    ):
        raise ValueError(
            f"folder: the nodes {again} are not those of this version of jaxgel; run the case again"
        )
    if case.time is not None and (missing := [name for name in OF_SOLVENT if name not in states]):
        raise ValueError(f"folder: states.npz {again} has no {missing[0]}; run the case again")
    columns = {name: states[name] for name in (*STEP_ARRAYS, *OF_SOLVENT) if name in states}
    return case, Path(
        problem=case.problem(model, imperfect=False),
        status=np.array([Status[name] for name in states["status"]]),
        derivative=np.full(len(states["x"]), int(Status.NOT_EXAMINED)),
        symmetry=tuple(map(str, states["symmetry"])),
        stop=Status[run.summary["stop"]],
        stop_text=run.summary["reason"],
        **columns,
    )
