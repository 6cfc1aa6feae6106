"""A branch followed along its control, one state after another, with contact and changes of branch.

A state knows nothing of the sweep: it is a prediction and Newton's method. `follow` yields accepted states; the public `sweep` and the
derivative rule of a sweep both take them from here.
"""

import dataclasses
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np

from .._validation import one_of
from ..controls import scale_of
from ..equilibrium import (
    State,
    Status,
    accepted,
    dry_state,
    of_control,
    of_outlines,
    relax,
    relax_along,
    solve,
)
from ..linalg import SingularTangent
from ..materials import gel_in_groups, rises_always
from ..mechanics import Problem, all_volumes, carries_volume, restrict, touches, volume_ratios
from .frames import Frames
from .options import BRANCHES, CONTACT, MAX_STEPS, SYMMETRY
from .predictor import EXTRAPOLATED, predict, same_branch
from .steps import Steps, adaptive, given_values
from .switching import stable_state

SNAP = 5e-3  # of the control's scale: a step this short that fails with contact ends on another branch, by relaxation
MOSTLY = 0.5  # of a step's energy in the network
LEAP = 2e-2  # of the control's scale: a step this short in which a gel changes its phase is accepted
FORESEEN = 0.2  # of ln J: what a prediction may be wrong
MUCH = 0.2  # of a gel's volume
SAYS_NOTHING = 1e-6  # of a step along a mode: what is predicted of it and smaller may be round-off
FAR_BELOW = 5.0  # kT: where a control's first state is approached from
LEAST_RAMP = 1 / 200  # of the motion of a plate's edges, which may come in steps before the first state


@dataclasses.dataclass(frozen=True)
class Following:
    """How a branch is followed; ValueError for a value that is not accepted."""

    branch: str = "stable"
    """Branch to follow where the plate is symmetric, "stable" or "symmetric"."""
    contact: str = "on"
    """Where hole boundaries meet, keep them apart ("on"), let them overlap ("off"), or "stop"."""
    adaptive: bool = False
    """Whether the values of the control are the ends and turning points of adaptive steps."""
    max_steps: int = MAX_STEPS
    """Most accepted states of adaptive steps."""
    symmetry: str = "auto"
    """Whether symmetric states are found on a fundamental region, "auto", or all of them on the whole plate, "off"."""
    jumps: bool = False
    """Whether a stable branch that ends is left by relaxation without contact too, and an unstable state ends the sweep."""

    def __post_init__(self) -> None:
        for name, choices in (("branch", BRANCHES), ("contact", CONTACT), ("symmetry", SYMMETRY)):
            one_of(name, getattr(self, name), choices)


class Followed:
    """Accepted states of `follow`, one after another; once they are exhausted ``stop`` and ``value`` say how the sweep ended, and where."""

    def __init__(self, problem: Problem, values: list[float], options: Following, before: list[State] | tuple = ()) -> None:
        self._steps = follow(problem, values, options, before)
        self.stop, self.value = Status.INTERRUPTED, float("nan")

    def __iter__(self) -> Iterator[State]:
        self.stop, self.value = yield from self._steps

    def light_states(self, seen: Callable[[State], object] | None = None) -> list[State]:
        """All states without their factors; ``seen`` is called with each while it has one."""
        states = []
        for state in self:
            if seen is not None:
                seen(state)
            states.append(state.light)
            del state  # its factor is freed before the next factorisation
        return states


def follow(problem: Problem, values: list[float], options: Following, before: list[State] | tuple = ()) -> Steps:
    """Yield the accepted states at the ``values`` after those ``before``, each with its factor; returns how it ended, see `steps`."""
    longest = SNAP * scale_of(problem.control)
    if options.jumps:
        longest = min(longest, SNAP * float(np.ptp(values)))
    attempt = _Attempt(Frames(problem, symmetry=options.symmetry == "auto"), options.branch == "stable", options.jumps, longest)
    if options.contact == "stop":
        attempt = _until_contact(attempt, problem.model)
    if options.adaptive:
        return adaptive(attempt, values, list(before), options.max_steps)
    return given_values(attempt, values, list(before))


def _until_contact(attempt, model):
    """``attempt`` that ends the sweep where hole boundaries overlap."""

    def stopping(value, states):
        found = attempt(value, states)
        return dataclasses.replace(found, status=of_outlines(found.x, model, contact=False)) if found.status.ok else found

    return stopping


@dataclasses.dataclass(frozen=True)
class _Attempt:
    """The `State` at a value after others, with its stability; with ``stable`` an unstable branch is left."""

    frames: Frames
    stable: bool
    jumps: bool
    snap: float
    """Longest step whose failure means the end of the branch, in the control's unit."""

    def __call__(self, value, states):
        history = same_branch(states)
        frame = self.frames.of_state(history[-1].x) if history else self.frames.of(self.frames.group)
        history = [frame.part(state) for state in history]
        found, switched = self._reach(frame, value, history)
        if not found.status.ok:
            return frame.whole(found)
        modes, held = history[-1].modes if history else None, [found]
        del found  # its factor may be freed before the next factorisation
        bare = dataclasses.replace(held[0], factor=None, status=Status.SINGULAR)
        try:
            stability, found = frame.check(held.pop(), modes)
        except SingularTangent:
            return frame.whole(bare)
        rate = None if states else frame.rate(found)
        other = self._stable(frame, found, stability, history) if self.stable and stability.negative > 0 else None
        if other is None and self.jumps and stability.negative > 0:
            return dataclasses.replace(frame.whole(found), factor=None, status=Status.UNSTABLE)
        if other is None:
            return dataclasses.replace(frame.whole(accepted(frame.problem, found, stability, switched=switched)), rate=rate)
        state, stability = other
        state = dataclasses.replace(state, newton_iterations=found.newton_iterations + state.newton_iterations)
        frame = self.frames.of_state(state.x)
        energy = accepted(frame.problem, frame.part(state), stability).energy
        return dataclasses.replace(state, energy=energy, stability=stability, switched=True)

    def _reach(self, frame, value, history):
        """`State` at a ``value`` from the one that ``history`` predicts, and whether it lies on another branch.

        Where holes touch, a step that moves the gel farther than the range of contact is refused, and a short one that fails relaxes.
        """
        problem = frame.problem
        x, pressure = predict(problem, value, history)
        if not history:
            return _first(problem, value, solve(problem, value, x, pressure)), False
        last, x = history[-1], frame.onto(x, value)
        if not problem.has_contact:
            found, leapt = _leapt(problem, _as_predicted(frame, solve(problem, value, x, pressure), x, last, self.snap), x, last)
            return self._relaxed(problem, found, leapt, last) if self.jumps else (found, leapt)
        most = float(problem.model.contact.range)
        far = not np.abs(x - last.x).max() < most
        was_active = touches(last.x, problem.model) if last.contact_active is None else last.contact_active
        near = bool((was_active or far) and touches(x, problem.model))
        if far and (was_active or near):
            return of_control(problem, State(float(problem.at(value)[1]), x, pressure), value), False
        found = _as_predicted(frame, solve(problem, value, x, pressure, near_contact=near), x, last, self.snap)
        if found.status.ok and found.contact_active and not np.abs(found.x - last.x).max() < most:
            found = dataclasses.replace(found, status=Status.NOT_CONVERGED)
        return self._relaxed(problem, *_leapt(problem, found, x, last), last)

    def _relaxed(self, problem, found, leapt, last):
        """The `State` found after the ``last`` one and whether it ``leapt``; where a short step failed, that to which the last relaxes."""
        if found.status.ok or not self.stable or abs(found.value - last.value) > self.snap:
            return found, leapt
        relaxed = relax(problem, found.value, last.x, last.pressure)
        spent = found.newton_iterations + relaxed.newton_iterations
        return dataclasses.replace(relaxed, newton_iterations=spent), relaxed.status.ok

    def _stable(self, frame, found, stability, history):
        """Stable whole `State` and its `Stability` from an unstable one: next to it on a branch that leaves there, or by relaxation."""
        problem = frame.problem
        touching = problem.has_contact and touches(found.x, problem.model)
        expected = predict(problem, found.value, history)[0] if history else None
        whole = frame.whole(found)
        other = None if touching else stable_state(self.frames, whole, stability, expected=expected)
        if other is None and (problem.has_contact or self.jumps):
            mode = stability.vectors[:, 0]
            frame = self.frames.along_mode(whole, mode)
            state = relax_along(frame.problem, frame.part(whole), frame.along(mode))
            if state.status.ok:
                stability, state = frame.check(state, None)
                other = (frame.whole(state), stability) if stability.negative == 0 else None
        return other


def _as_predicted(frame, found, predicted, last, short):
    """The `State` found, refused after a step longer than ``short`` if it is mostly the softest mode, against what was predicted of it.

    Next to an imperfect bifurcation Newton's method may end on the branch that turns the other way.
    """
    if not found.status.ok or last.modes is None or abs(found.value - last.value) <= short:
        return found
    step, expected = (restrict(np.asarray(x) - np.asarray(last.x), frame.problem.free) for x in (found.x, predicted))
    weighted = frame.stiffness @ frame.along(last.modes[:, 0])  # a mode v has v . N v = 1
    moved, foreseen = weighted @ step, weighted @ expected
    against = moved * foreseen < 0 and abs(foreseen) > SAYS_NOTHING * abs(moved)
    mostly = moved**2 > MOSTLY * (step @ (frame.stiffness @ step))
    return dataclasses.replace(found, status=Status.NOT_CONVERGED) if against and mostly else found


def _leapt(problem, found, predicted, last):
    """The `State` found, and whether much of the gel has another volume ratio than was ``predicted``: the gel has leapt to another phase.

    Only a gel in a poor solvent can. A step longer than ``LEAP`` is refused then, so that a leap has a place; a shorter one is accepted.
    """
    if not found.status.ok or rises_always(gel_in_groups(problem.at(found.value)[0].gel)):
        return found, False
    if not float(_unforeseen(problem.model, found.x, predicted)) > MUCH:
        return found, False
    if abs(found.value - last.value) > LEAP * scale_of(problem.control):
        return dataclasses.replace(found, status=Status.LEAPT), False
    return found, True


@jax.jit
def _unforeseen(model, x, predicted):
    """Share () of the dry volume in which the volume ratio at ``x`` (n, 2) is not that at the ``predicted`` positions, nearly."""
    J, foreseen = volume_ratios(x, model), volume_ratios(predicted, model)
    volumes = jnp.where(carries_volume(model), all_volumes(model), 0.0)
    apart = ~((foreseen > 0) & (jnp.abs(jnp.log(J / jnp.where(foreseen > 0, foreseen, 1.0))) < FORESEEN))
    return jnp.sum(volumes * apart) / jnp.sum(volumes)


def _first(problem, value, found):
    """The first `State` of a sweep, by way of others where it was not ``found`` at once."""
    if not found.status.ok and (problem.moves_edges or problem.model.cloud.plate.moved):
        found = _ramped(problem, value, found)
    return found if found.status.ok or problem.control is None else _approached(problem, value, found)


def _ramped(problem, value, failed):
    """First `State` of a plate whose edges are moved step by step, where moving them at once ``failed``."""
    model, pressure = problem.model, dry_state(problem)[1]
    whole, x = problem.dry_positions(value) - model.cloud.nodes, model.cloud.nodes
    share, step, iterations = 0.0, 1 / 8, failed.newton_iterations
    now, mu = problem.at(value)
    while share < 1:
        more = min(step, 1 - share)
        found = solve(now, mu, x + more * whole, pressure)
        iterations += found.newton_iterations
        if found.status.ok:
            x, pressure, share = found.x, found.pressure, share + more
        elif step < LEAST_RAMP:
            break
        else:
            step /= 2
    return dataclasses.replace(of_control(problem, found, value), newton_iterations=iterations)


def _approached(problem, value, failed):
    """First `State` of a control by way of lower chemical potentials, on the dry gel's branch, where going there at once ``failed``."""
    (now, mu), start, spent = problem.at(value), dry_state(problem, value), failed.newton_iterations

    def attempt(mu, states):
        return solve(now, mu, *(predict(now, mu, states[-EXTRAPOLATED:]) if states else start))

    for found in adaptive(attempt, [float(mu) - FAR_BELOW, float(mu)], [], MAX_STEPS):
        spent += found.newton_iterations
        if found.mu == float(mu):
            return dataclasses.replace(of_control(problem, found, value), newton_iterations=spent)
    return dataclasses.replace(failed, newton_iterations=spent)
