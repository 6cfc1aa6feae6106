"""JAX primitives of jaxgel and their derivative rules; the only module with JAX's internals."""

import functools
from collections.abc import Callable
from typing import Any

import jax
from jax.core import Tracer
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

try:
    from jax._src import config, mesh

    UNSET = config.config_ext.unset
    MESH = (
        mesh if hasattr(mesh, "abstract_mesh_context_manager") else config
    ).abstract_mesh_context_manager
except (ImportError, AttributeError):  # a later version of JAX
    MESH = UNSET = None

try:
    from jax._src.util import weakref_cache_key_types
except ImportError:  # a later version of JAX
    weakref_cache_key_types = set()


class _Held:
    """A parameter of a primitive that JAX's caches hold weakly.

    JAX (0.10 to 0.12) keeps the parameters of the latest 2048 calls that it has traced: with them
    all that these hold, as the lists of a cloud or the states of a run, would stay in memory.
    """

    def __init__(self, value: Any) -> None:
        self.value = value

    def __hash__(self) -> int:
        return hash(self.value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Held) and self.value == other.value


weakref_cache_key_types.add(_Held)


class _Primitive(Primitive):
    """A primitive whose parameters are `_Held` in traces."""

    def bind(self, *args: Any, **parameters: Any) -> Any:
        held = {
            name: value if isinstance(value, _Held) else _Held(value)
            for name, value in parameters.items()
        }
        return super().bind(*args, **held)


def _with_values(rule):
    """The rule of a primitive with the values of its parameters."""

    @functools.wraps(rule)
    def call(*args: Any, **parameters: Any) -> Any:
        values = {
            name: held.value if isinstance(held, _Held) else held
            for name, held in parameters.items()
        }
        return rule(*args, **values)

    return call


def primitive(
    name: str,
    *,
    value: Callable,
    traced: Callable,
    shapes: Callable,
    jvp: Callable,
    transpose: Callable,
    batch: Callable,
    several: bool,
    remembered: bool = False,
) -> Primitive:
    """A primitive called ``name`` with one result, or ``several`` in a list.

    Of its arguments and parameters ``value`` makes the results outside of ``jax.jit`` and
    ``traced`` inside, ``shapes`` their shapes; ``jvp(args, tangents, **parameters)`` results and
    tangents; ``transpose(cotangents, args, **parameters)`` the cotangents of the arguments in which
    it is linear, which are None among ``args``; ``batch`` is a rule of
    ``jax.interpreters.batching``, with None for what is not mapped. None stands for tangents and
    cotangents that are 0. Shapes that take time are ``remembered``, with the parameters.
    """
    made = Primitive(name) if remembered else _Primitive(name)
    value, traced, shapes, jvp, transpose, batch = map(
        _with_values, (value, traced, shapes, jvp, transpose, batch)
    )
    made.multiple_results = several
    made.def_impl(_outside_of_reverse(value))
    made.def_abstract_eval(shapes)

    def tangents(primals: Any, dots: Any, **parameters: Any) -> tuple[Any, Any]:
        found, changes = jvp(
            primals, [None if type(dot) is ad.Zero else dot for dot in dots], **parameters
        )
        pairs = zip(found, changes, strict=True) if several else ((found, changes),)
        changes = [
            ad.Zero(jax.typeof(value).to_tangent_aval()) if change is None else change
            for value, change in pairs
        ]
        return found, changes if several else changes[0]

    def cotangents(given: Any, *args: Any, **parameters: Any) -> Any:
        given = (
            [None if type(one) is ad.Zero else one for one in given]
            if several
            else None
            if type(given) is ad.Zero
            else given
        )
        return transpose(
            given, [None if ad.is_undefined_primal(arg) else arg for arg in args], **parameters
        )

    ad.primitive_jvps[made] = tangents
    ad.primitive_transposes[made] = cotangents
    mlir.register_lowering(made, mlir.lower_fun(traced, multiple_results=several))
    batching.primitive_batchers[made] = batch
    return made


def _outside_of_reverse(value):
    """``value`` with the programs of plain calls in a reverse pass, too.

    There JAX (0.10 to 0.12) sets an empty mesh in place of none, and ``jax.jit`` compiles again for
    another mesh.
    """
    if MESH is None:
        return value

    @functools.wraps(value)
    def call(*args: Any, **parameters: Any) -> Any:
        before = MESH.swap_local(UNSET)
        try:
            return value(*args, **parameters)
        finally:
            MESH.set_local(before)

    return call


def differentiated_value(leaf: Any) -> Any:
    """The value that JAX differentiates: an array, or a tracer of another transformation."""
    while isinstance(leaf, Tracer) and hasattr(leaf, "primal"):
        leaf = leaf.primal
    return leaf
