"""Runs, designs and maps killed at random moments and resumed, against uninterrupted ones.

They are killed by SIGKILL; the numbers must be the same. Designs and maps have them to the bit, a
single sweep to the tolerance of its states; with chosen steps its last state is compared.

    python benchmarks/kill.py [KILLS] [KIND ...]

The kinds take turns until KILLS (20) kills are done: sample 4 on 321 nodes, which buckles, at
twelve given values of mu ("given") and with chosen steps ("chosen"), a small design and a small map
on two processes. A kill falls soon, 0.2 s in the mean, after a number of states, or of a design's
sweeps, drawn among those that there will be, none and all included; half of the resumed processes
are killed as well, in the first five seconds. Prints a line per folder; exit code 1 if any ends
differently.
"""

import csv
import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

JAXGEL = [sys.executable, "-m", "jaxgel"]
HOLE = """
[plate]
width = 8.0
height = 8.0
edges = { top = "free" }
[[holes]]
kind = "ellipse"
centre = [0.3, -0.2]
semi_axes = [2.4, 1.6]
angle = 0.4
[discretisation]
spacing = 1.2
nodes_per_hole = 14
[sweep]
"""
DESIGN = """mu = [-3.0, -1.8]
[[parameters]]
of = "semi_axes"
lower = [2.1, 1.4]
upper = [2.7, 1.8]
[[objective]]
of = "area_reduction"
goal = "maximise"
at = -1.8
[search]
evaluations = 6
[verification]
spacing = 1.0
mu = [-3.0, -1.8]
"""
MAP = """mu_end = -1.5
steps = 6
[[parameters]]
of = "Nv"
values = [8e-4, 1e-3, 1.5e-3, 2e-3]
"""
RUN = ["run", "sample-4", "--spacing", "1.1", "--no-plots"]
COMMANDS = {  # arguments, beside --quiet and --out, and the file that makes a folder one to resume
    "given": ([*RUN, "--steps", "12"], "summary.json"),
    "design": (["design", "design.toml"], "design.json"),
    "chosen": ([*RUN, "--steps", "auto"], "summary.json"),
    "map": (["map", "map.toml", "--workers", "2"], "map.json"),
}


def process_of(kind, folder, *, resume=False):
    """The process that begins, or goes on with, a folder beside the studies."""
    last = (
        ["--no-plots"]
        if kind in ("given", "chosen")
        else ["--workers", "2"]
        if kind == "map"
        else []
    )
    words = ["resume", folder.name, *last] if resume else [*COMMANDS[kind][0], "--out", folder.name]
    quiet = [] if resume and kind == "design" else ["--quiet"]
    return subprocess.Popen(
        [*JAXGEL, *words, *quiet],
        cwd=folder.parent,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )


def ended(process):
    """Wait for a process that nobody kills."""
    if process.wait() != 0:
        raise SystemExit(f"{process.args} ended with {process.returncode}")


def progress(kind, folder):
    """Number of states, or of a design's sweeps, on disk; -1 if there is nothing to resume yet."""
    if not (folder / COMMANDS[kind][1]).is_file():
        return -1
    if kind == "design":
        return len(json.loads((folder / "design.json").read_text())["evaluations"])
    return sum(json.loads(file.read_text())["states"] for file in folder.rglob("summary.json"))


def numbers(folder):
    """File -> content of all that a folder holds but figures and the time it took."""
    return {
        str(file.relative_to(folder)): _content(file)
        for file in sorted(folder.rglob("*"))
        if file.is_file() and file.suffix != ".png"
    }


def same(kind, folder, expected):
    """Whether a folder ends with the numbers of another one."""
    if kind not in ("given", "chosen"):
        return numbers(folder) == numbers(expected)
    one, two = (np.load(place / "states.npz") for place in (folder, expected))
    if kind == "given":
        return one["x"].shape == two["x"].shape and bool(
            np.allclose(one["x"], two["x"], rtol=0, atol=1e-9)
        )
    return one["mu"][-1] == two["mu"][-1] and bool(
        np.allclose(one["x"][-1], two["x"][-1], rtol=0, atol=1e-9)
    )


def _content(file):
    if file.suffix == ".json":
        return json.loads(file.read_text(), object_pairs_hook=_without_time)
    if file.name == "points.csv":
        with file.open(newline="") as stream:
            return [_without_time(row.items()) for row in csv.DictReader(stream)]
    return file.read_bytes()


def _without_time(pairs):
    return {name: value for name, value in pairs if name not in ("seconds", "wall_seconds")}


def killed(process, wait_for, seconds):
    """Whether a process was still running, and killed, so many seconds after ``wait_for()``."""
    while process.poll() is None and not wait_for():
        time.sleep(0.01)
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return True
    return False


def main():
    """Reference folders, then the kills."""
    kills, kinds = int(sys.argv[1]) if len(sys.argv) > 1 else 20, sys.argv[2:] or list(COMMANDS)
    rng, wrong, done, turn = random.Random(7), 0, 0, 0
    with tempfile.TemporaryDirectory() as scratch:
        scratch = Path(scratch)
        (scratch / "design.toml").write_text(HOLE + DESIGN)
        (scratch / "map.toml").write_text(HOLE + MAP)
        for kind in kinds:
            ended(process_of(kind, scratch / kind))
        expected = {kind: progress(kind, scratch / kind) for kind in kinds}
        while done < kills:
            kind, folder, left = kinds[turn % len(kinds)], scratch / f"killed-{turn}", []
            least, process = rng.randint(0, expected[kind]), process_of(kind, folder)
            if killed(
                process,
                lambda kind=kind, folder=folder, least=least: progress(kind, folder) >= least,
                rng.expovariate(5),
            ):
                left.append(progress(kind, folder))
            if done + len(left) < kills and rng.choice((True, False)):
                process = process_of(kind, folder, resume=True)
                if killed(process, lambda: True, rng.uniform(0, 5)):
                    left.append(progress(kind, folder))
            ended(process_of(kind, folder, resume=True))
            done, turn, alike = done + len(left), turn + 1, same(kind, folder, scratch / kind)
            wrong += not alike
            what = (
                f"killed at {' and '.join(map(str, left))} of {expected[kind]}"
                if left
                else "ended before"
            )
            print(
                f"{done:2d} kills, {kind}: {what}: {'the same' if alike else 'DIFFERENT'}",
                flush=True,
            )
    print(f"{done} kills, {wrong} folders ended differently")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
