"""Critical points of a branch and how they move with the design.

Derivative: lambda = v . K v = phi(x, theta, mu) with the modes normalised. Its change with theta at fixed x, and by the state's motion dx =
-K^-1 dr across the mode, is that of phi - w . r with K w = dphi/dx across the mode; the modes' own motion drops out. With Phi = phi - w . r
at fixed x, v, w, the critical value s of the control changes by ds = -(dPhi/dtheta) / (dPhi/ds). For a double eigenvalue phi is the sum
over both modes. At a fold Phi = v . r. A complex mode counts as two, its real and its imaginary part.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float
from ..continuation import Path, is_traced, values_of
from ..controls import Control, check_values, control_name, unit_of
from ..discretisation import Model
from ..equilibrium import first_order_only, without_derivatives
from ..materials import AnyGel
from ..mechanics import Problem, check_model, curvature, localised, residual
from .points import CriticalPoint
from .search import locate

Point = TypeVar("Point")


def critical_points(
    model: Model,
    gel: AnyGel,
    *,
    mu: tuple[float, float] | None = None,
    control: Control | None = None,
    values: tuple[float, float] | None = None,
    loads: Float[Array, "n 2"] | None = None,
    most: int = 4,
) -> list[CriticalPoint]:
    """``CriticalPoint``s of the branch that continues the dry state between ``mu = (first, last)``, or ``values`` of another ``control``.

    At most ``most``, in the order in which that way meets them; the last value may be below the first. They are located to
    ``search.TOLERANCE``; a fold where the branch turns back, if it does (on other branches: see ``folds``). ``point.value``, which is
    ``point.mu`` without another control, is differentiable once in everything the model, the gel and the control depend on, forward and
    reverse; derivatives for designs that break the symmetry are those of the perfect branch, for a double eigenvalue those of the mean.
    A change of stability whose point is not located is warned of (`PointNotLocated`). ValueError inside jit or vmap and for second
    derivatives.
    """
    check_model(model, gel)
    ends = ends_of(mu, control, values)
    loads = jnp.zeros((model.n_nodes, 2)) if loads is None else loads
    problem = Problem(model, localised(model, gel), loads, None, control)
    return located("critical_points", lambda problem: locate(problem, ends, most), problem)


def ends_of(mu: tuple[float, float] | None, control: Control | None, values: tuple[float, float] | None) -> tuple[float, float]:
    """First and last value of the control; ValueError, one line, for anything else."""
    name, ends = control_name(control), values_of(mu, control, values)
    check_values(ends, name, unit_of(control))
    if not (isinstance(ends, tuple) and len(ends) == 2):
        raise ValueError(f"{name}: {ends} is not accepted, it must be a tuple (first, last)")
    first, last = map(float, ends)
    return first, last


def located(
    name: str, find: Callable[[Any], list[Point]], of: Any, field: str = "value", tangent: Callable[..., Any] | None = None
) -> list[Point]:
    """The points that ``find(of)`` gives, with the value in a ``field`` that JAX differentiates once; errors speak of ``name``.

    ``of`` is a `Problem` whose points are like a `CriticalPoint`: with ``kind``, ``x``, ``modes`` and ``correction``. Or it is any pytree,
    and ``tangent(point, value, of, dots)`` () is that of a point's value for the tangents ``dots`` of it. The other floats of the points
    are `without_derivatives`.
    """
    if not is_traced(of):
        return find(of)
    search = _Search(name, find, field, tangent or _critical_tangent)
    leaves, structure = jax.tree.flatten(with_float_parameters(of) if isinstance(of, Problem) else of)
    values = _located(search, structure, leaves)
    points = without_derivatives_by(search.points, leaves, name, field)
    return [dataclasses.replace(point, **{field: value}) for point, value in zip(points, values, strict=True)]


def without_derivatives_by(results: Any, inputs: Any, name: str, field: str) -> Any:
    """Results of the function ``name`` whose floats have no derivatives by the ``inputs``, which the ``field`` of a result has."""
    text = f"{name}: only the {field} of a result has derivatives, its states, modes and other numbers have none"
    return with_floats(lambda values: without_derivatives(values, inputs, text), results)


def with_floats(change: Callable[[Any], Any], results: Any) -> Any:
    """Results with ``change(value)`` in place of each float and array of floats, also in lists, tuples and dataclasses.

    Models, gels and controls, and the ``value``s of a path, at which it was computed, stay.
    """
    if isinstance(results, list | tuple):
        return type(results)(with_floats(change, one) for one in results)
    if dataclasses.is_dataclass(results) and not isinstance(results, type):
        kept = ("model", "gel", "control", "value", *(["mu"] if results.control is None else [])) if isinstance(results, Path) else ()
        names = [one.name for one in dataclasses.fields(results) if one.name not in kept]
        return dataclasses.replace(results, **{name: with_floats(change, getattr(results, name)) for name in names})
    is_float = isinstance(results, float | np.floating | np.ndarray | jax.Array) and jnp.issubdtype(jnp.result_type(results), jnp.floating)
    return change(results) if is_float else results


def with_float_parameters(problem: Problem) -> Problem:
    """The problem with floating-point numbers in its gel and control, which have tangents."""
    gel, control = jax.tree.map(lambda v: jnp.asarray(v, dtype=float), (problem.gel, problem.control))
    return dataclasses.replace(problem, gel=gel, control=control)


def check_untraced(name: str, *inputs: Any) -> None:
    """Raise ValueError, one line, where a function without derivatives is differentiated, or is inside jit or vmap."""
    if is_traced(inputs):
        raise ValueError(f"{name}: has no derivatives, and is not available inside jit or vmap; differentiate sweep or critical_points")


@dataclasses.dataclass(frozen=True, eq=False)
class _Search:
    """What a traced search looks for, and the points it found: its result, but for the values, is on the host. Hashed by identity."""

    name: str
    find: Callable
    field: str
    tangent: Callable
    points: list = dataclasses.field(default_factory=list)

    @property
    def values(self):
        """Values of the points."""
        return [getattr(point, self.field) for point in self.points]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _located(search, structure, leaves):
    """The values (k,) of the points."""
    if is_traced(leaves):
        raise ValueError(f"{search.name}: is not available inside jit or vmap")
    search.points[:] = search.find(jax.tree.unflatten(structure, leaves))
    return jnp.array(search.values)


@_located.defjvp
def _located_jvp(search, structure, primals, tangents):
    values = first_order_only(_located(search, structure, *primals), search.name)
    of, dots = jax.tree.unflatten(structure, primals[0]), jax.tree.unflatten(structure, tangents[0])
    found = [search.tangent(point, value, of, dots) for point, value in zip(search.points, search.values, strict=True)]
    return values, jnp.stack(found) if found else jnp.zeros(0)


def _critical_tangent(point, value, problem, dots):
    return _onset_tangent(point.x, point.modes, point.correction, value, problem, dots, fold=point.kind == "fold")


@functools.partial(jax.jit, static_argnames="fold")
def _onset_tangent(x, modes, correction, value, problem, dots, *, fold):
    """Tangent () of a critical value: -(dPhi . dots) / (dPhi/dvalue) at fixed x, v, w; constrained nodes move with the dry plate."""

    def onset(problem, value):
        nodes, (now, mu) = problem.model.cloud.nodes, problem.at(value)
        at = problem.placed(x + problem.carried(nodes - jax.lax.stop_gradient(nodes), jax.lax.stop_gradient(value)), value)
        r = residual(at, now.model, now.gel, mu, now.loads)
        if fold:
            return jnp.sum(modes[0] * r)
        return sum(curvature(at, v, now.model, now.gel, mu, now.loads) for v in modes) - jnp.sum(correction * r)

    _, change = jax.jvp(lambda problem: onset(problem, value), (problem,), (dots,))
    return -change / jax.grad(onset, argnums=1)(problem, value)
