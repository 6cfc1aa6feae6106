"""Time and memory of jaxgel against the size of the cloud: sample 1 from 1e3 to 3e5 nodes.

    python benchmarks/scale.py [--nodes 1000 3000 10000 30000 100000 300000] [--threads 1] [--limit
    16]

Every size runs in a process of its own. Prints and writes scale.json beside this file: seconds of
the setup (cloud, discretisation, constants and pattern), of the parts of a Newton step (medians of
three: linearisation, tangent, factor, solve), of a sweep to two states with contact, of
compilation, which the others leave out, the GiB of the factor, and the peak memory of the process
after the step and after the sweep; below each column its exponent among the larger sizes, and that
of the pairs of nodes that share a cell, which assembly adds up: a node has the more of them the
fewer lie near an edge. A process that takes more than ``--limit`` GiB is stopped, and the table
says so.

1e5 nodes, one thread: setup 43 s, a Newton step 11 s (assembly 1.7 s, factor 8.2 s) in 5.9 GiB, the
sweep in 6.9 GiB.
"""  # fmt: skip

import argparse
import json
import math
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
MU = (-4.9678, -4.5)  # kT
SETUP, STEP = ("cloud", "discretise", "prepare"), ("linearise", "tangent", "factor", "solve")
COLUMNS = (*SETUP, "setup", *STEP, "assembly", "step", "sweep", "compile")
MEMORY = ("factor_gib", "step_gib", "peak_gib")
EXPONENT_FROM = 9000  # nodes: below, fixed costs show


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--nodes",
        type=float,
        nargs="+",
        default=[1e3, 3e3, 1e4, 3e4, 1e5, 3e5],
        help="sizes (1e3 ... 3e5)",
    )
    parser.add_argument(
        "--threads", type=int, default=1, help="threads of XLA and BLAS, and processors (1)"
    )
    parser.add_argument(
        "--limit", type=float, default=16.0, help="GiB at which a process is stopped (16)"
    )
    parser.add_argument("--out", type=Path, default=HERE / "scale.json")
    parser.add_argument("--child", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(child(options.child, options.threads)))
        return
    print(
        f"{'nodes':>7} {'DOFs':>7}",
        *(name.rjust(10) for name in COLUMNS),
        f"{'Newton':>6} {'factor':>7} {'step':>7} {'peak GiB':>8} {'load':>5}",
    )
    rows = []
    for nodes in options.nodes:
        row = isolated(nodes, options.threads, options.limit)
        rows.append(row)
        if "stopped" in row:
            print(f"{nodes:7.0f} {row['stopped']}", flush=True)
            continue
        times = " ".join(f"{row[name]:9.3f}s" for name in COLUMNS)
        memory = f"{row['factor_gib']:7.2f} {row['step_gib']:7.2f} {row['peak_gib']:8.2f}"
        print(
            (
                f"{row['nodes']:7d} {row['dofs']:7d} {times} {row['newton']:6d} {memory} "
                f"{row['load']:5.1f}"
            ),
            flush=True,
        )
    exponents = {name: exponent(rows, name) for name in (*COLUMNS, *MEMORY, "pairs")}
    memory = (
        f"{exponents['factor_gib']:7.2f} {exponents['step_gib']:7.2f} {exponents['peak_gib']:8.2f}"
    )
    print(
        f"{'exponent':>15}", *(f"{exponents[name]:10.2f}" for name in COLUMNS), f"{'':6} {memory}"
    )
    print(f"exponent of the pairs of nodes {exponents['pairs']:.2f}")
    machine = {
        "cores": os.cpu_count(),
        "processor": platform.machine(),
        "python": platform.python_version(),
        "threads": options.threads,
    }
    options.out.write_text(
        json.dumps({"machine": machine, "rows": rows, "exponents": exponents}, indent=1) + "\n"
    )


def exponent(rows, name):
    """Exponent of the number of nodes in a column by least squares; nan below two sizes."""
    points = [
        (math.log(row["nodes"]), math.log(row[name]))
        for row in rows
        if "stopped" not in row and row["nodes"] > EXPONENT_FROM
    ]
    if len(points) < 2:
        return float("nan")
    x, y = (statistics.fmean(column) for column in zip(*points, strict=True))
    return sum((a - x) * (b - y) for a, b in points) / sum((a - x) ** 2 for a, _ in points)


def isolated(nodes, threads, limit):
    """Row of one size from a process with given threads, stopped above ``limit`` GiB (Linux)."""
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NPROC")
    environment = os.environ | dict.fromkeys(names, str(threads)) | {"PYTHONPATH": str(HERE.parent)}
    command = [sys.executable, __file__, "--child", str(nodes), "--threads", str(threads)]
    with tempfile.TemporaryFile("w+") as printed:
        process = subprocess.Popen(command, env=environment, stdout=printed)
        while process.poll() is None:
            time.sleep(0.2)
            if resident(process.pid) > limit:
                process.kill()
                process.wait()
                return {"asked": nodes, "stopped": f"stopped at {limit:g} GiB"}
        printed.seek(0)
        lines = printed.read().splitlines()
    return (
        json.loads(lines[-1])
        if process.returncode == 0
        else {"asked": nodes, "stopped": f"failed with {process.returncode}, see above"}
    )


def resident(pid):
    """GiB of memory that a process fills; 0 if that is not known."""
    try:
        return (
            int(Path(f"/proc/{pid}/statm").read_text().split()[1])
            * os.sysconf("SC_PAGE_SIZE")
            / 2**30
        )
    except (OSError, IndexError):
        return 0.0


def child(wanted, threads):
    """Row of one size, measured in this process."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])
    import jax
    import numpy as np

    import jaxgel
    from jaxgel.equilibrium import dry_state
    from jaxgel.linalg import factor
    from jaxgel.mechanics import linearise, tangent

    plate = jaxgel.sample("sample-1")
    # 0.48 n^2 + 6 n nodes for n intervals a side
    spacing = plate.width * 0.961 / (math.sqrt(36 + 1.922 * wanted) - 6)
    seconds, compiled = {}, [0.0]

    def listen(event, duration, **_):
        if event.startswith("/jax/core/compile/"):
            compiled[0] += duration

    jax.monitoring.register_event_duration_secs_listener(listen)

    def timed(name, function, *args):
        begin, before = time.perf_counter(), compiled[0]
        result = function(*args)
        jax.block_until_ready(
            [leaf for leaf in jax.tree.leaves(result) if isinstance(leaf, jax.Array)]
        )
        seconds.setdefault(name, []).append(time.perf_counter() - begin - (compiled[0] - before))
        return result

    cloud = timed("cloud", lambda: jaxgel.make_cloud(plate, spacing=spacing))
    model = timed("discretise", lambda: jaxgel.discretise(cloud))
    problem = timed("prepare", lambda: jaxgel.Problem(model, plate.gel, contact=False).prepared)
    timed("prepare", lambda: (problem.pattern, problem.operators.network.block_until_ready()))
    seconds["prepare"] = [sum(seconds["prepare"])]
    (x, pressure), free = dry_state(problem), problem.free
    for _ in range(4):
        made = None  # one factor is in memory at a time
        now = timed("linearise", linearise, problem, x, pressure, MU[0])
        pairs = timed("tangent", tangent, problem, x, pressure, now)
        made = timed("factor", factor, problem.pattern, pairs)
        timed("solve", made.solve, np.ones(len(free)))
    row = {name: statistics.median(values[1:] or values) for name, values in seconds.items()}
    unit = 2**30 if sys.platform == "darwin" else 2**20
    factor_gib, step_gib, cells = (
        made.size / 2**30,
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit,
        model.n_cells,
    )
    n_pairs = len(pairs)
    made = pairs = now = problem = None  # their memory is that of one step, not of the sweep
    begin, before = time.perf_counter(), compiled[0]
    path = jaxgel.sweep(jaxgel.Problem(model, plate.gel), list(MU))
    row["sweep"] = time.perf_counter() - begin - (compiled[0] - before)
    row["setup"] = sum(row[name] for name in SETUP)
    row["assembly"] = row["linearise"] + row["tangent"]
    row["step"] = sum(row[name] for name in STEP)
    return row | {
        "nodes": model.n_nodes,
        "dofs": len(free),
        "cells": cells,
        "pairs": n_pairs,
        "compile": compiled[0],
        "factor_gib": factor_gib,
        "step_gib": step_gib,
        "newton": int(np.sum(path.newton_iterations)),
        "stop": path.stop.name,
        "core_rotation": np.asarray(jaxgel.core_rotation(path)).tolist(),
        "peak_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit,
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan"),
    }


if __name__ == "__main__":
    main()
