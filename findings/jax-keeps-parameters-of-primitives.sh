#!/usr/bin/env bash
# jax 0.10.1: what a parameter of a custom primitive holds stays in memory after all traces of it are gone.
#
# A primitive of one's own that takes an object as parameter, hashed by identity (a mesh, a factor, the states of a run), looks safe: the
# object is held by the jaxprs that contain it, and dies with them. But JAX remembers the abstract values of the latest 2048 calls that it
# has traced, `make_jaxpr`, `grad` and `jit` alike, by primitive and parameters, and holds these strongly: a loop over designs with
# derivatives fills the memory with objects that nobody can reach. Arrays among them count as live (`jax.live_arrays`). `jax.clear_caches`
# frees them, and all compiled programs too. Types in `jax._src.util.weakref_cache_key_types`, JAX's own jaxprs, are held weakly instead.
# Seen: "16 of 16 objects alive after 16 gradients, 0 after clear_caches".
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet "jax==0.10.1" "jaxlib==0.10.1" "numpy==2.2.6"
"$work/venv/bin/python" - <<'PY'
import gc
import weakref

import jax
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad


class Mesh:
    def __init__(self, size):
        self.weights = np.linspace(0.0, 1.0, size)


total = Primitive("total")
total.def_impl(lambda x, mesh: x * mesh.weights.sum())
total.def_abstract_eval(lambda x, mesh: x)
ad.deflinear(total, lambda cotangent, mesh: [total.bind(cotangent, mesh=mesh)])
alive = []
for size in range(10, 26):
    mesh = Mesh(size)
    assert jax.grad(lambda x, mesh=mesh: total.bind(x, mesh=mesh))(1.0) == mesh.weights.sum()
    alive.append(weakref.ref(mesh))
    del mesh
gc.collect()
before = sum(ref() is not None for ref in alive)
jax.clear_caches()
gc.collect()
after = sum(ref() is not None for ref in alive)
print(f"{before} of {len(alive)} objects alive after {len(alive)} gradients, {after} after clear_caches")
assert (before, after) == (16, 0), "the behaviour has changed"
PY
