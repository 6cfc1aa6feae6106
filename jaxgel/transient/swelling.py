"""Transient swelling: states of a gel in a bath at chosen times."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from .._primitives import differentiated_value
from .._sizes import taken
from .._tracing import is_traced
from .._types import Array, Float, Scalar
from .._validation import Inadmissible, check_kind, did_you_mean, one_of
from ..continuation import BRANCHES, Path, SweepFailed, sweep
from ..controls import ChemicalPotential, check_values
from ..equilibrium import NEWTON, UNOBSERVED, Newton, Observer, State
from ..materials import elementwise, free_swelling, gel_in_groups, layer_diffusivity
from ..mechanics import Problem, wetted_parts
from .autodiff import INSIDE_JIT, traced_swell
from .bath import Bath, time_in
from .problem import transport
from .run import Start, check_numbers, check_swelling, kinks_of, run

DRIER = 3.0, 2.0, 1.0, 0.0  # kT below the start, by way of which a sweep comes to it if it must
Baths = Scalar | Bath | Mapping[str | int, Scalar | Bath | None]


@dataclasses.dataclass(frozen=True)
class TimeSteps:
    """Times of `swell` that grow geometrically from `first` to `end`; the user makes it.

    Steps begin anew at each kink of the bath.

    >>> import jaxgel
    >>> cloud = jaxgel.make_cloud(jaxgel.Plate(1.0, 1.0, edges={"top": "free"}), spacing=0.25)
    >>> problem = jaxgel.Problem(jaxgel.discretise(cloud), jaxgel.Gel(1e-3, 0.1), contact=False)
    >>> times = jaxgel.TimeSteps(0.1, first=1e-4, per_decade=1)
    >>> path = jaxgel.swell(problem, -0.4999, times, start=-0.5)
    >>> path.t.round(9).tolist(), path.stop.ok
    ([0.0, 0.0001, 0.001, 0.01, 0.1], True)
    """

    end: float
    """Last time, in the unit of time of D."""
    first: float | None = None
    """First time above 0; None for a thousandth of the time to diffuse over a node spacing."""
    per_decade: int = 10
    """Number of steps to a decade of time."""

    def __post_init__(self) -> None:
        check_values([0.0, self.end], "end", "time", rising=True)
        if self.first is not None:
            check_values([0.0, self.first, self.end], "first", "time", rising=True)
        if not self.per_decade >= 1:
            raise ValueError(f"per_decade: {self.per_decade} is not accepted, it must be 1 or more")

    def values(
        self, spacing: float, D: float, kinks: Sequence[float] = ()
    ) -> Float[np.ndarray, " k"]:
        """The times (k,) for a cloud of this node ``spacing``, mm, the ``kinks`` among them."""
        first = min(1e-3 * spacing**2 / D, self.end / 2) if self.first is None else self.first
        starts = [0.0, *(kink for kink in kinks if kink < self.end)]
        times = set()
        for start, last in zip(starts, [*starts[1:], self.end], strict=True):
            count = int(np.ceil(self.per_decade * np.log10(max((last - start) / first, 1.0)))) + 1
            times |= {
                start + step
                for step in np.geomspace(min(first, last - start), last - start, count).tolist()[
                    :-1
                ]
            } | {last}
        return np.array(sorted(times))


def swell(
    problem: Problem,
    bath: Baths,
    times: Sequence[float] | Float[Array, " k"] | TimeSteps,
    *,
    start: Scalar | State | Path,
    D: Scalar = 1.0,
    unit: str = "",
    branch: str = "stable",
    newton: Newton = NEWTON,
    observer: Observer = UNOBSERVED,
) -> Path:
    """`Path` of the states of a gel in a bath at chosen times, the first one at time 0.

    Arguments:

    - `problem`: the `Problem`, without contact, controlled by mu.
    - `bath`: chemical potential, kT, or a `Bath`, at all that can be wetted: holes and free edges.
      Or a mapping from numbers of holes and names of free edges to these; what is left out or None
      is sealed.
    - `times` (k,): times of the states, and of the steps between them; or `TimeSteps`.
    - `start`: chemical potential, kT, of the equilibrium before; or a `State`, such as the last of
      another run; or the `Path` of the first states of this run, continued to the last bit as in a
      run without interruption. Bath and loads act from time 0 on; the bath counts as changed then
      also for a state on its way to it.
    - `D`: diffusivity of the solvent, mm^2 per unit of time, see `materials.transport`; only `D`
      times the time counts.
    - `unit`: unit of time in figures and files.
    - `branch`: "stable" ends the path before a state that is unstable at its chemical potentials,
      which a perturbation would leave as solvent moves; "symmetric" does not, and flags derivatives
      of the states from there on (`path.derivative`).
    - `newton`, `observer`: as in `sweep`.

    Returns the path, with the times `t`, `potential` and `supplied`; see `Path`. If Newton's method
    fails a step is halved, up to 14 times; if that does not help, or if an outline meets itself,
    the path ends early, with the reason in `path.stop` and `path.stop_text`. Until the layer below
    a surface is as thick as its cells the uptake is that of a half-space, good to about 10 %, see
    docs/theory.md. JAX differentiates the path, once, by the problem, `D`, the `start`, and the
    values and times of the bath. Times of steps are constant, but for kinks of the bath.

    Raises `ValueError`, one line, for an unusable bath, times or problem (films, periodic edges,
    contact, gels with phases, elastomers, other controls), and inside `jax.jit` and `jax.vmap`.
    Source: Hong, Zhao, Zhou & Suo (2008). Example: docs/howto/time.md.
    """
    check_kind(
        "problem", problem, Problem, "a Problem, as Problem(model, gel, contact=False) makes it"
    )
    baths = baths_of(problem, bath)
    inputs = jax.tree.leaves((problem, D, start, [(one.mu, one.times) for one in baths.values()]))
    if is_traced([differentiated_value(leaf) for leaf in inputs]):
        raise ValueError(INSIDE_JIT)
    one_of("branch", branch, BRANCHES)
    check_swelling(problem)
    problem = problem.replace(control=ChemicalPotential())
    check_numbers(problem, baths.values(), D)
    times = step_times(problem, baths, times, D).tolist()
    made = transport(problem, tuple(baths), D)
    options = tuple(baths.values()), times, time_in(baths, D, unit), branch, newton, observer
    if isinstance(start, Path):
        if is_traced(inputs):
            raise ValueError(
                "start: a path goes on without derivatives; give the state path[-1], whose run is "
                "differentiated"
            )
        return run(made, _first_states(start, times), *options).path
    first = _start(problem, start, newton)
    if is_traced(inputs, first):
        return traced_swell(made, first, *options)
    return run(made, first, *options).path


def step_times(
    problem: Problem,
    baths: Mapping[str | int, Bath],
    times: Sequence[float] | Float[Array, " k"] | TimeSteps,
    D: Scalar = 1.0,
) -> Float[np.ndarray, " k"]:
    """The times (k,) of the states of `swell` after the first one.

    ValueError, one line, if they are not above 0 and rising.
    """
    if isinstance(times, TimeSteps):
        spacing = problem.model.lists.topology.node_spacing.min()
        return times.values(
            float(spacing), float(differentiated_value(D)), kinks_of(baths.values())
        )
    numbers = check_values(times, "times", "time", rising=True)
    if not numbers[0] > 0:
        raise ValueError(
            f"times: {numbers[0]:g} is not accepted, the first must be above 0, at which the "
            "start is"
        )
    return numbers


def resolved_time(
    problem: Problem, wetted: Iterable[str | int], mu: float, D: Scalar = 1.0
) -> float:
    """Time at which the boundary layer is as thick as the ``wetted`` cells: h^2 / D_eff.

    nan if it is not known. h is the largest node spacing there, D_eff the least diffusivity along a
    stretch of the gel that swells freely at ``mu``, kT. Until then the uptake is that of a
    half-space, see `swell`.
    """
    lists, axial = problem.model.lists, problem.model.axial_stretch
    nodes = np.concatenate([wetted_parts(lists)[part] for part in wetted])

    def diffusivity(mu, gel):
        stretch = free_swelling(mu, gel, axial)
        return layer_diffusivity(stretch, stretch, gel, axial, D)

    values = elementwise(diffusivity, jnp.asarray(mu, dtype=float), gel_in_groups(problem.gel))
    return float(lists.topology.node_spacing[nodes].max() ** 2 / np.min(values))


def _first_states(path, times):
    """The states of a path to go on from.

    ValueError if they are not the first ones of a run with these times.
    """
    if path.t is None or path.t[0] != 0 or not np.array_equal(path.t[1:], times[: len(path) - 1]):
        raise ValueError(
            "start: the path is not one of swell with these times; give its first states, or a "
            "State"
        )
    return [path[k] for k in range(len(path))]


def _start(problem, start, newton):
    """`Start` from a state, or from the equilibrium at a mu, by way of drier ones if needed."""
    model = problem.model
    if not isinstance(start, State):
        try:
            path = sweep(problem, [start], newton=newton)
        except SweepFailed:
            path = sweep(problem, [start - below for below in DRIER], newton=newton)
        if not path.stop.ok:
            raise Inadmissible(
                f"start: {differentiated_value(start):g} kT is not reached: {path.stop_text}"
            )
        last = np.array(len(path) - 1)
        x, pressure = taken(path.x, last), taken(path.pressure, last)
        return Start(x, pressure, taken(path.mu, np.full(model.carries.shape, last)))
    x, pressure, mu = (
        start.x,
        start.pressure,
        start.mu if start.potential is None else start.potential,
    )
    if x.shape != model.nodes.shape:
        raise ValueError(f"start: is a state of {len(x)} nodes, the model has {len(model.nodes)}")
    return Start(x, pressure, (jnp if is_traced(mu) else np).broadcast_to(mu, model.carries.shape))


def baths_of(problem: Problem, bath: Baths) -> dict[str | int, Bath]:
    """The `Bath` of each wetted part of the boundary, by its number or name.

    ValueError, one line, for a part that there is not.
    """
    parts = wetted_parts(problem.model.lists)
    given = dict.fromkeys(parts, bath) if not isinstance(bath, Mapping) else bath
    for name in given:
        if name not in parts:
            known = (
                f"a hole has a number below {len(problem.model.lists.topology.plate.holes)}"
                if isinstance(name, int)
                else ""
            )
            raise ValueError(
                f"bath: there is no {name!r} to wet; "
                f"{known or did_you_mean(name, map(str, parts)) or 'nothing is free'}"
            )
    found = {
        name: one if isinstance(one, Bath) else Bath(one)
        for name, one in given.items()
        if one is not None
    }
    if not found:
        raise ValueError("bath: nothing is wetted; the plate needs a hole or a free edge that is")
    return found
