"""The command line swells a case in time: files, output, and a killed run continued."""

import json
import re
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from studies import COARSE, Interrupted, changed

from jaxgel.cases import load_path
from jaxgel.cases import resume as resuming
from jaxgel.cli import command_line as cli
from jaxgel.io import load_run
from jaxgel.observables import COLUMNS, uptake

pytestmark = pytest.mark.thorough

TIMES = [0.001, 0.01, 0.1, 0.2, 1.0]
CASE = (
    changed(COARSE, ("radius = 1.1\n", "radius = 1.1\nbath = { mu = -1.0, ramp = 0.15 }\n"))
    + (
        f'[gel]\nchi = 0.1\n[sweep]\nmu_start = -4.0\n[time]\ntimes = {TIMES}\nunit = "h"\n'
        "[bath]\nmu = -1.5\n"
    )
    + "[output]\nfigures = false\nanimation = false\n"
)
"""The tiny plate in two baths, one of which has a kink between two of the times."""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a whole run, with ``after-k`` as it was after k states, and the output."""
    parent = tmp_path_factory.mktemp("time")
    (parent / "tiny.toml").write_text(CASE)
    command = ["run", str(parent / "tiny.toml"), "--out", str(parent / "whole")]
    with pytest.MonkeyPatch.context() as patch, (parent / "printed.txt").open("w") as printed:
        patch.setattr(resuming, "Recorder", Interrupted)
        patch.setattr(sys, "stdout", printed)
        assert cli.main(command) == 0
    return parent / "whole"


def contents(folder):
    """File -> its bytes, of the summary all but the seconds that the run took."""
    files = {
        str(file.relative_to(folder)): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file()
    }
    summary = json.loads(files["summary.json"])
    return files | {
        "summary.json": {key: value for key, value in summary.items() if key != "wall_seconds"}
    }


def assert_same(folder, other):
    one, two = contents(folder), contents(other)
    assert one.keys() == two.keys()
    assert [name for name in one if one[name] != two[name]] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mu", "text"), [(-60.0, "bath.mu: -60 is too low"), (0.5, "bath.mu: 0.5 is not accepted")]
)
def test_a_bath_that_is_refused_leaves_former_results(run, tmp_path, capsys, mu, text):
    """Too dry for the gel, or above the pure solvent."""
    folder = shutil.copytree(run, tmp_path / "former")
    (tmp_path / "other.toml").write_text(changed(CASE, ("mu = -1.5\n", f"mu = {mu}\n")))
    assert cli.main(["run", str(tmp_path / "other.toml"), "--out", str(folder)]) == 2
    assert text in capsys.readouterr().err and contents(folder) == contents(run)


def test_a_run_in_time_leaves_its_files(run):
    """Time is the first column and the control, the uptake the last column.

    The states hold what the solvent needs.
    """
    found = load_run(run)
    assert found.control == ("t", "h") and list(found.history) == ["t", *COLUMNS, "uptake"]
    np.testing.assert_array_equal(found.history["uptake"], uptake(load_path(run)))
    np.testing.assert_array_equal(found.value, [0.0, *TIMES])
    assert found.states["potential"].shape == found.states["pressure"].shape and found.states[
        "supplied"
    ].shape == (6, 2)
    assert found.summary["status"] == "complete" and 0 < found.summary["t_resolved"] < 1
    path = load_path(run)
    assert path.t.tolist() == [0.0, *TIMES] and path.control.unit == "h" and path.stop.ok
    np.testing.assert_array_equal(path.potential, found.states["potential"])
    assert {file.name for file in run.iterdir()} == {
        "summary.json",
        "history.csv",
        "states.npz",
        "series.pvd",
        "vtu",
    }


def test_a_run_in_time_prints_its_times_and_from_when_on_it_resolves_the_layer(run):
    """States before that time are counted."""
    printed, resolved = (
        (run.parent / "printed.txt").read_text(),
        load_run(run).summary["t_resolved"],
    )
    rows = [line.split() for line in printed.splitlines() if re.match(r" +\d", line)]
    assert [float(row[0]) for row in rows] == [0.0, *TIMES]
    assert f"the boundary layer is resolved from t = {resolved:.3g} h on\n" in printed
    early = sum(t < resolved for t in TIMES)
    assert (
        early
        and f"{early} states are before t = {resolved:.3g} h: their uptake is an estimate"
        in printed
    )


@pytest.mark.parametrize("k", [4, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 5))])
def test_a_killed_run_in_time_ends_with_the_same_bytes(run, k, tmp_path):
    """After its first state, and before and after the kink of a bath.

    With a row that has no state yet, as after a kill between both.
    """
    copy = tmp_path / "copy"
    shutil.copytree(run.with_name(f"after-{k}"), copy)
    shutil.copy(run.with_name(f"after-{k + 1}") / "history.csv", copy / "history.csv")
    assert load_run(copy).summary["status"] == "running"
    assert cli.main(["resume", str(copy), "--quiet"]) == 0
    assert_same(copy, run)


@pytest.mark.slow
def test_a_run_in_time_killed_twice_at_any_moment_ends_with_the_same_bytes(run, tmp_path):
    """By a signal that no program sees."""
    folder, moments = tmp_path / "killed", np.random.default_rng(3)
    command = ["run", str(run.parent / "tiny.toml"), "--out", str(folder), "--quiet"]
    for rows in (2, 4):
        process = subprocess.Popen(
            [sys.executable, "-m", "jaxgel", *command],
            stderr=subprocess.DEVNULL,
            stdin=subprocess.DEVNULL,
        )
        while process.poll() is None and not (
            (folder / "history.csv").is_file()
            and (folder / "history.csv").read_bytes().count(b"\n") > rows
        ):
            time.sleep(0.02)
        time.sleep(moments.uniform(0, 0.5))
        process.kill()
        process.wait()
        command = ["resume", str(folder), "--quiet"]
    assert cli.main(command) == 0
    assert_same(folder, run)


@pytest.mark.slow
def test_ctrl_c_keeps_the_states_of_a_run_in_time(run, tmp_path, monkeypatch, capsys):
    """And the run goes on to the same bytes."""

    class Stopped(Interrupted):
        def __call__(self, step):
            super().__call__(step)
            if len(self.records) == 3:
                signal.raise_signal(signal.SIGINT)

    folder = tmp_path / "whole"
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(resuming, "Recorder", Stopped)
            assert cli.main(["run", str(run.parent / "tiny.toml"), "--out", str(folder)]) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert (
        "3 states in" in capsys.readouterr().out
        and load_run(folder).summary["status"] == "interrupted"
    )
    assert cli.main(["resume", str(folder), "--quiet"]) == 0
    assert_same(folder, run)


@pytest.mark.slow
def test_a_run_in_time_that_stops_early_says_at_which_time(run, tmp_path, monkeypatch, capsys):
    """Where an outline meets itself; what there is is kept."""
    answers = iter([False, False, True])
    monkeypatch.setattr("jaxgel.transient.run.overlaps", lambda *_: next(answers))
    assert cli.main(["run", str(run.parent / "tiny.toml"), "--out", str(tmp_path), "--quiet"]) == 3
    reason = "stopped after t = 0.01: hole boundaries touch or overlap"
    assert (
        capsys.readouterr()
        .err.splitlines()[-1]
        .startswith(f"jaxgel: the run stopped early: {reason}")
    )
    found = load_run(tmp_path)
    assert (found.summary["status"], found.summary["stop"], len(found.value)) == (
        "stopped",
        "SELF_CONTACT",
        3,
    )
    assert found.summary["reason"].startswith(reason)


def test_a_run_of_other_times_is_not_continued(run, tmp_path, capsys):
    folder = tmp_path / "copy"
    shutil.copytree(run.with_name("after-3"), folder)
    summary = json.loads((folder / "summary.json").read_text())
    summary["options"]["time"]["times"] = [0.001, 0.02, 1.0]
    (folder / "summary.json").write_text(json.dumps(summary))
    assert cli.main(["resume", str(folder)]) == 2
    assert re.fullmatch(
        (
            r"jaxgel: error: folder: the t in '[^\n]* are not those of the case in its "
            r"summary\.json; [^\n]*\n"
        ),
        capsys.readouterr().err,
    )


def test_states_without_the_solvent_are_not_continued(run, tmp_path, capsys):
    """Or of another shape; the files stay."""
    folder = tmp_path / "copy"
    shutil.copytree(run.with_name("after-3"), folder)
    arrays = dict(np.load(folder / "states.npz"))
    potential = arrays.pop("potential")
    for others, message in (
        ({}, "has no potential"),
        ({"potential": potential[:, 1:]}, "potential has shape"),
        ({"potential": potential[0, 0]}, "shape"),
    ):
        np.savez(folder / "states.npz", **arrays, **others)
        before = {file.name: file.read_bytes() for file in folder.glob("*.*")}
        assert cli.main(["resume", str(folder)]) == 2
        assert re.fullmatch(
            rf"jaxgel: error: folder: [^\n]*{message}[^\n]*\n", capsys.readouterr().err
        )
        assert {file.name: file.read_bytes() for file in folder.glob("*.*")} == before


BUCKLING = """
[plate]
sample = "sample-4"
[sweep]
mu_start = -4.9678
[time]
times = [0.01, 0.5, 2.0]
[bath]
mu = -1.3
[discretisation]
spacing = 1.1
[output]
figures = false
animation = false
"""


@pytest.mark.slow
def test_a_loss_of_stability_that_ends_a_run_is_an_event_of_its_summary(tmp_path, capsys):
    """With its time; on the branch that goes on the table of states has it."""
    (tmp_path / "buckling.toml").write_text(BUCKLING)
    assert (
        cli.main(
            ["run", str(tmp_path / "buckling.toml"), "--out", str(tmp_path / "out"), "--quiet"]
        )
        == 3
    )
    assert "stopped after t = 0.5: at t = 2 the state is unstable" in capsys.readouterr().err
    found = load_run(tmp_path / "out")
    (event,) = [one for one in found.summary["events"] if one["event"] == "bifurcation"]
    assert (event["state"], event["t_before"], event["t"]) == (3, 0.5, 2.0) and len(
        found.value
    ) == 3
    assert (
        event["text"]
        == "the state becomes unstable, with which the run ends, between t = 0.5 and 2"
    )


MAP = '[map]\nsamples = "grid"\n[[parameters]]\nof = "chi"\nvalues = [0.1, 0.2]\n'


def test_commands_on_equilibria_refuse_a_case_in_time_in_one_line(run, tmp_path, capsys):
    """Each names the section time, and writes nothing."""
    case = str(run.parent / "tiny.toml")
    (tmp_path / "map.toml").write_text(f'case = "{case}"\n' + MAP)
    for command in ("critical", "loop", "waves", "map"):
        given = str(tmp_path / "map.toml") if command == "map" else case
        assert cli.main([command, given, "--out", str(tmp_path / "out")]) == 2, command
        assert re.fullmatch(
            rf"jaxgel: error: time: is not accepted by jaxgel {command}, [^\n]*\n",
            capsys.readouterr().err,
        ), command
    for option in (
        ["--mu-end", "-1"],
        ["--back"],
        ["--contact", "on"],
        ["--imperfection", "0.1"],
        ["--steps", "3"],
        ["--imperfection", "0.1"],
    ):
        assert cli.main(["run", case, *option, "--out", str(tmp_path / "out")]) == 2, option
        assert re.fullmatch(
            rf"jaxgel: error: sweep\.{option[0][2:].replace('-', '_')}: [^\n]* \[time\][^\n]*\n",
            capsys.readouterr().err,
        ), option
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_commands_on_a_folder_take_a_run_in_time(run, tmp_path, capsys):
    """Figures, outline at a time, netCDF and page."""
    assert cli.main(["plot", str(run), "--out", str(tmp_path)]) == 0
    assert {file.name for file in tmp_path.iterdir()} >= {
        "pattern.png",
        "curves.png",
        "pattern.gif",
    }
    assert (
        cli.main(["outline", str(run), "--at", "0.1", "--out", str(tmp_path / "swollen.dxf")]) == 0
    )
    assert cli.main(["outline", str(run), "--at", "2.0"]) == 2
    assert "t: 2 is beyond the path" in capsys.readouterr().err
    assert cli.main(["export", str(run), "--out", str(tmp_path / "run.nc")]) == 0
    assert cli.main(["view", str(run), "--out", str(tmp_path / "view.html")]) == 0


def test_init_writes_a_case_in_time(tmp_path, monkeypatch, capsys):
    """Of the example or of a built-in case."""
    monkeypatch.chdir(tmp_path)
    assert cli.main(["init", "--time"]) == 0 and cli.main(["init", "--from", "two-sizes"]) == 0
    assert (
        "[bath]" in (tmp_path / "case.toml").read_text()
        and "[bath]" in (tmp_path / "two-sizes.toml").read_text()
    )
    for arguments in (["--time", "--regions", "b"], ["--time", "--from", "sample-1"]):
        assert cli.main(["init", *arguments]) == 2
        assert re.fullmatch(
            r"jaxgel: error: [^\n]*leave one of the two out\n", capsys.readouterr().err
        )
