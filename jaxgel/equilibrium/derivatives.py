"""Refusal of derivatives: values that have first derivatives only, or none."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from .._primitives import primitive
from .._types import Array, Scalar


@functools.partial(jax.custom_jvp[Any], nondiff_argnums=(1,))
def first_order_only(values: Any, what: str) -> Any:  # noqa: ARG001
    """The ``values`` of ``what``.

    Used in a rule for tangents, ValueError if that is differentiated once more.
    """
    return values


@first_order_only.defjvp
def _refuse(what, *_):
    raise ValueError(f"{what}: has first derivatives only")


def without_derivatives(values: Any, inputs: Any, text: str) -> Any:
    """The ``values``, a pytree, without derivatives by the ``inputs``, a pytree.

    The reverse pass of a function that depends on a float among them is a ValueError with the
    ``text``, its tangents are nan: JAX would take them for constants. Comparisons, and what a
    derivative does not ask about, remain free.
    """
    return _without_derivatives(text, values, inputs)


@functools.partial(jax.custom_jvp[Any], nondiff_argnums=(0,))
def _without_derivatives(text, values, inputs):  # noqa: ARG001
    return values


@functools.partial(_without_derivatives.defjvp, symbolic_zeros=True)
def _without_derivatives_jvp(text, primals, tangents):
    values, dots = (
        primals[0],
        [dot for dot in jax.tree.leaves(tangents[1]) if not isinstance(dot, SymbolicZero)],
    )
    dots = [dot for dot in dots if dot.dtype != jax.dtypes.float0]
    return values, jax.tree.map(lambda value: no_tangents(value, dots, text), values)


def no_tangents(value: Array | Scalar, dots: list[Any], text: str) -> Any:
    """Tangents of a ``value`` that has no derivative by what changes with the tangents ``dots``.

    See `without_derivatives`.
    """
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
    jvp=lambda args, _, **parameters: (
        _undefined.bind(*args, **parameters),
        _undefined.bind(*args, **parameters),
    ),
    transpose=_refuse_reverse,
    batch=lambda args, _, **parameters: (_undefined.bind(*args, **parameters), None),
    several=False,
)
"""Tangents that do not exist, for those of the inputs."""
