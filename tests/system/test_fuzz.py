"""Two hundred damaged files and folders end in exit code 2 and one line.

No traceback, bounded time and memory.
"""

import functools
import re
import signal
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest

from jaxgel.cases import case_text, example
from jaxgel.cli import command_line as cli
from jaxgel.cli import folders, runs

SECONDS = 60  # far more than the fraction of a second that reading takes
MEBIBYTE = 2**20
WORDS = [
    "nan",
    "-inf",
    "1e999",
    "true",
    "[]",
    '"roller"',
    "{}",
    "-1",
    "0",
    "9" * 400,
    '""',
    "[[",
    "1e-320",
    '"\\u0000"',
    "[[[[1]]]]",
    "2.5",
]


@pytest.fixture
def bounded():
    """The most memory, and the time after which a test that hangs ends."""

    def hangs(*_):
        raise TimeoutError("a damaged input is not refused")

    signal.signal(signal.SIGALRM, hangs)
    tracemalloc.start()
    yield
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    signal.alarm(0)
    assert most < 100 * MEBIBYTE


@pytest.fixture
def only_read(monkeypatch):
    """``jaxgel run`` stops where it would start to compute."""
    monkeypatch.setattr(runs, "run", lambda args: 0 * len(runs.load_case(args.case).table()))


def refused(arguments, capsys):
    """Whether a command ended with exit code 2 and one line; the only other end is 0."""
    code = cli.main(arguments)
    printed = capsys.readouterr()
    assert code in (0, 2), printed.err
    assert code == 0 or re.fullmatch(r"jaxgel: error: [^\n]+\n", printed.err), printed.err
    assert "Traceback" not in printed.err
    return code == 2


def mutated(text, rng):
    """The text with one value replaced, one line lost or repeated, or some bytes changed."""
    lines = text.splitlines()
    entries = [i for i, line in enumerate(lines) if " = " in line and not line.startswith("#")]
    i, kind = int(rng.choice(entries)), rng.integers(4)
    if kind == 0:
        key = lines[i].split(" = ")[0]
        lines[i] = f"{key} = {WORDS[rng.integers(len(WORDS))]}"
    elif kind == 1:
        lines[i] = lines[i][:1] + lines[i]
    elif kind == 2:
        lines.insert(i, lines[i])
    content = bytearray("\n".join(lines).encode())
    if kind == 3:
        for position in rng.integers(len(content), size=rng.integers(1, 8)):
            content[position] = rng.integers(256)
    return bytes(content)


# of the case file, and as many of a folder's files
MUTATIONS = [range(5), pytest.param(range(5, 100), marks=pytest.mark.slow)]


def first_refused(attempt, capsys):
    """Damage inputs by ``attempt()``, which gives the command that reads one, until one is refused.

    What still is an input runs.
    """
    signal.alarm(SECONDS)
    while not refused(attempt(), capsys):
        pass


@pytest.mark.parametrize("numbers", MUTATIONS, ids=len)
def test_a_mutated_case_file_is_refused_in_one_line(numbers, bounded, only_read, tmp_path, capsys):
    text, file = case_text(example()), tmp_path / "case.toml"
    # damage of comments changes nothing
    text = "\n".join(line.split(" # ")[0] for line in text.splitlines())

    def attempt(rng):
        file.write_bytes(mutated(text, rng))
        return ["run", str(file)]

    for number in numbers:
        first_refused(functools.partial(attempt, np.random.default_rng(number)), capsys)


def test_hostile_toml_is_refused(bounded, only_read, tmp_path, capsys):
    file = tmp_path / "case.toml"
    nested, digits = "a = " + "[" * 2000 + "]" * 2000, "[plate]\nwidth = " + "9" * 5000
    for text in (
        nested,
        "a." * 3000 + "b = 1",
        digits,
        "\x00",
        "\ufeff[plate]",
        "[[plate]]\n" * 50,
    ):
        file.write_text(text)
        assert refused(["run", str(file)], capsys), text[:20]


@pytest.mark.parametrize("numbers", MUTATIONS, ids=len)
def test_a_mutated_folder_is_refused_in_one_line(
    numbers, bounded, run_folder, path, tmp_path, monkeypatch, capsys
):
    """By resume and by plot, both of which read all three files.

    What would be computed from them is left out.
    """
    monkeypatch.setattr("jaxgel.cases.case.Case.model", lambda case: path.model)
    monkeypatch.setattr(
        "jaxgel.cases.resume.Recorder",
        lambda _, case, *__: SimpleNamespace(case=case, begin=lambda _: None),
    )
    for name in ("run_recorded", "draw"):
        monkeypatch.setattr(folders, name, lambda *_, **__: 0)
    files = {
        name: (run_folder / name).read_bytes()
        for name in ("summary.json", "history.csv", "states.npz")
    }

    def attempt(rng):
        for name, content in files.items():
            (tmp_path / name).write_bytes(content)
        name = str(rng.choice(list(files)))
        content = bytearray(files[name])
        for position in rng.integers(len(content), size=rng.integers(1, 30)):
            content[position] = rng.integers(256)
        if rng.random() < 0.3:
            del content[rng.integers(len(content)) :]
        (tmp_path / name).write_bytes(content)
        return [str(rng.choice(["plot", "resume"])), str(tmp_path)]

    for number in numbers:  # with a digit of a residual changed it is a folder still
        first_refused(functools.partial(attempt, np.random.default_rng(number)), capsys)
