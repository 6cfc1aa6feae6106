"""A design problem: parameters, bounds, plate, objective and constraints."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from .._deprecated import old_arguments
from .._types import Array, Float, Scalar
from .._validation import Inadmissible
from ..bifurcation import problem_by_options, sweep_by_options
from ..cloud import Cloud
from ..continuation import Path, SweepOptions
from ..controls import check_values
from ..discretisation import DiscretisationOptions
from ..geometry import Plate, check_plate
from ..materials import AnyGel, check_gel
from ..mechanics import Loads
from ..transient import Bath, TimeOptions, TimeSteps, swell
from .criteria import Constraint
from .robust import Spread


@dataclasses.dataclass(frozen=True, eq=False)
class DesignProblem:
    """A design problem: parameters, plate and gel, objective and constraints; the user makes it.

    Raises `ValueError` for bounds that are missing, do not contain the start or are not finite, for
    an unusable mu, and for an imperfection.
    """

    start: dict
    """Name -> start value, a number or an array, of every parameter."""
    bounds: dict
    """Name -> (lower, upper), numbers or arrays of the parameter's shape.

    They also set its scale.
    """
    plate: Callable[[dict], Plate]
    """Function of the parameters (a dict as ``start``) that gives the `Plate`, traceable."""
    gel: AnyGel | Callable[[dict], AnyGel]
    """The `Gel` or `Composite`, or a function of the parameters that gives it."""
    mu: Sequence[float]
    """(k,) increasing chemical potentials of the sweep, kT.

    With another control in ``sweep`` its values, all different. Of a gel that swells in time one,
    that of its equilibrium at time 0.
    """
    objective: Callable
    """Function of the path that gives a number, see `objectives`.

    With a ``spread`` its samples count, see `Spread`.
    """
    maximise: bool = False
    """Whether the objective is to be maximised; minimised by default."""
    constraints: tuple = ()
    """The `Constraint`s to be met."""
    options: DiscretisationOptions = dataclasses.field(default_factory=DiscretisationOptions)
    """Node spacing and discretisation of the search."""
    sweep: SweepOptions = dataclasses.field(default_factory=SweepOptions)
    """Control, branch and contact of the sweeps; ``mu`` takes the place of their values."""
    loads: Loads = dataclasses.field(default_factory=Loads)
    """Body force and tractions."""
    time: TimeOptions | None = None
    """Times of a gel that swells in time, and its diffusivity; None for a sweep."""
    baths: Mapping[str | int, Bath] = dataclasses.field(default_factory=dict)
    """In time, the bath of each wetted hole, by its number, and free edge, by its name."""
    reported: Mapping[str, Callable] = dataclasses.field(default_factory=dict)
    """Name -> function of the path: further numbers for log and verification."""
    spread: Spread | None = None
    """Errors with which a design is made, if the objective takes them into account."""
    allow_unstable: bool = False
    """Whether states with negative pivots count as valid."""

    def __post_init__(self) -> None:
        control = self.sweep.control
        object.__setattr__(
            self, "mu", check_values(list(self.mu), control, rising=control == "mu").tolist()
        )
        for k, value in enumerate(self.mu):
            if value in self.mu[:k]:
                raise ValueError(
                    f"{control}: {value:g} is there twice, the values of a design must differ, as "
                    "quantities count at them"
                )
        object.__setattr__(self, "sweep", self.sweep.at(self.mu))
        if self.time is not None and len(self.mu) != 1:
            raise ValueError(
                f"{control}: {len(self.mu)} values do not go with time; give one, that of the "
                "equilibrium at time 0"
            )
        if self.sweep.imperfection:
            raise ValueError(
                f"sweep.imperfection: {self.sweep.imperfection:g} is not accepted in a design, as "
                "its load along a mode has no derivative; "
                "set it to 0, or break the symmetry by the holes"
            )
        start = {name: jnp.asarray(value, dtype=float) for name, value in self.start.items()}
        object.__setattr__(self, "start", start)
        if start.keys() != self.bounds.keys():
            raise ValueError(
                f"bounds: {sorted(self.bounds)} given for the parameters {sorted(start)}; give "
                "(lower, upper) of each"
            )
        bounds = {
            name: _bounds(name, self.bounds[name], np.asarray(value))
            for name, value in start.items()
        }
        object.__setattr__(self, "bounds", bounds)

    @property
    def vector(self) -> Float[np.ndarray, " d"]:
        """The start, scaled to [0, 1] by its bounds."""
        return np.clip((_flat(self.start) - self._lower) / self._range, 0.0, 1.0)

    def parameters(self, vector: Float[Array, " d"]) -> dict:
        """The dict of parameters of a scaled ``vector``, which may be traced."""
        values, found, first = self._lower + self._range * vector, {}, 0
        for name in sorted(self.start):
            last = first + self.start[name].size
            found[name] = jnp.asarray(values[first:last].reshape(self.start[name].shape))
            first = last
        return found

    def gel_at(self, parameters: dict) -> AnyGel:
        """The gel of a dict of parameters."""
        return self.gel(parameters) if callable(self.gel) else self.gel

    def check_dry(self, parameters: dict) -> None:
        """ValueError, one line, for parameters of an impossible plate or gel.

        A constraint on the dry plate may also be violated.
        """
        plate = self.plate(parameters)
        check_plate(plate)
        check_gel(self.gel_at(parameters))
        for constraint in self.constraints:
            if constraint.dry and not np.all(np.asarray(constraint.function(plate)) >= 0):
                raise Inadmissible(f"{constraint.name} is not met by the dry plate")

    def violation(self, constraints: dict[str, float]) -> float:
        """Largest scaled violation of constraints by their smallest values; 0 if all are met.

        Names are those of `Design`.
        """
        return violation(constraints[c.name] / c.scale for c in self.constraints)

    def distance(self, one: dict, other: dict) -> float:
        """Largest difference of two dicts of parameters, as a share of their bounds' ranges."""
        shares = [
            np.abs(np.asarray(one[name]) - other[name]) / (upper - lower)
            for name, (lower, upper) in self.bounds.items()
        ]
        return max(float(np.max(share)) for share in shares)

    def make_cloud(self, plate: Plate, spacing: float | None = None) -> Cloud:
        """A new cloud for a concrete plate, its own reference.

        Its spacing, mm, is that of the search, or a given one.
        """
        options = self.options if spacing is None else self.options.at_spacing(spacing)
        return options.cloud(dataclasses.replace(plate, reference=None))

    @old_arguments
    def path(
        self, parameters: dict, cloud: Cloud, values: Sequence[float] | TimeSteps | None = None
    ) -> Path:
        """The swollen path of a dict of parameters on a cloud placed at them; both may be traced.

        ``values`` of the control, or times, take the place of the problem's own.
        """
        return self._path(self.plate(parameters), self.gel_at(parameters), cloud, values)

    def as_made(
        self, parameters: dict, cloud: Cloud, values: Sequence[float] | TimeSteps | None = None
    ) -> list[Path]:
        """The `path` of every sample of the ``spread``, as the design is made.

        None without a spread.
        """
        if self.spread is None:
            return []
        plate, gel = self.plate(parameters), self.gel_at(parameters)
        return [
            self._path(*self.spread.change(plate, gel, errors), cloud, values)
            for errors in self.spread.errors
        ]

    def value(self, path: Path, made: Sequence[Path] = ()) -> Scalar:
        """Objective of a design by its path and those of its samples `as_made`."""
        if self.spread is None:
            return jnp.asarray(self.objective(path))
        return self.spread.objective(
            jnp.stack([jnp.asarray(self.objective(one)) for one in made]), self.maximise
        )

    def judged(
        self, vector: Float[Array, " d"], cloud: Cloud
    ) -> tuple[Float[Array, " c"], list[Path], dict[str, Scalar]]:
        """Objective, to be minimised, and scaled constraints on the path (1 + w,) of a design.

        Also its path and those `as_made`, and what is reported. The ``vector`` is scaled, and may
        be traced; the cloud is placed there.
        """
        parameters = self.parameters(vector)
        path, made = self.path(parameters, cloud), self.as_made(parameters, cloud)
        values = [self.value(path, made) * (-1.0 if self.maximise else 1.0)]
        values += [jnp.asarray(c.function(path)) / c.scale for c in self.of_path]
        reported = {name: function(path) for name, function in self.reported.items()}
        return jnp.stack(values), [path, *made], reported

    @property
    def of_path(self) -> list[Constraint]:
        """The constraints on the path, the others need no sweep."""
        return [c for c in self.constraints if not (c.dry or c.of_gel)]

    def _path(self, plate, gel, cloud, values):
        model = self.options.model(cloud.at(plate))
        problem = problem_by_options(model, gel, self.sweep, loads=self.loads.of(model))
        if self.time is None:
            return sweep_by_options(
                problem, self.sweep, values=self.mu if values is None else values
            )
        times = self.time.values if values is None else values
        options = {"D": self.time.D, "unit": self.time.unit}
        return swell(problem, self.baths, times, start=self.mu[0], **options)

    @property
    def refined(self) -> list[float] | TimeSteps:
        """Values of the sweep with one between every two.

        In time, the times with half the steps.
        """
        if self.time is not None:
            return self.time.refined
        count = len(self.mu)
        return np.interp(np.arange(2 * count - 1) / 2, np.arange(count), self.mu).tolist()

    @property
    def _lower(self):
        return _flat({name: lower for name, (lower, _) in self.bounds.items()})

    @property
    def _range(self):
        return _flat({name: upper - lower for name, (lower, upper) in self.bounds.items()})


def _flat(parameters):
    """The values (d,) of a dict, in the order of its sorted names."""
    return np.concatenate([np.ravel(parameters[name]) for name in sorted(parameters)])


def violation(scaled: Iterable[float]) -> float:
    """Largest violation of constraints by their scaled values; 0 if all are met."""
    return max(0.0, *(-value for value in scaled), 0.0)


def _bounds(name, bounds, value):
    """(lower, upper) as arrays of the shape of ``value``.

    ValueError unless they are finite and contain it.
    """
    try:
        lower, upper = (
            np.broadcast_to(np.asarray(bound, dtype=float), value.shape) for bound in bounds
        )
    except (TypeError, ValueError):
        raise ValueError(
            f"bounds.{name}: {bounds!r} is not (lower, upper), two numbers or arrays of shape "
            f"{value.shape}"
        ) from None
    if not (
        np.all(np.isfinite(upper - lower))
        and np.all(lower < upper)
        and np.all((lower <= value) & (value <= upper))
    ):
        raise ValueError(
            f"bounds.{name}: {lower.tolist()} ... {upper.tolist()} are not finite bounds around "
            f"the start {value.tolist()}"
        )
    return lower, upper
