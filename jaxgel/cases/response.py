"""Quantities at a map case's last state as a function of its parameters, with derivatives.

The parameters are a vector (d,): the components of all parameters of the map, in the order of the
columns of points.csv.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Float
from .._validation import did_you_mean
from ..bifurcation import problem_by_options, sweep_by_options
from ..cloud import Cloud
from ..continuation import Path
from ..discretisation import Model
from ..equilibrium import StateNotFound
from ..mechanics import Problem
from ..observables import QUANTITIES, is_flat
from .parameter_map import MapStudy, Vector
from .parameters import gel_of, plate_of

DIFFERENTIABLE = tuple(
    name
    for name, quantity in QUANTITIES.items()
    if quantity.differentiable and not quantity.in_time
)
RESPONSES = ("core_rotation", "rotation", "area_reduction")


@dataclasses.dataclass(frozen=True, eq=False)
class Response:
    """Quantities of a map's case.

    ValueError for a name that is not one of ``DIFFERENTIABLE``, and too many components.
    """

    study: MapStudy
    """The case, and the parameters with their bounds."""
    cloud: Cloud
    """The cloud of the study's own plate, which all points share."""
    quantities: Sequence[str] = RESPONSES
    """Names of the quantities."""

    def __post_init__(self) -> None:
        self.study.check_components()
        for name in self.quantities:
            if name not in DIFFERENTIABLE:
                raise ValueError(
                    f"quantities: {name!r} is unknown; {did_you_mean(name, DIFFERENTIABLE)}"
                )

    def path(self, vector: Vector) -> Path:
        """The `Path` of a point, as ``jaxgel map`` computes it.

        ValueError for parameters out of bounds, or of a plate or gel that cannot be;
        `StateNotFound` if the sweep does not reach its end.
        """
        case = self.study.at(self.study.point(vector))
        path = case.path(case.model(self.cloud))
        if not path.stop.ok:
            raise StateNotFound(path.stop_text)
        return path

    def values(self, path: Path) -> Float[np.ndarray, " r"]:
        """The quantities (r,) at the last state of a path.

        ArithmeticError if one of them has no value there.
        """
        values = np.array([float(QUANTITIES[name].of(path)[-1]) for name in self.quantities])
        for name, value in zip(self.quantities, values, strict=True):
            if not np.isfinite(value):
                raise ArithmeticError(f"{name}: has no value at the last state of this case")
        return values

    def jacobian(self, vector: Vector, path: Path) -> Float[np.ndarray, "r d"]:
        """Derivatives (r, d) of the quantities at the last state, by adjoints.

        ``path`` is the `path` of the point ``vector``. A row is nan if its quantity has no
        derivative, as the rotation of a level midline, or no value. ValueError for an imperfection,
        whose load has no derivative.
        """
        level = ["rotation"] if is_flat(path.x[-1:], path.model)[0] else []
        values = {
            name: float(QUANTITIES[name].of(path)[-1])
            for name in self.quantities
            if name not in level
        }
        # nan would spread to the others' derivatives
        names = [name for name, value in values.items() if np.isfinite(value)]
        point = {
            name: jnp.asarray(value, dtype=float)
            for name, value in self.study.point(vector).items()
        }
        _, pullback = jax.vjp(lambda point: self._last(point, path, names), point)
        rows = {
            name: _flat(pullback(row)[0], point)
            for name, row in zip(names, jnp.eye(len(names)), strict=True)
        }
        return np.array([rows.get(name, np.full(len(vector), np.nan)) for name in self.quantities])

    def _last(self, point, path, names):
        """Quantities ``names`` at the last state, a differentiable function of parameters.

        They are a dict. The sweep takes the values of ``path`` on its cloud; the last value is
        mu_end, if that is a parameter.
        """
        values = jnp.asarray(path.value)
        ends = [point[p["name"]] for p in self.study.parameters if p["of"] == "mu_end"]
        if ends and not self.study.case.sweep.back:
            values = values.at[-1].set(ends[0])
        model = self.study.case.discretisation.model(path.model.cloud)
        problem = problem_at(self.study, point, model)
        again = sweep_by_options(problem, self.study.case.sweep, values=values)
        return jnp.stack([QUANTITIES[name].function(again)[-1] for name in names])


def problem_at(study: MapStudy, point: Mapping, model: Model) -> Problem:
    """The `Problem` of a point, name -> value, which may be traced.

    Its plate lies on the cloud of the ``model``, placed.
    """
    case, parameters = study.case, study.parameters
    if any(p["holes"] for p in parameters):
        model = case.discretisation.model(model.cloud.at(plate_of(case.plate, parameters)(point)))
    gel = gel_of(case.gel, parameters)
    return problem_by_options(
        model, gel(point) if callable(gel) else gel, case.sweep, loads=case.loads.of(model)
    )


def derivative_columns(
    names: Sequence[str], quantities: Sequence[str] = RESPONSES
) -> dict[tuple[str, str], str]:
    """(quantity, component of a parameter) -> column of points.csv with its derivative."""
    return {(q, name): f"d_{QUANTITIES[q].column}_d_{name}" for q in quantities for name in names}


def _flat(cotangent: Mapping, point: Mapping) -> Float[np.ndarray, " d"]:
    """Components (d,) of a dict of parameters, in the order of ``point``."""
    return np.concatenate([np.ravel(cotangent[name]) for name in point])
