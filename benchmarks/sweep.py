"""Time and error of jaxgel on sample 1 in 30 given steps of mu, beside NGSolve in the same run.

Extra ``[bench]``.

    python benchmarks/sweep.py [--runs 3] [--threads 1 2]

Prints a table and writes sweep.json beside this file. Each row is a process of its own, held to the
stated number of threads. The sweep is the median of ``--runs`` after a first one; setup is
everything before it (imports, cloud and model, or mesh and forms) and compilation what the first
sweep takes longer than the median. The error is the largest relative error of the core rotation
over all 30 states against refined quartic elements (reference_core_rotation.json).
"""  # fmt: skip

import argparse
import dataclasses
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
REFERENCE = json.loads((HERE / "reference_core_rotation.json").read_text())
SPACINGS = (22 / 30, None, 22 / 60)  # mm; None is the default
# of the core rotation: the NGSolve row that the others are compared with is the fastest within it
ACCURACY = 0.01
COLUMNS = {  # heading: width, how a row says it
    "solver": (17, lambda row: row["solver"]),
    "DOFs": (6, lambda row: row["free_dofs"]),
    "threads": (8, lambda row: row["threads"]),
    "setup/s": (8, lambda row: f"{row['setup_s']:.2f}"),
    "compile/s": (10, lambda row: f"{row['compile_s']:.2f}"),
    "sweep/s": (8, lambda row: f"{row['wall_s']:.3f}"),
    "CPU/s": (8, lambda row: f"{row['cpu_s']:.3f}"),
    "Newton": (7, lambda row: row["newton"]),
    "factors": (8, lambda row: row["factorisations"]),
    "error": (8, lambda row: f"{row['error']:.2%}"),
    "peak MiB": (9, lambda row: f"{row['peak_rss_mib']:.0f}"),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=3, help="timed sweeps per row (3)")
    parser.add_argument(
        "--threads", type=int, nargs="+", default=[1, 2], help="numbers of threads (1 2)"
    )
    parser.add_argument("--out", type=Path, default=HERE / "sweep.json")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(json.dumps(child(json.loads(options.child), options.runs, options.threads[0])))
        return
    result = {"machine": machine(), "runs": options.runs, "rows": []}
    print(
        *(f"{key}: {value}" for key, value in result["machine"].items()),
        f"median of {options.runs} sweeps",
        sep="; ",
    )
    print(*(heading.rjust(width) for heading, (width, _) in COLUMNS.items()), sep="")
    for threads in options.threads:
        rows = compare(threads, options.runs)
        result["rows"] += rows
        summarise(rows)
    options.out.write_text(json.dumps(result, indent=1) + "\n")


def compare(threads, runs):
    """Rows of both solvers at one number of threads, printed as they come."""
    try:
        from ngsolve_sweep import ROWS
    except ImportError as missing:
        sys.exit(f'sweep.py: {missing}; pip install "jaxgel[bench]"')
    cases = [{"ngsolve": dataclasses.asdict(row)} for row in ROWS] + [
        {"spacing": spacing} for spacing in SPACINGS
    ]
    rows = []
    for case in cases:
        rows.append(isolated(case, runs, threads))
        print(
            *(str(say(rows[-1])).rjust(width) for width, say in COLUMNS.values()),
            sep="",
            flush=True,
        )
    return rows


def isolated(case, runs, threads):
    """Row of one case from a child process with that many threads and processors."""
    # the last is read by XLA
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NPROC")
    command = [
        sys.executable,
        __file__,
        "--runs",
        str(runs),
        "--threads",
        str(threads),
        "--child",
        json.dumps(case),
    ]
    environment = os.environ | dict.fromkeys(names, str(threads)) | {"PYTHONPATH": str(HERE.parent)}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        sys.exit(f"sweep.py: {case} failed, see above")
    row = json.loads(done.stdout.splitlines()[-1])
    exact = REFERENCE["core_rotation"]
    complete = len(row["core_rotation"]) == len(exact)
    row["error"] = (
        max(abs(a / b - 1) for a, b in zip(row["core_rotation"], exact, strict=True))
        if complete
        else float("inf")
    )
    return row | {"threads": threads}


def child(case, runs, threads):
    """Row of one case, measured in this process."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])
    begin = time.perf_counter()
    if "ngsolve" in case:
        from ngsolve_sweep import Row, measure

        imported = time.perf_counter() - begin
        row = measure(Row(**case["ngsolve"]), runs, threads)
        row["setup_s"] += imported
    elif "skfem" in case:
        from skfem_gel import Row, measure

        imported = time.perf_counter() - begin
        row = measure(Row(**case["skfem"]), runs)
        row["setup_s"] += imported
    else:
        row = measure_jaxgel(case["spacing"], runs)
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return row | {"peak_rss_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit}


def measure_jaxgel(spacing, runs):
    """Row of jaxgel's defaults at one node spacing."""
    begin = time.perf_counter()
    import jax
    import numpy as np

    import jaxgel

    plate = jaxgel.sample("sample-1")
    cloud = jaxgel.make_cloud(plate, spacing=spacing)
    model = jax.block_until_ready(jaxgel.discretise(cloud))
    setup, wall, cpu = time.perf_counter() - begin, [], []
    for _ in range(runs + 1):
        begin = time.perf_counter(), time.process_time()
        path = jaxgel.sweep(jaxgel.Problem(model, plate.gel), REFERENCE["mu"])
        wall.append(time.perf_counter() - begin[0])
        cpu.append(time.process_time() - begin[1])
    if not path.stop.ok:
        print(f"jaxgel, spacing {spacing}: {path.stop_text}", file=sys.stderr)
    nodes, newton = len(cloud.nodes), int(np.sum(path.newton_iterations))
    median = statistics.median(wall[1:])
    return {
        "solver": f"jaxgel {nodes} nodes",
        "version": f"jax {jax.__version__}, numpy {np.__version__}",
        "mesh": {"spacing": cloud.spacing, "nodes": nodes},
        "free_dofs": free_dofs(cloud),
        "newton": newton,
        "factorisations": newton,
        "setup_s": setup,
        "compile_s": wall[0] - median,
        "wall_s": median,
        "wall_all_s": wall,
        "cpu_s": statistics.median(cpu[1:]),
        "energy": float(path.energy[-1]),
        "core_rotation": np.asarray(jaxgel.core_rotation(path)).tolist(),
    }


def free_dofs(cloud):
    """Displacement components that the rollers leave free."""
    half = 11 * (1 - 1e-9)
    return sum(int((abs(component) < half).sum()) for component in cloud.nodes.T)


def summarise(rows):
    """Each jaxgel row against the fastest NGSolve row within ACCURACY, and against the last one.

    The last one has cubic elements and plain Newton.
    """
    peers = [row for row in rows if row["solver"].startswith("NGSolve")]
    peers = [
        min((row for row in peers if row["error"] < ACCURACY), key=lambda row: row["wall_s"]),
        peers[-1],
    ]
    for row in rows:
        if row["solver"].startswith("jaxgel"):
            row["times_as_fast"] = {
                f"{p['solver']}, {p['free_dofs']} DOFs, {p['error']:.2%}": p["wall_s"]
                / row["wall_s"]
                for p in peers
            }
            ratios = "; ".join(
                f"{ratio:.2f} times as fast as {peer}"
                for peer, ratio in row["times_as_fast"].items()
            )
            print(
                f"{row['solver']}, {row['threads']} thread(s), error {row['error']:.2%}: {ratios}"
            )


def machine():
    """What a time depends on, for the record."""
    load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
    return {
        "Python": platform.python_version(),
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "load average": load,
    }


if __name__ == "__main__":
    main()
