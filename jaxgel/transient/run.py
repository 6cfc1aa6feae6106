"""A run in time: a gel in its bath from one state on, to chosen times."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from .._programs import program
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
from ..mechanics import Problem, factorised_tangent, linearise, moments, of_groups, overlaps, volume_ratios
from .bath import Bath, time_in, values_of
from .march import Moment, Step, advance
from .problem import Transport
from .stage import Stage, acting_potential, acting_problem


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
        return _unknowns(model, self.potential)

    def mean(self, model: Model) -> Float[Array, ""]:
        """Mean chemical potential (), kT, of the groups that carry volume."""
        return (self.potential @ np.asarray(model.carries, float)) / np.sum(model.carries)


@program(potential="g", returns="g")
def _unknowns(model, potential):
    sums = moments(jnp.where(model.carries, potential, 0.0), model)
    return jnp.where(model.carries, sums / of_groups([jnp.full(block.groups.shape, block.carrying) for block in model.blocks], model), 0.0)


class Run(NamedTuple):
    """What a run leaves."""

    path: Path
    """Its states at the times that were asked for."""
    first: Stage
    """The state at time 0."""
    steps: list[Step]
    """All steps."""


def run(transport: Transport, baths: Sequence[Bath], start: Start, times: Sequence[float], newton: Newton, observer: Observer) -> Run:
    """The `Run` to these ``times``, with a bath for each wetted part."""
    problem, model = transport.problem, transport.problem.model
    J = np.asarray(volume_ratios(start.x, model))
    first, at_start = Stage(*start[:2], np.asarray(start.unknowns(model)), J, Status.CONVERGED), [float(start.mean(model))] * len(baths)

    def instant(t):
        return Instant(*values_of(baths, at_start, t))

    kinks = {kink for bath in baths for kink in bath.kinks if kink < times[-1]}
    before, now = None, Moment(0.0, first, np.zeros(len(baths)))
    states, steps = [_state(transport, now, at_start[0])], []
    stop, text = Status.CONVERGED, ""
    for t in sorted({*times, *kinks}):
        following = advance(transport, before, now, t, instant, newton)
        state = _state(transport, following, float(np.mean(instant(t).mu)))
        if not following.stage.status.ok:
            observer.refused(state)
            stop = following.stage.status
            text = f"stopped after t = {now.t:.6g}: {stop.text}; residual {state.residual:.1e}, solvent {following.stage.balance:.1e}"
            break
        if overlaps(following.stage.x, model):
            stop, text = Status.SELF_CONTACT, f"stopped after t = {now.t:.6g}: {Status.SELF_CONTACT.text}"
            break
        before, now = (None if t in kinks else now), following
        steps += following.steps
        if t in times:
            observer.accepted(state)
            states.append(state)
    problem = problem.replace(control=time_in(baths, transport.wetted, transport.D))
    return Run(Path.from_states(problem, states, stop=stop, stop_text=text), first, steps)


def check_run(problem: Problem, baths: Sequence[Bath], D: Scalar) -> None:
    """Raise ValueError, one line, for what transient swelling does not cover, and for numbers that cannot be used; traced values pass."""
    if not is_traced(D) and not (np.isfinite(D) and D > 0):
        raise ValueError(f"D: {D} is not accepted, it must be a number > 0 (mm^2 per unit of time)")
    plate = problem.model.lists.topology.plate
    if problem.has_contact:
        raise Inadmissible("contact: is not part of transient swelling; give Problem(..., contact=False)")
    if not isinstance(problem.control, ChemicalPotential):
        raise Inadmissible(f"control: {problem.control.name} is not accepted, the bath drives transient swelling; leave the control out")
    if problem.model.film:
        raise Inadmissible("kinematics: a film drinks through its faces, too, which transient swelling does not cover")
    if "periodic" in plate.edges.values():
        raise Inadmissible("edges: periodic edges are not covered by transient swelling")
    if isinstance(problem.gel, Filled):
        raise Inadmissible("gel: a plate with elastomers is not covered by transient swelling")
    if is_traced(problem, [bath.mu for bath in baths]):
        return
    if not np.all(rises_always(gel_in_groups(problem.gel))):
        raise Inadmissible("gel: can separate into phases, or is not known not to, which transient swelling does not cover")
    check_sweep(problem, np.concatenate([bath.mu for bath in baths]))


def _state(transport, moment, mu):
    """The `State` of a moment, with the negative pivots of its own tangent."""
    stage, stability = moment.stage, None
    acting, potential = acting_problem(transport, stage.m), acting_potential(transport, stage.m)
    now = stage.linearisation or linearise(acting, stage.x, stage.pressure, potential)
    if stage.status.ok:
        try:
            stability = Stability(factorised_tangent(acting, stage.x, stage.pressure, now).negative_pivots)
        except SingularTangent:
            stability = None
    return State(
        moment.t,
        mu,
        stage.x,
        stage.pressure,
        status=stage.status,
        newton_iterations=moment.iterations,
        residual=float(now.residual_norm),
        energy=float(now.energy),
        stability=stability,
        potential=potential,
        supplied=moment.supplied,
    )
