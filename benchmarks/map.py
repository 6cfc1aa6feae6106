"""Parallel efficiency of ``jaxgel map``: sample 1 at many designs on several workers.

The reference is one worker in the same run.

    python benchmarks/map.py [--points 48] [--workers 1 4] [--spacing H] [--out FILE]

Each number of workers runs the same Sobol samples of the semi-axes and of Nv, 30 steps of mu to
-0.9178 each, from an empty folder; what is compiled comes from JAX's compilation cache
(JAX_COMPILATION_CACHE_DIR, or a temporary one that a first point fills). Prints and writes map.json
beside this file: wall seconds with the start of the processes, median seconds of a point,
efficiency = (wall of one worker / wall) / workers, the share of their time in which workers are
busy with points, and the load of the machine. "machine" is what the processors give: the pace of as
many processes that share nothing, each with its own dense products, over that of one.
"""  # fmt: skip

import argparse
import json
import os
import platform
import statistics
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np

STUDY = """
case = "sample-1"
[sweep]
mu_start = -4.9678
mu_end = -0.9178
steps = 30
[discretisation]
spacing = {spacing}
[[parameters]]
of = "semi_axes"
lower = [4.9, 3.9]
upper = [5.0, 4.0]
[[parameters]]
of = "Nv"
lower = 0.9e-3
upper = 1.1e-3
[map]
samples = "sobol"
points = {points}
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=48, help="designs (48)")
    parser.add_argument(
        "--workers",
        type=int,
        nargs="+",
        default=[1, 4],
        help="numbers of workers, the first is the reference (1 4)",
    )
    parser.add_argument(
        "--spacing", type=float, default=0.55, help="node spacing in mm (the paper's 0.55)"
    )
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("map.json"))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(scratch) / "cache"))
        # XLA writes its machine's features for every program from the cache
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
        rows = measure(options, Path(scratch))
    machine = {
        "cores": os.cpu_count(),
        "processor": platform.machine(),
        "python": platform.python_version(),
    }
    versions = {name: version(name) for name in ("jaxgel", "jax", "numpy", "scipy")}
    result = {
        "machine": machine,
        "versions": versions,
        "points": options.points,
        "spacing": options.spacing,
        "rows": rows,
    }
    options.out.write_text(json.dumps(result, indent=1) + "\n")


def measure(options, scratch):
    """One dict for each number of workers, printed as they come."""
    from jaxgel.cases import load_map, run_map
    from jaxgel.io import Workers

    file = scratch / "study.toml"
    file.write_text(STUDY.format(points=1, spacing=options.spacing))
    with Workers(1) as executor:  # fills the cache
        run_map(load_map(file), scratch / "first", executor)
    file.write_text(STUDY.format(points=options.points, spacing=options.spacing))
    study, rows = load_map(file), []
    print(
        f"{'workers':>7} {'wall':>8} {'per point':>10} {'efficiency':>10} {'machine':>7} "
        f"{'busy':>6} {'load':>6}  points"
    )
    for number in options.workers:
        with Workers(number) as executor:
            list(executor.map(pace, [0.0] * number))  # they have started
            rate = statistics.fmean(executor.map(pace, [3.0] * number))
        begin = time.perf_counter()
        with Workers(number) as executor:
            points = run_map(
                study, scratch / f"of-{number}", executor, quiet=not sys.stderr.isatty()
            )
        wall = time.perf_counter() - begin
        median = statistics.median(point["seconds"] for point in points)
        row = dict(
            workers=number,
            wall_s=wall,
            point_s=median,
            busy=sum(point["seconds"] for point in points) / (number * wall),
        )
        row["pace"] = rate
        row["load"] = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
        row["statuses"] = {
            status: sum(p["status"] == status for p in points)
            for status in {p["status"] for p in points}
        }
        rows.append(row)
        row["efficiency"] = rows[0]["wall_s"] * rows[0]["workers"] / (row["wall_s"] * number)
        row["machine"] = rate / rows[0]["pace"]
        print(
            (
                f"{number:7d} {wall:7.1f}s {median:9.2f}s {row['efficiency']:10.0%} "
                f"{row['machine']:7.0%} {row['busy']:6.0%}"
            ),
            f"{row['load']:6.1f}  {row['statuses']}",
            flush=True,
        )
    return rows


def pace(seconds):
    """Products per second of matrices (300, 300) in this process.

    They fit the cache of one core.
    """
    matrix, began, made = np.random.default_rng(0).normal(size=(300, 300)), time.perf_counter(), 0
    while time.perf_counter() - began < seconds:
        matrix @ matrix
        made += 1
    return made / max(seconds, 1e-9)


if __name__ == "__main__":
    main()
