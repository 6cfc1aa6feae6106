"""The public verb of transient swelling: states of a gel in a bath at chosen times."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from .._threads import few_threads
from .._tracing import is_traced
from .._types import Array, Float, Scalar
from .._validation import Inadmissible, check_kind, did_you_mean
from ..continuation import Adaptive, Path, SweepFailed, check_sweep, sweep
from ..controls import ChemicalPotential, check_values
from ..equilibrium import NEWTON, UNOBSERVED, Newton, Observer, Stability, State, Status
from ..linalg import SingularTangent
from ..materials import Filled, elementwise, free_swelling, gel_in_groups, layer_diffusivity, rises_always
from ..mechanics import Bath as Instant
from ..mechanics import Problem, factorised_tangent, linearise, overlaps, volume_ratios, wetted_parts
from ..mechanics import moments as of_unknowns
from .bath import Bath, Time, time_in, values_of
from .march import Moment, advance
from .problem import Transport, transport
from .stage import Stage, acting_potential, acting_problem

DRIER = 3.0  # kT below the start at which a sweep to it begins, if it must
Baths = Scalar | Bath | Mapping[str | int, Scalar | Bath | None]


@dataclasses.dataclass(frozen=True)
class TimeSteps:
    """Times that grow geometrically, ``per_decade`` to a decade, from ``first`` to ``end``, in the unit of time of D.

    Steps begin anew at each kink of the bath. The default ``first`` is a thousandth of the time in which solvent moves a node spacing.
    """

    end: float
    first: float | None = None
    per_decade: int = 10

    def __post_init__(self) -> None:
        check_values([0.0, self.end], "end", "time", rising=True)
        if self.first is not None:
            check_values([0.0, self.first, self.end], "first", "time", rising=True)
        if not self.per_decade >= 1:
            raise ValueError(f"per_decade: {self.per_decade} is not accepted, it must be 1 or more")

    def values(self, spacing: float, D: float, kinks: Sequence[float] = ()) -> Float[np.ndarray, " k"]:
        """The times (k,) for a cloud of this node ``spacing``, mm, the ``kinks`` among them."""
        first = min(1e-3 * spacing**2 / D, self.end / 2) if self.first is None else self.first
        starts = [0.0, *(kink for kink in kinks if kink < self.end)]
        times = set()
        for start, last in zip(starts, [*starts[1:], self.end], strict=True):
            count = int(np.ceil(self.per_decade * np.log10(max((last - start) / first, 1.0)))) + 1
            times |= {start + step for step in np.geomspace(min(first, last - start), last - start, count).tolist()[:-1]} | {last}
        return np.array(sorted(times))


def swell(
    problem: Problem,
    bath: Baths,
    times: Sequence[float] | Float[Array, " k"] | TimeSteps,
    *,
    start: Scalar | State | Path,
    D: Scalar = 1.0,
    unit: str = "",
    newton: Newton = NEWTON,
    observer: Observer = UNOBSERVED,
) -> Path:
    """`Path` of the states of a gel in a ``bath`` at the ``times``, the first one at time 0.

    ``start`` is the chemical potential, kT, at which the gel is in equilibrium before, or a `State`,
    the last one of another run, say; or the `Path` of the first states of this run, which is continued
    with the states, to the last bit, that a run without interruption has. Bath and loads act from time
    0 on. Solvent moves through the gel with the diffusivity ``D``, mm^2 per unit of time, see
    ``materials.transport``; only ``D`` times the time counts. ``unit`` is the unit of time in figures
    and files. ``bath`` is a chemical potential, kT, or a `Bath`, of all that can be wetted: holes and
    free edges. Or a mapping from the numbers of holes and the names of free edges to baths; what it
    leaves out, or gives as None, is sealed. ``times`` are those of the states, and of the steps between
    them, or `TimeSteps`.

    The path has the times as ``t`` (k,), which are its ``value``, the mean chemical potential of the wetted boundary as ``mu`` (k,), that
    of the solvent in every volume group as ``potential`` (k, g), and ``supplied`` (k, b), the solvent that has come in through each wetted
    part, mm^2. ``negative_pivots`` are those of the tangent at this potential. If Newton's method fails a step is halved, up to 14 times;
    if that does not help, or if an outline meets itself, the path ends early, with the reason in ``path.stop`` and ``path.stop_text``.

    Until the layer below a surface is as thick as its cells the uptake is that of a half-space, good to about 10 % in films and 20 % along
    holes, see docs/theory.md. The bath counts as changed at time 0, also if the ``start`` is a state on the way to it.

    Raises ValueError, one line, for a bath, times or a problem that cannot be used: films, periodic edges, contact, gels that can separate
    into phases, elastomers, and controls other than the chemical potential are not. It is not differentiated by JAX yet: traced inputs are
    refused. Hong, Zhao, Zhou & Suo (2008).

    >>> import jaxgel
    >>> plate = jaxgel.Plate(0.8, 1.0, edges={"top": "free"})
    >>> problem = jaxgel.Problem(jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.1)), jaxgel.Gel(1e-3, 0.1), contact=False)
    >>> path = jaxgel.swell(problem, -0.4999, [1e-4, 1e-3, 1e-2, 0.1], start=-0.5)
    >>> path.t.tolist(), path.stop.ok
    ([0.0, 0.0001, 0.001, 0.01, 0.1], True)
    """
    check_kind("problem", problem, Problem, "a Problem, as Problem(model, gel, contact=False) makes it")
    if is_traced((problem, start, D)):
        raise ValueError("swell: is not differentiated yet, and is not available inside jax.jit or jax.vmap; call it with numbers")
    check_swelling(problem)
    problem = problem.replace(control=ChemicalPotential())
    if not (np.isfinite(D) and D > 0):
        raise ValueError(f"D: {D} is not accepted, it must be a number > 0 (mm^2 per unit of time)")
    baths = baths_of(problem, bath)
    check_sweep(problem, np.array([mu for bath in baths.values() for mu in np.atleast_1d(bath.mu)]))
    numbers = step_times(problem, baths, times, D)
    problem = problem.prepared
    with few_threads(2 * problem.model.n_nodes):
        swelling = _Swelling(transport(problem, tuple(baths), D), tuple(baths.values()), newton, observer)
        if isinstance(start, Path):
            states = _first_states(start, numbers)
        else:
            states = [swelling.first(start if isinstance(start, State) else _equilibrium(problem, float(start), newton))]
            observer.accepted(states[0])
        stop, text = swelling.march(states, numbers)
    control = dataclasses.replace(time_in(swelling.baths), unit=unit)
    return Path.from_states(problem.replace(control=control), states, stop=stop, stop_text=text)


def step_times(
    problem: Problem, baths: Mapping[str | int, Bath], times: Sequence[float] | Float[Array, " k"] | TimeSteps, D: Scalar = 1.0
) -> Float[np.ndarray, " k"]:
    """The times (k,) of the states of `swell` after the first one; ValueError, one line, if they are not above 0 and rising."""
    if isinstance(times, TimeSteps):
        return times.values(float(problem.model.lists.topology.node_spacing.min()), float(D), kinks_of(baths.values()))
    numbers = check_values(times, "times", "time", rising=True)
    if not numbers[0] > 0:
        raise ValueError(f"times: {numbers[0]:g} is not accepted, the first must be above 0, at which the start is")
    return numbers


def resolved_time(problem: Problem, wetted: Iterable[str | int], mu: float, D: Scalar = 1.0) -> float:
    """Time from which on the boundary layer is as thick as the cells at the ``wetted`` parts: h^2 / D_eff; nan if it is not known.

    h is the largest node spacing there, D_eff the least diffusivity along a stretch of the gel that swells freely at ``mu``, kT. Until then
    the uptake is that of a half-space, see `swell`.
    """
    lists, axial = problem.model.lists, problem.model.axial_stretch
    nodes = np.concatenate([wetted_parts(lists)[part] for part in wetted])

    def diffusivity(mu, gel):
        stretch = free_swelling(mu, gel, axial)
        return layer_diffusivity(stretch, stretch, gel, axial, D)

    values = elementwise(diffusivity, jnp.asarray(mu, dtype=float), gel_in_groups(problem.gel))
    return float(lists.topology.node_spacing[nodes].max() ** 2 / np.min(values))


def kinks_of(baths: Iterable[Bath]) -> list[float]:
    """Times above 0, rising, at which the slope of one of the baths changes."""
    return sorted({kink for bath in baths for kink in bath.kinks})


def _first_states(path, times):
    """The states of a path to go on from; ValueError if they are not the first ones of a run with these times."""
    if path.t is None or path.t[0] != 0 or not np.array_equal(path.t[1:], times[: len(path) - 1]):
        raise ValueError("start: the path is not one of swell with these times; give its first states, or a State")
    return [path[k] for k in range(len(path))]


def _equilibrium(problem, mu, newton):
    """The `State` at this chemical potential, by way of drier ones if it is not found at once."""
    try:
        return sweep(problem, [mu], newton=newton)[0]
    except SweepFailed:
        path = sweep(problem, Adaptive(mu - DRIER, mu), newton=newton)
        if not path.stop.ok:
            raise ValueError(f"start: {mu:g} kT is not reached: {path.stop_text}") from None
        return path[-1]


def check_swelling(problem: Problem) -> None:
    """Raise ValueError, one line that names the field, for what transient swelling does not cover."""
    plate = problem.model.lists.topology.plate
    if problem.has_contact:
        raise Inadmissible("contact: is not part of transient swelling; give Problem(..., contact=False)")
    if not isinstance(problem.control, ChemicalPotential | Time):
        raise Inadmissible(f"control: {problem.control.name} is not accepted, the bath drives transient swelling; leave the control out")
    if problem.model.film:
        raise Inadmissible("kinematics: a film drinks through its faces, too, which transient swelling does not cover")
    if "periodic" in plate.edges.values():
        raise Inadmissible("edges: periodic edges are not covered by transient swelling")
    if isinstance(problem.gel, Filled):
        raise Inadmissible("gel: a plate with elastomers is not covered by transient swelling")
    if not np.all(rises_always(gel_in_groups(problem.gel))):
        raise Inadmissible("gel: can separate into phases, or is not known not to, which transient swelling does not cover")


def baths_of(problem: Problem, bath: Baths) -> dict[str | int, Bath]:
    """The `Bath` of each wetted part of the boundary, by its number or name; ValueError, one line, for a part that there is not."""
    parts = wetted_parts(problem.model.lists)
    given = dict.fromkeys(parts, bath) if not isinstance(bath, Mapping) else bath
    for name in given:
        if name not in parts:
            known = f"a hole has a number below {len(problem.model.lists.topology.plate.holes)}" if isinstance(name, int) else ""
            raise ValueError(f"bath: there is no {name!r} to wet; {known or did_you_mean(name, map(str, parts)) or 'nothing is free'}")
    found = {name: one if isinstance(one, Bath) else Bath(one) for name, one in given.items() if one is not None}
    if not found:
        raise ValueError("bath: nothing is wetted; the plate needs a hole or a free edge that is")
    return found


@dataclasses.dataclass(frozen=True)
class _Swelling:
    """A run of `swell`: what its steps have in common."""

    transport: Transport
    baths: tuple[Bath, ...]
    newton: Newton
    observer: Observer

    def first(self, start: State) -> State:
        """The state at time 0 of a gel that comes from the state ``start``."""
        stage = self._stage(start)
        mu = acting_potential(self.transport, stage.m)[np.asarray(self.transport.model.carries)].mean()
        return _state(self.transport, Moment(0.0, stage, np.zeros(len(self.baths))), float(mu))

    def march(self, states: list[State], times: Float[np.ndarray, " k"]) -> tuple[Status, str]:
        """Add to the ``states``, the first ones of the path, those at the ``times`` that are left; how it ended, and a text if early.

        A step depends on these states alone, so that a path that was interrupted goes on to the same bits.
        """
        start = np.full(len(self.baths), states[0].mu)
        kinks = kinks_of(self.baths)

        def instant(t):
            return Instant(*values_of(self.baths, start, t))

        for t in times[len(states) - 1 :].tolist():
            between = [kink for kink in kinks if states[-1].value < kink < t]
            before, now = self._last_two(states, kinks)
            following, spent = now, 0
            for end in (*between, t):
                following = advance(self.transport, before, following, end, instant, self.newton)
                before, spent = None, spent + following.iterations
                if not following.stage.status.ok:
                    break
            mu = float(np.mean(instant(t).mu))
            state = _state(self.transport, dataclasses.replace(following, iterations=spent), mu)
            if not state.status.ok:
                self.observer.refused(state)
                text = f"{state.status.text}; residual {state.residual:.1e}, solvent {following.stage.balance:.1e}"
                return state.status, f"stopped after t = {now.t:.6g}: {text}"
            if overlaps(state.x, self.transport.model):
                return Status.SELF_CONTACT, f"stopped after t = {now.t:.6g}: {Status.SELF_CONTACT.text}"
            self.observer.accepted(state)
            states.append(state)
        return Status.CONVERGED, ""

    def _last_two(self, states, kinks):
        """The moments of the last two states, the former one None if the bath has a kink after it."""
        before, now = ([None, *states])[-2:]
        smooth = before is not None and not any(before.value < kink <= now.value for kink in kinks)
        return self._moment(before) if smooth else None, self._moment(now)

    def _moment(self, state):
        return Moment(state.value, self._stage(state), state.supplied)

    def _stage(self, state):
        """The stage of a state, in equilibrium or of transient swelling."""
        problem, model = self.transport.problem, self.transport.model
        if state.x.shape != model.nodes.shape:
            raise ValueError(f"start: is a state of {len(state.x)} nodes, the model has {len(model.nodes)}")
        mu = np.broadcast_to(np.asarray(state.mu if state.potential is None else state.potential, dtype=float), model.carries.shape)
        sums = np.asarray(of_unknowns(np.where(model.carries, mu, 0.0), model))
        counts = np.concatenate([np.full(block.groups.size, block.carrying) for block in model.blocks])
        J = np.asarray(volume_ratios(state.x, model))
        return Stage(problem.placed(state.x, 0.0), state.pressure, sums / counts, J, Status.CONVERGED)


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
