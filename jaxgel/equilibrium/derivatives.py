"""Rules for tangents: of values that were found otherwise, and of values that have first derivatives only."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
from jax.custom_derivatives import SymbolicZero


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


@functools.partial(jax.jit, static_argnums=0)
def remade(function: Callable[..., Any], *args: Any) -> Any:
    """Values of ``function`` by one program; only the arguments are kept for the reverse."""
    return jax.checkpoint(lambda *args: function(*args))(*args)
