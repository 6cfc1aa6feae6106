"""A branch followed along its control, one state after another, with contact and changes of branch.

One step is `next_state`. `Followed` yields the accepted states; the public `sweep` and the
derivative rule of a sweep take them from here.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator

import jax.numpy as jnp
import numpy as np

from .._programs import program
from .._threads import few_threads
from .._validation import one_of
from ..equilibrium import (
    NEWTON,
    UNOBSERVED,
    Change,
    Newton,
    Observer,
    Stability,
    State,
    Status,
    accepted,
    as_number,
    of_outlines,
    relax,
    relax_along,
    solve,
    touching,
)
from ..linalg import SingularTangent
from ..materials import gel_in_groups, rises_always
from ..mechanics import Problem, all_volumes, restrict, volume_ratios
from .first import first_state, first_state_failed
from .frames import GROUPS, Frames
from .predictor import predict, same_branch
from .steps import STEP_CONTROL, Adaptive, StepControl, adaptive, given_values
from .switching import stable_state

BRANCHES = ("stable", "symmetric")
SYMMETRY = ("auto", "off", *GROUPS)
MOSTLY = 0.5  # of a step's energy in the network
SAYS_NOTHING = 1e-6  # of a step along a mode: what is predicted of it and smaller may be round-off


@dataclasses.dataclass(frozen=True)
class Following:
    """How a branch is followed; ValueError for a value that is not accepted."""

    branch: str = "stable"
    """Branch to follow where the plate is symmetric, "stable" or "symmetric"."""
    symmetry: str = "auto"
    """Use of symmetry: "auto" for a fundamental region, or "off" for the whole plate.

    It concerns symmetric states. Or the name of a group: that of the region.
    """
    eigenvalues: bool = False
    """Whether lowest eigenvalue and mode are computed at all states.

    Otherwise only if a change of branch needs them.
    """
    until_contact: bool = False
    """Whether the sweep ends where the sides of a hole overlap."""
    newton: Newton = NEWTON
    """When Newton's method ends."""
    steps: StepControl = STEP_CONTROL
    """When a step is refused, cut or taken for a jump."""
    observer: Observer = UNOBSERVED
    """Observer of the sweep."""
    jumps: bool = False
    """Whether a stable branch that ends is left by relaxation without contact too.

    An unstable state then ends the sweep.
    """

    def __post_init__(self) -> None:
        one_of("branch", self.branch, BRANCHES)
        one_of("symmetry", self.symmetry, SYMMETRY)


class Followed:
    """Accepted states at the ``values`` after those ``before``, each with its factor.

    One after another. Once they are exhausted ``stop`` and ``value`` say how the sweep ended, and
    where.
    """

    def __init__(
        self,
        problem: Problem,
        values: list[float] | Adaptive,
        options: Following,
        before: list[State] | tuple[State, ...] = (),
    ) -> None:
        steps, numbers = (
            (adaptive, values.values) if isinstance(values, Adaptive) else (given_values, values)
        )
        snap = options.steps.snap * min(
            [problem.control.scale, *[float(np.ptp(numbers))] * options.jumps]
        )
        attempt = functools.partial(next_state, Frames(problem, options.symmetry), options, snap)
        self._steps = steps(attempt, values, list(before), options.steps)
        self._problem, self._first, self._accepted = problem, numbers[0], options.observer.accepted
        self.stop, self.value = Status.INTERRUPTED, float("nan")

    def __iter__(self) -> Iterator[State]:
        self.stop, self.value = yield from self._steps

    @property
    def stop_text(self) -> str:
        """The last value and why no state follows it; empty if all were reached."""
        return (
            ""
            if self.stop.ok
            else f"stopped after {self._problem.control.name} = {self.value:.6g}: {self.stop.text}"
        )

    def light_states(self, seen: Callable[[State], object] = id) -> list[State]:
        """All states without their factors, at least one, or `SweepFailed`.

        ``seen`` is called with each while it has one.
        """
        states = []
        with few_threads(2 * self._problem.model.n_nodes):
            for state in self:
                seen(state)
                self._accepted(state)
                states.append(state.light)
                del state  # its factor is freed before the next factorisation
        if not states:
            raise first_state_failed(self._problem.control, self._first, self.stop)
        return states


def next_state(
    frames: Frames, options: Following, snap: float, value: float, states: list[State]
) -> State:
    """The `State` at a ``value`` of the control after the accepted ``states``, whatever its status.

    With branch "stable" an unstable branch is left. If a step of at most ``snap`` fails there, in
    the control's unit, the branch has ended: the gel relaxes to another state if its problem has
    contact, or if the options ask for jumps.
    """

    def refused(state, status):
        state = dataclasses.replace(state, status=status, factor=None)
        options.observer.refused(state)
        return state

    history, stable, newton = same_branch(states), options.branch == "stable", options.newton
    frame = frames.of_state(history[-1].x) if history else frames.of(frames.group)
    problem, history = frame.problem, [frame.part(state) for state in history]
    relaxes = stable and (problem.has_contact or options.jumps)

    # predict, solve, accept or refuse
    if not history:
        found = first_state(problem, value, newton, options.observer)
    else:
        last, short = history[-1], abs(value - history[-1].value) <= snap
        x, pressure = predict(problem, value, history)
        x = frame.onto(x, value)
        status = _judge_prediction(problem, x, last)
        if not status.ok:
            return refused(
                frame.whole(State(value, as_number(problem.at(value)[1]), x, pressure)), status
            )
        found = solve(problem, value, x, pressure, newton=newton, observer=options.observer)
        status, change = _judge(frame, found, x, last, options.steps, short=short)
        found = dataclasses.replace(found, status=status, switched=change)
        if not status.ok and short and relaxes:
            relaxed = relax(problem, value, last.x, last.pressure, newton)
            spent = found.newton_iterations + relaxed.newton_iterations
            found = dataclasses.replace(
                relaxed, newton_iterations=spent, switched=Change.RELAXATION
            )
    if not found.status.ok:
        return refused(frame.whole(found), found.status)

    # stability
    try:
        found = frame.factorised(found)
        stability = Stability(found.factor.negative_pivots)
        if options.eigenvalues:
            stability, found = frame.check(found, history[-1].modes if history else None)
    except SingularTangent:
        return refused(frame.whole(found), Status.SINGULAR)

    # change of branch
    other = (
        _next_to_unstable(frames, frame, found, history, options, relaxes=relaxes)
        if stable and stability.negative
        else None
    )
    if other is None:
        if stable and stability.negative and options.jumps:
            return refused(frame.whole(found), Status.UNSTABLE)
        rate = None if states else frame.rate(found)
        other = dataclasses.replace(
            frame.whole(accepted(problem, found, stability, switched=found.switched)), rate=rate
        )
    status = (
        of_outlines(other.x, frames.problem.model, contact=False)
        if options.until_contact
        else Status.CONVERGED
    )
    return other if status.ok else refused(other, status)


def _judge_prediction(problem, x, last):
    """Status of predicted positions ``x`` after the ``last`` state."""
    far = problem.has_contact and _moves_far(problem, x, last)
    return (
        Status.BEYOND_CONTACT
        if far and (touching(problem, last).pairs or problem.touching(x).pairs)
        else Status.CONVERGED
    )


def _judge(frame, found, predicted, last, steps, *, short):
    """Status of a state ``found`` as the next after the ``last``, and its `Change`."""
    if not found.status.ok:
        return found.status, Change.NONE
    if not short and _against_prediction(frame, found, predicted, last):
        return Status.AGAINST_PREDICTION, Change.NONE
    if found.touches and _moves_far(frame.problem, found.x, last):
        return Status.BEYOND_CONTACT, Change.NONE
    changes = _changes_phase(frame.problem, found, predicted, steps)
    if changes and abs(found.value - last.value) > steps.leap * frame.problem.control.scale:
        return Status.LEAPT, Change.NONE
    return Status.CONVERGED, Change.PHASE if changes else Change.NONE


def _moves_far(problem, x, last):
    """Whether a node moves farther from the ``last`` state than the range of contact.

    Sides may have passed each other.
    """
    return not np.abs(np.asarray(x) - np.asarray(last.x)).max() < float(problem.model.contact.range)


def _against_prediction(frame, found, predicted, last):
    """Whether a step is mostly along the softest mode of ``last``, against ``predicted``.

    Next to an imperfect bifurcation Newton's method may end on the branch that turns the other way.
    The mode is computed where the prediction missed so much of the step that this may be.
    """
    step, expected = (
        restrict(np.asarray(x) - np.asarray(last.x), frame.problem.free)
        for x in (found.x, predicted)
    )
    miss, size = (vector @ (frame.stiffness @ vector) for vector in (step - expected, step))
    if miss < MOSTLY * size:
        return False
    modes = last.modes if last.modes is not None else frame.check(last)[0].vectors
    weighted = frame.stiffness @ frame.along(modes[:, 0])  # a mode v has v . N v = 1
    moved, foreseen = weighted @ step, weighted @ expected
    return (
        moved * foreseen < 0
        and abs(foreseen) > SAYS_NOTHING * abs(moved)
        and moved**2 > MOSTLY * size
    )


def _changes_phase(problem, found, predicted, control):
    """Whether much of the gel has another volume ratio than was ``predicted``.

    Only a gel in a poor solvent can.
    """
    if rises_always(gel_in_groups(problem.at(found.value)[0].gel)):
        return False
    return float(_unforeseen(problem.model, found.x, predicted, control.foreseen)) > control.much


@program(x="n", predicted="n")
def _unforeseen(model, x, predicted, foreseen):
    """Dry volume share () in which ln J at ``x`` (n, 2) misses ``predicted`` by ``foreseen``."""
    J, before = volume_ratios(x, model), volume_ratios(predicted, model)
    volumes = jnp.where(model.carries, all_volumes(model), 0.0)
    apart = ~((before > 0) & (jnp.abs(jnp.log(J / jnp.where(before > 0, before, 1.0))) < foreseen))
    return jnp.sum(volumes * apart) / jnp.sum(volumes)


def _next_to_unstable(frames, frame, found, history, options, *, relaxes):
    """Stable `State` of the whole plate from an unstable one; None if there is none.

    Next to it on a branch that leaves there, or by relaxation.
    """
    problem = frame.problem
    expected = predict(problem, found.value, history)[0] if history else None
    stability, found = frame.check(found, history[-1].modes if history else None)
    whole = frame.whole(found)
    other = None if found.touches else stable_state(frames, whole, stability, expected=expected)
    change = Change.BIFURCATION
    if other is None and relaxes:
        frame, change = frames.along_mode(whole, stability.vectors[:, 0]), Change.RELAXATION
        relaxed = relax_along(
            frame.problem, frame.part(whole), frame.along(stability.vectors[:, 0]), options.newton
        )
        if relaxed.status.ok:
            stability, relaxed = frame.check(relaxed)
            other = (frame.whole(relaxed), stability) if stability.negative == 0 else None
    if other is None:
        return None
    state, stability = other
    frame = frames.of_state(state.x)
    energy = accepted(frame.problem, frame.part(state), stability).energy
    iterations = found.newton_iterations + state.newton_iterations
    return dataclasses.replace(
        state, energy=energy, stability=stability, switched=change, newton_iterations=iterations
    )
