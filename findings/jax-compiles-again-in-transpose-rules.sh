#!/usr/bin/env bash
# JAX 0.10.1 (and 0.12.0.1): a compiled function that a transpose rule calls is compiled a second time in a reverse pass.
#
# A primitive of one's own has a transpose rule, or an implementation, that calls g = jax.jit(...) with arrays of numbers. Under jax.jvp the
# programs of plain calls serve. In the reverse pass of jax.grad JAX evaluates each recorded operation with the abstract mesh that was current
# when it was recorded. Without a mesh that is an empty mesh, not the absence of one; both mean the same, but the programs of jax.jit are kept
# by what is set, so every g compiles once more. Solvers whose adjoint calls their own compiled kernels compile all of them twice.
# Seen: "programs after plain calls 1, after jax.jvp 1, after jax.grad 2".
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet "jax==0.10.1" "jaxlib==0.10.1"
JAX_PLATFORMS=cpu "$work/venv/bin/python" - <<'PY'
import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad

kernel = jax.jit(lambda x: 2 * x)
double = Primitive("double")  # linear, its own transpose, evaluated by a compiled kernel
double.def_impl(kernel)
double.def_abstract_eval(lambda x: x)
ad.deflinear2(double, lambda cotangent, _: [double.bind(cotangent)])

x, found = jnp.ones(3), []
double.bind(x)
found.append(kernel._cache_size())
jax.jvp(double.bind, (x,), (x,))
found.append(kernel._cache_size())
gradient = jax.grad(lambda x: double.bind(x).sum())(x)
assert gradient.tolist() == [2.0] * 3, gradient
found.append(kernel._cache_size())
text = "programs after plain calls {}, after jax.jvp {}, after jax.grad {}".format(*found)
print(text)
assert found == [1, 1, 2], text
PY
