"""Critical points of a branch and how they move with the design.

Derivative: lambda = v . K v = phi(x, theta, mu) with the modes normalised. Its change with theta at
fixed x, and by the state's motion dx = -K^-1 dr across the mode, is that of phi - w . r with K w =
dphi/dx across the mode; the modes' own motion drops out. With Phi = phi - w . r at fixed x, v, w,
the critical value s of the control changes by ds = -(dPhi/dtheta) / (dPhi/ds). For a double
eigenvalue phi is the sum over both modes. At a fold Phi = v . r. A complex mode counts as two, its
real and its imaginary part.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._deprecated import old_arguments
from .._programs import fitted
from .._tracing import is_traced
from .._validation import check_kind
from ..continuation import STEP_CONTROL, Path, StepControl
from ..controls import check_values
from ..equilibrium import (
    NEWTON,
    UNOBSERVED,
    Newton,
    Observer,
    first_order_only,
    without_derivatives,
)
from ..mechanics import Problem, curvature, residual, shared_tangents, touching_tangents
from .points import CriticalPoint
from .search import locate

Point = TypeVar("Point")


@old_arguments
def critical_points(
    problem: Problem,
    between: tuple[float, float],
    *,
    most: int = 4,
    newton: Newton = NEWTON,
    steps: StepControl = STEP_CONTROL,
    observer: Observer = UNOBSERVED,
) -> list[CriticalPoint]:
    """`CriticalPoint`s, between two values of the control, of the branch from the dry state.

    Arguments:

    - `problem`: the `Problem`, with its control.
    - `between`: (first, last), values of the control in its unit; the last may be the lower one.
    - `most`: largest number of points, the first ones in the order from first to last.
    - `newton`, `steps`: tolerances and step control, as in `sweep`.
    - `observer`: functions called with the accepted states and with each located point.

    Returns a list of points, located to `search.TOLERANCE` (1e-9 of the control's scale). If the
    branch turns back, that fold is among them; `folds` gives those of other branches.
    `point.value`, equal to `point.mu` if the control is mu, is differentiable once in everything
    the problem depends on, forward and reverse. For designs that break the symmetry the derivatives
    are those of the perfect branch, for a double eigenvalue those of the mean.

    Raises `ValueError` inside `jax.jit` or `jax.vmap`, and for second derivatives. Warns
    (`PointNotLocated`) of a change of stability whose point is not located.

    Example: docs/howto/bifurcation.md.
    """
    ends, options = ends_of(problem, between), {"newton": newton, "steps": steps}
    return located(
        "critical_points", lambda problem: locate(problem, ends, most, observer, **options), problem
    )


def ends_of(problem: Problem, between: tuple[float, float]) -> tuple[float, float]:
    """First and last value of the control of a `Problem`.

    ValueError, one line, for anything else.
    """
    check_kind("problem", problem, Problem, "a Problem, as Problem(model, gel) makes it")
    ends = check_values(between, problem.control.name, problem.control.unit)
    if len(ends) != 2:
        raise ValueError(
            f"{problem.control.name}: {between} is not accepted, it must be two numbers (first, "
            "last)"
        )
    return float(ends[0]), float(ends[1])


def located(
    name: str,
    find: Callable[[Any], list[Point]],
    of: Any,
    field: str = "value",
    tangent: Callable[..., Any] | None = None,
) -> list[Point]:
    """The points that ``find(of)`` gives, their value in a ``field`` differentiable once by JAX.

    Errors speak of ``name``. ``of`` is a `Problem` whose points are like a `CriticalPoint`: with
    ``kind``, ``x``, ``modes`` and ``correction``. Or it is any pytree, and
    ``tangent(point, value, of, dots)`` () is that of a point's value for the tangents ``dots`` of
    it. The other floats of the points are `without_derivatives`.
    """
    if not is_traced(of):
        return find(of)
    search = _Search(name, find, field, tangent or _critical_tangent)
    leaves, structure = jax.tree.flatten(of)
    values = _located(search, structure, leaves)
    points = without_derivatives_by(search.points, leaves, name, field)
    found = [
        dataclasses.replace(point, **{field: value})
        for point, value in zip(points, values, strict=True)
    ]
    if not (isinstance(of, Problem) and field == "value"):
        return found
    return [dataclasses.replace(point, mu=of.at(point.value)[1]) for point in found]


def without_derivatives_by(results: Any, inputs: Any, name: str, field: str) -> Any:
    """Results of the function ``name`` whose floats have no derivatives by the ``inputs``.

    The ``field`` of a result has them.
    """
    text = (
        f"{name}: only the {field} of a result has derivatives, its states, modes and other "
        "numbers have none"
    )
    return with_floats(lambda values: without_derivatives(values, inputs, text), results)


def with_floats(change: Callable[[Any], Any], results: Any) -> Any:
    """Results with ``change(value)`` in place of each float and array of floats.

    Lists, tuples and dataclasses are entered. The problem of a path and the values of its control,
    at which it was computed, stay.
    """
    if isinstance(results, list | tuple):
        parts = [with_floats(change, one) for one in results]
        return type(results)(*parts) if hasattr(results, "_fields") else type(results)(parts)
    if dataclasses.is_dataclass(results) and not isinstance(results, type):
        kept = (
            ("problem", "value", *(["mu"] if results.control.name == "mu" else []))
            if isinstance(results, Path)
            else ()
        )
        names = [one.name for one in dataclasses.fields(results) if one.name not in kept]
        return dataclasses.replace(
            results, **{name: with_floats(change, getattr(results, name)) for name in names}
        )
    is_float = isinstance(results, float | np.floating | np.ndarray | jax.Array) and jnp.issubdtype(
        jnp.result_type(results), jnp.floating
    )
    return change(results) if is_float else results


def check_untraced(name: str, *inputs: Any) -> None:
    """Raise ValueError, one line, if a function without derivatives is differentiated.

    It cannot be inside jit or vmap either.
    """
    if is_traced(inputs):
        raise ValueError(
            f"{name}: has no derivatives, and is not available inside jit or vmap; differentiate "
            "sweep or critical_points"
        )


@dataclasses.dataclass(frozen=True, eq=False)
class _Search:
    """Subject of a traced search, and the points it found, on the host but for values.

    Hashed by identity.
    """

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
    found = [
        search.tangent(point, value, of, dots)
        for point, value in zip(search.points, search.values, strict=True)
    ]
    return values, jnp.stack(found) if found else jnp.zeros(0)


def _critical_tangent(point, value, problem, dots):
    problem, dots = touching_tangents(problem, dots, [point.x], [value])
    shared, dots = shared_tangents(problem, dots)
    fields = (
        fitted(point.x, "n", shared.lengths),
        fitted(point.modes, "mn", shared.lengths),
        fitted(point.correction, "n", shared.lengths),
    )
    return _onset_tangent(*fields, value, shared, dots, fold=point.kind == "fold")


@compiled(static=("fold",))
def _onset_tangent(x, modes, correction, value, problem, dots, *, fold):
    """Tangent () of a critical value: -(dPhi . dots) / (dPhi/dvalue) at fixed x, v, w.

    Constrained nodes move with the dry plate.
    """

    def onset(problem, value):
        nodes, (now, mu) = problem.model.nodes, problem.at(value)
        at = problem.placed(
            x + problem.carried(nodes - jax.lax.stop_gradient(nodes), jax.lax.stop_gradient(value)),
            value,
        )
        r = residual(at, now.model, now.gel, mu, now.loads)
        if fold:
            return jnp.sum(modes[0] * r)
        return sum(curvature(at, v, now.model, now.gel, mu, now.loads) for v in modes) - jnp.sum(
            correction * r
        )

    _, change = jax.jvp(lambda problem: onset(problem, value), (problem,), (dots,))
    return -change / jax.grad(onset, argnums=1)(problem, value)
