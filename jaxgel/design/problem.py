"""A design problem: parameters, bounds, plate, objective and constraints."""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..cloud import make_cloud
from ..continuation import check_mu, sweep
from ..discretisation import DiscretisationOptions, discretise


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


def _bounds(name, bounds, value):
    """(lower, upper) as arrays of the shape of ``value``; ValueError unless they are finite and contain it."""
    try:
        lower, upper = (np.broadcast_to(np.asarray(bound, dtype=float), value.shape) for bound in bounds)
    except (TypeError, ValueError):
        raise ValueError(f"bounds.{name}: {bounds!r} is not (lower, upper), two numbers or arrays of shape {value.shape}") from None
    if not (np.all(np.isfinite(upper - lower)) and np.all(lower < upper) and np.all((lower <= value) & (value <= upper))):
        raise ValueError(f"bounds.{name}: {lower.tolist()} ... {upper.tolist()} are not finite bounds around the start {value.tolist()}")
    return lower, upper
