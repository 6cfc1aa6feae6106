"""``jax.jit`` of jaxgel's functions and their derivatives, with programs that can be kept.

Under JAX's transformations a function is a primitive of flat arrays: its tangents, and the reverse
of these, are functions of flat arrays again, with programs of their own. They remember the
arguments only and evaluate the function anew, so that its values are those of one program,
differentiated or not; JAX would compile them once more, with all that their reverse needs.
"""

import dataclasses
import functools
import hashlib
import inspect
import itertools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from ._described import NotDescribed, described
from ._kept import KEPT
from ._primitives import differentiated_value, primitive
from ._tracing import is_traced

P = ParamSpec("P")
R = TypeVar("R")


def compiled(*, static: tuple[str, ...] = ()) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorator: ``jax.jit`` of a function of jaxgel with hashable ``static`` arguments.

    If programs are kept (`keep_programs`), calls load them, or compile and keep them, for arrays of
    these shapes and types; Python numbers count as arrays. So do derivatives. In the trace of
    another program it is ``jax.jit`` alone. What depends on a function or class that is not
    jaxgel's is not kept.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        jitted = jax.jit(function, static_argnames=static)
        PROGRAMS.jitted.append(jitted)
        names = list(inspect.signature(function).parameters)
        places = sorted(names.index(name) for name in static)

        @functools.wraps(function)
        def call(*args: Any, **options: Any) -> Any:
            # else a program for numbers of Python and another one for those of arrays
            args = tuple([np.float64(arg) if type(arg) is float else arg for arg in args])
            for name, arg in options.items():
                options[name] = np.float64(arg) if type(arg) is float else arg
            if not (are_kept() or is_traced((args, options))) or jax.config.jax_disable_jit:
                return jitted(*args, **options)
            fixed = [(place, args[place]) for place in places if place < len(args)]
            fixed += [(name, options[name]) for name in static if name in options]
            moving = [arg for place, arg in enumerate(args) if place not in places]
            leaves, structure = jax.tree.flatten(
                (moving, {name: options[name] for name in options if name not in static})
            )
            flat = _Call(function, structure, tuple(fixed), jitted)
            if is_traced(leaves):
                at = [differentiated_value(leaf) for leaf in leaves]
                if is_traced(at):
                    return jitted(*args, **options)
                result = PROGRAMS.of(flat, at)[1] if are_kept() else None
                values, result = (
                    _results(flat, leaves),
                    result or jax.tree.structure(jitted.eval_shape(*args, **options)),
                )
            else:
                values, result = PROGRAMS.run(flat, leaves)
            return (
                jitted(*args, **options) if values is None else jax.tree.unflatten(result, values)
            )

        return call

    return decorate


@dataclasses.dataclass(frozen=True)
class _Call:
    """A function as one of flat arrays."""

    function: Callable
    structure: Any
    """Tree structure of its arguments in place and by name, without static ones."""
    fixed: tuple
    """Places or names and values of the static ones."""
    jitted: Callable = dataclasses.field(compare=False)
    """``jax.jit`` of the function."""

    def of(self, function, leaves):
        """Results of ``function``, this one or its program, as they are."""
        args, options = jax.tree.unflatten(self.structure, leaves)
        for place, value in self.fixed:
            if isinstance(place, int):
                args.insert(place, value)
            else:
                options[place] = value
        return function(*args, **options)

    def __call__(self, *leaves):
        return jax.tree.leaves(self.of(self.function, leaves))

    def compiled(self, *leaves):
        """The same by the program."""
        return jax.tree.leaves(self.of(self.jitted, leaves))


class Programs:
    """Compiled programs of this process, and functions of flat arrays loaded or made to be kept."""

    def __init__(self) -> None:
        self.jitted, self._latest, self._by_shapes = [], {}, {}

    def forget_kept(self) -> None:
        """Release those of flat arrays."""
        self._latest.clear()
        self._by_shapes.clear()

    def release(self) -> None:
        """Release all; those still needed are loaded or compiled again at their next call."""
        self.forget_kept()
        for jitted in (*self.jitted, _jitted):
            jitted.clear_cache()

    def run(self, function: Any, leaves: list) -> tuple[list | None, Any]:
        """The results of ``function`` and their structure; None if it is left to ``jax.jit``."""
        program, result = self._latest.get(function) or self.of(function, leaves)
        try:
            return None if program is None else program(*leaves), result
        # other shapes than those of the latest call, to compare which takes as long as a small
        # program
        except TypeError:
            program, result = self.of(function, leaves)
            return None if program is None else program(*leaves), result

    def of(self, function: Any, leaves: list) -> tuple[Callable[..., list] | None, Any]:
        """The program of ``function`` for the shapes of ``leaves``, and the structure of results.

        None if it is left to ``jax.jit``.
        """
        shapes = tuple([(leaf.shape, leaf.dtype) for leaf in map(jax.typeof, leaves)])
        found = self._by_shapes.get((function, shapes))
        if found is None:
            found = self._by_shapes[function, shapes] = _loaded(function, shapes)
        self._latest[function] = found
        return found


PROGRAMS = Programs()
"""Those of this process."""


def are_kept() -> bool:
    """Whether this process keeps programs."""
    return KEPT.root is not None and not (jax.config.jax_debug_nans or jax.config.jax_debug_infs)


def _loaded(function, shapes):
    try:
        text = described((function, tuple((shape, str(dtype)) for shape, dtype in shapes)))
    except NotDescribed:
        return None, None
    name = f"{_name(function)}-{hashlib.sha256(text.encode()).hexdigest()[:32]}"
    return KEPT.load(name) or (
        _made(name, function, shapes) if KEPT.accepts(name) else (None, None)
    )


def _name(function):
    if isinstance(function, _Derivative):
        return f"{_name(function.function)}{function.suffix}"
    return function.function.__name__ if isinstance(function, _Call) else type(function).__name__


def _made(name, function, shapes):
    result = None

    def flat(*leaves):
        nonlocal result
        values, result = jax.tree.flatten(
            function.of(function.function, leaves)
            if isinstance(function, _Call)
            else function(*leaves)
        )
        return values

    flat.__name__ = _name(function)
    lowered = jax.jit(flat).lower(*(jax.ShapeDtypeStruct(*shape) for shape in shapes))
    return KEPT.saved(name, lowered, result), result


# --- derivatives ----------------------------------------------------------------------------------


class _Derivative:
    """Functions of flat arrays that are compiled as they are."""

    def compiled(self, *args):
        """Their results by one program."""
        return _jitted(self, *args)


@dataclasses.dataclass(frozen=True)
class _Tangent(_Derivative):
    """Tangents of the results of floating type for tangents of the arguments ``which``.

    These follow the arguments.
    """

    function: Any
    which: tuple
    suffix = "_tangent"

    def __call__(self, *args):
        count = len(args) - len(self.which)
        values, at = _of_some(self.function, args[:count], self.which)
        return jax.jvp(values, at, args[count:])[1]


@dataclasses.dataclass(frozen=True)
class _Reverse(_Derivative):
    """Cotangents of the arguments numbered ``which``, for those of results of floating type.

    The arguments come first, then the cotangents.
    """

    function: Any
    which: tuple
    count: int
    """Number of arguments."""
    asked: tuple
    """For each result of floating type whether it has a cotangent."""
    suffix = "_reverse"

    def __call__(self, *args):
        values, at = _of_some(self.function, args[: self.count], self.which)
        return list(
            jax.vjp(lambda *at: list(itertools.compress(values(*at), self.asked)), *at)[1](
                list(args[self.count :])
            )
        )


def _of_some(function, args, which):
    """The results of floating type as a function of the arguments numbered ``which``, and these."""

    def values(*some):
        given = dict(zip(which, some, strict=True))
        return [
            value
            for value in function(*(given.get(i, arg) for i, arg in enumerate(args)))
            if _is_floating(value)
        ]

    return values, tuple(args[i] for i in which)


def tangents(function: Callable[..., Any], args: Any, dots: Any, values: Any) -> list:
    """Tangents of the ``values`` of floating type of a ``function`` of flat arrays.

    Found by a program of their own. The ``function`` is hashable and returns a list; None stands
    for tangents ``dots`` of its ``args`` that are 0.
    """
    which = tuple(i for i, dot in enumerate(dots) if dot is not None)
    shapes = tuple(jax.ShapeDtypeStruct(value.shape, value.dtype) for value in values)
    return (
        _results(_Tangent(function, which), [*args, *(dots[i] for i in which)], shapes)
        if shapes
        else []
    )


def _is_floating(value):
    return jnp.issubdtype(value.dtype, jnp.inexact)


def _results(function, leaves, shapes=None):
    """The results of a function of flat arrays, with these ``shapes`` and types if known."""
    inputs = tuple(jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in map(jax.typeof, leaves))
    return flat_call.bind(*leaves, function=function, inputs=inputs, shapes=shapes)


def _value(*args, function, **_):
    values = PROGRAMS.run(function, args)[0] if are_kept() else None
    return function.compiled(*args) if values is None else values


@functools.partial(jax.jit, static_argnums=0)
def _jitted(function, *args):
    return function(*args)


def _shapes(*_, function, inputs, shapes):
    shapes = jax.eval_shape(function, *inputs) if shapes is None else shapes
    return [jax.core.ShapedArray(value.shape, value.dtype) for value in shapes]


def _jvp(args, dots, *, function, **_):
    values = _results(function, args)
    changes = iter(tangents(function, args, dots, filter(_is_floating, values)))
    return values, [next(changes) if _is_floating(value) else None for value in values]


def _transpose(cotangents, args, *, function, inputs, shapes):
    """Transposition by the tangents, the last arguments, in which alone a function is linear."""
    asked = tuple(one is not None for one in cotangents)
    if not any(asked):
        return [None] * len(args)
    count = len(args) - len(function.which)
    numbers = [number for number, arg in enumerate(args) if arg is None]
    which, shapes = (
        tuple(function.which[number - count] for number in numbers),
        tuple(inputs[number] for number in numbers),
    )
    reverse = _Reverse(function.function, which, count, asked)
    found = iter(_results(reverse, [*args[:count], *itertools.compress(cotangents, asked)], shapes))
    return [next(found) if arg is None else None for arg in args]


def _batch(args, axes, *, function, **_):
    found = jax.vmap(functools.partial(_jitted, function), axes)(*args)
    return found, [0] * len(found)


flat_call = primitive(
    "compiled",
    value=_value,
    traced=lambda *args, function, **_: function(*args),
    shapes=_shapes,
    jvp=_jvp,
    transpose=_transpose,
    batch=_batch,
    several=True,
    remembered=True,
)
"""The results of a ``function`` of flat arrays, see `_results`."""
