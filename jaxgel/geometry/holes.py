"""Kinds of holes: smooth closed outlines as functions of a few continuous parameters.

Lengths in mm, angles in radians. Every hole is a JAX pytree whose leaves are its parameters, which
may be traced arrays. An outline is a periodic function ``point(t)`` of t in [0, 1], anticlockwise,
smooth between the ``corners``.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._types import Array, Float, Scalar
from .hole import Hole, pytree


class _Radial:
    """Outline in polar form about ``centre``, turned by ``angle`` if the kind has one.

    ``radius_at(phi)`` is its distance from the centre, mm, at the polar angle ``phi`` in the hole's
    own axes.
    """

    def point(self, t: Scalar) -> Float[Array, "2"]:
        phi = 2 * jnp.pi * t
        return self.centre + self.radius_at(phi) * _direction(phi + self._turn)

    def excess(self, x: Float[Array, "2"]) -> Float[Array, ""]:
        d = x - self.centre
        rho2 = d @ d
        rho = jnp.where(rho2 > 0, jnp.sqrt(jnp.where(rho2 > 0, rho2, 1.0)), 0.0)
        return rho - self.radius_at(jnp.arctan2(d[1], jnp.where(rho2 > 0, d[0], 1.0)) - self._turn)

    @property
    def _turn(self):
        return getattr(self, "angle", 0.0)


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Circle(_Radial, Hole):
    """A circular hole; the user makes it for a `Plate`."""

    centre: Float[Array, "2"] | Sequence[Scalar]
    """Centre, mm."""
    radius: Scalar
    """Radius, mm."""

    shapes: ClassVar[dict[str, tuple]] = {"centre": (2,), "radius": ()}
    positive: ClassVar[tuple[str, ...]] = ("radius",)

    def radius_at(self, phi: Scalar) -> Float[Array, ""]:
        return self.radius + 0 * phi

    def area(self) -> Float[Array, ""]:
        return jnp.pi * self.radius**2


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Ellipse(_Radial, Hole):
    """An elliptical hole; the user makes it for a `Plate`.

    t is the eccentric anomaly over 2 pi, so `point(0)` is the end of the first axis.
    """

    centre: Float[Array, "2"] | Sequence[Scalar]
    """Centre, mm."""
    semi_axes: Float[Array, "2"] | Sequence[Scalar]
    """Half the lengths of the two axes, mm."""
    angle: Scalar = 0.0
    """Angle of the first axis to the x axis, rad."""

    shapes: ClassVar[dict[str, tuple]] = {"centre": (2,), "semi_axes": (2,), "angle": ()}
    positive: ClassVar[tuple[str, ...]] = ("semi_axes",)

    def point(self, t: Scalar) -> Float[Array, "2"]:
        return self.centre + _rotation(self.angle) @ (self.semi_axes * _direction(2 * jnp.pi * t))

    def radius_at(self, phi: Scalar) -> Float[Array, ""]:
        u = _direction(phi) / self.semi_axes
        return 1 / jnp.sqrt(u @ u)

    def area(self) -> Float[Array, ""]:
        return jnp.pi * self.semi_axes[0] * self.semi_axes[1]


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Superellipse(_Radial, Hole):
    """A hole |x/a|^n + |y/b|^n = 1, by its polar angle; the user makes it for a `Plate`.

    n = 2 is the ellipse, a large n a rectangle with round corners.
    """

    centre: Float[Array, "2"] | Sequence[Scalar]
    """Centre, mm."""
    semi_axes: Float[Array, "2"] | Sequence[Scalar]
    """Semi-axes a and b, mm."""
    exponent: Scalar
    """Exponent n (), above 1 and at most 100."""
    angle: Scalar = 0.0
    """Angle of the first axis to the x axis, rad."""

    shapes: ClassVar[dict[str, tuple]] = {
        "centre": (2,),
        "semi_axes": (2,),
        "exponent": (),
        "angle": (),
    }
    positive: ClassVar[tuple[str, ...]] = ("semi_axes", "exponent")

    def radius_at(self, phi: Scalar) -> Float[Array, ""]:
        # lengths over sqrt(ab), so that the powers neither overflow nor vanish together
        a, n = jnp.sqrt(self.semi_axes[0] * self.semi_axes[1]), self.exponent
        u = jnp.abs(_direction(phi)) * (a / self.semi_axes)
        return a * (_power(u[0], n) + _power(u[1], n)) ** (-1 / n)

    def area(self) -> Float[Array, ""]:
        n, log_gamma = self.exponent, jax.scipy.special.gammaln
        return (
            4
            * self.semi_axes[0]
            * self.semi_axes[1]
            * jnp.exp(2 * log_gamma(1 + 1 / n) - log_gamma(1 + 2 / n))
        )


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Fourier(_Radial, Hole):
    """A hole with the outline r(phi) of a Fourier series; the user makes it for a `Plate`.

    r = radius (1 + sum_k cos_k cos k phi + sin_k sin k phi) with k = 2, 3, ..., m + 1. k = 1 is
    left out because to first order it only moves the centre; an angle is left out because cos and
    sin contain it.
    """

    centre: Float[Array, "2"] | Sequence[Scalar]
    """Centre, mm."""
    radius: Scalar
    """Mean radius, mm."""
    cos: Float[Array, " m"] | Sequence[Scalar]
    """Coefficients (m,) of cos 2 phi, cos 3 phi, ..., dimensionless."""
    sin: Float[Array, " m"] | Sequence[Scalar]
    """Coefficients (m,) of sin 2 phi, sin 3 phi, ..., dimensionless."""

    shapes: ClassVar[dict[str, tuple]] = {
        "centre": (2,),
        "radius": (),
        "cos": ("m",),
        "sin": ("m",),
    }
    positive: ClassVar[tuple[str, ...]] = ("radius",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cos.shape != self.sin.shape:
            raise ValueError(
                f"Fourier.cos, Fourier.sin: {len(self.cos)} and {len(self.sin)} coefficients; "
                "both must have the same number"
            )

    def radius_at(self, phi: Scalar) -> Float[Array, ""]:
        k = np.arange(2, len(self.cos) + 2)
        return self.radius * (1 + self.cos @ jnp.cos(k * phi) + self.sin @ jnp.sin(k * phi))

    def area(self) -> Float[Array, ""]:
        return jnp.pi * self.radius**2 * (1 + (self.cos @ self.cos + self.sin @ self.sin) / 2)


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Rectangle(Hole):
    """A rectangular hole; the user makes it for a `Plate`.

    t = 0, 1/4, 1/2, 3/4 are its corners, from the lower left one on.
    """

    centre: Float[Array, "2"] | Sequence[Scalar]
    """Centre, mm."""
    sides: Float[Array, "2"] | Sequence[Scalar]
    """Full lengths of the sides, mm."""
    angle: Scalar = 0.0
    """Angle of the first side to the x axis, rad."""

    shapes: ClassVar[dict[str, tuple]] = {"centre": (2,), "sides": (2,), "angle": ()}
    positive: ClassVar[tuple[str, ...]] = ("sides",)

    @property
    def corners(self) -> tuple[float, ...]:
        return (0.0, 0.25, 0.5, 0.75)

    def point(self, t: Scalar) -> Float[Array, "2"]:
        vertices = jnp.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        return self.centre + _rotation(self.angle) @ (self.sides * _along(vertices, t))

    def excess(self, x: Float[Array, "2"]) -> Float[Array, ""]:
        return jnp.max(jnp.abs(_rotation(self.angle).T @ (x - self.centre)) - self.sides / 2)

    def area(self) -> Float[Array, ""]:
        return self.sides[0] * self.sides[1]


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Polygon(Hole):
    """A polygonal hole without crossings, convex or not; the user makes it for a `Plate`.

    t = k/n is vertex k.
    """

    vertices: Float[Array, "n 2"] | Sequence[Sequence[Scalar]]
    """Vertices, anticlockwise, mm; the first one is not repeated."""

    shapes: ClassVar[dict[str, tuple]] = {"vertices": ("n", 2)}

    @property
    def corners(self) -> tuple[float, ...]:
        n = len(self.vertices)
        return tuple(k / n for k in range(n))

    def point(self, t: Scalar) -> Float[Array, "2"]:
        return _along(self.vertices, t)

    def excess(self, x: Float[Array, "2"]) -> Float[Array, ""]:
        v, side = self.vertices, jnp.roll(self.vertices, -1, axis=0) - self.vertices
        d = x[None, :] - v
        fraction = jnp.clip(jnp.sum(d * side, axis=1) / jnp.sum(side**2, axis=1), 0.0, 1.0)
        distance = jnp.min(jnp.linalg.norm(d - fraction[:, None] * side, axis=1))
        # even-odd rule: sides that cross the ray from x to the right
        # one comparison for both sides that meet in a vertex: differences would be rounded for each
        # by itself
        above = v[:, 1] > x[1]
        crosses = above != jnp.roll(above, -1)
        right = d[:, 0] < d[:, 1] * side[:, 0] / jnp.where(crosses, side[:, 1], 1.0)
        return jnp.where(jnp.sum(crosses & right) % 2 == 1, -distance, distance)

    def area(self) -> Float[Array, ""]:
        x, y = self.vertices.T
        return jnp.sum(x * jnp.roll(y, -1) - y * jnp.roll(x, -1)) / 2


KINDS: Mapping[str, type[Hole]] = {
    kind.__name__.lower(): kind
    for kind in (Circle, Ellipse, Rectangle, Superellipse, Fourier, Polygon)
}
"""Name of each kind of hole, as written in a case file, and its class."""


def _direction(phi):
    return jnp.stack([jnp.cos(phi), jnp.sin(phi)])


def _rotation(angle):
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])


def _power(u, n):
    """u^n for u >= 0 with finite derivatives at u = 0, all zero there."""
    positive = u > 0
    return jnp.where(positive, jnp.exp(n * jnp.log(jnp.where(positive, u, 1.0))), 0.0)


@compiled()
def _along(vertices, t):
    """Point (2,) at t of a closed polygon whose sides take equal shares of [0, 1]."""
    n = len(vertices)
    side = jnp.floor(n * t)
    fraction = n * t - side
    k = side.astype(int)
    return (1 - fraction) * vertices[k % n] + fraction * vertices[(k + 1) % n]
