"""One function of many equal parts of its arguments, called for them side by side in threads, and so are its derivatives.

On the CPU the programs that one Python thread starts run one after another, and those of several threads at once. JAX's derivatives of
such calls would be back in one thread, so `over_parts` is a primitive of its own, with rules for tangents, transposition and batches: a
derivative of the parts is a function of the parts.
"""

import dataclasses
import functools
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from ._threads import usable_threads

PROGRAMS = 256  # functions of parts, of some shapes, whose programs are kept


def over_parts(function, args, shared=(), *, linear=(), shared_linear=()):
    """Values (k, ...), a list, of ``function(*part, *shared)`` for the ``k`` parts that the arrays ``args`` (k, ...) have as rows.

    The function takes arrays and gives a list of arrays; it is compiled once for all parts, and for all functions that equal it, so it must
    be hashable: one of a module, or a frozen dataclass that can be called. Differentiable by all arguments of floating type. More
    arguments in which it is linear may follow: first ``linear`` (k, ...), then ``shared_linear``. A part with zeros for all of them has
    zeros as its values, at no cost. Parts that share arguments are called one by one: what such a derivative sums is added up in place.
    """
    groups = args, shared, linear, shared_linear
    whole = [w for group, w in zip(groups, (False, True, False, True), strict=True) for _ in group]
    args = [arg if isinstance(arg, jax.Array) else jnp.asarray(arg) for group in groups for arg in group]
    summed = (False,) * len(_values(function, _of_part(args, whole)))
    return _parts.bind(*args, function=function, whole=tuple(whole), summed=summed, linear=len(linear) + len(shared_linear))


_parts = Primitive("over_parts")
"""``function`` of the rows of the arguments that are not ``whole``. Its values are rows too, or ``summed`` over the parts where that flag
is set; it is linear in the last arguments, ``linear`` of them."""
_parts.multiple_results = True


@dataclasses.dataclass(frozen=True)
class Tangent:
    """Tangents of the values of ``function`` for its arguments and the tangents of those numbered ``which``."""

    function: object
    which: tuple

    def __call__(self, *args):
        count = len(args) - len(self.which)
        fixed = args[:count]

        def values(*some):
            known = dict(zip(self.which, some, strict=True))
            return self.function(*(known.get(i, arg) for i, arg in enumerate(fixed)))

        return jax.jvp(values, [fixed[i] for i in self.which], list(args[count:]))[1]


@dataclasses.dataclass(frozen=True)
class _Transposed:
    """Cotangents of the last arguments of ``function``, of these ``shapes``, that are numbered ``which`` among them.

    It is called with the other arguments and the cotangents of the values numbered ``values``, and linear in these.
    """

    function: object
    shapes: tuple
    which: tuple
    values: tuple

    def __call__(self, *args):
        others, cotangents = args[: len(args) - len(self.values)], list(args[len(args) - len(self.values) :])

        def linear(*some):
            known = dict(zip(self.which, some, strict=True))
            last = (known[i] if i in known else jnp.zeros(s.shape, s.dtype) for i, s in enumerate(self.shapes))
            found = self.function(*others, *last)
            return [found[i] for i in self.values]

        return list(jax.linear_transpose(linear, *(self.shapes[i] for i in self.which))(cotangents))


@dataclasses.dataclass(frozen=True)
class _Batched:
    """``function`` of batches of the arguments that have an axis in ``axes``."""

    function: object
    axes: tuple

    def __call__(self, *args):
        return jax.vmap(self.function, self.axes)(*args)


@_parts.def_impl
def _evaluated(*args, function, whole, summed, linear):
    """With values, on the CPU: in threads, or one by one. Parts with zeros for what the function is linear in cost nothing."""
    if jax.default_backend() != "cpu":
        return _one_program(*args, function=function, whole=whole, summed=summed)
    shapes = _of_part(args, whole)
    program, (sums, values) = _program(function, summed, shapes), _split(_values(function, shapes), summed)
    totals, number = _zeros(tuple(sums)), len(next(arg for arg, w in zip(args, whole, strict=True) if not w))
    stacked = [np.zeros((number, *v.shape), v.dtype) for v in values]
    args = [arg if w else np.asarray(arg) for arg, w in zip(args, whole, strict=True)]

    def call(k, totals=()):
        part = [arg if w else arg[k] for arg, w in zip(args, whole, strict=True)]
        if linear and not any(np.any(arg) for arg in part[-linear:]):
            return totals
        totals, found = program(list(totals), *part)
        for value, own in zip(stacked, found, strict=True):
            value[k] = own
        return totals

    if any(whole):
        for k in range(number):
            totals = call(k, totals)
    else:
        with ThreadPoolExecutor(usable_threads()) as pool:
            list(pool.map(call, range(number)))
    return _merged(totals, map(jnp.asarray, stacked), summed)


def _in_one_program(*args, function, whole, summed, linear=0):  # noqa: ARG001
    """Inside jit, and on devices that are no CPU: one part after the other."""
    rows = [arg for arg, w in zip(args, whole, strict=True) if not w]

    def add(totals, rows):
        rows = iter(rows)
        return _added(function, summed, totals, *(arg if w else next(rows) for arg, w in zip(args, whole, strict=True)))

    sums, _ = _split(_values(function, _of_part(args, whole)), summed)
    return _merged(*lax.scan(add, _zeros(tuple(sums)), rows), summed)


_one_program = jax.jit(_in_one_program, static_argnames=("function", "whole", "summed"))


def _added(function, summed, totals, *part):
    """The ``totals`` with those values of ``function`` of a part added that are ``summed``, and the other values."""
    own, others = _split(_called(function, *part), summed)  # traced once, for its shapes too
    return list(map(jnp.add, totals, own)), others


def _split(values, summed):
    """Those of the values that are ``summed``, and the others."""
    pairs = list(zip(values, summed, strict=True))
    return [v for v, s in pairs if s], [v for v, s in pairs if not s]


@functools.partial(jax.jit, static_argnums=0)
def _zeros(shapes):
    return [jnp.zeros(s.shape, s.dtype) for s in shapes]


def _merged(totals, stacked, summed):
    totals, stacked = iter(totals), iter(stacked)
    return [next(totals) if s else next(stacked) for s in summed]


_added_in_place = jax.jit(_added, static_argnums=(0, 1), donate_argnums=2)


@functools.lru_cache(PROGRAMS)
def _program(function, summed, shapes):
    """Compiled `_added` for parts of these ``shapes``."""
    return _added_in_place.lower(function, summed, _split(_values(function, shapes), summed)[0], *shapes).compile()


@functools.partial(jax.jit, static_argnums=0)
def _called(function, *args):
    return function(*args)


@functools.lru_cache(PROGRAMS)
def _values(function, shapes):
    """Shapes of the values of ``function``."""
    return _called.eval_shape(function, *shapes)


def _shapes(args):
    return tuple(jax.ShapeDtypeStruct(arg.shape, arg.dtype) for arg in args)


def _of_part(args, whole):
    """Shapes of the arguments of one part."""
    return tuple(s if w else s.update(shape=s.shape[1:]) for s, w in zip(_shapes(args), whole, strict=True))


@_parts.def_abstract_eval
def _abstract(*args, function, whole, summed, linear):  # noqa: ARG001
    number = next(arg.shape[0] for arg, w in zip(args, whole, strict=True) if not w)
    shapes = _values(function, _of_part(args, whole))
    return [jax.core.ShapedArray(v.shape if s else (number, *v.shape), v.dtype) for v, s in zip(shapes, summed, strict=True)]


def _jvp(primals, tangents, *, function, whole, summed, **others):
    which = tuple(i for i, tangent in enumerate(tangents) if type(tangent) is not ad.Zero)
    own = dict(whole=whole + tuple(whole[i] for i in which), summed=summed, linear=len(which))
    values = _parts.bind(*primals, function=function, whole=whole, summed=summed, **others)
    return values, _parts.bind(*primals, *(tangents[i] for i in which), function=Tangent(function, which), **own)


def _transpose(cotangents, *args, function, whole, summed, linear):
    others, last = args[: len(args) - linear], args[len(args) - linear :]
    which = tuple(i for i, arg in enumerate(last) if ad.is_undefined_primal(arg))
    values = tuple(i for i, cotangent in enumerate(cotangents) if type(cotangent) is not ad.Zero)
    if not values:
        return [None] * len(others) + [ad.Zero(arg.aval) if ad.is_undefined_primal(arg) else None for arg in last]
    shapes = _of_part([arg.aval if ad.is_undefined_primal(arg) else arg for arg in last], whole[len(others) :])
    own = dict(whole=whole[: len(others)] + tuple(summed[i] for i in values), summed=tuple(whole[len(others) + i] for i in which))
    made = _Transposed(function, shapes, which, values)
    found = iter(_parts.bind(*others, *(cotangents[i] for i in values), function=made, linear=len(values), **own))
    return [None] * len(others) + [next(found) if i in which else None for i in range(linear)]


def _batch(args, axes, *, function, whole, summed, **others):
    mapped = [axis is not batching.not_mapped for axis in axes]
    moved = [jnp.moveaxis(arg, a, 0 if w else 1) if m else arg for arg, a, w, m in zip(args, axes, whole, mapped, strict=True)]
    batched = _Batched(function, tuple(0 if m else None for m in mapped))
    return _parts.bind(*moved, function=batched, whole=whole, summed=summed, **others), [0 if s else 1 for s in summed]


ad.primitive_jvps[_parts] = _jvp
ad.primitive_transposes[_parts] = _transpose
batching.primitive_batchers[_parts] = _batch
mlir.register_lowering(_parts, mlir.lower_fun(_in_one_program, multiple_results=True))
