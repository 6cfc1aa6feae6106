"""Seconds to the first results after ``import jaxgel``, compilation included: python benchmarks/first.py [--runs N]

The first result is the core rotation of sample 1 (1009 nodes) at mu = -2.9678, the first gradient that of its midline rotation by the
semi-axes. Each row is the median of processes of their own: without compiled programs, with those that the one before left behind (JAX's
compilation cache), and without, with XLA's own choice of the flags that the command line sets.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile

from jaxgel.cli.environment import quick_flags

RESULTS = """
import time
began = time.perf_counter()
import jax, jax.numpy as jnp, jaxgel
plate = jaxgel.sample("sample-1")
cloud = jaxgel.make_cloud(plate)
jax.block_until_ready(jaxgel.core_rotation(jaxgel.sweep(jaxgel.Problem(jaxgel.discretise(cloud), plate.gel), [-2.9678])))
print(time.perf_counter() - began)
def rotation(axes):
    model = jaxgel.discretise(cloud.at(plate.at([{"semi_axes": axes}] * 4)))
    return jaxgel.rotation_angle(jaxgel.sweep(jaxgel.Problem(model, plate.gel), [-2.9678]))[-1]
jax.block_until_ready(jax.grad(rotation)(jnp.array([5.0, 4.0])))
print(time.perf_counter() - began)
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1, help="processes of each kind (1)")
    runs = parser.parse_args().runs
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    quick = " ".join(quick_flags())
    rows = {"cold": [], "warm": [], "cold, XLA's own flags": []}
    for _ in range(runs):
        with tempfile.TemporaryDirectory() as cache, tempfile.TemporaryDirectory() as other:
            for name, folder, flags in zip(rows, (cache, cache, other), (quick, quick, ""), strict=True):
                rows[name].append(seconds(folder, flags))
    print(f"{cores} cores, load {os.getloadavg()[0]:.1f}\n{'':<22} first result  with first gradient")
    for name, found in rows.items():
        print(f"{name:<22} {statistics.median(f[0] for f in found):10.1f} s {statistics.median(f[1] for f in found):16.1f} s")


def seconds(cache, flags):
    """Seconds to the first result and to the first gradient of one process."""
    told = {"JAX_COMPILATION_CACHE_DIR": cache, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0", "XLA_FLAGS": flags}
    done = subprocess.run([sys.executable, "-c", RESULTS], env=os.environ | told, check=True, capture_output=True, text=True)
    return tuple(map(float, done.stdout.split()))


if __name__ == "__main__":
    main()
