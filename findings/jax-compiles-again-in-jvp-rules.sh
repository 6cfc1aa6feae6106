#!/usr/bin/env bash
# JAX 0.10.1 (and 0.12.0.1): a compiled function that a jvp rule calls is compiled a second time under jax.vjp and jax.grad.
#
# A rule of jax.custom_jvp returns the value f(x), found by a function g = jax.jit(...) that has run before with an array of the same shape
# and type. Under jax.jvp the program of g serves again. Under jax.vjp, and so jax.grad, JAX compiles g once more, although the rule calls
# it with a concrete array: the primal of the rule is traced by linearisation, where a call of g does not reach the programs of plain calls.
# For large functions that doubles the compilation of values. A rule that reaches g as the implementation of a primitive of its own (bound in
# the rule) takes the first program. Seen: "compiled under jvp 0, under vjp 1, by way of a primitive 0".
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet "jax==0.10.1" "jaxlib==0.10.1"
JAX_PLATFORMS=cpu "$work/venv/bin/python" - <<'PY'
import jax
import jax.numpy as jnp
from jax import monitoring
from jax.extend.core import Primitive
from jax.interpreters import ad

compiled = []


def hear(event, *_, fun_name="", **__):
    if event.endswith("backend_compile_duration"):
        compiled.append(fun_name)


monitoring.register_event_time_span_listener(hear)


def of_rule(value):
    """How often g is compiled under jvp and vjp of a function whose rule finds its value by ``value(g)``."""

    def g(x):
        return 2.0 * jnp.sin(x)

    g = jax.jit(g)
    find = value(g)
    f = jax.custom_jvp(find)
    f.defjvp(lambda primals, tangents: (find(*primals), 3.0 * tangents[0]))
    x, counts = jnp.ones(3), []
    g(x)
    for transform in (lambda: jax.jvp(f, (x,), (x,)), lambda: jax.vjp(f, x)[1](x)):
        compiled.clear()
        transform()
        counts.append(sum(name == "jit(g)" for name in compiled))
    return counts


def by_primitive(g):
    own = Primitive("g")
    own.def_impl(g)
    own.def_abstract_eval(lambda x: x)
    ad.primitive_jvps[own] = lambda primals, tangents: (own.bind(*primals), 3.0 * tangents[0])
    return own.bind


(forward, reverse), (_, primitive) = of_rule(lambda g: g), of_rule(by_primitive)
print(f"compiled under jvp {forward}, under vjp {reverse}, by way of a primitive {primitive}")
assert (forward, reverse, primitive) == (0, 1, 0), "the behaviour has changed"
PY
