#!/usr/bin/env bash
# JAX 0.10.1 (and jaxlib 0.10.1, SciPy 1.17.1), CPU: factors inside a compiled program run on the threads of SciPy's OpenBLAS.
#
# XLA's flags for one thread (xla_cpu_multi_thread_eigen=false, intra_op_parallelism_threads=1) leave `cholesky`, `lu` and triangular solves
# alone: these are calls of the LAPACK that SciPy has loaded, which takes all cores, for matrices of a few hundred rows too, and for every
# matrix of a vmapped batch anew. Its threads spin while they wait for each other, so that beside another busy process on the same cores a batch
# of small factors took ten times as long as on one thread. Only what limits OpenBLAS helps: OPENBLAS_NUM_THREADS before the start, or
# threadpoolctl around the call of the program, even long after it was compiled.
# Seen on two cores: "SciPy's workers with XLA's flags: busy; with threadpoolctl: idle". Needs Linux and two cores.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet "jax==0.10.1" "jaxlib==0.10.1" "scipy==1.17.1" "threadpoolctl==3.8.0"
export JAX_PLATFORMS=cpu JAX_ENABLE_X64=1 TF_CPP_MIN_LOG_LEVEL=3
export XLA_FLAGS="--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
unset OPENBLAS_NUM_THREADS OMP_NUM_THREADS
found=$("$work/venv/bin/python" - <<'PY'
import pathlib

import numpy as np

SIZE, CALLS = 1200, 20
TASKS = pathlib.Path("/proc/self/task")
before = {task.name for task in TASKS.iterdir()}
import scipy.linalg  # starts the workers of its OpenBLAS

workers = {task.name for task in TASKS.iterdir()} - before
import jax
from threadpoolctl import threadpool_limits

factor = jax.jit(jax.numpy.linalg.cholesky)
root = np.random.default_rng(0).standard_normal((SIZE, SIZE))
matrix = root @ root.T + SIZE * np.eye(SIZE)
factor(matrix).block_until_ready()


def work():  # user time of the workers, in ticks, while the program runs
    def ticks():
        return sum(int((TASKS / name / "stat").read_text().rsplit(")", 1)[1].split()[11]) for name in workers)

    start = ticks()
    for _ in range(CALLS):
        factor(matrix).block_until_ready()
    return ticks() - start


free = work()
with threadpool_limits(1, user_api="blas"):
    limited = work()
print(f"SciPy's workers with XLA's flags: {'busy' if free > 20 else 'idle'}; with threadpoolctl: {'busy' if limited > free / 10 else 'idle'}")
PY
)
echo "$found"
if [[ $found != *"flags: busy; with threadpoolctl: idle" ]]; then
    echo "the behaviour has changed" >&2
    exit 1
fi
