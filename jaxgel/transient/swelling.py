"""The public verb of transient swelling: states of a gel in a bath at chosen times."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from .._threads import few_threads
from .._tracing import is_traced
from .._types import Array, Float, Scalar
from .._validation import Inadmissible, check_kind, did_you_mean
from ..continuation import Adaptive, Path, SweepFailed, check_sweep, sweep
from ..controls import ChemicalPotential, check_values
from ..equilibrium import NEWTON, UNOBSERVED, Newton, Observer, Stability, State, Status
from ..linalg import SingularTangent
from ..materials import Filled, gel_in_groups, rises_always
from ..mechanics import Bath as Instant
from ..mechanics import Problem, factorised_tangent, linearise, overlaps, volume_ratios, wetted_parts
from ..mechanics import moments as of_unknowns
from .bath import Bath, time_in, values_of
from .march import Moment, advance
from .problem import transport
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
    start: Scalar | State,
    D: Scalar = 1.0,
    newton: Newton = NEWTON,
    observer: Observer = UNOBSERVED,
) -> Path:
    """`Path` of the states of a gel in a ``bath`` at the ``times``, the first one at time 0.

    ``start`` is the chemical potential, kT, at which the gel is in equilibrium before, or a `State`, the last one of another run, say. Bath
    and loads act from time 0 on. Solvent moves through the gel with the diffusivity ``D``, mm^2 per unit of time, see
    ``materials.transport``; only ``D`` times the time counts. ``bath`` is a chemical potential, kT, or a `Bath`, of all that can be wetted:
    holes and free edges. Or a mapping from the numbers of holes and the names of free edges to baths; what it leaves out, or gives as None,
    is sealed. ``times`` are those of the states, and of the steps between them, or `TimeSteps`.

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
    _check_problem(problem)
    if not (np.isfinite(D) and D > 0):
        raise ValueError(f"D: {D} is not accepted, it must be a number > 0 (mm^2 per unit of time)")
    baths = _baths(problem, bath)
    check_sweep(problem, np.array([mu for bath in baths.values() for mu in np.atleast_1d(bath.mu)]))
    kinks = sorted({kink for bath in baths.values() for kink in bath.kinks})
    spacing = float(problem.model.lists.topology.node_spacing.min())
    numbers = times.values(spacing, float(D), kinks) if isinstance(times, TimeSteps) else times
    numbers = check_values(numbers, "times", "time", rising=True)
    if not numbers[0] > 0:
        raise ValueError(f"times: {numbers[0]:g} is not accepted, the first must be above 0, at which the start is")
    problem = problem.prepared
    with few_threads(2 * problem.model.n_nodes):
        if not isinstance(start, State):
            start = _equilibrium(problem, float(start), newton, observer)
        return _marched(transport(problem, tuple(baths), D), list(baths.values()), start, numbers, kinks, newton, observer)


def _equilibrium(problem, mu, newton, observer):
    """The `State` at this chemical potential, by way of drier ones if it is not found at once."""
    try:
        return sweep(problem, [mu], newton=newton, observer=observer)[0]
    except SweepFailed:
        path = sweep(problem, Adaptive(mu - DRIER, mu), newton=newton, observer=observer)
        if not path.stop.ok:
            raise ValueError(f"start: {mu:g} kT is not reached: {path.stop_text}") from None
        return path[-1]


def _check_problem(problem):
    """ValueError for what transient swelling does not cover."""
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
    if not np.all(rises_always(gel_in_groups(problem.gel))):
        raise Inadmissible("gel: can separate into phases, or is not known not to, which transient swelling does not cover")


def _baths(problem, bath):
    """The `Bath` of each wetted part."""
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


def _marched(transport, baths, start, times, kinks, newton, observer):
    """The path of the states at these times."""
    problem, first = transport.problem, _first(transport, start)
    at_start = np.full(len(baths), np.mean(acting_potential(transport, first.m)[np.asarray(problem.model.carries)]))

    def instant(t):
        return Instant(*values_of(baths, at_start, t))

    before, now = None, Moment(0.0, first, np.zeros(len(baths)))
    states = [_state(transport, now, float(at_start[0]))]
    stop, text = Status.CONVERGED, ""
    for t in sorted({*times.tolist(), *(kink for kink in kinks if kink < times[-1])}):
        following = advance(transport, before, now, t, instant, newton)
        mu = float(np.mean(instant(t).mu))
        state = _state(transport, following, mu)
        if not following.stage.status.ok:
            observer.refused(state)
            stop = following.stage.status
            text = f"stopped after t = {now.t:.6g}: {stop.text}; residual {state.residual:.1e}, solvent {following.stage.balance:.1e}"
            break
        if overlaps(following.stage.x, problem.model):
            stop, text = Status.SELF_CONTACT, f"stopped after t = {now.t:.6g}: {Status.SELF_CONTACT.text}"
            break
        before, now = (None if t in kinks else now), following
        if t in times:
            observer.accepted(state)
            states.append(state)
    return Path.from_states(problem.replace(control=time_in(baths, transport.wetted, transport.D)), states, stop=stop, stop_text=text)


def _first(transport, start):
    """The stage of the state at time 0."""
    problem, model = transport.problem, transport.problem.model
    if start.x.shape != model.nodes.shape:
        raise ValueError(f"start: is a state of {len(start.x)} nodes, the model has {len(model.nodes)}")
    mu = np.broadcast_to(np.asarray(start.mu if start.potential is None else start.potential, dtype=float), model.carries.shape)
    sums = np.asarray(of_unknowns(np.where(model.carries, mu, 0.0), model))
    counts = np.concatenate([np.full(block.groups.size, block.carrying) for block in model.blocks])
    J = np.asarray(volume_ratios(start.x, model))
    return Stage(problem.placed(start.x, 0.0), start.pressure, sums / counts, J, Status.CONVERGED)


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
