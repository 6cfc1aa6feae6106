"""The public verb of transient swelling: states of a gel in a bath at chosen times."""

import dataclasses
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from .._primitives import differentiated_value
from .._threads import few_threads
from .._tracing import is_traced
from .._types import Array, Float, Scalar
from .._validation import check_kind, did_you_mean
from ..continuation import Path, SweepFailed, sweep
from ..controls import check_values
from ..equilibrium import NEWTON, UNOBSERVED, Newton, Observer, State
from ..mechanics import Problem, wetted_parts
from .autodiff import traced_swell
from .bath import Bath
from .problem import transport
from .run import Start, check_run, run

DRIER = 3.0, 2.0, 1.0, 0.0  # kT below the start, by way of which a sweep comes to it if it must
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
    into phases, elastomers, and controls other than the chemical potential are not. Hong, Zhao, Zhou & Suo (2008).

    JAX differentiates the path, once, by the problem, ``D``, the ``start``, and the values and times of the bath. Times of steps are held,
    but for kinks of the bath. Inside ``jax.jit`` and ``jax.vmap`` it is refused.

    >>> import jaxgel
    >>> plate = jaxgel.Plate(0.8, 1.0, edges={"top": "free"})
    >>> problem = jaxgel.Problem(jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.1)), jaxgel.Gel(1e-3, 0.1), contact=False)
    >>> path = jaxgel.swell(problem, -0.4999, [1e-4, 1e-3, 1e-2, 0.1], start=-0.5)
    >>> path.t.tolist(), path.stop.ok
    ([0.0, 0.0001, 0.001, 0.01, 0.1], True)
    """
    check_kind("problem", problem, Problem, "a Problem, as Problem(model, gel, contact=False) makes it")
    found = _baths(problem, bath)
    parts, baths = tuple(found), list(found.values())
    check_run(problem, baths, D)
    kinks = sorted({kink for bath in baths for kink in bath.kinks})
    spacing = float(problem.model.lists.topology.node_spacing.min())
    numbers = times.values(spacing, float(differentiated_value(D)), kinks) if isinstance(times, TimeSteps) else times
    numbers = check_values(numbers, "times", "time", rising=True).tolist()
    if not numbers[0] > 0:
        raise ValueError(f"times: {numbers[0]:g} is not accepted, the first must be above 0, at which the start is")
    first = _start(problem, start, newton, observer)
    if is_traced((problem, D, first, [(bath.times, bath.mu) for bath in baths])):
        return traced_swell(transport(problem, parts, D), baths, first, numbers, newton, observer)
    problem = problem.prepared
    with few_threads(2 * problem.model.n_nodes):
        return run(transport(problem, parts, D), baths, first, numbers, newton, observer).path


def _start(problem, start, newton, observer):
    """The `Start` that is a state, or the equilibrium at a chemical potential, by way of drier ones if it is not found at once."""
    model = problem.model
    if not isinstance(start, State):
        try:
            path = sweep(problem, [start], newton=newton, observer=observer)
        except SweepFailed:
            path = sweep(problem, [start - below for below in DRIER], newton=newton, observer=observer)
        if not path.stop.ok:
            raise ValueError(f"start: {differentiated_value(start):g} kT is not reached: {path.stop_text}")
        x, pressure, mu = (getattr(path, name)[-1] for name in ("x", "pressure", "mu"))
    else:
        x, pressure, mu = start.x, start.pressure, start.mu if start.potential is None else start.potential
    if x.shape != model.nodes.shape:
        raise ValueError(f"start: is a state of {len(x)} nodes, the model has {len(model.nodes)}")
    return Start(x, pressure, (jnp if is_traced(mu) else np).broadcast_to(mu, model.carries.shape))


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
