"""Twenty runs killed at random moments (SIGKILL) and resumed: each ends with the numbers of an uninterrupted one, to the bit.

    python benchmarks/kill.py [KILLS]

Two cases take turns: sample 4 on 321 nodes, which buckles, at twelve given values of mu and with chosen steps. A kill falls anywhere
between the start of the process and the time that an uninterrupted one takes; half of the resumed processes are killed as well. Where
it falls before the run has a folder, ``run`` is what is repeated. Prints a line per kill; exit code 1 if any run ends differently.
"""

import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CASES = {"given": ["--steps", "12"], "chosen": ["--steps", "auto"]}
JAXGEL = [sys.executable, "-m", "jaxgel"]


def run_command(kind, folder):
    """Command line of the uninterrupted run."""
    return [*JAXGEL, "run", "sample-4", "--spacing", "1.1", *CASES[kind], "--no-plots", "--quiet", "--out", str(folder)]


def numbers(folder):
    """All that a run leaves but the time it took."""
    summary = json.loads((folder / "summary.json").read_text())
    del summary["wall_seconds"]
    vtu = sorted(file.read_bytes() for file in (folder / "vtu").iterdir())
    return summary, (folder / "history.csv").read_bytes(), (folder / "states.npz").read_bytes(), vtu


def killed(command, seconds):
    """Whether a command was killed after so many seconds, not having ended before."""
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return True
    return False


def states(folder):
    """What a killed run left, in words."""
    if not (folder / "summary.json").is_file():
        return "no folder"
    summary = json.loads((folder / "summary.json").read_text())
    return f"{summary['states']} states, {summary['status']}"


def main():
    """Reference runs, then the kills."""
    kills, rng = int(sys.argv[1]) if len(sys.argv) > 1 else 20, random.Random(20)
    wrong = 0
    with tempfile.TemporaryDirectory() as scratch:
        expected, seconds = {}, {}
        for kind in CASES:
            subprocess.run(run_command(kind, Path(scratch) / kind), check=True)  # compiles
            began = time.perf_counter()
            subprocess.run(run_command(kind, Path(scratch) / kind), check=True)
            seconds[kind], expected[kind] = time.perf_counter() - began, numbers(Path(scratch) / kind)
        done = 0
        while done < kills:
            kind, folder = list(CASES)[done % 2], Path(scratch) / f"killed-{done}"
            command, left = run_command(kind, folder), []
            for _ in range(rng.choice((1, 2))):
                if done < kills and killed(command, rng.uniform(0, seconds[kind])):
                    done += 1
                    left.append(states(folder))
                command = [*JAXGEL, "resume", str(folder), "--no-plots", "--quiet"] if (folder / "summary.json").is_file() else command
            subprocess.run(command, check=True)
            same = numbers(folder) == expected[kind]
            wrong += not same
            print(f"{done:2d} kills, {kind}: {'; then '.join(left) or 'ended before'}: {'identical' if same else 'DIFFERENT'}", flush=True)
    print(f"{done} kills, {wrong} runs ended differently")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
