"""Inverse design: parameters -> plate and gel -> swollen path -> objective and constraints, searched with exact gradients.

Optimisers see every parameter scaled to [0, 1] by its bounds. What they ask for is in `search`, how they take constraints and invalid
designs in `optimisers`, and the usual objectives and constraints are in `objectives`.
"""

import dataclasses
import enum
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from .cloud import make_cloud
from .discretisation import discretise
from .objectives import CURVES
from .observables import min_gap, surface_ratio
from .optimisers import METHODS, Exhausted, Invalid, Stuck, optimiser
from .search import FEASIBLE, Search, check_path, violation
from .sections import DiscretisationOptions
from .sweep import check_mu, sweep


class Outcome(enum.StrEnum):
    """How a search for a design ended."""

    CONVERGED = "converged"
    EXHAUSTED = "exhausted"
    STUCK = "stuck"
    INTERRUPTED = "interrupted"

    @property
    def text(self):
        """One line that says what happened and what to try."""
        return {
            "converged": "the optimiser finds no better design nearby",
            "exhausted": "the number of evaluations is used up; give more of them to go on",
            "stuck": "no step from the best design gives a valid one, however short; look at the reasons in the history",
            "interrupted": "interrupted by the user; resume goes on",
        }[self]


@dataclasses.dataclass(frozen=True, eq=False)
class DesignProblem:
    """What is varied, what it makes, and what it is judged by.

    Raises ValueError for bounds that are missing, do not contain the start or are not finite, and for an unusable mu.
    """

    start: dict
    """Name -> start value, a number or an array, of every parameter."""
    bounds: dict
    """Name -> (lower, upper), numbers or arrays of the parameter's shape; they also set its scale."""
    plate: Callable
    """Function of the parameters (a dict as ``start``) that gives the `Plate`, traceable."""
    gel: object
    """The `Gel`, or a function of the parameters that gives it."""
    mu: list
    """(k,) increasing chemical potentials of the sweep, kT."""
    objective: Callable
    """Function of the path that gives a number, see `objectives`."""
    maximise: bool = False
    """Whether a large objective is good."""
    constraints: tuple = ()
    """`objectives.Constraint` to be met."""
    options: DiscretisationOptions = dataclasses.field(default_factory=DiscretisationOptions)
    """Cloud and method of the search."""
    branch: str = "stable"
    """Branch that the sweeps follow, "stable" or "symmetric"."""
    allow_unstable: bool = False
    """Whether states with negative pivots count as valid."""

    def __post_init__(self):
        object.__setattr__(self, "mu", check_mu(list(self.mu))[0].tolist())
        start = {name: jnp.asarray(value, dtype=float) for name, value in self.start.items()}
        object.__setattr__(self, "start", start)
        if start.keys() != self.bounds.keys():
            raise ValueError(f"bounds: {sorted(self.bounds)} given for the parameters {sorted(start)}; give (lower, upper) of each")
        bounds = {name: _bounds(name, self.bounds[name], np.asarray(value)) for name, value in start.items()}
        object.__setattr__(self, "bounds", bounds)

    @property
    def vector(self):
        """The start scaled to [0, 1], NumPy (n,)."""
        return np.clip((np.asarray(ravel_pytree(self.start)[0]) - self._lower) / self._range, 0.0, 1.0)

    def parameters(self, vector):
        """The dict of parameters of a scaled ``vector`` (n,), which may be traced."""
        return ravel_pytree(self.start)[1](self._lower + self._range * vector)

    def gel_at(self, parameters):
        """The gel of a dict of parameters."""
        return self.gel(parameters) if callable(self.gel) else self.gel

    def make_cloud(self, plate, spacing=None):
        """A new cloud for a concrete plate, its own reference from here on, with the search's spacing or a given one."""
        own, plate = self.options, dataclasses.replace(plate, reference=None)
        nodes = own.nodes_per_hole if spacing is None else None
        return make_cloud(plate, spacing=own.spacing if spacing is None else spacing, nodes_per_hole=nodes)

    def path(self, parameters, cloud, mu=None):
        """The swollen path of a dict of parameters on a cloud placed at them; both may be traced."""
        own = self.options
        cloud = cloud.at(self.plate(parameters))
        model = discretise(cloud, basis=own.basis, dmax=own.dmax, method=own.method, quadrature=own.quadrature)
        return sweep(model, self.gel_at(parameters), mu=self.mu if mu is None else mu, branch=self.branch)

    @property
    def _lower(self):
        return np.asarray(ravel_pytree({name: lower for name, (lower, _) in self.bounds.items()})[0])

    @property
    def _range(self):
        return np.asarray(ravel_pytree({name: upper - lower for name, (lower, upper) in self.bounds.items()})[0])


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """The best design of a search and how it was found."""

    parameters: dict
    """Name -> value of the best design: feasible if any was, otherwise the one with the least violation."""
    value: float
    """Its objective, in the user's own sign and unit."""
    constraints: dict
    """Name -> smallest value of each constraint's function there, in its own unit; met if not negative."""
    feasible: bool
    """Whether it meets all constraints."""
    outcome: Outcome
    """How the search ended."""
    history: list
    """One dict per evaluation: value, violation (largest, scaled), feasible, invalid (text, empty if valid), cloud (its number)."""

    @property
    def text(self):
        """The outcome in one line."""
        return self.outcome.text


def optimise(problem, *, method="slsqp", evaluations=60, step=0.2, tolerance=1e-5, folder=None, resume=False, record=None, quiet=True):
    """The `Design` found by ``method`` within a number of sweeps, starting at ``problem.start``.

    ``method`` is "slsqp" (SciPy), "mma" (nlopt, extra ``[mma]``), "lbfgs" (SciPy's L-BFGS-B), "adam", or an optax
    GradientTransformation for parameters scaled to [0, 1]; the last three take constraints by an augmented Lagrangian, see
    `optimisers`. ``step`` is the longest move of a scaled parameter at once, ``tolerance`` the change of the objective, over its start
    value, that no longer counts. With a ``folder`` the log is on disk, whole, after every evaluation, and ``resume`` continues it to
    the same numbers as without interruption; ``record`` (a dict) is stored with it. Raises ValueError for an unknown method, a start
    that is no valid design, and a log of another problem.
    """
    if not 0 < step <= 1:
        raise ValueError(f"step: {step!r} is not in (0, 1], the share of the bounds' range")
    if evaluations < 1:
        raise ValueError(f"evaluations: {evaluations!r} is not a whole number of at least 1")
    if not 0 < tolerance <= 1:
        raise ValueError(f"tolerance: {tolerance!r} is not in (0, 1], a share of the objective at the start")
    run = optimiser(method, step, tolerance)
    search = Search(problem, evaluations, folder=folder, name=str(method) if method in METHODS else "optax", record=record, quiet=quiet)
    if resume:
        search.recall()
    try:
        search.first()
        run(search)
        outcome = Outcome.CONVERGED
    except Exhausted:
        outcome = Outcome.EXHAUSTED
    except Stuck:
        outcome = Outcome.STUCK
    except KeyboardInterrupt:
        outcome = Outcome.INTERRUPTED
    finally:
        search.bar.close()
    search.write(outcome)
    return _design(search, outcome)


def verify(problem, parameters, *, spacing, mu=None):
    """Objective, constraints and state of a design on a fresh cloud built from its final holes: a dict, and the path.

    ``spacing`` in mm; ``mu`` (k,) defaults to the problem's own with a value between every two. The dict holds value, constraints
    (name -> smallest value, in its unit), valid (bool), reason (one line), nodes, spacing, the worst negative_pivots, min_gap and
    surface_ratio of the path, and ``last``, the quantities of `objectives.CURVES` at its last mu (None where there is no value).
    """
    parameters = {name: jnp.asarray(value) for name, value in parameters.items()}
    plate, between = problem.plate(parameters), 0.5 * (np.array(problem.mu[1:]) + problem.mu[:-1])
    path = problem.path(parameters, problem.make_cloud(plate, spacing), np.sort([*problem.mu, *between]).tolist() if mu is None else mu)
    reason = "valid: stable, no self-contact"
    try:
        if not path.stop.ok:
            raise Invalid(path.stop_text)
        check_path(path, problem.allow_unstable)
    except Invalid as invalid:
        reason = str(invalid)
    last = {name: float(quantity(path)[-1]) for name, quantity in CURVES.items()}
    found = dict(
        value=float(problem.objective(path)),
        constraints={c.name: float(np.min(c.function(plate if c.dry else path))) for c in problem.constraints},
        valid=reason.startswith("valid"),
        reason=reason,
        nodes=path.model.n_nodes,
        spacing=float(spacing),
        negative_pivots=int(np.max(path.negative_pivots)),
        min_gap=float(np.min(min_gap(path))),
        surface_ratio=float(np.max(surface_ratio(path))),
        last={name: value if np.isfinite(value) else None for name, value in last.items()},
    )
    return found, path


def intervals(problem, parameters, curve, noise, *, cloud=None):
    """Standard deviations and covariance of parameters fitted to ``curve`` (a function of the path, (k,)) with the given noise.

    Gauss and Newton's Hessian of the sum of squares over 2 noise^2, J^T J / noise^2, inverted: a dict name -> standard deviation, and
    the covariance (n, n) in the order of `jax.flatten_util.ravel_pytree`. ``noise`` is the standard deviation of independent errors.
    """
    flat, unravel = ravel_pytree({name: jnp.asarray(value, dtype=float) for name, value in parameters.items()})
    cloud = problem.make_cloud(problem.plate(unravel(flat))) if cloud is None else cloud
    slopes = np.asarray(jax.jacfwd(lambda v: curve(problem.path(unravel(v), cloud)))(flat))
    scale = np.abs(np.asarray(flat)) + (np.asarray(flat) == 0)
    covariance = noise**2 * np.linalg.inv((slopes * scale).T @ (slopes * scale)) * np.outer(scale, scale)
    return {name: np.asarray(v) for name, v in unravel(jnp.sqrt(jnp.diag(jnp.asarray(covariance)))).items()}, covariance


def _design(search, outcome):
    """`Design` of a search's log."""
    best = search.best()
    return Design(
        parameters={name: np.asarray(v) for name, v in search.problem.parameters(np.array(best["vector"])).items()},
        value=search.value(best),
        constraints=search.constraints(best),
        feasible=violation(best) <= FEASIBLE,
        outcome=outcome,
        history=[_row(search, entry) for entry in search.log],
    )


def _row(search, entry):
    row = dict(value=None, violation=None, feasible=False, invalid=entry["invalid"], cloud=entry["cloud"])
    if not entry["invalid"]:
        row |= dict(value=search.value(entry), violation=violation(entry), feasible=violation(entry) <= FEASIBLE)
    return row


def _bounds(name, bounds, value):
    """(lower, upper) as arrays of the shape of ``value``; ValueError unless they are finite and contain it."""
    try:
        lower, upper = (np.broadcast_to(np.asarray(bound, dtype=float), value.shape) for bound in bounds)
    except (TypeError, ValueError):
        raise ValueError(f"bounds.{name}: {bounds!r} is not (lower, upper), two numbers or arrays of shape {value.shape}") from None
    if not (np.all(np.isfinite(upper - lower)) and np.all(lower < upper) and np.all((lower <= value) & (value <= upper))):
        raise ValueError(f"bounds.{name}: {lower.tolist()} ... {upper.tolist()} are not finite bounds around the start {value.tolist()}")
    return lower, upper
