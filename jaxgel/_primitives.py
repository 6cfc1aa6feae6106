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
) -> Primitive:
    """A primitive called ``name`` with one result, or ``several`` in a list.

    Of its arguments and parameters ``value`` makes the results outside of ``jax.jit`` and
    ``traced`` inside, ``shapes`` their shapes; ``jvp(args, tangents, **parameters)`` results and
    tangents; ``transpose(cotangents, args, **parameters)`` the cotangents of the arguments in which
    it is linear, which are None among ``args``; ``batch`` is a rule of
    ``jax.interpreters.batching``, with None for what is not mapped. None stands for tangents and
    cotangents that are 0.
    """
    made = Primitive(name)
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
