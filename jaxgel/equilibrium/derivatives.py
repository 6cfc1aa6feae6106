"""Rules for derivatives: of values found otherwise, and of values that have first ones only or none."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from .._compiled import compiled
from .._primitives import primitive


@functools.partial(jax.custom_jvp[Any], nondiff_argnums=(1,))
def first_order_only(values: Any, what: str) -> Any:  # noqa: ARG001
    """The ``values`` of ``what``; used in a rule for tangents, ValueError where that is differentiated once more."""
    return values


@first_order_only.defjvp
def _refuse(what, *_):
    raise ValueError(f"{what}: has first derivatives only")


@dataclasses.dataclass(frozen=True)
class Tangent:
    """Tangents of the values of ``function`` for its arguments and the tangents of those numbered ``which``."""

    function: object
    which: tuple

    def __call__(self, *args: jax.Array) -> Any:
        count = len(args) - len(self.which)
        fixed = args[:count]

        def values(*some):
            given = dict(zip(self.which, some, strict=True))
            return self.function(*(given.get(i, arg) for i, arg in enumerate(fixed)))

        return jax.jvp(values, [fixed[i] for i in self.which], list(args[count:]))[1]


@functools.partial(jax.custom_jvp[Any], nondiff_argnums=(0,))
def with_derivatives_of(function: Callable[..., Any], values: Any, *inputs: Any) -> Any:  # noqa: ARG001
    """The ``values`` of ``function(*inputs)``, found otherwise; what their derivatives need is computed where these are asked for."""
    return values


@functools.partial(with_derivatives_of.defjvp, symbolic_zeros=True)
def _with_derivatives_jvp(function, primals, tangents):
    (values, *inputs), (_, *inputs_dot) = primals, tangents
    leaves, structure = jax.tree.flatten(inputs)
    dots = jax.tree.leaves(inputs_dot)
    which = tuple(i for i, dot in enumerate(dots) if not isinstance(dot, SymbolicZero) and dot.dtype != jax.dtypes.float0)
    if not which:
        return values, jax.tree.map(SymbolicZero.from_primal_value, values)
    return values, remade(Tangent(_OfLeaves(function, structure), which), *leaves, *(dots[i] for i in which))


@dataclasses.dataclass(frozen=True)
class _OfLeaves:
    """``function`` of the leaves of its arguments."""

    function: object
    structure: object
    """Tree structure of the arguments."""

    def __call__(self, *leaves):
        return self.function(*jax.tree.unflatten(self.structure, leaves))


@compiled(static=("function",))
def remade(function: Callable[..., Any], *args: Any) -> Any:
    """Values of ``function`` by one program; only the arguments are kept for the reverse."""
    return jax.checkpoint(lambda *args: function(*args))(*args)


def without_derivatives(values: Any, inputs: Any, text: str) -> Any:
    """The ``values``, a pytree, as quantities of ``inputs``, a pytree, that have no derivatives by these.

    The reverse pass of a function that depends on a float among them is a ValueError with the ``text``, its tangents are nan: JAX would
    take them for constants. Comparisons, and what a derivative does not ask about, remain free.
    """
    return _without_derivatives(text, values, inputs)


@functools.partial(jax.custom_jvp[Any], nondiff_argnums=(0,))
def _without_derivatives(text, values, inputs):  # noqa: ARG001
    return values


@functools.partial(_without_derivatives.defjvp, symbolic_zeros=True)
def _without_derivatives_jvp(text, primals, tangents):
    values, dots = primals[0], [dot for dot in jax.tree.leaves(tangents[1]) if not isinstance(dot, SymbolicZero)]
    dots = [dot for dot in dots if dot.dtype != jax.dtypes.float0]
    return values, jax.tree.map(lambda value: no_tangents(value, dots, text), values)


def no_tangents(value: jax.Array, dots: list[jax.Array], text: str) -> Any:
    """Tangents of a ``value`` that has no derivative by what changes with the tangents ``dots``; see `without_derivatives`."""
    if not dots or not jnp.issubdtype(jnp.result_type(value), jnp.floating):
        return SymbolicZero.from_primal_value(value)
    return _undefined.bind(*dots, shape=jnp.shape(value), dtype=jnp.result_type(value), text=text)


def _refuse_reverse(*_, text, **__):
    raise ValueError(text)


def _nan(*_, shape, dtype, **__):
    return jnp.full(shape, jnp.nan, dtype)


_undefined = primitive(
    "undefined_tangents",
    value=_nan,
    traced=_nan,
    shapes=lambda *_, shape, dtype, **__: jax.core.ShapedArray(shape, dtype),
    jvp=lambda args, _, **parameters: (_undefined.bind(*args, **parameters), _undefined.bind(*args, **parameters)),
    transpose=_refuse_reverse,
    batch=lambda args, _, **parameters: (_undefined.bind(*args, **parameters), None),
    several=False,
)
"""Tangents that do not exist, for those of the inputs."""
