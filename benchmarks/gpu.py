"""Many sheets by one program: ``jax.vmap`` of a sweep of sample 1 and of its gradient.

The host's sweep is timed beside it.

    python benchmarks/gpu.py [--sheets sample-1] [--spacing 1.1] [--batch 16] [--states 30]
        [--repeats 3] [--out FILE]

Every sheet has ellipses (semi-axes, centre, angle) and a gel (Nv, chi) of its own, 22 numbers; of
``--sheets`` sample-1, sample-2, and film, printed and cell: sample 1 as a film, of a gel whose Nv
is a field of four pixels, and with periodic edges. Runs on JAX's default device, a GPU if there is
one, and without contact. Prints and writes gpu.json beside this file: seconds of compilation, and a
sheet's seconds alone, in the batch, with its gradient, and by the host, the set-up of the sheet
included; ratios to the host; the largest differences over all sheets to where the program ends; how
many sheets it loses before the last state.
"""  # fmt: skip

import argparse
import dataclasses
import functools
import json
import os
import statistics
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxgel

AGREEMENT, OF_GRADIENTS = 1e-9, 1e-8  # mm; relative
SPREAD = 0.02  # of the numbers of the sheets
PIXELS = [1e-3, 1.5e-3, 1.5e-3, 1e-3]  # Nv of the printed gel
SHEETS = {
    "sample-1": {},
    "sample-2": {},
    "film": {"kinematics": "plane stress"},
    "printed": {},
    "cell": {"edges": "periodic"},
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sheets", choices=SHEETS, default="sample-1", help="what is swept")
    parser.add_argument("--spacing", type=float, default=1.1, help="node spacing in mm (1.1)")
    parser.add_argument("--batch", type=int, default=16, help="sheets at once (16)")
    parser.add_argument(
        "--states", type=int, default=30, help="states from mu = -4.9678 to -0.9178 (30)"
    )
    parser.add_argument(
        "--repeats", type=int, default=3, help="runs of which the median is taken (3)"
    )
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("gpu.json"))
    options = parser.parse_args()
    kind, printed = options.sheets, options.sheets == "printed"
    plate = jaxgel.sample(kind if kind.startswith("sample") else "sample-1")
    plate = dataclasses.replace(plate, **SHEETS[kind])
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=options.spacing))
    mu = np.linspace(-4.9678, -0.9178, options.states)
    names = ["semi_axes", "centre", "angle"]
    holes = np.array([np.r_[hole.semi_axes, hole.centre, hole.angle] for hole in plate.holes])
    start = np.r_[holes.ravel(), PIXELS if printed else 1e-3, 1e-4]
    sheets = start + SPREAD * np.random.default_rng(5).uniform(
        -1, 1, (options.batch, len(start))
    ) * np.where(start, start, 1.0)

    def rotation(numbers):
        """Core rotation of the last state, degrees, and the positions of all states."""
        parts = [
            dict(zip(names, (p[:2], p[2:4], p[4]), strict=True))
            for p in numbers[: holes.size].reshape(-1, 5)
        ]
        placed = jaxgel.discretise(model.cloud.at(plate.at(parts)))
        Nv = numbers[holes.size : -1]
        Nv = (
            jaxgel.PixelField(Nv.reshape(2, 2), (-11, 11, -11, 11), smooth=True)
            if printed
            else Nv[0]
        )
        gel = jaxgel.Gel(Nv=Nv, chi=numbers[-1])
        path = jaxgel.sweep(jaxgel.Problem(placed, gel, contact=False), mu)
        return jaxgel.core_rotation(path)[-1], path.x

    slope = jax.value_and_grad(rotation, has_aux=True)
    sheets, row = (
        jnp.asarray(sheets),
        {"device": str(jax.devices()[0]), "jax": jax.__version__, "nodes": model.n_nodes},
    )
    programs = {"alone": rotation, "batch": jax.vmap(rotation), "gradient": jax.vmap(slope)}
    given = {"alone": sheets[0], "batch": sheets, "gradient": sheets}
    found = {}
    for name, function in programs.items():
        begin = time.perf_counter()
        compiled = jax.jit(function).lower(given[name]).compile()
        row[f"compile_{name}_s"] = time.perf_counter() - begin
        seconds, found[name] = timed(functools.partial(compiled, given[name]), options.repeats)
        row[f"{name}_s"] = seconds / (1 if name == "alone" else options.batch)
    row["host_s"], _ = timed(lambda: rotation(sheets[0]), options.repeats)
    row["host_gradient_s"], _ = timed(lambda: slope(sheets[0]), options.repeats)
    by_host = [slope(sheet) for sheet in sheets]
    x, slopes = (jnp.stack(part) for part in zip(*((x, d) for (_, x), d in by_host), strict=True))
    row |= {f"{name}_over_host": row[f"{name}_s"] / row["host_s"] for name in ("alone", "batch")}
    row["gradient_over_host"] = row["gradient_s"] / row["host_gradient_s"]
    row["gradient_over_batch"] = row["gradient_s"] / row["batch_s"]
    swept = jnp.isfinite(found["batch"][0])
    row["lost"] = int(jnp.sum(~swept))
    row["difference_mm"] = float(
        max(
            jnp.nanmax(jnp.abs(found["batch"][1] - x)),
            jnp.nanmax(jnp.abs(found["alone"][1] - x[0])),
        )
    )
    largest = jnp.abs(slopes).max(axis=1, keepdims=True)
    apart = jnp.abs((found["gradient"][1] - slopes) / largest)[swept]
    row["gradient_difference"] = float(apart.max(initial=0.0))
    row |= {
        "sheets": kind,
        "batch": options.batch,
        "states": options.states,
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan"),
    }
    print(
        *(
            f"{name}: {value:.3g}" if isinstance(value, float) else f"{name}: {value}"
            for name, value in row.items()
        ),
        sep="\n",
    )
    options.out.write_text(json.dumps(row, indent=1) + "\n")
    if not (row["difference_mm"] < AGREEMENT and row["gradient_difference"] < OF_GRADIENTS):
        sys.exit(
            f"gpu.py: program and host differ by more than {AGREEMENT:g} mm or {OF_GRADIENTS:g} "
            "of the gradient"
        )


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
