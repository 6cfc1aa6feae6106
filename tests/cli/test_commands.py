"""The command line: files, exit codes, one line per error, nothing lost if stopped."""

import contextlib
import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
from studies import TINY

import jaxgel
from jaxgel.cli import command_line as cli
from jaxgel.cli import starting
from jaxgel.continuation import SweepFailed
from jaxgel.equilibrium import Status
from jaxgel.io import interruptible, load_run

SMALL = ["--spacing", "1.1", "--no-plots"]
FILES = {
    "summary.json",
    "history.csv",
    "states.npz",
    "pattern.png",
    "curves.png",
    "pattern.gif",
    "series.pvd",
    "vtu",
}
CASE = "[plate]\nwidth = 22.0\nheight = 22.0\n"


def hole(x, y, radius):
    return f'[[holes]]\nkind = "circle"\ncentre = [{x}, {y}]\nradius = {radius}\n'


@pytest.mark.smoke
def test_a_run_leaves_the_files_of_the_interface(run_folder):
    assert {file.name for file in run_folder.iterdir()} == FILES


@pytest.mark.slow
def test_plot_draws_the_figures_of_a_folder_again(run_folder, tmp_path, capsys):
    assert cli.main(["plot", str(run_folder), "--out", str(tmp_path / "again"), "--mp4"]) == 0
    drawn = {file.name for file in (tmp_path / "again").iterdir()}
    assert drawn == FILES - {"summary.json", "history.csv", "states.npz"} | {"pattern.mp4"}
    assert capsys.readouterr().err == ""


def test_a_run_prints_a_table_its_events_and_where_its_files_are(tmp_path, capsys):
    arguments = [
        "run",
        "sample-1",
        "--mu-start",
        "-4.9",
        "--mu-end=-4e0",
        "--steps",
        "2",
        *SMALL,
        "--out",
        str(tmp_path / "run"),
    ]
    assert cli.main(arguments) == 0
    printed = capsys.readouterr().out
    rows = [line.split() for line in printed.splitlines() if re.match(r" *-\d", line)]
    assert [float(row[0]) for row in rows] == [-4.9, -4.0]
    assert str(tmp_path / "run") in printed
    np.testing.assert_allclose(load_run(tmp_path / "run").mu, [-4.9, -4.0])


def test_options_reach_the_model(tmp_path, tiny_plate, monkeypatch):
    models = []

    def fail(problem, *_, **__):
        models.append(problem.model)
        raise SweepFailed("sweep: not wanted")

    monkeypatch.setattr("jaxgel.bifurcation.imperfections.sweep", fail)
    (tmp_path / "tiny.toml").write_text(
        CASE.replace("22.0", "4.0") + 'edges = { top = "free" }\n' + hole(0.1, -0.2, 1.1)
    )
    options = dict(spacing=tiny_plate.spacing, nodes_per_hole=12, basis="linear", dmax=2.5)
    arguments = [
        word
        for name, value in options.items()
        for word in (f"--{name.replace('_', '-')}", str(value))
    ]
    arguments += ["--mu-start", "-4.9", "--mu-end", "-4.8", "--steps", "2", "--no-plots", "--quiet"]
    assert (
        cli.main(["run", str(tmp_path / "tiny.toml"), *arguments, "--out", str(tmp_path / "out")])
        == 3
    )
    assert (
        json.loads((tmp_path / "out" / "summary.json").read_text())["options"]["discretisation"]
        == options
    )
    (model,) = models
    assert model.n_nodes == len(jaxgel.make_cloud(tiny_plate).nodes)
    assert all(getattr(model, name) == options[name] for name in ("basis", "dmax"))


def test_unusable_arguments_are_one_line_and_exit_code_2(capsys):
    for arguments, message in [
        (["rnu", "sample-1"], r"command: 'rnu' is unknown; did you mean 'run'\?"),
        (["run", "smaple-1"], r"case: unknown name 'smaple-1'; did you mean 'sample-1'\?"),
        (
            ["run", "sample-1", "--spaceing", "1"],
            r"'--spaceing' is not an option of run; did you mean '--spacing'\?",
        ),
        (["run"], "CASE"),
        (["run", "sample-1", "--mu-end", "nan"], "mu_end: nan"),
        (["run", "sample-1", "--mu-end", "-inf"], "mu_end: -inf"),
        (["run", "sample-1", "--mu-end", "high"], "--mu-end: 'high' is not a number"),
        (["run", "sample-1", "--mu-start", "-1", "--mu-end", "-1"], "must differ"),
        (
            ["run", "sample-1", "--steps", "many"],
            "--steps: 'many' is neither auto nor a whole number",
        ),
        (
            ["run", "sample-1", "--basis", "quadratc"],
            r"basis: 'quadratc' is unknown; did you mean 'quadratic'\?",
        ),
        (["run", "sample-1", "--spacing", "-1"], r"spacing: -1\.0"),
        (["run", "sample-1", "--dmax", "0.5"], r"dmax|support"),
        (["run", "missing.toml"], "cannot read 'missing.toml'"),
        (["outline", "sample-1", "--at", "0.3"], "--mu/--at: 'sample-1' is a case"),
        (["outline", "sample-1", "--at", "nan"], "--mu/--at: nan is not a finite number"),
        (["plot", "nowhere"], r"'nowhere' holds no summary\.json"),
        (["plot"], "DIR"),
        ([], "COMMAND"),
    ]:
        check_refused(arguments, message, capsys)


def test_unusable_cases_are_one_line_and_exit_code_2(tmp_path, capsys):
    for text, message in [
        (CASE + hole(0, 0, 4) + hole(3, 0, 4), r"holes\[0\], holes\[1\]"),
        (CASE + hole(30, 0, 4), r"holes\[0\].*outside the plate"),
        (
            CASE + hole(-4.6, 0, 5) + hole(5.6, 0, 5) + "[discretisation]\nspacing = 2.2\n",
            "ligament",
        ),
        (CASE + hole(0, 0, 4) + "[gel]\nNv = -1.0\n", "Nv"),
        (CASE + hole(0, 0, 4) + "[gel]\nchi = 2.0\n", "chi"),
        (CASE + hole(0, 0, 4) + "[sweep]\nmu = [-2.0, -2.0]\n", "mu"),
        (CASE + "[[holes]\n", "is not TOML"),
    ]:
        (tmp_path / "case.toml").write_text(text)
        check_refused(
            ["run", str(tmp_path / "case.toml"), "--out", str(tmp_path / "out")], message, capsys
        )
        assert not (tmp_path / "out" / "summary.json").exists(), text


def test_a_folder_that_cannot_be_written_is_refused(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    check_refused(
        ["run", "square", "--out", str(tmp_path / "file" / "run")], "out: cannot write in", capsys
    )


def check_refused(arguments, message, capsys):
    """The command ends with exit code 2 and one line on standard error that matches ``message``."""
    assert cli.main(arguments) == 2, arguments
    printed = capsys.readouterr()
    assert re.fullmatch(r"jaxgel: error: [^\n]*\n", printed.err), arguments
    assert re.search(message, printed.err), (arguments, printed.err)
    assert printed.out == "", arguments


def test_a_sweep_that_stops_early_is_exit_code_3_with_its_reason(
    path, tmp_path, monkeypatch, capsys
):
    stopped = dataclasses.replace(
        path, stop=Status.STEP_TOO_SMALL, stop_text="stopped after mu = -0.9: reason"
    )
    steps = [path[k] for k in range(len(path))]

    def sweep(*_, observer, **__):
        return list(map(observer.accepted, steps)) and stopped

    monkeypatch.setattr("jaxgel.bifurcation.imperfections.sweep", sweep)
    assert cli.main(["run", "sample-1", *SMALL, "--quiet", "--out", str(tmp_path)]) == 3
    assert "stopped after mu = -0.9: reason" in capsys.readouterr().err
    run = load_run(tmp_path)
    assert (run.summary["status"], run.summary["reason"]) == (
        "stopped",
        "stopped after mu = -0.9: reason",
    )
    assert len(run.mu) == len(path.mu)


def test_a_sweep_without_a_first_state_is_exit_code_3(tmp_path, monkeypatch, capsys):
    def fail(*_, **__):
        raise SweepFailed("sweep: no equilibrium at mu = -4.9")

    monkeypatch.setattr("jaxgel.bifurcation.imperfections.sweep", fail)
    assert cli.main(["run", "square", "--quiet", "--out", str(tmp_path)]) == 3
    assert "no equilibrium at mu = -4.9" in capsys.readouterr().err
    assert '"status": "failed"' in (tmp_path / "summary.json").read_text()


def started(folder, rows):
    """A process of ``python -m jaxgel run`` with many steps, once ``rows`` of them are on disk."""
    arguments = ["run", "sample-1", *SMALL, "--steps", "3000", "--out", str(folder)]
    process = subprocess.Popen(
        [sys.executable, "-m", "jaxgel", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 240
    while time.monotonic() < deadline and process.poll() is None:
        if (folder / "history.csv").is_file() and (folder / "history.csv").read_bytes().count(
            b"\n"
        ) > rows:
            return process
        time.sleep(0.05)
    process.kill()
    raise AssertionError(process.communicate()[1].decode())


@pytest.mark.slow
def test_ctrl_c_keeps_all_finished_steps(tmp_path):
    process = started(tmp_path, rows=3)
    process.send_signal(signal.SIGINT)
    errors = process.communicate(timeout=120)[1].decode()
    assert process.returncode == 130
    assert "Traceback" not in errors
    run = load_run(tmp_path)
    assert run.summary["status"] == "interrupted"
    assert len(run.mu) == len(run.x) == run.summary["states"] >= 3


@pytest.mark.slow
@pytest.mark.parametrize(("argument", "unbuffered"), [("schema", "1"), ("--help", "")])
def test_a_reader_who_leaves_ends_a_command_without_a_word(argument, unbuffered):
    """As ``jaxgel schema | head -1`` does; the code is that of other tools, 128 + SIGPIPE."""
    read, write = os.pipe()
    os.close(read)
    environment = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    process = subprocess.run(
        [sys.executable, "-m", "jaxgel", argument],
        stdout=write,
        stderr=subprocess.PIPE,
        env=environment,
    )
    os.close(write)
    assert (process.returncode, process.stderr) == (128 + signal.SIGPIPE, b"")


def test_another_pipe_that_breaks_is_reported(monkeypatch, capsys):
    def fail(*_):
        raise BrokenPipeError("of ffmpeg")

    monkeypatch.setattr(starting, "list_samples", fail)
    assert cli.main(["samples"]) == 3
    assert capsys.readouterr().err == "jaxgel: error: of ffmpeg\n"


def test_samples_lists_every_case(capsys):
    assert cli.main(["samples"]) == 0
    names = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert names == [
        *(f"sample-{i}" for i in range(1, 10)),
        "lattice",
        "square",
        "sample-1-bath",
        "two-sizes",
    ]


def test_help_and_version_are_exit_code_0(capsys):
    for arguments in (["--help"], ["run", "--help"], ["plot", "--help"], ["--version"]):
        with pytest.raises(SystemExit) as end:
            cli.main(arguments)
        assert end.value.code == 0
        assert "jaxgel" in capsys.readouterr().out


def test_the_version_is_that_of_the_project(capsys):
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    with pytest.raises(SystemExit):
        cli.main(["--version"])
    assert capsys.readouterr().out.split() == ["jaxgel", project["version"]]


@pytest.fixture
def _ctrl_c():
    """Python's own reaction to Ctrl-C, which a process started in the background does not have."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_ctrl_c")
def test_ctrl_c_is_not_lost_with_its_exception():
    """An exception in a destructor is only printed.

    The next step still knows that Ctrl-C was pressed.
    """
    with interruptible() as stop_if_asked:
        stop_if_asked()
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            stop_if_asked()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.slow
def test_loop_writes_what_it_found(tmp_path, capsys):
    """A plate with a free edge, deswelled by the options, comes back the way it went."""
    case = tmp_path / "free.toml"
    case.write_text(TINY)
    folder, driven = tmp_path / "loop", ["--control=chi", "--from=0.1", "--to=0.2", "--at-mu=-4.0"]
    assert cli.main(["loop", str(case), *driven, "--quantity", "J_mean", "--out", str(folder)]) == 0
    assert "no loop: up and down the same branch, width 0" in capsys.readouterr().out
    assert {file.name for file in folder.iterdir()} == {"loop.json", "loop.csv", "loop.png"}
    record = json.loads((folder / "loop.json").read_text())
    assert (
        record["control"],
        record["unit"],
        record["width"],
        record["fold_up"],
        record["stop"],
    ) == ("chi", "", 0.0, None, "converged")
    assert cli.main(["loop", str(case), "--quantity", "status", "--out", str(folder)]) == 2
    assert capsys.readouterr().err.startswith(
        "jaxgel: error: quantity: 'status' is not one of free_stretch, "
    )
