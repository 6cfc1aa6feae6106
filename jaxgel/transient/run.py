"""Runs in time: a gel in its bath from one state to chosen times."""

import dataclasses
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from .._programs import program
from .._threads import few_threads
from .._tracing import is_traced
from .._types import Array, Float, Scalar
from .._validation import Inadmissible
from ..continuation import Path, check_sweep
from ..controls import ChemicalPotential
from ..discretisation import Model
from ..equilibrium import Newton, Observer, Stability, State, Status
from ..linalg import SingularTangent
from ..materials import Filled, gel_in_groups, rises_always
from ..mechanics import Bath as Instant
from ..mechanics import Problem, factorised_tangent, moments, of_groups, overlaps, volume_ratios
from .bath import Bath, Time, values_of
from .march import Moment, Step, advance
from .problem import Transport
from .stage import BALANCE, Stage, acting_problem


class Start(NamedTuple):
    """The state at time 0; a pytree."""

    x: Float[Array, "n 2"]
    """Positions, mm."""
    pressure: Float[Array, " g"]
    """Pressures of the volume groups, kT/v."""
    potential: Float[Array, " g"]
    """Chemical potentials of the volume groups, kT."""

    def unknowns(self, model: Model) -> Float[Array, " g"]:
        """The unknowns of mu (g,), see ``mechanics.solvent``."""
        return _unknowns_and_mean(model, self.potential)[0]

    def mean(self, model: Model) -> Float[Array, ""]:
        """Mean chemical potential (), kT, of the groups that carry volume."""
        return _unknowns_and_mean(model, self.potential)[1]


@program(potential="g", returns=("g", None))
def _unknowns_and_mean(model, potential):
    mu, counts = (
        jnp.where(model.carries, potential, 0.0),
        [jnp.full(block.groups.shape, block.carrying) for block in model.blocks],
    )
    unknowns = jnp.where(model.carries, moments(mu, model) / of_groups(counts, model), 0.0)
    return unknowns, jnp.sum(mu) / jnp.sum(model.carries)


class Run(NamedTuple):
    """What a run leaves."""

    path: Path
    """Its states at the requested times."""
    first: Stage
    """The state at time 0."""
    steps: list[Step]
    """All steps that it has made."""


def run(
    transport: Transport,
    start: Start | list[State],
    baths: Sequence[Bath],
    times: Sequence[float],
    time: Time,
    branch: str,
    newton: Newton,
    observer: Observer,
) -> Run:
    """The `Run` to ``times``, with a bath per wetted part, from 0 or a path's first states.

    With the ``branch`` "stable" it ends before a state that is unstable at its chemical potentials.
    A step depends on the states of the path alone, so that a run that was interrupted goes on to
    the same bits.
    """
    transport = dataclasses.replace(transport, problem=transport.problem.prepared)
    with few_threads(2 * transport.model.n_nodes):
        if isinstance(start, Start):
            states = [
                _state(
                    transport,
                    _moment(transport, 0.0, start, np.zeros(len(baths))),
                    float(start.mean(transport.model)),
                )
            ]
            observer.accepted(states[0])
        else:
            states = list(start)
        first, steps = _of_state(transport, states[0]).stage, []
        stop, text = _march(
            transport, baths, states, steps, times[len(states) - 1 :], branch, newton, observer
        )
    path = Path.from_states(
        transport.problem.replace(control=time), states, stop=stop, stop_text=text
    )
    lost = np.maximum.accumulate(path.negative_pivots) > 0
    return Run(
        dataclasses.replace(
            path, derivative=np.where(lost, Status.LOST_STABILITY, Status.CONVERGED)
        ),
        first,
        steps,
    )


def _march(transport, baths, states, steps, times, branch, newton, observer):
    """Add to the ``states`` those at the ``times``, and to the ``steps``.

    How it ended, and a text if early.
    """
    at_start, kinks = [states[0].mu] * len(baths), kinks_of(baths)

    def instant(t, share):
        return Instant(*values_of(baths, at_start, t, share))

    for t in times:
        before, now = ([None, *states])[-2:]
        smooth = before is not None and not any(before.value < kink <= now.value for kink in kinks)
        before, following, spent = (
            _of_state(transport, before) if smooth else None,
            _of_state(transport, now),
            0,
        )
        for end in (*(kink for kink in kinks if now.value < kink < t), t):
            following = advance(transport, before, following, end, instant, newton, observer)
            before, spent = None, spent + following.iterations
            if not following.stage.status.ok:
                break
            steps += following.steps
        state = _state(
            transport,
            dataclasses.replace(following, iterations=spent),
            float(np.mean(instant(t, 1.0).mu)),
        )
        if not state.status.ok:
            if following.stage.status.ok:  # otherwise `advance` has reported it
                observer.refused(state)
            missed = "".join(f"; {error}" for error in _missed(following.stage, newton))
            text = (
                f"the last step, from t = {following.began:.6g}, failed: "
                f"{state.status.text}{missed}"
            )
            return state.status, f"stopped after t = {now.value:.6g}: {text}"
        if branch == "stable" and state.negative_pivots > 0:
            observer.refused(dataclasses.replace(state, status=Status.LOST_STABILITY))
            text = (
                f"at t = {t:.6g} the state is unstable at its chemical potentials, negative "
                f"pivots: {state.negative_pivots}"
            )
            return (
                Status.LOST_STABILITY,
                f'stopped after t = {now.value:.6g}: {text}; branch = "symmetric" goes on',
            )
        if overlaps(state.x, transport.model):
            observer.refused(dataclasses.replace(state, status=Status.SELF_CONTACT))
            return (
                Status.SELF_CONTACT,
                f"stopped after t = {now.value:.6g}: {Status.SELF_CONTACT.text}",
            )
        observer.accepted(state)
        states.append(state)
    return Status.CONVERGED, ""


def _missed(stage, newton):
    """The errors of an iterate that are above their tolerances, in words."""
    errors = {
        "residual of the forces": (stage.residual, newton.tolerance),
        "error of the volume ratios": (
            float(stage.linearisation.violation),
            newton.constraint_tolerance,
        ),
        "balance of the solvent": (stage.balance, BALANCE),
    }
    return [
        f"{name} {error:.1e}, tolerance {most:.0e}"
        for name, (error, most) in errors.items()
        if not error < most
    ]


def kinks_of(baths: Iterable[Bath]) -> list[float]:
    """Times above 0, rising, at which the slope of one of the baths changes."""
    return sorted({kink for bath in baths for kink in bath.kinks})


def _of_state(transport, state):
    """The `Moment` of a state of a path."""
    return _moment(
        transport, state.value, Start(state.x, state.pressure, state.potential), state.supplied
    )


def _moment(transport, t, start, supplied):
    J = np.asarray(volume_ratios(start.x, transport.model))
    m = np.asarray(start.unknowns(transport.model))
    return Moment(t, Stage(start.x, start.pressure, m, J, Status.CONVERGED), supplied)


def check_swelling(problem: Problem) -> None:
    """Raise ValueError, one line with the field, for unsupported transient swelling."""
    plate = problem.model.lists.topology.plate
    if problem.has_contact:
        raise Inadmissible(
            "contact: is not part of transient swelling; give Problem(..., contact=False)"
        )
    if not isinstance(problem.control, ChemicalPotential | Time):
        raise Inadmissible(
            f"control: {problem.control.name} is not accepted, the bath drives transient "
            "swelling; leave the control out"
        )
    if problem.model.film:
        raise Inadmissible(
            "kinematics: a film drinks through its faces, too, which transient swelling does not "
            "cover"
        )
    if "periodic" in plate.edges.values():
        raise Inadmissible("edges: periodic edges are not covered by transient swelling")
    if isinstance(problem.gel, Filled):
        raise Inadmissible("gel: a plate with elastomers is not covered by transient swelling")
    if not is_traced(problem) and not np.all(rises_always(gel_in_groups(problem.gel))):
        raise Inadmissible(
            "gel: can separate into phases, or is not known not to, which transient swelling does "
            "not cover"
        )


def check_numbers(problem: Problem, baths: Iterable[Bath], D: Scalar) -> None:
    """Raise ValueError, one line, for a diffusivity and baths that cannot be used.

    Traced values pass.
    """
    if not is_traced(D) and not (np.isfinite(D) and D > 0):
        raise ValueError(f"D: {D} is not accepted, it must be a number > 0 (mm^2 per unit of time)")
    mu = [bath.mu for bath in baths]
    if not is_traced(problem, mu):
        check_sweep(problem, np.concatenate(mu), field="bath.mu")


def _state(transport, moment, mu):
    """The `State` of a moment, with the negative pivots of its own tangent."""
    found = moment.state(transport, mu)
    if not found.status.ok:
        return found.light
    try:
        made = factorised_tangent(
            acting_problem(transport, moment.stage.m), found.x, found.pressure, found.linearisation
        )
    except SingularTangent:
        return dataclasses.replace(found.light, status=Status.SINGULAR)
    return dataclasses.replace(found.light, stability=Stability(made.negative_pivots))
