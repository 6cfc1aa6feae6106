#!/usr/bin/env bash
# jax 0.10.1: a jitted function that is called under jax.ensure_compile_time_eval is compiled once more, and each of its operations with
# constants by itself.
#
# `with jax.ensure_compile_time_eval():` is the documented way to compute with numbers beside a trace. Outside of all traces it looks like
# nothing. But it is a configuration, part of the key of `jax.jit`'s cache, that also holds while a jitted function met inside is traced:
# the function is compiled again although its program exists, and what in it depends on constants alone (`jnp.arange`, `jnp.eye`, indices
# of `.at[]`) is not staged but evaluated at once, each operation by a program of its own. A set-up phase in such a block compiled 55 programs
# instead of 23. `jax.core.eval_context()` gives the same numbers inside a trace and shares the programs (also in 0.12.0's source: read, not run).
# Seen: "0 programs under eval_context, 11 under ensure_compile_time_eval".
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet "jax==0.10.1" "jaxlib==0.10.1" "numpy==2.2.6"
"$work/venv/bin/python" - <<'PY'
import jax
import jax.numpy as jnp
import numpy as np

names = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, _, fun_name="", **__: names.append(fun_name) if "backend_compile" in event else None
)


@jax.jit
def picked(x):
    return jnp.where(jnp.arange(5) == 2, x, jnp.eye(5)[0])


def compiled(context):
    names.clear()
    with context:
        picked(numbers)
    return len(names)


numbers = np.ones(5)
picked(numbers)
counts = compiled(jax.core.eval_context()), compiled(jax.ensure_compile_time_eval())


@jax.jit
def beside_a_trace(x):
    with jax.core.eval_context():
        made = picked(numbers)
    assert not isinstance(made, jax.core.Tracer)
    return x + made


beside_a_trace(1.0)
print(f"{counts[0]} programs under eval_context, {counts[1]} under ensure_compile_time_eval")
assert counts[0] == 0 and counts[1] > 1, "the behaviour has changed"
PY
