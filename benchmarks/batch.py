"""Many designs or gels at once: ``jax.vmap`` of a whole sweep of sample 1 against one sweep after the other, in the same run.

    python benchmarks/batch.py [--batch 8] [--spacing 1.1] [--states 12] [--repeats 3] [--out FILE]

Designs differ in their semi-axes, gels in Nv and chi. Prints and writes batch.json beside this file: median seconds after compilation of
the compiled batch, of the sweeps one by one as a user writes them and of the compiled single sweep, both times per sweep, their ratio,
and the largest difference of a nodal position in mm. Both do without contact, which these holes do not reach.
"""  # fmt: skip

import argparse
import json
import os
import platform
import statistics
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxgel

SEED = 5


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--batch", type=int, default=8, help="sweeps at once (8)")
    parser.add_argument("--spacing", type=float, default=1.1, help="node spacing in mm (1.1)")
    parser.add_argument("--states", type=int, default=12, help="states from mu = -4.9678 to -0.9178 (12)")
    parser.add_argument("--repeats", type=int, default=3, help="runs of which the median is taken (3)")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("batch.json"))
    options = parser.parse_args()
    rows = []
    names = ("vmap", "compiled", "one by one", "ratio", "max dx/mm", "load")
    print(f"{'batch of':>8} {'sweeps':>6} {'nodes':>6}", *(name.rjust(10) for name in names))
    for name, (one, inputs) in problems(options).items():
        rows.append(compare(name, one, inputs, options))
        row = rows[-1]
        print(
            f"{name:>8} {options.batch:6d} {row['nodes']:6d} {row['vmap_s']:9.3f}s {row['compiled_s']:9.3f}s {row['single_s']:9.3f}s"
            f" {row['ratio']:10.2f} {row['difference_mm']:10.1e} {row['load']:10.1f}",
            flush=True,
        )
    machine = {"cores": os.cpu_count(), "processor": platform.machine(), "device": str(jax.devices()[0]), "jax": jax.__version__}
    options.out.write_text(json.dumps({"machine": machine, "rows": rows}, indent=1) + "\n")


def problems(options):
    """Name -> (function of one design or gel that gives positions (k, n, 2) and statuses (k,), the inputs stacked)."""
    plate = jaxgel.sample("sample-1")
    cloud, mu = jaxgel.make_cloud(plate, spacing=options.spacing), np.linspace(-4.9678, -0.9178, options.states).tolist()
    fixed, random = jaxgel.discretise(cloud), np.random.default_rng(SEED)
    axes = np.array([4.9, 3.95]) + 0.1 * random.uniform(-1, 1, (options.batch, 2))
    gels = np.array([1e-3, 1e-4]) * (1 + 0.1 * random.uniform(-1, 1, (options.batch, 2)))

    def swollen(model, gel):
        path = jaxgel.sweep(model, gel, mu=mu, contact="off")
        return jnp.asarray(path.x), jnp.asarray(path.status)

    def design(axes):
        return swollen(jaxgel.discretise(cloud.at(plate.at([{"semi_axes": axes}] * 4))), plate.gel)

    def gel(values):
        return swollen(fixed, jaxgel.Gel(Nv=values[0], chi=values[1]))

    return {"designs": (design, jnp.asarray(axes)), "gels": (gel, jnp.asarray(gels))}


def compare(name, one, inputs, options):
    """One row: times per sweep, ratio and agreement."""
    batch, alone = jax.jit(jax.vmap(one)), jax.jit(one)
    together, (x, status) = timed(lambda: batch(inputs), options.repeats)
    compiled, _ = timed(lambda: [alone(v) for v in inputs], options.repeats)
    single, found = timed(lambda: [one(v) for v in inputs], options.repeats)
    difference = max(float(np.abs(x[i] - found[i][0]).max()) for i in range(len(inputs)))
    n = len(inputs)
    return {
        "batch": name,
        "nodes": x.shape[2],
        "vmap_s": together / n,
        "compiled_s": compiled / n,
        "single_s": single / n,
        "ratio": single / together,
        "difference_mm": difference,
        "converged": bool(np.all(np.asarray(status) == 0)),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan"),
    }


def timed(function, repeats):
    """Median seconds of a function after a first call, and what it gave."""
    result, seconds = jax.block_until_ready(function()), []
    for _ in range(repeats):
        begin = time.perf_counter()
        result = jax.block_until_ready(function())
        seconds.append(time.perf_counter() - begin)
    return statistics.median(seconds), result


if __name__ == "__main__":
    main()
