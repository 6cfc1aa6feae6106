"""Rigid bodies that the gel meets without friction: half-planes, discs and lines.

Lengths in mm, in the coordinates of the plate. Parameters are the leaves of a pytree and may be
traced. A body is made of primitives, each a segment with a radius, or the boundary of a half-plane;
its gap to a point is the smallest of theirs.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float, Int, Scalar
from .._validation import Inadmissible
from .hole import checked_parameter, pytree

CORNERS = 128  # of a disc that is drawn


class Primitives(NamedTuple):
    """The primitives of all obstacles of a plate; a pytree."""

    start: Float[Array, "s 2"]
    """First end of each segment, or a point of the boundary of a half-plane."""
    end: Float[Array, "s 2"]
    """Second end."""
    radius: Float[Array, " s"]
    """Of the body around the segment."""
    normal: Float[Array, "s 2"]
    """Unit normal of a half-plane, towards the gel; 0 for segments."""
    owner: Int[Array, " s"]
    """The obstacle to which each belongs."""

    def moved(self, by: Mapping[int, Float[Array, " 2"]]) -> "Primitives":
        """The primitives with obstacles displaced ``by`` vectors, number -> (2,) mm."""
        step = sum(
            (self.owner == number)[:, None] * jnp.asarray(vector) for number, vector in by.items()
        )
        return self._replace(start=self.start + step, end=self.end + step)


def gap(point: Float[Array, " 2"], primitive: Primitives) -> Float[Array, ""]:
    """Gap () between a ``point`` (2,) and one of the `Primitives`, mm; negative inside."""
    along, away = primitive.end - primitive.start, point - primitive.start
    square = jnp.sum(along**2)
    share = jnp.clip(jnp.sum(away * along) / jnp.where(square > 0, square, 1.0), 0.0, 1.0)
    away = away - share * along
    distance = jnp.sqrt(jnp.where(jnp.any(away != 0), jnp.sum(away**2), 1.0)) * jnp.any(away != 0)
    return jnp.where(
        jnp.any(primitive.normal != 0),
        jnp.sum(primitive.normal * away),
        distance - primitive.radius,
    )


class Obstacle:
    """What all obstacles share.

    ValueError for a parameter that is no number or has another shape.
    """

    shapes: ClassVar[dict[str, tuple]] = {}

    def __post_init__(self) -> None:
        for name, shape in self.shapes.items():
            object.__setattr__(
                self,
                name,
                checked_parameter(getattr(self, name), shape, f"{type(self).__name__}.{name}"),
            )

    def primitives(self) -> tuple[Any, Any, Any, Any]:
        """The first four fields of its `Primitives`."""
        raise NotImplementedError

    def drawn(self, size: float) -> tuple[Float[np.ndarray, "m 2"], bool]:
        """Points (m, 2) of its boundary, and whether they enclose it.

        A half-plane is drawn up to a ``size``, mm, from the origin.
        """
        raise NotImplementedError


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class HalfPlane(Obstacle):
    """A rigid half plane, such as a wall or a flat punch; made by the user for a `Plate`."""

    point: Float[Array, "2"] | Sequence[Scalar]
    """A point of its straight boundary, mm."""
    normal: Float[Array, "2"] | Sequence[Scalar]
    """Normal of the boundary towards the gel, of any length."""
    shapes: ClassVar[dict[str, tuple]] = {"point": (2,), "normal": (2,)}

    def primitives(self) -> tuple[Any, Any, Any, Any]:
        """See `Obstacle`."""
        normal = self.normal / jnp.linalg.norm(self.normal)
        return self.point[None], self.point[None], np.zeros(1), normal[None]

    def drawn(self, size: float) -> tuple[Float[np.ndarray, "m 2"], bool]:
        """See `Obstacle`."""
        away = np.asarray(self.normal) / np.linalg.norm(self.normal)
        foot, along = np.dot(away, self.point) * away, size * np.array([-away[1], away[0]])
        return np.stack(
            [foot - along, foot + along, foot + along - size * away, foot - along - size * away]
        ), True


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Disc(Obstacle):
    """A rigid disc, such as a pin or a round punch; made by the user for a `Plate`."""

    centre: Float[Array, "2"] | Sequence[Scalar]
    """Centre, mm."""
    radius: Scalar
    """Radius, mm."""
    shapes: ClassVar[dict[str, tuple]] = {"centre": (2,), "radius": ()}

    def primitives(self) -> tuple[Any, Any, Any, Any]:
        """See `Obstacle`."""
        return self.centre[None], self.centre[None], jnp.reshape(self.radius, 1), np.zeros((1, 2))

    def drawn(self, size: float) -> tuple[Float[np.ndarray, "m 2"], bool]:  # noqa: ARG002
        """See `Obstacle`."""
        angle = np.linspace(0.0, 2 * np.pi, CORNERS, endpoint=False)
        return np.asarray(self.centre) + float(self.radius) * np.stack(
            [np.cos(angle), np.sin(angle)], axis=1
        ), True


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Polyline(Obstacle):
    """A rigid thin polyline, with the gel on either side; made by the user for a `Plate`."""

    points: Float[Array, "m 2"] | Sequence[Sequence[Scalar]]
    """Points of the line, mm, at least two."""
    shapes: ClassVar[dict[str, tuple]] = {"points": ("m", 2)}

    def primitives(self) -> tuple[Any, Any, Any, Any]:
        """See `Obstacle`."""
        pieces = len(self.points) - 1
        return self.points[:-1], self.points[1:], np.zeros(pieces), np.zeros((pieces, 2))

    def drawn(self, size: float) -> tuple[Float[np.ndarray, "m 2"], bool]:  # noqa: ARG002
        """See `Obstacle`."""
        return np.asarray(self.points), False


OBSTACLES: dict[str, type[Obstacle]] = {"half-plane": HalfPlane, "disc": Disc, "polyline": Polyline}


def primitives_of(obstacles: tuple[Obstacle, ...]) -> Primitives:
    """`Primitives` of all obstacles."""
    parts = [obstacle.primitives() for obstacle in obstacles]
    owner = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    empty = [(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)))]
    arrays = (
        jnp.concatenate([jnp.asarray(part, float) for part in column])
        for column in zip(*empty, *parts, strict=True)
    )
    return Primitives(*(arrays if parts else empty[0]), owner)


def checked_obstacles(obstacles: Any) -> tuple[Obstacle, ...]:
    """The obstacles as a tuple.

    ValueError, one line, for what is none and for sizes that cannot be used.
    """
    found = (obstacles,) if isinstance(obstacles, Obstacle) else tuple(obstacles)
    for k, one in enumerate(found):
        if not isinstance(one, Obstacle):
            raise ValueError(
                f"obstacles[{k}]: {one!r} is not an obstacle; give a HalfPlane, a Disc or a "
                "Polyline"
            )
        if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(one)):
            continue
        if isinstance(one, HalfPlane) and not np.any(np.asarray(one.normal)):
            raise Inadmissible(
                f"obstacles[{k}].normal: [0, 0] has no direction; give a vector towards the gel"
            )
        if isinstance(one, Disc) and not float(one.radius) > 0:
            raise Inadmissible(f"obstacles[{k}].radius: {float(one.radius):g} is not a length > 0")
        if isinstance(one, Polyline) and len(one.points) < 2:
            raise Inadmissible(f"obstacles[{k}].points: one point is not a line; give at least two")
    return found
