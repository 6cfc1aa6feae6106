"""A branch followed along its control, one state after another, with contact and changes of branch.

One step is `_Step`: predict, solve, accept or refuse, count the negative eigenvalues, change the branch. `follow` yields accepted states;
the public `sweep` and the derivative rule of a sweep both take them from here.
"""

import dataclasses
from collections.abc import Callable, Iterator

import jax.numpy as jnp
import numpy as np

from .._programs import program
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
    dry_state,
    of_outlines,
    relax,
    relax_along,
    solve,
)
from ..linalg import SingularTangent
from ..materials import gel_in_groups, rises_always
from ..mechanics import Problem, all_volumes, restrict, touches, volume_ratios
from .frames import Frame, Frames
from .predictor import EXTRAPOLATED, predict, same_branch
from .steps import STEP_CONTROL, Adaptive, StepControl, Steps, adaptive, given_values
from .switching import stable_state

BRANCHES = ("stable", "symmetric")
SYMMETRY = ("auto", "off")
MOSTLY = 0.5  # of a step's energy in the network
SAYS_NOTHING = 1e-6  # of a step along a mode: what is predicted of it and smaller may be round-off
FAR_BELOW = 5.0  # kT: where a control's first state is approached from
LEAST_RAMP = 1 / 200  # of the motion of a plate's edges, which may come in steps before the first state


@dataclasses.dataclass(frozen=True)
class Following:
    """How a branch is followed; ValueError for a value that is not accepted."""

    branch: str = "stable"
    """Branch to follow where the plate is symmetric, "stable" or "symmetric"."""
    symmetry: str = "auto"
    """Whether symmetric states are found on a fundamental region, "auto", or all of them on the whole plate, "off"."""
    eigenvalues: bool = False
    """Whether the lowest eigenvalue and its mode are computed at every state, not only where a change of branch needs them."""
    until_contact: bool = False
    """Whether the sweep ends where the sides of a hole overlap."""
    newton: Newton = NEWTON
    """When Newton's method ends."""
    steps: StepControl = STEP_CONTROL
    """When a step is refused, cut or taken for a jump."""
    observer: Observer = UNOBSERVED
    """What is told while the sweep goes."""
    jumps: bool = False
    """Whether a stable branch that ends is left by relaxation without contact too, and an unstable state ends the sweep."""

    def __post_init__(self) -> None:
        one_of("branch", self.branch, BRANCHES)
        one_of("symmetry", self.symmetry, SYMMETRY)


class Followed:
    """Accepted states of `follow`, one after another; once they are exhausted ``stop`` and ``value`` say how the sweep ended, and where."""

    def __init__(
        self, problem: Problem, values: list[float] | Adaptive, options: Following, before: list[State] | tuple[State, ...] = ()
    ) -> None:
        self._steps, self._accepted = follow(problem, values, options, before), options.observer.accepted
        self.stop, self.value = Status.INTERRUPTED, float("nan")

    def __iter__(self) -> Iterator[State]:
        self.stop, self.value = yield from self._steps

    def light_states(self, seen: Callable[[State], object] = id) -> list[State]:
        """All states without their factors; ``seen`` is called with each while it has one."""
        states = []
        for state in self:
            seen(state)
            self._accepted(state)
            states.append(state.light)
            del state  # its factor is freed before the next factorisation
        return states


def follow(problem: Problem, values: list[float] | Adaptive, options: Following, before: list[State] | tuple[State, ...] = ()) -> Steps:
    """Yield the accepted states at the ``values`` after those ``before``, each with its factor; returns how it ended, see `steps`."""
    chosen = isinstance(values, Adaptive)
    snap = options.steps.snap * problem.control.scale
    if options.jumps:
        snap = min(snap, options.steps.snap * float(np.ptp(values.values if chosen else values)))
    step = _Step(Frames(problem, symmetry=options.symmetry == "auto"), options, snap)
    if chosen:
        return adaptive(step, values, list(before), options.steps)
    return given_values(step, values, list(before), options.steps)


@dataclasses.dataclass(frozen=True)
class _Step:
    """The `State` at a value after others, whatever its status; with branch "stable" an unstable branch is left."""

    frames: Frames
    options: Following
    snap: float
    """Longest step whose failure means the end of the branch, in the control's unit."""

    def __call__(self, value: float, states: list[State]) -> State:
        """The state that `_take` finds, unless it is refused for what its outlines do."""
        found = self._take(value, states)
        if found.status.ok and self.options.until_contact:
            found = dataclasses.replace(found, status=of_outlines(found.x, self.frames.problem.model, contact=False))
        if not found.status.ok:
            self.options.observer.refused(found)
        return found

    def _take(self, value: float, states: list[State]) -> State:
        """Predict, solve, accept or refuse, count, change the branch."""
        history = same_branch(states)
        frame = self.frames.of_state(history[-1].x) if history else self.frames.of(self.frames.group)
        history = [frame.part(state) for state in history]
        found, change = self._after(frame, value, history) if history else (self._first(frame.problem, value), Change.NONE)
        if not found.status.ok:
            return frame.whole(found)
        try:
            found = frame.factorised(found)
            stability = Stability(found.factor.negative_pivots)
            if self.options.eigenvalues:
                stability, found = frame.check(found, history[-1].modes if history else None)
        except SingularTangent:
            return dataclasses.replace(frame.whole(found), factor=None, status=Status.SINGULAR)
        if stability.negative > 0 and self.options.branch == "stable":
            other = self._stable(frame, found, history)
            if other is not None:
                return other
            if self.options.jumps:
                return dataclasses.replace(frame.whole(found), factor=None, status=Status.UNSTABLE)
        rate = None if states else frame.rate(found)
        return dataclasses.replace(frame.whole(accepted(frame.problem, found, stability, switched=change)), rate=rate)

    def _solve(self, problem, value, x, pressure, near_contact=None):
        return solve(problem, value, x, pressure, near_contact=near_contact, newton=self.options.newton, observer=self.options.observer)

    def _first(self, problem: Problem, value: float) -> State:
        """The first `State` of a sweep, by way of others where it is not found at once."""
        found = self._solve(problem, value, *predict(problem, value, []))
        if not found.status.ok and (problem.moves_edges or problem.model.cloud.plate.moved):
            found = _ramped(problem, value, found, self.options.newton)
        return found if found.status.ok else _approached(problem, value, found, self.options.newton)

    def _after(self, frame: Frame, value: float, history: list[State]) -> tuple[State, Change]:
        """`State` at a ``value`` from the one that ``history`` predicts, and why it does not continue these states.

        Where holes touch, a step that moves the gel farther than the range of contact is refused, and a short one that fails relaxes.
        """
        problem, last = frame.problem, history[-1]
        x, pressure = predict(problem, value, history)
        x, near, most = frame.onto(x, value), None, np.inf
        if problem.has_contact:
            most = float(problem.model.contact.range)
            far = not np.abs(x - np.asarray(last.x)).max() < most
            was_active = touches(last.x, problem.model) if last.contact_active is None else last.contact_active
            near = bool((was_active or far) and touches(x, problem.model))
            if far and (was_active or near):
                return State(value, as_number(problem.at(value)[1]), x, pressure, status=Status.BEYOND_CONTACT), Change.NONE
        found = self._solve(problem, value, x, pressure, near)
        short = abs(value - last.value) <= self.snap
        if found.status.ok and not short and _against_prediction(frame, found, x, last):
            found = dataclasses.replace(found, status=Status.AGAINST_PREDICTION)
        if found.status.ok and found.contact_active and not np.abs(np.asarray(found.x) - np.asarray(last.x)).max() < most:
            found = dataclasses.replace(found, status=Status.BEYOND_CONTACT)
        if found.status.ok and _changes_phase(problem, found, x, self.options.steps):
            if abs(value - last.value) <= self.options.steps.leap * problem.control.scale:
                return found, Change.PHASE
            found = dataclasses.replace(found, status=Status.LEAPT)
        relaxes = self.options.branch == "stable" and (problem.has_contact or self.options.jumps)
        if found.status.ok or not (short and relaxes):
            return found, Change.NONE
        relaxed = relax(problem, value, last.x, last.pressure, self.options.newton)
        spent = found.newton_iterations + relaxed.newton_iterations
        return dataclasses.replace(relaxed, newton_iterations=spent), Change.RELAXATION if relaxed.status.ok else Change.NONE

    def _stable(self, frame: Frame, found: State, history: list[State]) -> State | None:
        """Stable `State` of the whole plate from an unstable one: next to it on a branch that leaves there, or by relaxation; or None."""
        problem = frame.problem
        touching = problem.has_contact and touches(found.x, problem.model)
        expected = predict(problem, found.value, history)[0] if history else None
        stability, found = frame.check(found, history[-1].modes if history else None)
        whole = frame.whole(found)
        other = None if touching else stable_state(self.frames, whole, stability, expected=expected)
        change = Change.BIFURCATION
        if other is None and (problem.has_contact or self.options.jumps):
            frame, change = self.frames.along_mode(whole, stability.vectors[:, 0]), Change.RELAXATION
            relaxed = relax_along(frame.problem, frame.part(whole), frame.along(stability.vectors[:, 0]), self.options.newton)
            if relaxed.status.ok:
                stability, relaxed = frame.check(relaxed)
                other = (frame.whole(relaxed), stability) if stability.negative == 0 else None
        if other is None:
            return None
        state, stability = other
        frame = self.frames.of_state(state.x)
        energy = accepted(frame.problem, frame.part(state), stability).energy
        iterations = found.newton_iterations + state.newton_iterations
        return dataclasses.replace(state, energy=energy, stability=stability, switched=change, newton_iterations=iterations)


def _against_prediction(frame, found, predicted, last):
    """Whether a step is mostly along the softest mode of the ``last`` state, and against what was ``predicted`` of it.

    Next to an imperfect bifurcation Newton's method may end on the branch that turns the other way. The mode is computed where the
    prediction missed so much of the step that this may be.
    """
    step, expected = (restrict(np.asarray(x) - np.asarray(last.x), frame.problem.free) for x in (found.x, predicted))
    miss, size = (vector @ (frame.stiffness @ vector) for vector in (step - expected, step))
    if miss < MOSTLY * size:
        return False
    modes = last.modes if last.modes is not None else frame.check(last)[0].vectors
    weighted = frame.stiffness @ frame.along(modes[:, 0])  # a mode v has v . N v = 1
    moved, foreseen = weighted @ step, weighted @ expected
    return moved * foreseen < 0 and abs(foreseen) > SAYS_NOTHING * abs(moved) and moved**2 > MOSTLY * size


def _changes_phase(problem, found, predicted, control):
    """Whether much of the gel has another volume ratio than was ``predicted``; only a gel in a poor solvent can."""
    if rises_always(gel_in_groups(problem.at(found.value)[0].gel)):
        return False
    return float(_unforeseen(problem.model, found.x, predicted, control.foreseen)) > control.much


@program(x="n", predicted="n")
def _unforeseen(model, x, predicted, foreseen):
    """Share () of the dry volume in which ln J at ``x`` (n, 2) is not that at the ``predicted`` positions within ``foreseen``."""
    J, before = volume_ratios(x, model), volume_ratios(predicted, model)
    volumes = jnp.where(model.carries, all_volumes(model), 0.0)
    apart = ~((before > 0) & (jnp.abs(jnp.log(J / jnp.where(before > 0, before, 1.0))) < foreseen))
    return jnp.sum(volumes * apart) / jnp.sum(volumes)


def _ramped(problem, value, failed, newton):
    """First `State` of a plate whose edges are moved step by step, where moving them at once ``failed``."""
    model, pressure = problem.model, dry_state(problem)[1]
    whole, x = problem.dry_positions(value) - model.cloud.nodes, model.cloud.nodes
    share, step, iterations = 0.0, 1 / 8, failed.newton_iterations
    now, mu = problem.at(value)
    while share < 1:
        more = min(step, 1 - share)
        found = solve(now, mu, x + more * whole, pressure, newton=newton)
        iterations += found.newton_iterations
        if found.status.ok:
            x, pressure, share = found.x, found.pressure, share + more
        elif step < LEAST_RAMP:
            break
        else:
            step /= 2
    return dataclasses.replace(found, value=value, newton_iterations=iterations)


def _approached(problem, value, failed, newton):
    """First `State` by way of lower chemical potentials, on the dry gel's branch, where going there at once ``failed``."""
    (now, mu), start, spent = problem.at(value), dry_state(problem, value), failed.newton_iterations

    def attempt(mu, states):
        return solve(now, mu, *(predict(now, mu, states[-EXTRAPOLATED:]) if states else start), newton=newton)

    for found in adaptive(attempt, Adaptive(float(mu) - FAR_BELOW, float(mu)), []):
        spent += found.newton_iterations
        if found.mu == float(mu):
            return dataclasses.replace(found, value=value, newton_iterations=spent)
    return dataclasses.replace(failed, newton_iterations=spent)
