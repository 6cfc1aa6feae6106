"""Base class of holes: parameters as leaves of a pytree, outline, inside and area."""

import contextlib
import dataclasses
from collections.abc import Callable, Sequence
from typing import ClassVar, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._sizes import padded, resized, rung
from .._types import Array, Float, Scalar

C = TypeVar("C", bound=type)
LEAST = 64  # times a power of 2 points of an outline are computed together


def pytree(*, meta: Sequence[str] = ()) -> Callable[[C], C]:
    """Register a dataclass as a JAX pytree whose fields named in ``meta`` are static.

    Unlike ``jax.tree_util.register_dataclass`` it rebuilds objects without calling the constructor,
    so that a constructor may convert and check what a person writes and never meets JAX's
    placeholder leaves.
    """

    def register(cls):
        names = [field.name for field in dataclasses.fields(cls)]
        data = [name for name in names if name not in meta]

        def flatten_with_keys(self):
            leaves = [(jax.tree_util.GetAttrKey(name), getattr(self, name)) for name in data]
            return leaves, tuple(getattr(self, name) for name in meta)

        def unflatten(static, leaves):
            self = object.__new__(cls)
            for name, value in zip([*data, *meta], [*leaves, *static], strict=True):
                object.__setattr__(self, name, value)
            return self

        jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten)
        return cls

    return register


class Hole:
    """Base class of holes; a kind adds its parameters as fields and the three functions below.

    Raises ValueError for a parameter that is no number or has the wrong shape. Values are checked
    by ``check_plate``.
    """

    shapes: ClassVar[dict[str, tuple]] = {}
    """Parameter -> its shape; a letter stands for any length."""
    positive: ClassVar[tuple[str, ...]] = ()
    """Parameters that must be above zero."""

    def __post_init__(self) -> None:
        for name, shape in self.shapes.items():
            object.__setattr__(
                self,
                name,
                checked_parameter(getattr(self, name), shape, f"{type(self).__name__}.{name}"),
            )

    @property
    def corners(self) -> tuple[float, ...]:
        """The t at which the outline has a kink."""
        return ()

    @property
    def theta(self) -> dict[str, Array]:
        """The hole's parameters as a dict, name -> array."""
        return {name: getattr(self, name) for name in self.shapes}

    def translated(self, by: Float[Array, " 2"]) -> "Hole":
        """The hole translated ``by`` a vector (2,), mm.

        ValueError for a kind that has neither a ``centre`` nor ``vertices``.
        """
        place = next((name for name in ("centre", "vertices") if name in self.shapes), None)
        if place is None:
            raise ValueError(
                f"{type(self).__name__}: has no parameter 'centre' or 'vertices'; define "
                "translated(by) for it"
            )
        moved = {place: getattr(self, place) + by}
        return dataclasses.replace(self, **moved)  # pyright: ignore[reportArgumentType]

    def point(self, t: Scalar) -> Float[Array, "2"]:
        """Point of the outline at t; t and t + 1 are the same point."""
        raise NotImplementedError

    def excess(self, x: Float[Array, "2"]) -> Float[Array, ""]:
        """Signed distance of the point ``x`` from the hole, mm, along a ray; negative inside.

        Along the ray from its centre or across its sides.
        """
        raise NotImplementedError

    def area(self) -> Float[Array, ""]:
        """Area enclosed by the outline, mm^2, whether or not the plate's edge cuts the hole."""
        raise NotImplementedError


def checked_parameter(value: object, shape: tuple, name: str) -> Array:
    """``value`` as a float array of ``shape``; ValueError otherwise."""
    wanted = (
        "a number"
        if shape == ()
        else f"an array of numbers of shape ({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"
    )
    if isinstance(value, (list, tuple, int, float, np.ndarray, np.generic)):
        # a list that holds traced numbers, or no numbers at all
        with contextlib.suppress(TypeError, ValueError, OverflowError):
            value = np.asarray(value, dtype=float)
    # converting a traced one takes time and does nothing
    is_float = isinstance(value, jax.Array) and value.dtype == jnp.float64
    try:
        array = value if is_float else jnp.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name}: {value!r} is not {wanted}") from None
    if array.ndim != len(shape) or any(
        isinstance(n, int) and n != m for n, m in zip(shape, array.shape, strict=True)
    ):
        raise ValueError(f"{name}: an array of shape {array.shape} is not {wanted}")
    return array


def outline_points(hole: Hole, t: Float[Array, " m"]) -> Float[Array, "m 2"]:
    """Points (m, 2) of the outline at the parameters ``t`` (m,), mm.

    Few programs per kind of hole serve all numbers of points.
    """
    many = padded(t, LEAST * rung(-(-len(t) // LEAST), 1))
    return resized(_points(hole, many), (len(t), 2))


@compiled()
def _points(hole, t):
    return jax.vmap(hole.point)(t)
