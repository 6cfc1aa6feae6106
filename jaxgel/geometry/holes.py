"""Kinds of holes: smooth closed outlines as functions of a few continuous parameters.

Lengths in mm, angles in radians. Every hole is a JAX pytree whose leaves are its parameters, which may be traced arrays. An
outline is a periodic function ``point(t)`` of t in [0, 1], anticlockwise, smooth between the ``corners``.
"""

import contextlib
import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np


def pytree(*, meta=()):
    """Register a dataclass as a JAX pytree whose fields named in ``meta`` are static.

    Unlike ``jax.tree_util.register_dataclass`` it rebuilds objects without calling the constructor, so that a constructor may
    convert and check what a person writes and never meets JAX's placeholder leaves.
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
    """What all holes share; a kind of hole adds its parameters as dataclass fields and the three functions below.

    Raises ValueError for a parameter that is no number or has the wrong shape. Values are checked by ``geometry.check_plate``.
    """

    shapes: ClassVar[dict] = {}
    """Parameter -> its shape; a letter stands for any length."""
    positive: ClassVar[tuple] = ()
    """Parameters that must be above zero."""

    def __post_init__(self):
        for name, shape in self.shapes.items():
            object.__setattr__(self, name, _parameter(getattr(self, name), shape, f"{type(self).__name__}.{name}"))

    @property
    def corners(self):
        """Static tuple of the t at which the outline has a kink."""
        return ()

    @property
    def theta(self):
        """The hole's parameters as a dict, name -> array."""
        return {name: getattr(self, name) for name in self.shapes}

    def point(self, t):
        """Point (2,) of the outline at t (); t and t + 1 are the same point."""
        raise NotImplementedError

    def excess(self, x):
        """How far outside the hole the point ``x`` (2,) lies, in mm; negative inside.

        Measured along the ray from the hole's centre, for straight-sided holes across the sides.
        """
        raise NotImplementedError

    def area(self):
        """Area enclosed by the outline, mm^2, whether or not the plate's edge cuts the hole."""
        raise NotImplementedError


class _Radial:
    """Outline in polar form about ``centre``, turned by ``angle`` where the kind has one."""

    centre: Any

    def radius_at(self, phi):
        """Distance of the outline from the centre, mm, at the polar angle ``phi`` () in the hole's own axes."""
        raise NotImplementedError

    def point(self, t):
        phi = 2 * jnp.pi * t
        return self.centre + self.radius_at(phi) * _direction(phi + self._turn)

    def excess(self, x):
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
    """A circle."""

    centre: Any
    """(2,) mm."""
    radius: Any
    """() mm."""

    shapes: ClassVar[dict] = {"centre": (2,), "radius": ()}
    positive: ClassVar[tuple] = ("radius",)

    def radius_at(self, phi):
        return self.radius + 0 * phi

    def area(self):
        return jnp.pi * self.radius**2


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Ellipse(_Radial, Hole):
    """An ellipse; t is the eccentric anomaly over 2 pi, so ``point(0)`` is the end of the first axis."""

    centre: Any
    """(2,) mm."""
    semi_axes: Any
    """(2,) half the lengths of the two axes, mm."""
    angle: Any = 0.0
    """() of the first axis to the x axis, rad."""

    shapes: ClassVar[dict] = {"centre": (2,), "semi_axes": (2,), "angle": ()}
    positive: ClassVar[tuple] = ("semi_axes",)

    def point(self, t):
        return self.centre + _rotation(self.angle) @ (self.semi_axes * _direction(2 * jnp.pi * t))

    def radius_at(self, phi):
        u = _direction(phi) / self.semi_axes
        return 1 / jnp.sqrt(u @ u)

    def area(self):
        return jnp.pi * self.semi_axes[0] * self.semi_axes[1]


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Superellipse(_Radial, Hole):
    """The curve |x/a|^n + |y/b|^n = 1 by its polar angle: n = 2 is the ellipse, a large n a rectangle with round corners."""

    centre: Any
    """(2,) mm."""
    semi_axes: Any
    """(2,) a and b, mm."""
    exponent: Any
    """() n, above 1 and at most 100."""
    angle: Any = 0.0
    """() of the first axis to the x axis, rad."""

    shapes: ClassVar[dict] = {"centre": (2,), "semi_axes": (2,), "exponent": (), "angle": ()}
    positive: ClassVar[tuple] = ("semi_axes", "exponent")

    def radius_at(self, phi):
        # lengths over sqrt(ab), so that the powers neither overflow nor vanish together
        a, n = jnp.sqrt(self.semi_axes[0] * self.semi_axes[1]), self.exponent
        u = jnp.abs(_direction(phi)) * (a / self.semi_axes)
        return a * (_power(u[0], n) + _power(u[1], n)) ** (-1 / n)

    def area(self):
        n, log_gamma = self.exponent, jax.scipy.special.gammaln
        return 4 * self.semi_axes[0] * self.semi_axes[1] * jnp.exp(2 * log_gamma(1 + 1 / n) - log_gamma(1 + 2 / n))


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Fourier(_Radial, Hole):
    """The outline r(phi) = radius (1 + sum_k cos_k cos k phi + sin_k sin k phi) with k = 2, 3, ..., m + 1.

    k = 1 is left out because to first order it only moves the centre; an angle is left out because cos and sin contain it.
    """

    centre: Any
    """(2,) mm."""
    radius: Any
    """() mean radius, mm."""
    cos: Any
    """(m,) coefficients of cos 2 phi, cos 3 phi, ..."""
    sin: Any
    """(m,) coefficients of sin 2 phi, sin 3 phi, ..."""

    shapes: ClassVar[dict] = {"centre": (2,), "radius": (), "cos": ("m",), "sin": ("m",)}
    positive: ClassVar[tuple] = ("radius",)

    def __post_init__(self):
        super().__post_init__()
        if self.cos.shape != self.sin.shape:
            raise ValueError(f"Fourier.cos, Fourier.sin: {len(self.cos)} and {len(self.sin)} coefficients; both must have the same number")

    def radius_at(self, phi):
        k = jnp.arange(2, len(self.cos) + 2)
        return self.radius * (1 + self.cos @ jnp.cos(k * phi) + self.sin @ jnp.sin(k * phi))

    def area(self):
        return jnp.pi * self.radius**2 * (1 + (self.cos @ self.cos + self.sin @ self.sin) / 2)


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Rectangle(Hole):
    """A rectangle; t = 0, 1/4, 1/2, 3/4 are its corners, from the lower left one on."""

    centre: Any
    """(2,) mm."""
    sides: Any
    """(2,) full lengths of the sides, mm."""
    angle: Any = 0.0
    """() of the first side to the x axis, rad."""

    shapes: ClassVar[dict] = {"centre": (2,), "sides": (2,), "angle": ()}
    positive: ClassVar[tuple] = ("sides",)

    @property
    def corners(self):
        return (0.0, 0.25, 0.5, 0.75)

    def point(self, t):
        vertices = jnp.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        return self.centre + _rotation(self.angle) @ (self.sides * _along(vertices, t))

    def excess(self, x):
        return jnp.max(jnp.abs(_rotation(self.angle).T @ (x - self.centre)) - self.sides / 2)

    def area(self):
        return self.sides[0] * self.sides[1]


@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Polygon(Hole):
    """A simple polygon, convex or not; t = k/n is vertex k."""

    vertices: Any
    """(n, 2) anticlockwise, mm, first one not repeated."""

    shapes: ClassVar[dict] = {"vertices": ("n", 2)}

    @property
    def corners(self):
        n = len(self.vertices)
        return tuple(k / n for k in range(n))

    def point(self, t):
        return _along(self.vertices, t)

    def excess(self, x):
        v, side = self.vertices, jnp.roll(self.vertices, -1, axis=0) - self.vertices
        d = x[None, :] - v
        fraction = jnp.clip(jnp.sum(d * side, axis=1) / jnp.sum(side**2, axis=1), 0.0, 1.0)
        distance = jnp.min(jnp.linalg.norm(d - fraction[:, None] * side, axis=1))
        # even-odd rule: sides that cross the ray from x to the right
        crosses = (d[:, 1] < 0) != (d[:, 1] < side[:, 1])
        right = d[:, 0] < d[:, 1] * side[:, 0] / jnp.where(crosses, side[:, 1], 1.0)
        return jnp.where(jnp.sum(crosses & right) % 2 == 1, -distance, distance)

    def area(self):
        x, y = self.vertices.T
        return jnp.sum(x * jnp.roll(y, -1) - y * jnp.roll(x, -1)) / 2


KINDS = {kind.__name__.lower(): kind for kind in (Circle, Ellipse, Superellipse, Fourier, Rectangle, Polygon)}
"""Name of each kind of hole, as written in a case file, and its class."""


def check_parameters(hole, name):
    """Raise ValueError, in one line that starts with the hole's ``name``, for concrete parameters out of their range."""
    for parameter, value in hole.theta.items():
        value = np.asarray(value)
        if not np.isfinite(value).all():
            raise ValueError(f"{name}.{parameter}: {value.tolist()} is not finite; give numbers")
        if parameter in hole.positive and not (value > 0).all():
            raise ValueError(f"{name}.{parameter}: {value.tolist()} is not positive; give values above 0")
    if isinstance(hole, Superellipse) and not 1 < hole.exponent <= 100:
        raise ValueError(f"{name}.exponent: {hole.exponent} is not in (1, 100]")
    if isinstance(hole, Polygon):
        sides = np.linalg.norm(hole.vertices - np.roll(hole.vertices, -1, axis=0), axis=1)
        if len(sides) < 3 or not (sides > 0).all():
            raise ValueError(f"{name}.vertices: {np.asarray(hole.vertices).tolist()} are not at least 3, each different from the next")


def _direction(phi):
    return jnp.stack([jnp.cos(phi), jnp.sin(phi)])


def _rotation(angle):
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])


def _power(u, n):
    """u^n for u >= 0 with finite derivatives at u = 0, all zero there."""
    positive = u > 0
    return jnp.where(positive, jnp.exp(n * jnp.log(jnp.where(positive, u, 1.0))), 0.0)


def _along(vertices, t):
    """Point (2,) at t of a closed polygon whose sides take equal shares of [0, 1]."""
    n = len(vertices)
    side = jnp.floor(n * t)
    fraction = n * t - side
    k = side.astype(int)
    return (1 - fraction) * vertices[k % n] + fraction * vertices[(k + 1) % n]


def _parameter(value, shape, name):
    """``value`` as a float array of ``shape``; ValueError otherwise."""
    if isinstance(value, (list, tuple, int, float, np.ndarray, np.generic)):
        with contextlib.suppress(TypeError, ValueError, OverflowError):  # a list that holds traced numbers, or no numbers at all
            value = np.asarray(value, dtype=float)
    try:
        array = value if _is_float(value) else jnp.asarray(value, dtype=float)  # converting a traced one takes time and does nothing
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name}: {value!r} is not {_shape_in_words(shape)}") from None
    if array.ndim != len(shape) or any(isinstance(n, int) and n != m for n, m in zip(shape, array.shape, strict=True)):
        raise ValueError(f"{name}: an array of shape {array.shape} is not {_shape_in_words(shape)}")
    return array


def _is_float(value):
    return isinstance(value, jax.Array) and value.dtype == jnp.float64


def _shape_in_words(shape):
    return "a number" if shape == () else f"an array of numbers of shape ({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"
