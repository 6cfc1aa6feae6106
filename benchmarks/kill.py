"""Twenty runs killed at random moments (SIGKILL) and resumed: each ends with the numbers of an uninterrupted one, to the bit.

    python benchmarks/kill.py [KILLS]

Two cases take turns: sample 4 on 321 nodes, which buckles, at twelve given values of mu and with chosen steps. A kill falls somewhere in
the second after a number of states drawn among those that the run will have, none and all included; half of the resumed processes are
killed as well. Prints a line per run; exit code 1 if any ends differently.
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


def begun(command, folder):
    """The process of a command, once it has written its folder's summary."""
    before = written(folder)
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    while process.poll() is None and written(folder) == before:
        time.sleep(0.01)
    return process


def written(folder):
    """When the folder's summary was written, or None."""
    file = folder / "summary.json"
    return file.stat().st_mtime_ns if file.is_file() else None


def killed(process, folder, states, seconds):
    """Whether a process was killed so many seconds after its folder had so many states, not having ended before."""
    while process.poll() is None and summary_of(folder)["states"] < states:
        time.sleep(0.01)
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return True
    return False


def summary_of(folder):
    """Content of the folder's summary, which is whole at any moment."""
    return json.loads((folder / "summary.json").read_text())


def left_by(folder):
    """What a killed run left, in words."""
    summary = summary_of(folder)
    return f"{summary['states']} states, {summary['status']}"


def main():
    """Reference runs, then the kills."""
    kills, rng = int(sys.argv[1]) if len(sys.argv) > 1 else 20, random.Random(20)
    wrong = 0
    with tempfile.TemporaryDirectory() as scratch:
        expected = {}
        for kind in CASES:
            subprocess.run(run_command(kind, Path(scratch) / kind), check=True)
            expected[kind] = numbers(Path(scratch) / kind)
        done = 0
        while done < kills:
            kind, folder = list(CASES)[done % 2], Path(scratch) / f"killed-{done}"
            command, left = run_command(kind, folder), []
            for _ in range(rng.choice((1, 2))):
                when = rng.randint(0, expected[kind][0]["states"]), rng.uniform(0, 1)
                if done < kills and killed(begun(command, folder), folder, *when):
                    done += 1
                    left.append(left_by(folder))
                command = [*JAXGEL, "resume", str(folder), "--no-plots", "--quiet"]
            subprocess.run(command, check=True)
            same = numbers(folder) == expected[kind]
            wrong += not same
            print(f"{done:2d} kills, {kind}: {'; then '.join(left) or 'ended before'}: {'identical' if same else 'DIFFERENT'}", flush=True)
    print(f"{done} kills, {wrong} runs ended differently")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
