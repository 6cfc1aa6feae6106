"""Inverse design: parameters -> plate, gel -> path -> objective and constraints.

Searched with exact gradients. Every parameter is scaled to [0, 1] by its bounds. Evaluations are in
`search`, constraints and invalid designs of each optimiser in `optimisers`, and the usual
objectives and constraints are in `objectives`.
"""

import dataclasses
import enum
import pathlib
from typing import Any

import numpy as np

from .lagrangian import Exhausted, Stuck
from .optimisers import METHODS, MOST_DENSE, optimiser
from .problem import DesignProblem, violation
from .search import FEASIBLE, Search
from .together import Member
from .transformations import check_transformation


class Outcome(enum.StrEnum):
    """How a search for a design ended."""

    CONVERGED = "converged"
    EXHAUSTED = "exhausted"
    STUCK = "stuck"
    INTERRUPTED = "interrupted"

    @property
    def text(self) -> str:
        """One line that says what happened and what to try."""
        return {
            "converged": "the optimiser finds no better design nearby",
            "exhausted": "the number of evaluations is used up; give more of them to go on",
            "stuck": (
                "no step from the best design gives a valid one, however short; look at the "
                "reasons in the history"
            ),
            "interrupted": "interrupted by the user; resume goes on",
        }[self]


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """Best design of a search; `optimise` returns it."""

    parameters: dict
    """Name -> value of the best design; without a feasible one, that of the least violation."""
    value: float
    """Objective of the best design, in the user's sign and unit."""
    constraints: dict
    """Name -> smallest value of each constraint's function, in its unit; met if not negative."""
    feasible: bool
    """Whether the best design meets all constraints."""
    outcome: Outcome
    """How the search ended."""
    history: list
    """One dict per evaluation: value, violation (largest, scaled), feasible, invalid, cloud.

    ``invalid`` is a text, empty if valid, ``cloud`` its number; and reported, as below.
    """
    reported: dict = dataclasses.field(default_factory=dict)
    """Name -> number of the best design, of what its problem reports."""

    @property
    def text(self) -> str:
        """The outcome in one line."""
        return self.outcome.text


def optimise(
    problem: DesignProblem,
    *,
    method: Any = "slsqp",
    evaluations: int = 60,
    step: float = 0.2,
    tolerance: float = 1e-5,
    folder: pathlib.Path | str | None = None,
    resume: bool = False,
    record: dict[str, Any] | None = None,
    quiet: bool = True,
    member: Member | None = None,
) -> Design:
    """Best `Design` of a design problem within a number of sweeps, from the start of the problem.

    Arguments:

    - `problem`: the `DesignProblem`.
    - `method`: "slsqp" (SciPy), "mma" (nlopt, extra `[mma]`), "lbfgs" (SciPy's L-BFGS-B), "adam",
      or an optax GradientTransformation for parameters scaled to [0, 1], whose update is given
      `value`, `grad` and `value_fn`; the last three take constraints by an augmented Lagrangian,
      see `optimisers`.
    - `evaluations`: largest number of evaluations, one sweep with its gradient each.
    - `step`: largest change of a scaled parameter at once, in (0, 1].
    - `tolerance`: change of the objective, over its start value, that ends the search, in (0, 1].
    - `folder`: where the complete log is written after every evaluation; no log by default.
    - `resume`: whether to continue the log in `folder`, to the same numbers as a search without
      interruption.
    - `record`: dict stored with the log.
    - `quiet`: whether to print no progress.
    - `member`: what a `Together` gives to each of several searches at once; none by default.

    Returns the design; `outcome` says how the search ended, also if the user interrupted it after
    its first valid design.

    Raises `ValueError` for an unknown method or an unusable option, a start that is no valid
    design, and a log of another problem. Example: design/bistable.py; see docs/howto/design.md.
    """
    if not 0 < step <= 1:
        raise ValueError(f"step: {step!r} is not in (0, 1], the share of the bounds' range")
    if evaluations < 1:
        raise ValueError(f"evaluations: {evaluations!r} is not a whole number of at least 1")
    if not 0 < tolerance <= 1:
        raise ValueError(
            f"tolerance: {tolerance!r} is not in (0, 1], a share of the objective at the start"
        )
    if method == "slsqp" and len(problem.vector) > MOST_DENSE:
        raise ValueError(
            f"method: 'slsqp' takes at most {MOST_DENSE} parameters, not {len(problem.vector)}; "
            "use 'mma', 'lbfgs' or 'adam'"
        )
    run = optimiser(method, step, tolerance)
    if not isinstance(method, str):
        check_transformation(method, problem.vector)
    search = Search(
        problem,
        evaluations,
        folder=folder,
        name=str(method) if method in METHODS else "optax",
        record=record,
        quiet=quiet,
        member=member,
    )
    if resume:
        search.recall()
    try:
        search.first()
        run(search)
        outcome = Outcome.CONVERGED
    except Exhausted:
        outcome = Outcome.EXHAUSTED
    except Stuck:
        outcome = Outcome.STUCK
    except KeyboardInterrupt:
        if all(entry["invalid"] for entry in search.log):
            raise  # before there is a design
        outcome = Outcome.INTERRUPTED
    finally:
        search.bar.close()
    search.write(outcome)
    return _design(search, outcome)


def _design(search, outcome):
    """`Design` of a search's log."""
    best = search.best()
    return Design(
        parameters={
            name: np.asarray(v)
            for name, v in search.problem.parameters(np.array(best["vector"])).items()
        },
        value=search.value(best),
        constraints=search.constraints(best),
        feasible=violation(best["values"][1:]) <= FEASIBLE,
        outcome=outcome,
        history=[_row(search, entry) for entry in search.log],
        reported=best.get("reported", {}),
    )


def _row(search, entry):
    row = dict(
        value=None,
        violation=None,
        feasible=False,
        invalid=entry["invalid"],
        cloud=entry["cloud"],
        reported=entry.get("reported", {}),
    )
    if not entry["invalid"]:
        most = violation(entry["values"][1:])
        row |= dict(value=search.value(entry), violation=most, feasible=most <= FEASIBLE)
    return row
