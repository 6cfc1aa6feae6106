"""An interrupted run continues to the states of an uninterrupted one, or is refused."""

import json
import os
import re
import shutil
import subprocess
import sys
import time

import jax
import numpy as np
import pytest
from studies import TINY, killed

from jaxgel.cases import load_path
from jaxgel.cli import command_line as cli
from jaxgel.io import load_run

FILES = "[output]\nfigures = false\nanimation = false\n[sweep]\n"
GIVEN = TINY + FILES + "mu = [-4.9, -4.0, -3.0, -2.0, -1.5, -1.2]\n"
CHOSEN = TINY + FILES + 'steps = "auto"\nmu_end = -1.2\n'


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """As `killed`, with chosen steps."""
    return killed(CHOSEN, tmp_path_factory.mktemp("restart"))


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """As `killed`, with given mu."""
    return killed(GIVEN, tmp_path_factory.mktemp("given"))


@pytest.mark.thorough
@pytest.mark.parametrize("run", [pytest.param("given", marks=pytest.mark.slow), "swept"])
@pytest.mark.parametrize(
    "first",
    [pytest.param(True, marks=pytest.mark.slow), False],
    ids=["after the first", "in the middle"],
)
def test_a_run_killed_after_a_state_ends_with_the_same_states(run, first, request, tmp_path):
    folder, path = request.getfixturevalue(run)
    k = 1 if first else len(path) // 2
    copy = tmp_path / f"after-{k}"
    shutil.copytree(folder.with_name(copy.name), copy)
    assert load_run(copy).summary["status"] == "running"
    assert cli.main(["resume", str(copy), "--quiet", "--no-plots"]) == 0
    assert_same(copy, folder, k)
    assert (copy / "series.pvd").is_file()


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL there")
def test_a_run_killed_twice_at_any_moment_ends_with_the_same_states(swept, tmp_path):
    """The proof with twenty kills is benchmarks/kill.py."""
    folder, moments = tmp_path / "killed", np.random.default_rng(11)
    command = [
        "run",
        str(swept[0].parent / "case.toml"),
        "--out",
        str(folder),
        "--quiet",
        "--no-plots",
    ]
    for _ in range(2):
        process = subprocess.Popen(
            [sys.executable, "-m", "jaxgel", *command],
            stderr=subprocess.PIPE,
            stdin=subprocess.DEVNULL,
        )
        while process.poll() is None and len(list(folder.glob("*"))) < 3:
            time.sleep(0.02)
        time.sleep(moments.uniform(0, 2))
        process.kill()
        process.communicate()
        assert load_run(folder)
        command = ["resume", str(folder), "--quiet", "--no-plots"]
    assert cli.main(command) == 0
    assert_same(folder, swept[0])


def assert_same(folder, other, k=1):
    """The two runs have the same first ``k`` states, equal ends, and equal states at equal mu.

    States agree to the solver's tolerance.
    """
    one, two = load_run(folder), load_run(other)
    np.testing.assert_array_equal(one.x[:k], two.x[:k])
    assert one.mu[-1] == two.mu[-1]
    _, i, j = np.intersect1d(one.mu, two.mu, return_indices=True)
    np.testing.assert_allclose(one.x[i], two.x[j], atol=1e-9)
    for name in ("energy", "J_mean", "area_reduction", "rotation_deg"):
        np.testing.assert_allclose(one.history[name][i], two.history[name][j], rtol=1e-9, atol=1e-9)
    assert {key: one.summary[key] for key in ("status", "reason", "stop")} == {
        key: two.summary[key] for key in ("status", "reason", "stop")
    }


@pytest.mark.thorough
def test_a_path_read_back_is_the_one_that_was_written(swept):
    folder, path = swept
    again = load_path(folder)
    for leaf, original in zip(
        jax.tree.leaves((again.model, again.gel)),
        jax.tree.leaves((path.model, path.gel)),
        strict=True,
    ):
        np.testing.assert_array_equal(leaf, original)
    for name in set(path.__dataclass_fields__) - {"problem"}:
        np.testing.assert_array_equal(getattr(again, name), getattr(path, name), err_msg=name)


@pytest.mark.slow
def test_a_complete_run_is_only_drawn_again(swept, tmp_path, monkeypatch):
    shutil.copytree(swept[0], tmp_path / "copy")
    monkeypatch.setattr("jaxgel.bifurcation.imperfections.sweep", None)
    assert cli.main(["resume", str(tmp_path / "copy"), "--quiet", "--no-plots"]) == 0
    assert_same(tmp_path / "copy", swept[0])


@pytest.mark.slow
def test_a_run_killed_before_its_first_state_starts_again(swept, tmp_path):
    summary = json.loads((swept[0].with_name("after-1") / "summary.json").read_text())
    (tmp_path / "summary.json").write_text(json.dumps(summary | {"states": 0, "events": []}))
    assert cli.main(["resume", str(tmp_path), "--quiet", "--no-plots"]) == 0
    assert_same(tmp_path, swept[0])


@pytest.mark.slow
def test_other_versions_are_said(swept, tmp_path, capsys):
    shutil.copytree(swept[0], tmp_path / "copy")
    edit(tmp_path / "copy", versions={"jax": "0.1"})
    assert cli.main(["resume", str(tmp_path / "copy"), "--no-plots"]) == 0
    assert "jax 0.1 -> " in capsys.readouterr().out


def edit(folder, **entries):
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps(summary | entries))


def other_nodes(folder):
    arrays = dict(np.load(folder / "states.npz"))
    np.savez(folder / "states.npz", **(arrays | {"nodes": arrays["nodes"] + 1e-6}))


def other_mu(folder):
    options = json.loads((folder / "summary.json").read_text())["options"]
    sweep = {name: value for name, value in options["sweep"].items() if name != "steps"}
    edit(folder, options=options | {"sweep": sweep | {"mu_start": -4.0, "mu": [-4.0, -1.0]}})


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (
            lambda folder: edit(folder, format=2),
            r"summary\.json' is damaged or not written by jaxgel: format 2, this version reads 4",
        ),
        (lambda folder: edit(folder, format=99), "format 99, this version reads 4"),
        (lambda folder: edit(folder, stop="GONE"), "'GONE' is no status"),
        (lambda folder: (folder / "summary.json").write_text("{"), r"summary\.json' is damaged"),
        (lambda folder: (folder / "states.npz").write_bytes(b"PK"), r"states\.npz' is damaged"),
        (lambda folder: (folder / "history.csv").unlink(), r"history\.csv' is damaged"),
        (lambda folder: (folder / "summary.json").unlink(), r"holds none of design"),
        (other_nodes, "run the case again"),
        (other_mu, r"are not those of the case in its summary\.json"),
    ],
)
def test_what_cannot_be_continued_is_one_line(swept, tmp_path, capsys, damage, message):
    folder = tmp_path / "copy"
    shutil.copytree(swept[0].with_name("after-2"), folder)  # which no test continues
    damage(folder)
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    assert cli.main(["resume", str(folder)]) == 2
    printed = capsys.readouterr()
    assert re.fullmatch(r"jaxgel: error: folder: [^\n]*\n", printed.err)
    assert re.search(message, printed.err)
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before
