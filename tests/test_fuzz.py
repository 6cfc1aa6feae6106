"""Damaged case files and folders end in exit code 2 and one line, whatever the damage: never a traceback, never unbounded memory."""

import re
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest

from jaxgel import cli, commands
from jaxgel.case_file import case_text, example

MUTATIONS = 100  # of the case file, and as many of a folder's files
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
def only_read(monkeypatch):
    """``jaxgel run`` stops where it would start to compute."""
    monkeypatch.setattr(commands, "run", lambda args: 0 * len(commands.cases.load_case(args.case).table()))


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


def test_mutated_case_files_are_refused_in_one_line(only_read, tmp_path, capsys):
    rng, text, count = np.random.default_rng(3), case_text(example()), 0
    text = "\n".join(line.split(" # ")[0] for line in text.splitlines())  # damage of comments changes nothing
    tracemalloc.start()
    for number in range(MUTATIONS):
        file = tmp_path / f"{number}.toml"
        file.write_bytes(mutated(text, rng))
        count += refused(["run", str(file)], capsys)
    assert tracemalloc.get_traced_memory()[1] < 100 * MEBIBYTE
    tracemalloc.stop()
    assert count > 0.8 * MUTATIONS  # a replaced 22.0 by 2.5 is a case


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 2000 + "]" * 2000,
        "a." * 3000 + "b = 1",
        "[plate]\nwidth = " + "9" * 5000,
        "\x00",
        "\ufeff[plate]",
        "[[plate]]\n" * 50,
    ],
    ids=["nested", "dotted", "digits", "nul", "mark", "arrays"],
)
def test_hostile_toml_is_refused(text, only_read, tmp_path, capsys):
    (tmp_path / "case.toml").write_text(text)
    assert refused(["run", str(tmp_path / "case.toml")], capsys)


def test_mutated_folders_are_refused_in_one_line(run_folder, path, tmp_path, monkeypatch, capsys):
    """By resume and by plot, both of which read all three files; what would be computed from them is left out."""
    monkeypatch.setattr("jaxgel.cases.Case.model", lambda case: path.model)
    monkeypatch.setattr("jaxgel.restart.Recorder", lambda _, case, *__, steps=(), **___: SimpleNamespace(case=case, steps=steps))
    for name in ("_run", "_draw"):
        monkeypatch.setattr(commands, name, lambda *_, **__: 0)
    rng, count = np.random.default_rng(4), 0
    files = {name: (run_folder / name).read_bytes() for name in ("summary.json", "history.csv", "states.npz")}
    tracemalloc.start()
    for _ in range(MUTATIONS):
        for name, content in files.items():
            (tmp_path / name).write_bytes(content)
        name = str(rng.choice(list(files)))
        content = bytearray(files[name])
        for position in rng.integers(len(content), size=rng.integers(1, 30)):
            content[position] = rng.integers(256)
        if rng.random() < 0.3:
            del content[rng.integers(len(content)) :]
        (tmp_path / name).write_bytes(content)
        count += refused([str(rng.choice(["plot", "resume"])), str(tmp_path)], capsys)
    assert tracemalloc.get_traced_memory()[1] < 100 * MEBIBYTE
    tracemalloc.stop()
    assert count > 0.5 * MUTATIONS  # with a digit of a residual changed it is a folder still
