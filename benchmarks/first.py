"""Seconds to the first results after ``import jaxgel``: python benchmarks/first.py [--runs N]

Compilation is included. The first result is the core rotation of sample 1 (1009 nodes) at mu =
-2.9678, the first gradient that of its midline rotation by the semi-axes. Each row is the median of
processes of their own: without compiled programs, with those that the one before left behind (JAX's
compilation cache), with those of ``jaxgel.keep_programs``, which are neither traced nor lowered,
and without, with XLA's own choice of the flags that the command line sets.

Two more rows are of ``jaxgel run``, with the programs kept that other plates left behind: the first
state of a plate never seen, sample 1 with other ellipses, and all of sample-1 with its figures and
files. ``--quick`` leaves out the gradients and has a wide spacing.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import jaxgel
from jaxgel.cli.environment import quick_flags

RESULTS = """
import sys, time
began = time.perf_counter()
import jax, jax.numpy as jnp, jaxgel
folder, spacing, gradient = sys.argv[1], float(sys.argv[2]) or None, sys.argv[3] == "gradient"
if folder:
    jaxgel.keep_programs(folder)
plate = jaxgel.sample("sample-1")
cloud = jaxgel.make_cloud(plate, spacing=spacing)
problem = jaxgel.Problem(jaxgel.discretise(cloud), plate.gel)
jax.block_until_ready(jaxgel.core_rotation(jaxgel.sweep(problem, [-2.9678])))
print(time.perf_counter() - began)
def rotation(axes):
    model = jaxgel.discretise(cloud.at(plate.at([{"semi_axes": axes}] * 4)))
    return jaxgel.rotation_angle(jaxgel.sweep(jaxgel.Problem(model, plate.gel), [-2.9678]))[-1]
if gradient:
    jax.block_until_ready(jax.grad(rotation)(jnp.array([5.0, 4.0])))
print(time.perf_counter() - began)
"""
TRIAL = "import sys; from jaxgel._kept import try_waiting; try_waiting(sys.argv[1])"
AXES = ((4.9, 4.1), (5.05, 3.9))  # mm: semi-axes of plates like sample 1, which has 5 and 4


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1, help="processes of each kind (1)")
    parser.add_argument("--quick", action="store_true", help="a wide spacing, and no gradients")
    options = parser.parse_args()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    print(
        f"{cores} cores, load {os.getloadavg()[0]:.1f}\n{'':<22} first result  with first gradient"
    )
    flags, rows = (
        " ".join(quick_flags()),
        {"cold": [], "warm": [], "kept": [], "cold, XLA's own flags": []},
    )
    commands = {"first state, new plate": [], "jaxgel run sample-1": []}
    for _ in range(options.runs):
        with (
            tempfile.TemporaryDirectory() as cache,
            tempfile.TemporaryDirectory() as kept,
            tempfile.TemporaryDirectory() as other,
        ):
            rows["cold"].append(seconds(cache, flags, options.quick))
            rows["warm"].append(seconds(cache, flags, options.quick))
            seconds(cache, flags, options.quick, kept)
            tried(kept)
            rows["kept"].append(seconds(cache, flags, options.quick, kept))
            rows["cold, XLA's own flags"].append(seconds(other, "", options.quick))
            for name, found in of_command(Path(kept), options.quick).items():
                commands[name].append(found)
    for name, found in rows.items():
        print(
            f"{name:<22} {statistics.median(f[0] for f in found):10.1f} s "
            f"{statistics.median(f[1] for f in found):16.1f} s"
        )
    for name, found in commands.items():
        print(f"{name:<22} {statistics.median(found):10.1f} s")


def seconds(cache, flags, quick, kept=""):
    """Seconds to the first result and to the first gradient of one process."""
    told = {
        "JAX_COMPILATION_CACHE_DIR": cache,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "XLA_FLAGS": flags,
    }
    given = [kept, "2.2" if quick else "0", "" if quick else "gradient"]
    done = subprocess.run(
        [sys.executable, "-c", RESULTS, *given],
        env=os.environ | told,
        check=True,
        capture_output=True,
        text=True,
    )
    return tuple(map(float, done.stdout.split()))


def tried(folder):
    """Try the waiting programs of a folder, as a process does in the background when it ends."""
    subprocess.run([sys.executable, "-c", TRIAL, str(Path(folder) / "programs")], check=True)


def of_command(folder, quick):
    """Seconds of ``jaxgel run`` to the first state of a new plate, and of sample-1 whole.

    The programs of the latter are kept.
    """
    environment = {
        name: value
        for name, value in os.environ.items()
        if name not in ("JAX_COMPILATION_CACHE_DIR", "XLA_FLAGS")
    }
    environment["JAXGEL_CACHE"] = str(folder / "command")
    spacing = ["--spacing", "2.2"] if quick else []

    def run(case, *more):
        command = [
            sys.executable,
            "-m",
            "jaxgel",
            "run",
            str(case),
            "--out",
            str(folder / f"{time.time_ns()}"),
            *spacing,
            *more,
        ]
        began = time.perf_counter()
        subprocess.run(command, env=environment, check=True, capture_output=True)
        return time.perf_counter() - began

    run(written(folder, *AXES[0]), "--no-plots")
    tried(folder / "command")
    of_first = run(written(folder, *AXES[1]), "--no-plots")
    run("sample-1", *(("--steps", "3") if quick else ()))
    tried(folder / "command")
    return {
        "first state, new plate": of_first,
        "jaxgel run sample-1": run("sample-1", *(("--steps", "3") if quick else ())),
    }


def written(folder, length, width):
    """A case file of one state of a plate like sample 1 with ellipses of these semi-axes, mm."""
    plate = jaxgel.sample("sample-1")
    lines = ["[plate]", f"width = {plate.width}", f"height = {plate.height}"]
    for hole in plate.holes:
        x, y = np.asarray(hole.centre)
        lines += [
            "[[holes]]",
            'kind = "ellipse"',
            f"centre = [{x}, {y}]",
            f"semi_axes = [{length}, {width}]",
            f"angle = {float(hole.angle)}",
        ]
    lines += [
        "[sweep]",
        "mu = [-2.9678]",
        "[gel]",
        f"Nv = {plate.gel.Nv}",
        f"chi = {plate.gel.chi}",
    ]
    lines += [
        "[discretisation]",
        f"spacing = {plate.spacing}",
        f"nodes_per_hole = {plate.nodes_per_hole}",
    ]
    file = folder / f"{length}_{width}.toml"
    file.write_text("\n".join(lines))
    return file


if __name__ == "__main__":
    main()
