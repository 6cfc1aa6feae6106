"""Steps in time: SDIRK2, two stages of one kind of equation.

The method of Alexander (1977) with gamma = 1 - 1/sqrt 2 is of second order, L-stable, and ends with
its second stage. Both stages take up solvent over gamma dt, from the volume ratios

    stage 1   J_n                                               bath at t_n + gamma dt
    stage 2   J_n + (1 - gamma) / gamma (J_1 - J_n)             bath at t_n + dt

so that volume ratios are all that a step hands to the next one; positions, pressures and mu are
values to start from. What enters after a jump of the bath falls as 1 / sqrt(t), of which a first
step would take up four fifths: in the bath of a stage it is multiplied such that it sums up to its
integral over the step.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .._types import Array, Float, Scalar
from ..equilibrium import Newton, Observer, State, Status
from ..mechanics import Bath, linearise
from .bath import root
from .problem import Transport
from .stage import Stage, acting_potential, acting_problem, solve_stage

GAMMA = 1 - 1 / np.sqrt(2)
MAX_HALVINGS = 14  # of a step at which Newton's method fails
MAX_STEPS = 64  # tried between two times
# of the time that is left: a step that falls short of the end by no more goes to the end
ROUND_OFF = 1e-9
FARTHEST = 10.0  # times the step before, in the root of time, up to which a state is extrapolated
Instant = Callable[[float, float], Bath]  # the bath at a time, with the share of its jump


class Step(NamedTuple):
    """One step, of two stages."""

    start: float
    """Time before."""
    end: float
    """Time after."""
    first: Stage
    """Its stage."""
    second: Stage
    """Its stage and end."""


@dataclasses.dataclass(frozen=True, eq=False)
class Moment:
    """What is known at one time."""

    t: float
    """Time."""
    stage: Stage
    """The state."""
    supplied: Float[np.ndarray, " b"]
    """Solvent that has come in through each wetted part since the start, mm^2."""
    iterations: int = 0
    """Corrections of Newton's method since the moment before, those of refused steps included."""
    steps: tuple[Step, ...] = ()
    """The steps since the moment before."""
    began: float = 0.0
    """Time at which the last step began."""

    def state(self, transport: Transport, mu: float) -> State:
        """The `State` in a bath of mean potential ``mu``, kT, linearised there.

        Its stability is not computed.
        """
        stage, potential = self.stage, acting_potential(transport, self.stage.m)
        about = stage.linearisation or linearise(
            acting_problem(transport, stage.m), stage.x, stage.pressure, potential
        )
        return State(
            self.t,
            mu,
            stage.x,
            stage.pressure,
            status=stage.status,
            newton_iterations=self.iterations,
            residual=float(about.residual_norm),
            energy=float(about.energy),
            linearisation=about,
            potential=potential,
            supplied=self.supplied,
        )


def jump_share(
    begin: Float[Array, "..."] | Scalar, end: Float[Array, "..."] | Scalar
) -> Float[Array, "..."] | Scalar:
    """Integral (...) of 1 / sqrt(t) over steps between two times, over what its stages sum up to.

    1.25 in a step from time 0, and 1 in one that is short beside its time.
    """
    middle = begin + GAMMA * (end - begin)
    return 2 / (root(begin) + root(end)) / ((1 - GAMMA) / root(middle) + GAMMA / root(end))


def advance(
    transport: Transport,
    before: Moment | None,
    now: Moment,
    end: float,
    bath: Instant,
    newton: Newton,
    observer: Observer,
) -> Moment:
    """The `Moment` at ``end``, in one step or, after failures, in halved and doubled steps.

    Failures of Newton's method. The step that the moment ``before`` led to says where to start. The
    status of its stage says if no step was short enough, or too many were tried, or if the matrix
    is singular there. The ``observer`` is told of iterates and of refused steps.
    """
    step, spent, halvings, tried, steps = end - now.t, 0, 0, 0, ()
    while now.t < end:
        target = end if step > (1 - ROUND_OFF) * (end - now.t) else now.t + step
        last, tried = _step(transport, before, now, target, bath, newton, observer), tried + 1
        spent += last.iterations
        if last.stage.status.ok:
            before, now, steps = now, last, steps + last.steps
            step, halvings = 2 * step, max(halvings - 1, 0)
            continue
        observer.refused(last.state(transport, _mean(bath, last.t)))
        if halvings == MAX_HALVINGS or tried >= MAX_STEPS:
            return dataclasses.replace(last, iterations=spent)
        before, step, halvings = None, step / 2, halvings + 1
    return dataclasses.replace(now, iterations=spent, steps=steps)


def _step(transport, before, now, end, bath, newton, observer):
    """The moment at ``end`` by one step of two stages; of a stage that fails the iterate."""

    def solved(start, old, tau, t):
        def iterated(stage):
            observer.iteration(
                Moment(t, stage, now.supplied, stage.iterations).state(transport, _mean(bath, t))
            )

        at = bath(t, share)
        return solve_stage(transport, start, old, tau, at, newton=newton, iterated=iterated)

    share = jump_share(now.t, end)
    dt, old = end - now.t, now.stage.ratios
    middle = now.t + GAMMA * dt
    start = now.stage if before is None else _extrapolated(before, now, middle)
    first = solved(start, old, GAMMA * dt, middle)
    if not first.status.ok:
        return Moment(middle, first, now.supplied, first.iterations, began=now.t)
    target = old + (1 - GAMMA) / GAMMA * (first.ratios - old)
    start = _extrapolated(now, Moment(middle, first, now.supplied), end)
    second = solved(start, target, GAMMA * dt, end)
    supplied = (
        now.supplied + dt * ((1 - GAMMA) * first.inflow + GAMMA * second.inflow)
        if second.status.ok
        else now.supplied
    )
    iterations, step = (
        first.iterations + second.iterations,
        Step(now.t, end, first.light, second.light),
    )
    return Moment(end, second, supplied, iterations, (step,), now.t)


def _mean(bath, t):
    """Mean potential of the bath at a time, kT."""
    return float(np.mean(bath(t, 1.0).mu))


def _extrapolated(before, now, t):
    """A stage to start from at the time ``t``, linear in the root of time through two moments.

    The last one if these are close together.
    """
    step, last = np.sqrt(t) - np.sqrt(now.t), np.sqrt(now.t) - np.sqrt(before.t)
    if step >= FARTHEST * last:  # also of moments that differ by round-off
        return now.stage
    share = step / last
    columns = {name: getattr(now.stage, name) for name in ("x", "pressure", "m")}
    columns = {
        name: value + share * (value - getattr(before.stage, name))
        for name, value in columns.items()
    }
    return Stage(**columns, ratios=now.stage.ratios, status=Status.NOT_CONVERGED)
