"""Parameters that vary over the dry plate: printed gels.

A parameter of a gel is a number or a field: a function of the position X (2,), mm, that gives one
number, plain or with parameters of its own (any pytree with ``__call__``), in which everything that
follows is differentiable. On a model a field becomes arrays of its values, `LocalValues`, and
functions of the gel of one place are mapped over these by `elementwise`.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.ndimage import map_coordinates

from .._compiled import compiled
from .._types import Array, Float, Int


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class LocalValues:
    """A parameter of a gel on a model, see ``mechanics.localised``."""

    points: tuple
    """Per block (c, q) its values at the quadrature points."""
    groups: Float[Array, " g"]
    """In the volume groups."""
    outline: Float[Array, " p"]
    """At the outline vertices of the model, then at the nodes of the free edges."""


EDGE = 1e-9  # of a picture's size: points within this distance beyond its edge belong to it
Field = Callable[..., Any] | LocalValues | Array
"""A field parameter: a function of position, its values on a model, or an array of them."""


@functools.partial(
    jax.tree_util.register_dataclass, data_fields=["values"], meta_fields=["extent", "smooth"]
)
@dataclasses.dataclass(frozen=True, eq=False)
class PixelField:
    """A picture as a field over the dry plate; the user makes it, as a parameter of a gel.

    It is bilinear between the centres of its pixels, constant from the outermost ones to its edge,
    and nan beyond. A `smooth` one has no kinks: it is the sum of quadratic B-splines, one for each
    pixel, and keeps the picture's bounds. At the centre of a pixel it is a mean of that and its
    neighbours, 3/4 and 1/8 along each axis.

    >>> import jax.numpy as jnp
    >>> field = PixelField(jnp.array([[1.0, 3.0], [5.0, 5.0]]), extent=(-1.0, 1.0, -1.0, 1.0))
    >>> [float(field(jnp.array(at))) for at in ([-0.5, 0.5], [0.0, 0.5], [0.0, 0.0], [0.9, -0.9])]
    [1.0, 2.0, 3.5, 5.0]
    """

    values: Float[Array, "r c"]
    """Value of each pixel, in the unit of the parameter; the first row is the upper edge of the
    picture."""
    extent: tuple[float, float, float, float]
    """Left, right, lower and upper edge of the picture on the dry plate, mm."""
    smooth: bool = False
    """Whether its slope is continuous, and with it the derivative by a hole that moves under it."""

    def __call__(self, X: Float[Array, " 2"]) -> Float[Array, ""]:
        left, right, lower, upper = self.extent
        rows, columns = jnp.shape(self.values)
        along, down = (X[0] - left) / (right - left), (upper - X[1]) / (upper - lower)
        shares = jnp.stack([along, down])
        inside = jnp.where(jnp.all((shares >= -EDGE) & (shares <= 1 + EDGE)), 1.0, jnp.nan)
        at = [down * rows - 0.5, along * columns - 0.5]
        if self.smooth:
            (i, along_y), (j, along_x) = (
                _spline(u, count) for u, count in zip(at, (rows, columns), strict=True)
            )
            return inside * (
                along_y @ jnp.asarray(self.values, dtype=float)[i[:, None], j] @ along_x
            )
        return inside * map_coordinates(
            jnp.asarray(self.values, dtype=float), at, order=1, mode="nearest"
        )


@functools.partial(jax.tree_util.register_dataclass, data_fields=["field"], meta_fields=[])
@dataclasses.dataclass(frozen=True, eq=False)
class WithHoles:
    """A field that moves with the material if a design moves holes; the user makes it for a gel.

    It is evaluated at the position of a point on the reference cloud.
    """

    field: Callable
    """Function of the position X (2,), mm, on the plate whose cloud is moved."""

    def __call__(self, X: Float[Array, " 2"]) -> Float[Array, ""]:
        return self.field(X)


def values_at(field: Callable[..., Any], X: Float[Array, "p 2"]) -> Float[Array, " p"]:
    """Values (p,) of a field at positions ``X`` (p, 2), mm; those of a picture by one program."""
    picture = field.field if isinstance(field, WithHoles) else field
    return _of_picture(picture, X) if isinstance(picture, PixelField) else jax.vmap(field)(X)


@compiled()
def _of_picture(picture, X):
    return jax.vmap(picture)(X)


def _spline(u, count):
    """Numbers (3,) of the ``count`` points nearest ``u``, and quadratic B-spline values.

    These are the nearest of the points 0, 1 ... and its neighbours.
    """
    nearest = jnp.round(jax.lax.stop_gradient(u))
    d = u - nearest
    numbers = jnp.clip(nearest.astype(int) + jnp.arange(-1, 2), 0, count - 1)
    return numbers, jnp.stack([0.5 * (0.5 - d) ** 2, 0.75 - d**2, 0.5 * (0.5 + d) ** 2])


def named_parameters(gel: Any) -> dict[str, Any]:
    """The parameters of a gel by name."""
    entries, _ = jax.tree_util.tree_flatten_with_path(gel, is_leaf=lambda part: part is not gel)
    return {getattr(path[0], "name", str(path[0])): part for path, part in entries}


def fields_of(gel: Any) -> dict[str, Callable[..., Any]]:
    """The parameters of a gel that are fields, by name."""
    return {name: part for name, part in named_parameters(gel).items() if callable(part)}


def with_parameters(gel: Any, change: Callable[[Any], Any]) -> Any:
    """The gel with ``change(parameter)`` in place of each parameter."""
    return jax.tree.map(change, gel, is_leaf=lambda part: part is not gel)


def gel_at_points(gel: Any, block: int) -> Any:
    """The gel at the quadrature points (c, q) of a block, given by its number."""
    return _taken(gel, lambda local: local.points[block])


def gel_in_groups(gel: Any) -> Any:
    """The gel in the volume groups (g,)."""
    return _taken(gel, lambda local: local.groups)


def gel_on_outline(gel: Any, ends: Int[Array, "m 2"]) -> Any:
    """The gel on arcs between ``ends``, outline vertices or free-edge nodes: the mean of both.

    Nodes are numbered after the vertices.
    """
    return _taken(gel, lambda local: local.outline[ends].mean(axis=1))


def _taken(gel, values):
    return with_parameters(
        gel, lambda part: values(part) if isinstance(part, LocalValues) else part
    )


def varies(gel: Any) -> bool:
    """Whether a parameter of the gel is a field, or an array of its values."""
    return any(
        callable(part) or np.ndim(part) > 0 for part in jax.tree.leaves(gel, is_leaf=callable)
    )


def elementwise(
    function: Callable[..., Any],
    x: Float[Array, "..."],
    *parameters: Any,
    signature: str = "()->()",
) -> Float[Array, "..."]:
    """``function(x, *parameters)`` for every element of ``x`` with the parameters of its place.

    ``parameters`` are pytrees of numbers and of arrays that broadcast with the elements;
    ``signature`` says what an element is.
    """
    numbers, structure = jax.tree.flatten(
        jax.tree.map(lambda leaf: jnp.asarray(leaf, float), parameters)
    )
    element, result = signature.split("->")

    def of_place(x, *numbers):
        return function(x, *jax.tree.unflatten(structure, numbers))

    return jnp.vectorize(
        of_place, signature=f"{','.join([element] + ['()'] * len(numbers))}->{result}"
    )(jnp.asarray(x, float), *numbers)
