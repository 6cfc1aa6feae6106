"""What the README shows can be typed."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from jaxgel.cases import load_case
from jaxgel.cli import command_line as cli
from jaxgel.cli.parser import parse
from jaxgel.io import load_run

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language):
    """The README's code blocks in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)


@pytest.fixture
def quick_start(tmp_path, monkeypatch, capsys):
    """Names that the README's first example defines and what it prints, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    example = blocks("python")[0]
    assert len([line for line in example.splitlines() if line.strip()]) <= 10
    names = {}
    exec(compile(example, "README.md", "exec"), names)
    return names, capsys.readouterr().out


def test_the_quick_start_runs_and_draws(quick_start, tmp_path):
    assert (tmp_path / "rotation.png").stat().st_size > 0
    rotation, loss, unstable = map(float, quick_start[1].split())
    assert rotation > 20 and 0.1 < loss < 0.3 and unstable == 0


@pytest.mark.slow
def test_a_step_along_the_slope_of_the_second_example_turns_the_core_farther(quick_start):
    names, _ = quick_start
    exec(compile(blocks("python")[1], "README.md", "exec"), names)
    turned = names["rotation"](names["jnp"].array([5.0, 4.0]) + 0.01 * names["slope"])
    assert turned > names["angle"]


def test_the_case_file_is_a_case(tmp_path):
    (text,) = blocks("toml")
    (tmp_path / "valve.toml").write_text(text)
    assert load_case(str(tmp_path / "valve.toml")).plate.holes


@pytest.mark.slow
def test_the_case_file_can_be_run(tmp_path):
    (text,) = blocks("toml")
    (tmp_path / "valve.toml").write_text(text)
    changes = [
        "--mu-start",
        "-3",
        "--mu-end",
        "-2",
        "--steps",
        "2",
        "--spacing",
        "0.8",
        "--no-plots",
        "--quiet",
    ]
    assert (
        cli.main(["run", str(tmp_path / "valve.toml"), "--out", str(tmp_path / "out"), *changes])
        == 0
    )
    assert len(load_run(tmp_path / "out").mu) == 2


@pytest.mark.parametrize(
    "command", re.findall(r"`jaxgel ([^`\n]*)`", README) + ["run sample-1 --out out/sample-1"]
)
def test_commands_in_the_text_are_commands(command):
    words = command.split()
    if words[-1] == "--help":
        return
    args = parse(words)
    if words[0] == "run" and not words[1].endswith(".toml"):
        assert load_case(args.case).name == args.case


def test_the_readme_is_short_and_its_links_lead_somewhere():
    assert len(README.splitlines()) < 150
    links = [
        link for link in re.findall(r"\]\(([^)]+)\)", README) if not link.startswith("https://")
    ]
    assert links and all((ROOT / link).exists() for link in links)


def test_the_installed_and_the_documented_dependencies_agree():
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    listed = re.search(r"^dependencies = \[(.*?)^\]", project, flags=re.MULTILINE | re.DOTALL)
    text = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    table = re.search(r"^\| package \|.*?\n\n", text, flags=re.MULTILINE | re.DOTALL)
    assert listed
    assert table
    names = {
        re.match(r"[\w-]+", entry).group() for entry in re.findall(r'"([^"]+)"', listed.group(1))
    }
    documented = {
        name.strip()
        for row in table.group().splitlines()[2:]
        if row
        for name in row.split("|")[1].split(",")
    }
    assert documented == names


def test_every_dotted_name_of_the_documentation_resolves_after_importing_jaxgel_alone():
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    names = {
        name
        for page in pages
        for name in re.findall(
            r"(?<![\w./-])jaxgel(?:\.[A-Za-z_]\w*)+", page.read_text(encoding="utf-8")
        )
    }
    names -= {name for name in names if name.rpartition(".")[2] in {"toml", "py", "html"}}
    assert len(names) > 50
    program = (
        "import functools, sys, jaxgel\n"
        "def missing(name):\n"
        "    try:\n"
        "        functools.reduce(getattr, name.split('.')[1:], jaxgel)\n"
        "    except AttributeError:\n"
        "        return name\n"
        "print(*filter(None, map(missing, sys.argv[1:])))"
    )
    found = subprocess.run(
        [sys.executable, "-c", program, *sorted(names)], capture_output=True, text=True, check=True
    )
    assert found.stdout.split() == []
