"""Taylor test of a case's gradients, along one random direction d of each family of parameters.

The remainder f(x + h d) - f(x) - h f'(x) d must fall as h^2 from one step h to its half; if it is
too small for that, the difference quotient must agree with f'(x) d. Moved states are solved from
those of the start, as a sweep of a symmetric plate may end on either mirror image; in time every
path begins at time 0. The gradient is that of reverse mode, as for every optimiser.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from .._primitives import differentiated_value
from ..bifurcation import problem_by_options, sweep_by_options
from ..cases import Case
from ..continuation import Path
from ..equilibrium import solve
from ..observables import area_reduction, core_rotation, is_flat, rotation_angle
from ..transient import Bath, swell

STATES = 4
RATE = 1.9  # least rate; theory: 2
# relative, of difference quotient and derivative: more than the kink where a node enters a support
AGREEMENT = 1e-3
ROUND_OFF = 1e-11  # of an objective
STEPS = {
    "angle": 2e-5,
    "cos": 2e-5,
    "sin": 2e-5,
    "exponent": 1e-4,
    "mu": 0.01,
    "mu_start": 0.01,
    "chi": 0.005,
    "stretch": 1e-3,
}
STEPS |= {"temperature": 0.1, "pH": 0.02, "pKa": 0.02}
LENGTH = 1e-4  # first step of lengths over the node spacing
SHARE = 0.05  # first step of other parameters over their value
OF_GAP = 0.01  # first step of a bath's times over the distance to the next time of the run
OBJECTIVES = {
    "rotation": lambda path: rotation_angle(path)[-1],
    "core rotation": lambda path: core_rotation(path)[-1],
    "area reduction": lambda path: area_reduction(path)[-1],
    "whole curve": lambda path: (
        jnp.mean(rotation_angle(path) ** 2) / 100 + jnp.mean(area_reduction(path))
    ),
}


@dataclasses.dataclass(frozen=True)
class Row:
    """The test of one objective f along a direction d of one family of parameters.

    ``slope`` is f'(x) d, ``difference`` f(x + d / 2) - f(x - d / 2); ``remainders`` are those at
    h = 1 and h = 1/2, which may be round-off below ``round_off``.
    """

    objective: str
    family: str
    slope: float
    difference: float
    remainders: tuple[float, float]
    round_off: float

    @property
    def rate(self) -> float:
        """Order with which the remainder falls; inf if one is not above round-off."""
        first, second = self.remainders
        return np.inf if min(first, second) < self.round_off else float(np.log2(first / second))

    @property
    def ok(self) -> bool:
        """Whether the derivative is right."""
        return self.rate >= RATE or abs(self.difference - self.slope) < AGREEMENT * abs(self.slope)


def check_gradient(case: Case, *, states: int | None = None, quiet: bool = True) -> list[Row]:
    """List of `Row`: every objective that has a value, by every family of parameters of a `Case`.

    A family is all parameters of one name, of holes, regions and materials; the values of the
    control, by its name, or the mu at which another one is driven; in time D, mu_start, and mu and
    times of the baths. The path has ``states`` equally spaced values, in time as many of the case's
    times; None takes those that the case lists, or ``STATES``. The load of an imperfection stays
    constant. Raises ArithmeticError if the states are not found.
    """
    cloud, model, options = (
        case.discretisation.cloud(case.plate),
        case.discretisation.model,
        case.sweep,
    )
    start_model = model(cloud)
    drive = (_Sweep if case.time is None else _Swelling)(case, start_model, states)
    holes, regions = (
        [dict(outline.theta) for outline in outlines]
        for outlines in (case.plate.holes, case.plate.regions)
    )
    point = {"holes": holes, "regions": regions, "gel": case.gel} | drive.numbers
    point = jax.tree.map(lambda value: jnp.asarray(value, dtype=float), point)
    leaves, structure = jax.tree.flatten(point)
    families, sizes = _families(point, options.control, LENGTH * cloud.spacing, drive.sizes)
    push = case.problem(start_model).loads - case.problem(start_model, imperfect=False).loads

    def problem_of(point):
        """The `Problem` of a point, under the start's imperfection."""
        own = model(cloud.at(case.plate.at(point["holes"], point["regions"])))
        return problem_by_options(own, point["gel"], options, loads=case.loads.of(own), push=push)

    def read(path):
        return jnp.stack([OBJECTIVES[name](path) for name in names])

    def at(changed):
        """Objectives (o,) with other leaves, on the start's branch."""
        point = jax.tree.unflatten(structure, changed)
        return np.asarray(read(drive.beside(start, problem_of(point), point)))

    start = drive.path(problem_of(point), point)
    if not start.stop.ok:
        raise ArithmeticError(f"check-grad: {start.stop_text}; {drive.advice}")
    names = differentiable(start)
    pullback = jax.vjp(lambda point: read(drive.path(problem_of(point), point)), point)[1]
    gradients = [jax.tree.leaves(pullback(row)[0]) for row in jnp.eye(len(names))]
    random, f, rows = np.random.default_rng(0), at(leaves), []
    for family in tqdm(
        dict.fromkeys(filter(None, families)),
        unit="family",
        disable=True if quiet else None,
        leave=False,
    ):
        d = [
            (family == of) * size * random.normal(size=leaf.shape)
            for of, size, leaf in zip(families, sizes, leaves, strict=True)
        ]
        ahead, half, behind = (
            at([x + h * along for x, along in zip(leaves, d, strict=True)])
            for h in (1.0, 0.5, -0.5)
        )
        for k, name in enumerate(names):
            slope = sum(float(np.vdot(*pair)) for pair in zip(gradients[k], d, strict=True))
            remainders = (
                abs(float(ahead[k] - f[k] - slope)),
                abs(float(half[k] - f[k] - 0.5 * slope)),
            )
            rows.append(
                Row(
                    name,
                    family,
                    slope,
                    float(half[k] - behind[k]),
                    remainders,
                    ROUND_OFF * max(1.0, abs(float(f[k]))),
                )
            )
    return sorted(rows, key=lambda row: names.index(row.objective))


def differentiable(path: Path) -> tuple[str, ...]:
    """Names of objectives with finite value and derivative at the last state.

    A nan would spread to the others.
    """
    level = {"rotation"} if is_flat(path.x[-1:], path.model)[0] else set()
    return tuple(
        name
        for name, objective in OBJECTIVES.items()
        if name not in level and np.isfinite(objective(path))
    )


def _families(point, driven, length, special):
    """Name of the family and first step of each leaf.

    No name for a parameter that is ``driven``, which has no effect, or has no step.
    """
    families, sizes = [], []
    for keys, leaf in jax.tree_util.tree_flatten_with_path(point)[0]:
        names = [getattr(key, "key", getattr(key, "name", "")) for key in keys]
        family = next(
            name for name in names if name not in ("", "holes", "regions", "gel", "matrix")
        )
        family = {"values": driven, driven: ""}.get(family, family)
        size = STEPS.get(
            family, length if names[0] in ("holes", "regions") else SHARE * np.abs(leaf)
        )
        sizes.append(special.get(names[0], size))
        families.append(family if np.any(sizes[-1]) else "")
    return families, sizes


class _Sweep:
    """The sweep of a case at values of its control."""

    def __init__(self, case, _, states):
        self.options = options = case.sweep
        listed = states is None and options.listed
        values = (
            np.array(options.numbers) if listed else np.linspace(*options.ends, states or STATES)
        )
        self.numbers, self.sizes = {"values": values, "mu": options.at_mu}, {}
        self.advice = f"choose another {'--mu-end' if options.control == 'mu' else '--to'}"

    def path(self, problem, point):
        """The path at a point."""
        return sweep_by_options(self._driven(problem, point), self.options, values=point["values"])

    def beside(self, start, problem, point):
        """The path at a point on the branch of the path ``start``; nan if it is not found."""
        problem, states = self._driven(problem, point).prepared, []
        moved = problem.model.cloud.nodes - start.model.cloud.nodes
        for value, x, pressure in zip(point["values"], start.x, start.pressure, strict=True):
            # where the constrained ones have to be
            carried = moved @ np.asarray(problem.edges(value).deformation).T
            state = solve(problem, value, x + carried, pressure)
            states.append(
                state if state.status.ok else dataclasses.replace(state, x=np.full_like(x, np.nan))
            )
        return Path.from_states(problem, states)

    def _driven(self, problem, point):
        """The problem whose control, if it is not mu, acts at the point's mu."""
        mu = point["mu"]
        return (
            problem
            if mu is None
            else problem.replace(control=dataclasses.replace(problem.control, mu=mu))
        )


class _Swelling:
    """Swelling in time of a case, at some of its times.

    Equal numbers of the baths and of the start vary together: a ramp that begins at mu_start, a
    value that is held, and a kink that two baths share have no derivatives otherwise.
    """

    def __init__(self, case, model, states):
        self.baths, self.unit = case.baths(), case.time.unit
        self.start, times = case.sweep.mu_start, np.array(case.times(case.problem(model)))
        if case.time.times is None or states is not None:
            number = min(states or STATES, len(times))
            times = times[np.linspace(-1, len(times) - 1, number + 1).round().astype(int)[1:]]
        self.times = times.tolist()
        self.mu = sorted({mu for bath in self.baths.values() for mu in bath.mu} - {self.start})
        self.kinks = sorted({kink for bath in self.baths.values() for kink in bath.kinks})
        gaps = [
            min(abs(kink - t) for t in (0.0, *self.times, *self.kinks) if t != kink)
            for kink in self.kinks
        ]
        self.numbers = {
            "D": case.time.D,
            "mu_start": self.start,
            "bath mu": np.array(self.mu),
            "bath times": np.array(self.kinks),
        }
        self.sizes = {
            "bath mu": np.minimum(STEPS["mu"], SHARE * np.abs(self.mu)),
            "bath times": OF_GAP * np.array(gaps),
        }
        self.advice = "choose a larger --states"

    def path(self, problem, point):
        """The path at a point; times at kinks of the baths move with these."""
        mu = dict(zip([self.start, *self.mu], [point["mu_start"], *point["bath mu"]], strict=True))
        kinks = dict(zip(self.kinks, point["bath times"], strict=True))
        times = [float(differentiated_value(kinks.get(t, t))) for t in self.times]

        def bath_of(bath):
            return Bath(
                [mu[value] for value in bath.mu], times=[kinks.get(t, t) for t in bath.times]
            )

        baths = {part: bath_of(bath) for part, bath in self.baths.items()}
        return swell(problem, baths, times, start=point["mu_start"], D=point["D"], unit=self.unit)

    def beside(self, _, problem, point):
        """The path at a point; nan if it stops early."""
        path = self.path(problem, point)
        return path if path.stop.ok else dataclasses.replace(path, x=np.full_like(path.x, np.nan))
