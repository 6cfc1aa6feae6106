#!/usr/bin/env bash
# JAX 0.10.1 (and 0.12.0.1), CPU: an executable that came from the persistent compilation cache is serialised without its functions.
#
# `jax.experimental.serialize_executable.serialize` takes what `lowered.compile()` returns, and `compile()` looks into the persistent
# compilation cache first. After a hit there `serialize` raises nothing and returns bytes that load, also in another process; but the loaded
# program fails when it is called: "Function ... not found". So programs to be stored have to be compiled with the cache switched off
# (jax_enable_compilation_cache and compilation_cache.reset_cache), and a stored one has to be run once before it is trusted.
# Seen: "compiled: runs; from the cache: NOT_FOUND: Function wrapped_sine not found (type id: 1)".
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet "jax==0.10.1" "jaxlib==0.10.1"
export JAX_PLATFORMS=cpu JAX_COMPILATION_CACHE_DIR="$work/cache" JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS=0 TF_CPP_MIN_LOG_LEVEL=3

store() { # compile a program, or take it from the cache, and write its executable to a file
    "$work/venv/bin/python" - "$1" <<'PY'
import pickle
import sys

import jax
import jax.numpy as jnp
from jax.experimental import serialize_executable

program = jax.jit(lambda x: jnp.sin(x) @ jnp.cos(x).T + jnp.tanh(x).sum()).lower(jnp.ones((40, 40))).compile()
with open(sys.argv[1], "wb") as stream:
    pickle.dump(serialize_executable.serialize(program), stream)
PY
}

run() { # load the executable in another process and call it
    "$work/venv/bin/python" - "$1" <<'PY'
import pickle
import sys

import jax
import jax.numpy as jnp
from jax.experimental import serialize_executable

with open(sys.argv[1], "rb") as stream:
    program = serialize_executable.deserialize_and_load(*pickle.load(stream))
try:
    program(jnp.ones((40, 40))).block_until_ready()
    print("runs")
except jax.errors.JaxRuntimeError as problem:
    print(str(problem).splitlines()[0])
PY
}

store "$work/compiled"
store "$work/cached"
compiled=$(run "$work/compiled") cached=$(run "$work/cached")
echo "compiled: $compiled; from the cache: $cached"
if [ "$compiled" != runs ] || [[ $cached != *"not found"* ]]; then
    echo "the behaviour has changed" >&2
    exit 1
fi
