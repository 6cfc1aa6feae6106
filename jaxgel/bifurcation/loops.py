"""Hysteresis loops: snap points of a cyclic control, and the unstable branch between them."""

import dataclasses

import numpy as np
from jax.lax import stop_gradient

from .._deprecated import OldAttribute, old_arguments
from .._threads import few_threads
from .._tracing import is_traced
from .._types import Scalar
from .._validation import Inadmissible
from ..continuation import (
    STEP_CONTROL,
    Adaptive,
    Followed,
    Following,
    Path,
    StepControl,
    check_sweep,
)
from ..equilibrium import (
    NEWTON,
    UNOBSERVED,
    Change,
    Newton,
    Observer,
    State,
)
from ..mechanics import Problem
from .critical import ends_of, located, with_floats, without_derivatives_by
from .limits import limits_of
from .loop_branches import state_at, state_of_point, unstable_branch
from .points import CriticalPoint
from .search import Shared

MAX_STEPS = 400  # accepted states of both ways together
# fields of a loop that were computed
RESULTS = ("up", "down", "unstable", "jumps_up", "jumps_down")


@dataclasses.dataclass(frozen=True, eq=False)
class Loop:
    """Hysteresis loop of a control: stable states both ways, and their limits; see `loop`."""

    up: Path
    """States from the first value to the last.

    ``switched`` after a jump, and where a branch leaves another one.
    """
    down: Path | None
    """States from the last value back to the first; None if the way up did not reach it."""
    jumps_up: tuple[CriticalPoint, ...]
    """Folds and subcritical bifurcations at which a stable branch ends on the way up.

    Their ``value`` is differentiable, see `loop`.
    """
    jumps_down: tuple[CriticalPoint, ...]
    """Those on the way down."""
    unstable: Path | None
    """Unstable states from ``fold_up`` to ``fold_down``.

    None if there are none, or if not requested.
    """
    joined: bool
    """Whether the unstable branch ends at ``fold_down``."""
    unlocated: tuple[float, ...] = ()
    """Values after jumps whose limit of stability was not found."""

    loads = OldAttribute(instead="loop.up.problem, which holds the loads")

    @property
    def fold_up(self) -> CriticalPoint | None:
        """Limit of stability at which the way up first leaves the branch of the first value.

        None if it does not.
        """
        return self.jumps_up[0] if self.jumps_up else None

    @property
    def fold_down(self) -> CriticalPoint | None:
        """Last limit of stability of the way down, where it rejoins the way up; None if none."""
        return self.jumps_down[-1] if self.jumps_down else None

    @property
    def width(self) -> Scalar | None:
        """Width of the loop in the control's unit, between jumps up and down; 0 without jumps.

        None if it is not known: with one jump only, with jumps that were not located, and without a
        way down.
        """
        if self.fold_up is None and self.fold_down is None:
            return None if self.unlocated or self.down is None else 0.0
        if self.fold_up is None or self.fold_down is None:
            return None
        rising = float(self.up.value[-1]) > float(self.up.value[0])
        return (self.fold_up.value - self.fold_down.value) * (1.0 if rising else -1.0)

    @property
    def critical(self) -> Path | None:
        """The states at the jumps, those of the way up first.

        Without energies, None if there is none.
        """
        states = [state_of_point(point) for point in (*self.jumps_up, *self.jumps_down)]
        return Path.from_states(self.up.problem, states) if states else None

    def states_at(self, value: float) -> tuple[State, State]:
        """The stable states at a ``value`` of the control on the way up and down.

        The same one if there is only one. ValueError outside the loop's range, or if it has no way
        down; ArithmeticError if a state is not found.
        """
        if self.down is None:
            raise Inadmissible(f"{self._name}: the loop has no way down, {self.stop_text}")
        still = self.still
        states = (
            state_at(still.up, value, still.jumps_up),
            state_at(still.down, value, still.jumps_down),
        )
        traced = is_traced(self.up.x)
        return (
            without_derivatives_by(states, self.up.x, "states_at", "value of a jump of the loop")
            if traced
            else states
        )

    @property
    def still(self) -> "Loop":
        """The loop whose jumps have no derivatives: numbers also if the loop is differentiated."""
        results = with_floats(
            stop_gradient, (self.up, self.down, self.unstable, self.jumps_up, self.jumps_down)
        )
        return dataclasses.replace(self, **dict(zip(RESULTS, results, strict=True)))

    @property
    def stop_text(self) -> str:
        """Termination: "converged" if the way returned to the first value, else a diagnosis."""
        return (self.up if self.down is None else self.down).stop_text

    @property
    def text(self) -> str:
        """One line that says what it is."""
        if self.fold_up is None and self.fold_down is None:
            jumped = (
                (
                    f"; jumps before {', '.join(f'{value:.6g}' for value in self.unlocated)} were "
                    "not located"
                )
                if self.unlocated
                else ""
            )
            return (
                "no fold found"
                if jumped or self.down is None
                else "no loop: up and down the same branch, width 0"
            ) + jumped
        said = [
            f"{way} {self._name} = {float(point.value):.6g} ({point.kind})"
            for way, points in (("up", self.jumps_up), ("down", self.jumps_down))
            for point in points
        ]
        branch = (
            ""
            if self.unstable is None
            else f"; unstable branch of {len(self.unstable)} states"
            + (", joined" if self.joined else "")
        )
        width = (
            "width unknown" if self.width is None else f"width {float(self.width):.6g}{self._unit}"
        )
        return f"{width}, jumps {', '.join(said)}{branch}"

    def __repr__(self) -> str:
        ways = [path.value[[0, -1]] for path in (self.up, self.down) if path is not None]
        values = " ... ".join(f"{value:.4g}" for value in [ways[0][0], *(way[1] for way in ways)])
        return f"Loop over {self._name} = {values}{self._unit}: {self.text}; {self.stop_text}"

    @property
    def _name(self):
        return self.up.control.name

    @property
    def _unit(self):
        return f" {self.up.control.unit}".rstrip()


@old_arguments
def loop(
    problem: Problem,
    between: tuple[float, float],
    *,
    unstable: bool = True,
    symmetry: str = "auto",
    until_contact: bool = False,
    max_steps: int = MAX_STEPS,
    newton: Newton = NEWTON,
    steps: StepControl = STEP_CONTROL,
    observer: Observer = UNOBSERVED,
) -> Loop:
    """`Loop` of stable states from one value of the control to another and back, in adaptive steps.

    Arguments:

    - `problem`: the `Problem`, with its control.
    - `between`: (first, last), values of the control in its unit.
    - `unstable`: whether to follow the branch between `fold_up` and `fold_down` in arc length.
    - `symmetry`, `until_contact`, `newton`, `steps`, `observer`: as in `sweep`.
    - `max_steps`: largest number of accepted states, both ways together.

    At the end of a stable branch the gel relaxes to another stable state, marked by `switched`. If
    there is none the loop ends; `stop_text` gives the reason. Limits of stability are located to
    `search.TOLERANCE`. Their values, and so the width, are differentiable once in everything that
    the problem depends on, forward and reverse; the states are not (`ValueError`).

    Raises `ValueError` for unusable ends, gel or control, inside `jax.jit` or `jax.vmap`, and for
    second derivatives; `SweepFailed` if the first state is not found. Example:
    docs/howto/bifurcation.md.
    """
    first, last = ends_of(problem, between)
    options = Following(
        "stable", symmetry, True, until_contact, newton, steps, observer, jumps=True
    )
    made = []

    def find(problem):
        made[:] = [
            _loop(
                problem.prepared,
                Adaptive(first, last, first, max_steps=max_steps),
                options,
                unstable,
            )
        ]
        return [*made[0].jumps_up, *made[0].jumps_down]

    points = located("loop", find, problem)
    found, count = made[0], len(made[0].jumps_up)
    if is_traced(problem):
        up, down, branch = without_derivatives_by(
            (found.up, found.down, found.unstable), problem, "loop", "value of a jump"
        )
        found = dataclasses.replace(found, up=up, down=down, unstable=branch)
    return dataclasses.replace(
        found, jumps_up=tuple(points[:count]), jumps_down=tuple(points[count:])
    )


def _loop(problem, way, options, unstable):
    """`Loop` of a problem without tracers."""
    check_sweep(problem, np.array(way.values))
    with few_threads(2 * problem.model.n_nodes):
        sweep = Followed(problem, way, options)
        return _with_limits(problem, sweep.light_states(), way.values[:2], sweep, unstable)


def _with_limits(problem, states, ends, sweep, unstable):
    """`Loop` of the states of a sweep from the first of the ``ends`` to the last and back."""
    turn = next((k for k, state in enumerate(states) if state.value == ends[1]), len(states))
    ways, limits, shared = [states[: turn + 1], states[turn:]], [], Shared.of(problem.prepared)
    for number, way in enumerate(ways):
        limits.append(limits_of(shared, way))
        jumps = {limit.at for limit in limits[-1]}
        ways[number] = [
            dataclasses.replace(state, switched=state.switched or Change.RELAXATION)
            if k in jumps
            else state
            for k, state in enumerate(way)
        ]

    def path(way, last):
        reason = dict(stop=sweep.stop, stop_text=sweep.stop_text) if last else {}
        return Path.from_states(problem, way, **reason)

    paths = [
        path(way, last=number == 1 or not ways[1]) if way else None
        for number, way in enumerate(ways)
    ]
    made = Loop(
        *paths,
        *(tuple(limit.point for limit in found if limit.point is not None) for found in limits),
        unstable=None,
        joined=False,
        unlocated=tuple(
            way[limit.at].value
            for way, found in zip(ways, limits, strict=True)
            for limit in found
            if limit.point is None
        ),
    )
    if not unstable or made.fold_up is None:
        return made
    first = next(limit.at for limit in limits[0] if limit.point is not None)
    branch, joined = unstable_branch(made, ways[0][first - 1], ways[0][first])
    return dataclasses.replace(made, unstable=branch, joined=joined)
