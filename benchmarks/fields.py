"""Cost of parameters that vary over the plate: sample 1, 30 given states, one table.

    python benchmarks/fields.py [--repeats 7]

Seconds of a sweep, and of the mean square of its core rotation with its gradient by Nv, for the
plain gel and for pictures of 2 x 2 and 100 x 100 pixels of the same value; medians after a first
call, the three in turn. ``ratio`` is over the plain gel's. BLAS uses one thread, XLA what the
machine has.
"""  # fmt: skip

import argparse
import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np

import jaxgel

MU = jnp.linspace(-4.9678, -0.9178, 30)  # kT


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--repeats", type=int, default=7, help="runs of which the median is taken (7)"
    )
    repeats = parser.parse_args().repeats
    plate = jaxgel.sample("sample-1")
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    extent = (-plate.width / 2, plate.width / 2, -plate.height / 2, plate.height / 2)

    def swept(values):
        Nv = values if jnp.ndim(values) == 0 else jaxgel.PixelField(values, extent)
        return jaxgel.sweep(jaxgel.Problem(model, jaxgel.Gel(Nv, plate.gel.chi)), MU)

    def objective(values):
        return jnp.mean(jaxgel.core_rotation(swept(values)) ** 2)

    values = {"plain": np.array(plate.gel.Nv)} | {
        f"{n} x {n} pixels": np.full((n, n), plate.gel.Nv) for n in (2, 100)
    }
    gradient = jax.value_and_grad(objective)
    sweeps, gradients = (in_turn(function, values, repeats) for function in (swept, gradient))
    print(f"{'gel':16} {'sweep/s':>9} {'ratio':>6} {'gradient/s':>11} {'ratio':>6}")
    for name in values:
        ratios = sweeps[name] / sweeps["plain"], gradients[name] / gradients["plain"]
        print(
            f"{name:16} {sweeps[name]:9.3f} {ratios[0]:6.2f} {gradients[name]:11.3f} "
            f"{ratios[1]:6.2f}"
        )


def in_turn(function, values, repeats):
    """Name -> median seconds."""
    seconds = {name: [] for name in values}
    for _ in range(repeats + 1):
        for name, value in values.items():
            begin = time.perf_counter()
            jax.block_until_ready(
                [leaf for leaf in jax.tree.leaves(function(value)) if isinstance(leaf, jax.Array)]
            )
            seconds[name].append(time.perf_counter() - begin)
    return {name: statistics.median(spent[1:]) for name, spent in seconds.items()}


if __name__ == "__main__":
    main()
