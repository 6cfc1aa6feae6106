"""Parameter maps: the points of a study, their folders and table, and killed processes.

Nothing is lost with these.
"""

import concurrent.futures
import csv
import dataclasses
import json
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from studies import TINY

import jaxgel
from jaxgel.cases import (
    POINT,
    PROBLEM,
    TABLE,
    load_map,
    load_path,
    map_runs,
    map_sensitivity,
    parameter_map,
    resumed_map,
    run_map,
)
from jaxgel.cli import command_line as cli
from jaxgel.continuation import batched, devices_of
from jaxgel.io import TRIES, InThisProcess, Workers, load_run

SQUARE = """
case = "square"
[sweep]
mu_start = -2.0
mu_end = -0.5
steps = 12
[[parameters]]
of = "Nv"
values = [1e-3, 1.5e-3, 2e-3]
"""
QUICK = SQUARE.replace("steps = 12", "steps = 2")  # where no run is killed
HOLE = TINY + '[sweep]\nsteps = 2\nmu_start = -4.0\ncontact = "off"\n'
RADII = (
    '[[parameters]]\nof = "radius"\nvalues = [1.15, 0.9, 2.5]\n[[parameters]]\nof = "mu_end"\n'
    "values = [-2.0]\n"
)


class Inline(InThisProcess):
    """Runs a call where it is submitted.

    ``lost`` maps the names of points to how often their process dies.
    """

    def __init__(self, **lost):
        self.calls, self.lost = 0, lost

    def submit(self, function, /, *args):
        self.calls += 1
        name = f"point_{Path(args[-1]).name}"
        self.lost[name] = self.lost.get(name, 0) - 1
        return super().submit(died if self.lost[name] >= 0 else function, *args)


def died(*_):
    raise concurrent.futures.BrokenExecutor("its process died")


def study(tmp_path, text):
    (tmp_path / "study.toml").write_text(text)
    return load_map(tmp_path / "study.toml")


def table(folder):
    with (folder / TABLE).open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_grid_has_every_combination_and_sobol_samples_fill_the_bounds(tmp_path):
    axes = '[[parameters]]\nof = "centre"\nlower = [0.0, -0.2]\nupper = [0.2, 0.2]\nnumber = 3\n'
    axes += '[[parameters]]\nof = "chi"\nvalues = [0.1, 0.2]\n'
    points = study(tmp_path, HOLE + axes).points
    np.testing.assert_allclose(
        [p["centre"] for p in points[::2]], [[0.0, -0.2], [0.1, 0.0], [0.2, 0.2]], atol=1e-15
    )
    assert [p["chi"] for p in points] == [0.1, 0.2] * 3
    sobol = axes.replace("number = 3\n", "").replace(
        "values = [0.1, 0.2]", "lower = 0.1\nupper = 0.2"
    )
    sobol += '[map]\nsamples = "sobol"\npoints = 13\nseed = 7\n'
    points = study(tmp_path, HOLE + sobol).points
    assert points == study(tmp_path, HOLE + sobol).points
    assert points != study(tmp_path, HOLE + sobol.replace("seed = 7", "seed = 8")).points
    samples = np.array([[*p["centre"], p["chi"]] for p in points])
    assert samples.shape == (13, 3)
    assert np.all((samples >= [0.0, -0.2, 0.1]) & (samples <= [0.2, 0.2, 0.2]))
    # one of the first 8 in each eighth: a Sobol sequence
    assert len(np.unique(np.floor((samples[:8, 0] - 0.0) / 0.2 * 8))) == 8


def test_bad_studies_are_refused(tmp_path, refused, capsys):
    refused(
        lambda text: run_map(study(tmp_path, text), tmp_path / "out", Inline()),
        [
            (HOLE, r"study: parameters is missing; give .*written \[\[parameters\]\]"),
            (
                HOLE + '[[parameters]]\nof = "radios"\nvalues = [1.0]\n',
                r"parameters\[0\]\.of: 'radios' is unknown; did you mean 'radius'\?",
            ),
            (
                HOLE + '[[parameters]]\nof = "radius"\n',
                r"parameters\[0\]: number is missing; a grid takes it .* or values = \[list\]",
            ),
            (
                HOLE + '[[parameters]]\nof = "radius"\nlower = 1.0\nnumber = 3\n',
                r"parameters\[0\]: upper is missing; give a finite number or a list",
            ),
            (
                HOLE + '[[parameters]]\nof = "radius"\nlower = 1.0\nupper = 0.5\nnumber = 3\n',
                r"upper: 0\.5 is not above lower",
            ),
            (
                HOLE + '[[parameters]]\nof = "radius"\nvalues = ["big"]\n',
                r"parameters\[0\]\.values: 'big' is not a finite number",
            ),
            (
                HOLE + '[[parameters]]\nof = "radius"\nvalue = [1.0]\n',
                r"unknown entry 'value'; did you mean 'values'\?",
            ),
            (
                HOLE + RADII + '[map]\nsamples = "sobl"\n',
                r"map\.samples: 'sobl' is unknown; did you mean 'sobol'\?",
            ),
            (
                HOLE + RADII + '[map]\nsamples = "sobol"\n',
                r"map: points is missing; give a whole number of at least 1",
            ),
            (
                HOLE + RADII + '[map]\nsamples = "sobol"\npoints = 4\n',
                r"parameters\[0\]: number and values belong to a grid",
            ),
            (
                HOLE + '[[parameters]]\nof = "Nv"\nvalues = []\n',
                r"parameters\[0\]\.values: \[\] is not a list of 1 or more values",
            ),
            (
                HOLE + '[[parameters]]\nof = "Nv"\nvalues = [1e-3]\nlower = 1.0\n',
                r"\[0\]: unknown entry 'lower'; accepted: .*, values",
            ),
            (
                HOLE + RADII + '[map]\nsamples = "sobol"\npoints = 0\n',
                r"map\.points: 0 is not a whole number of at least 1",
            ),
            (HOLE + RADII + "[map]\nseed = 1\n", r"map: unknown entry 'seed'; accepted: samples"),
            ("map = 3\n" + HOLE + RADII, r"map: 3 is not a table, written \[map\]"),
            (
                HOLE + '[[parameters]]\nof = "Nv"\nvalues = [1e-3]\n' * 2,
                r"parameters: the names Nv, Nv are not all different",
            ),
            (
                HOLE + '[[parameters]]\nof = "Nv"\nvalues = [1e-3]\n[maps]\n',
                r"study: unknown entry 'maps'; did you mean 'map'\?",
            ),
            (HOLE.replace("0.1, -0.2", "0.1, -9.0") + RADII, r"holes\[0\].*outside the plate"),
        ],
    )
    assert cli.main(["map", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr()
    assert re.fullmatch(r"jaxgel: error: [^\n]*\n", printed.err) and printed.out == ""


BOUNDED = (
    '[[parameters]]\nof = "Nv"\nlower = 1e-3\nupper = 2e-3\n[[parameters]]\nof = "chi"\n'
    "lower = 0.0\nupper = 0.4\n"
)
FILE = (
    QUICK.split("[[parameters]]")[0] + BOUNDED + '[map]\nsamples = "file"\npoints = "samples.csv"\n'
)


@pytest.mark.slow
def test_samples_of_a_file_are_the_points_by_the_names_of_their_columns(tmp_path):
    (tmp_path / "samples.csv").write_text("# chi, Nv\n0.4,1e-3\n\n0.1,2e-3\n")
    mapped = study(tmp_path, FILE)
    assert mapped.points == [{"Nv": 1e-3, "chi": 0.4}, {"Nv": 2e-3, "chi": 0.1}]
    rows = run_map(mapped, tmp_path / "out", Inline())
    (tmp_path / "samples.csv").unlink()
    resumed = resumed_map(tmp_path / "out")  # needs the file no more
    assert (resumed.points, resumed.table) == (mapped.points, mapped.table)
    assert run_map(resumed, tmp_path / "out", Inline(), resume=True) == rows
    problem = json.loads((tmp_path / "out" / PROBLEM).read_bytes())
    assert problem == {"num_vars": 2, "names": ["Nv", "chi"], "bounds": [[1e-3, 2e-3], [0.0, 0.4]]}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of SALib's own
def test_salib_draws_the_points_and_analyses_the_table(tmp_path):
    sobol = pytest.importorskip("SALib.sample.sobol")
    from SALib.analyze.sobol import analyze

    problem = {"num_vars": 2, "names": ["Nv", "chi"], "bounds": [[1e-3, 2e-3], [0.0, 0.4]]}
    matrix = sobol.sample(dict(problem), 2, calc_second_order=False, seed=1)
    np.savetxt(tmp_path / "samples.csv", matrix, delimiter=",", header=",".join(problem["names"]))
    run_map(study(tmp_path, FILE), tmp_path / "out", Inline())
    assert json.loads((tmp_path / "out" / PROBLEM).read_bytes()) == problem
    values = np.array([float(row["J_mean"]) for row in table(tmp_path / "out")])
    swelling = np.array([float(row["Nv"]) for row in table(tmp_path / "out")])
    np.testing.assert_array_equal(swelling, matrix[:, 0])
    indices = analyze(problem, values, calc_second_order=False, seed=1)
    assert np.all(np.isfinite(indices["ST"])) and indices["ST"].shape == (2,)


def test_bad_sample_files_are_refused(tmp_path, refused):
    def attempt(text):
        (tmp_path / "samples.csv").write_text(text)
        return study(tmp_path, FILE)

    refused(
        attempt,
        [
            (
                "Nv,chy\n1e-3,0.1\n",
                (
                    r"map\.points: the column 'chy' of .* is unknown; did you mean 'chi'\? "
                    r"accepted: Nv, chi"
                ),
            ),
            ("1e-3,0.1\n", r"map\.points: the column '1e-3' of .* is unknown; accepted: Nv, chi"),
            (
                "Nv\n1e-3\n",
                r"map\.points: the column 'chi' is missing in .*; give one for each of Nv, chi",
            ),
            ("Nv,chi,Nv\n1e-3,0.1,1e-3\n", r"map\.points: the column 'Nv' is there twice"),
            ("Nv,chi\n", r"map\.points: .* has 0 rows below the names of its columns"),
            ("Nv,chi\n1e-3\n", r"map\.points: row 0 of .* has 1 values; give 2"),
            (
                "Nv,chi\n1e-3,0.1\n1e-3,much\n",
                r"map\.points: row 1, chi: 'much' is not a finite number",
            ),
            (
                "Nv,chi\n1e-3,nan\n",
                r"map\.points: row 0, chi: nan is not a number between lower = 0 and upper = 0\.4",
            ),
            (
                "Nv,chi\n3e-3,0.1\n",
                (
                    r"map\.points: row 0, Nv: 0\.003 is not a number between lower = 0\.001 and "
                    r"upper = 0\.002"
                ),
            ),
            ("", r"map\.points: the column 'Nv' is missing"),
        ],
    )
    refused(
        lambda *change: study(tmp_path, FILE.replace(*change)),
        [
            ("samples.csv", "none.csv", r"map\.points: cannot read .*none\.csv': No such file"),
            ('points = "samples.csv"\n', "", r"map: points is missing; it names a CSV file"),
            ('points = "samples.csv"', "points = 3", r"map\.points: 3 is not a text"),
            (
                "upper = 0.4",
                "upper = 0.4\nnumber = 3",
                r"parameters\[1\]: number and values belong to a grid; samples of a file take",
            ),
        ],
    )
    grid = QUICK + "[map]\ngradients = true\n"
    with pytest.raises(
        ValueError, match=r"map\.gradients: True is not accepted with sweep\.imperfection = 0\.1"
    ):
        study(tmp_path, grid.replace("steps = 2", "steps = 2\nimperfection = 0.1"))


@pytest.fixture(scope="module")
def holes(tmp_path_factory):
    """Study, folder and rows of a map of radii: near the study's own, too far, impossible."""
    folder = tmp_path_factory.mktemp("map")
    return (
        (mapped := study(folder, HOLE + RADII)),
        folder / "out",
        run_map(mapped, folder / "out", Inline()),
    )


@pytest.mark.slow
def test_a_map_leaves_a_run_for_each_point_and_a_table_of_all(holes):
    mapped, folder, rows = holes
    assert [row["status"] for row in rows] == ["complete", "complete", "failed"]
    assert "cover" in rows[2]["reason"] or "part" in rows[2]["reason"]
    for k in range(2):
        run = load_run(folder / f"000{k}")
        np.testing.assert_allclose(run.mu, [-4.0, -2.0])
        assert rows[k]["area_reduction"] == run.history["area_reduction"][-1]
        assert float(table(folder)[k]["radius"]) == mapped.points[k]["radius"]
        assert float(table(folder)[k]["area_reduction"]) == rows[k]["area_reduction"]
    assert table(folder)[2]["states"] == "0"
    assert table(folder)[2]["area_reduction"] == ""


@pytest.mark.slow
def test_a_point_lies_on_the_studys_cloud_placed_or_where_that_is_too_poor_on_its_own(holes):
    mapped, folder, _ = holes
    # it refuses nodes that are not the stored ones
    assert load_path(folder / "0000").model.cloud.plate.holes[0].radius == 1.15
    nodes = [load_run(folder / f"000{k}").states["nodes"] for k in range(2)]
    placed = [
        np.asarray(mapped.case.cloud().at(mapped.at(point).plate).nodes)
        for point in mapped.points[:2]
    ]
    np.testing.assert_allclose(nodes[0], placed[0], atol=1e-12)  # mm, round-off
    own = dataclasses.replace(mapped.at(mapped.points[1]).plate, reference=None)
    np.testing.assert_allclose(
        nodes[1],
        np.asarray(jaxgel.make_cloud(own, spacing=2 / 3, nodes_per_hole=12).nodes),
        atol=1e-12,
    )
    assert len(nodes[1]) != len(placed[1])


@pytest.fixture(scope="module")
def derived(tmp_path_factory):
    """Folder and rows of a map of two chi 2e-4 apart, with derivatives."""
    folder = tmp_path_factory.mktemp("gradients")
    chi = (
        '[map]\ngradients = true\n[[parameters]]\nof = "chi"\nlower = 0.0999\nupper = 0.1001\n'
        "number = 2\n"
    )
    return folder / "out", run_map(study(folder, HOLE + chi), folder / "out", Inline())


@pytest.mark.slow
def test_derivatives_of_a_map_agree_with_differences_of_its_points(derived):
    """The mean of two derivatives is the difference quotient, to the square of the distance."""
    _, rows = derived
    for column in ("rotation_deg", "area_reduction"):
        difference = (rows[1][column] - rows[0][column]) / 2e-4
        # error of the mean: 1e-8
        assert np.mean([row[f"d_{column}_d_chi"] for row in rows]) == pytest.approx(
            difference, rel=1e-6
        )
    # the core lies in the hole
    assert rows[1]["core_rotation_deg"] is None and rows[1]["d_core_rotation_deg_d_chi"] is None


@pytest.mark.slow
def test_measures_of_a_map_come_from_its_table(derived, refused):
    folder, rows = derived
    found = map_sensitivity(folder, "area_reduction")
    assert found.names == ["chi"]
    np.testing.assert_allclose(
        found.mean_squares,
        np.mean([row["d_area_reduction_d_chi"] ** 2 for row in rows]),
        rtol=1e-12,
    )
    refused(
        map_sensitivity,
        [
            (
                folder,
                "area_redaction",
                "quantity: 'area_redaction' is unknown; did you mean 'area_reduction'",
            ),
            (
                folder / "0000",
                "rotation",
                "folder: .* is not accepted .*; give one written by jaxgel map",
            ),
            (folder, "core_rotation", "is not accepted|at least 2"),
        ],
    )


@pytest.mark.slow
def test_a_finished_map_is_not_run_again(holes):
    mapped, folder, rows = holes
    again = Inline()
    assert run_map(resumed_map(folder), folder, again, resume=True) == rows
    assert again.calls == 0
    with pytest.raises(ValueError, match="holds a map already"):
        run_map(mapped, folder, again)
    with pytest.raises(ValueError, match="another study"):
        run_map(
            parameter_map.map_from_table(
                mapped.table | {"parameters": mapped.table["parameters"][:1]}, "x"
            ),
            folder,
            again,
            resume=True,
        )


@pytest.mark.thorough
def test_a_lost_point_is_tried_again_and_then_given_up_until_resumed(tmp_path, caplog):
    mapped, executor = study(tmp_path, QUICK), Inline(point_0000=1, point_0002=TRIES)
    rows = run_map(mapped, tmp_path / "out", executor)
    assert [row["status"] for row in rows] == ["complete", "complete", "lost"]
    # with its traceback
    assert "call 2 was lost, try 3 of 3" in caplog.text and "BrokenExecutor" in caplog.text
    assert executor.calls == 3 + 1 + (TRIES - 1)
    assert "its process died" in table(tmp_path / "out")[2]["reason"]
    kept = (tmp_path / "out" / "0000" / POINT).stat().st_mtime_ns
    executor = Inline()
    assert [row["status"] for row in run_map(mapped, tmp_path / "out", executor, resume=True)] == [
        "complete"
    ] * 3
    assert executor.calls == 1
    assert (tmp_path / "out" / "0000" / POINT).stat().st_mtime_ns == kept


@pytest.mark.thorough
def test_an_interrupted_map_keeps_what_has_ended(tmp_path, monkeypatch):
    run_point = map_runs.run_point

    def interrupted(text, values, folder):
        if values["Nv"] == 2e-3:
            raise KeyboardInterrupt
        return run_point(text, values, folder)

    mapped = study(tmp_path, QUICK)
    monkeypatch.setattr(map_runs, "run_point", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_map(mapped, tmp_path / "out", Inline())
    monkeypatch.setattr(map_runs, "run_point", run_point)
    executor = Inline()
    assert [row["status"] for row in run_map(mapped, tmp_path / "out", executor, resume=True)] == [
        "complete"
    ] * 3
    assert executor.calls == 1


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL there")
def test_ending_workers_at_once_does_not_wait_for_their_calls():
    executor = Workers(1)
    future = executor.submit(time.sleep, 600)
    while not multiprocessing.active_children():
        time.sleep(0.05)
    executor.shutdown(wait=False, cancel_futures=True)
    with pytest.raises((concurrent.futures.BrokenExecutor, concurrent.futures.CancelledError)):
        future.result(timeout=60)
    deadline = time.monotonic() + 60
    while multiprocessing.active_children() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert multiprocessing.active_children() == []


@pytest.mark.slow
def test_a_process_is_replaced_after_its_calls():
    with Workers(1, calls_each=2) as executor:
        first, second, third = (executor.submit(os.getpid).result() for _ in range(3))
        assert first == second != third


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """Rows of the map of the square, computed in this process."""
    folder = tmp_path_factory.mktemp("square")
    return run_map(study(folder, SQUARE), folder / "out", Inline())


def check(rows, expected, folder):
    """The rows are complete and have the expected numbers; the table has them all."""
    assert [row["status"] for row in rows] == ["complete"] * len(expected)
    for row, other in zip(rows, expected, strict=True):
        # of converged states, whatever XLA's threads
        np.testing.assert_allclose(row["J_mean"], other["J_mean"], rtol=1e-9)
    assert [int(row["point"]) for row in table(folder)] == list(range(len(expected)))
    assert all(
        json.loads((folder / f"000{k}" / POINT).read_bytes())["row"] == row
        for k, row in enumerate(rows)
    )


def killed_in_mid_run(folder, pid_of):
    """Thread that kills ``pid_of()`` once a point has a state on disk; a list of the killed."""
    done = []

    def kill():
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline:
            begun = [
                file.parent
                for file in folder.glob("*/history.csv")
                if file.read_bytes().count(b"\n") > 1
            ]
            if any(not (point / POINT).exists() for point in begun):
                done.append(pid_of())
                os.kill(done[0], signal.SIGKILL)
                return
            time.sleep(0.002)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    return thread, done


@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL there")
@pytest.mark.slow
def test_a_killed_worker_loses_no_point(tmp_path, expected):
    thread, killed = killed_in_mid_run(
        tmp_path / "out", lambda: multiprocessing.active_children()[0].pid
    )
    with Workers(2) as executor:
        rows = run_map(study(tmp_path, SQUARE), tmp_path / "out", executor)
    thread.join()
    assert len(killed) == 1
    check(rows, expected, tmp_path / "out")


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL there")
@pytest.mark.filterwarnings("ignore")  # of Dask's own
def test_a_killed_dask_worker_loses_no_point(tmp_path, expected):
    distributed = pytest.importorskip("distributed")
    options = dict(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        silence_logs=50,
        local_directory=str(tmp_path),
    )
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        thread, killed = killed_in_mid_run(
            tmp_path / "out", lambda: next(iter(client.run(os.getpid).values()))
        )
        rows = run_map(study(tmp_path, SQUARE), tmp_path / "out", client.get_executor(pure=False))
    thread.join()
    assert len(killed) == 1
    check(rows, expected, tmp_path / "out")


ROUND = (
    TINY
    + "[sweep]\nmu = [-4.0, -3.0, -2.0]\n"
    + '[[parameters]]\nof = "radius"\nvalues = [1.15, 1.12, 0.9, 2.5]\n'
    + '[[parameters]]\nof = "Nv"\nvalues = [1e-3]\n'
)


def alike(one, other):
    """Whether rows agree in all but who solved them, Newton's work and the time."""
    for name in one.keys() - {"solver", "seconds", "newton_iterations"}:
        if isinstance(one[name], float):
            np.testing.assert_allclose(one[name], other[name], rtol=1e-9, atol=1e-12, err_msg=name)
        else:
            assert one[name] == other[name], name
    return True


@pytest.mark.slow
def test_a_program_sweeps_in_batches_what_the_cloud_carries_and_the_host_the_others(
    tmp_path, monkeypatch
):
    """The same table and folders; what has ended is not run again; a kill loses one batch."""
    monkeypatch.setattr(batched, "ON_CPU", 2)
    mapped = study(tmp_path, ROUND)
    by_host = run_map(mapped, tmp_path / "host", Inline())
    executor = Inline()
    rows = run_map(mapped, tmp_path / "device", executor, device="cpu")
    assert [row["solver"] for row in rows] == ["program", "program", "host", "host"]
    assert [row["solver"] for row in by_host] == ["host"] * 4 and executor.calls == 2
    assert [row["status"] for row in rows] == ["complete"] * 3 + ["failed"]
    assert all(map(alike, rows, by_host))
    assert [row["solver"] for row in table(tmp_path / "device")] == [row["solver"] for row in rows]
    runs = [load_run(tmp_path / name / "0001") for name in ("host", "device")]
    for name, own in runs[0].states.items():
        if own.dtype.kind == "f" and name not in ("residual", "lowest_eigenvalue"):
            np.testing.assert_allclose(runs[1].states[name], own, rtol=1e-9, atol=1e-11)
    assert len(load_path(tmp_path / "device" / "0001")) == 3  # jaxgel plot and resume read it
    # a point whose process was killed before its row was written
    (tmp_path / "device" / "0001" / POINT).unlink()
    again = run_map(
        resumed_map(tmp_path / "device"), tmp_path / "device", Inline(), device="cpu", resume=True
    )
    assert all(map(alike, again, rows)) and again[0] == rows[0]


def test_devices_and_sweeps_that_no_program_has_are_refused(tmp_path, refused):
    def attempt(device, *change):
        run_map(study(tmp_path, ROUND.replace(*change)), tmp_path / "out", Inline(), device=device)

    mu = "mu = [-4.0, -3.0, -2.0]"
    refused(
        attempt,
        [
            ("gpu", "", "", r"device: 'gpu' is not accepted, JAX sees the CPU only; give cpu or"),
            ("tpu", "", "", r"device: 'tpu' is not accepted; give one of cpu, gpu, auto"),
            ("cpu", mu, 'steps = "auto"', r"device: sweep\.steps = 'auto' is for the host's"),
            ("cpu", mu, f'{mu}\nbranch = "symmetric"', r"device: sweep\.branch = 'symmetric' is"),
            ("cpu", mu, f'{mu}\ncontact = "stop"', r"device: sweep\.contact = 'stop' is for"),
            ("cpu", mu, f"{mu}\neigenvalues = true", r"device: sweep\.eigenvalues = True is for"),
            ("cpu", mu, f"{mu}\nimperfection = 0.1", r"device: sweep\.imperfection = 0\.1 is"),
        ],
    )
    assert devices_of(None) == devices_of("auto") == []


@pytest.mark.slow
def test_a_sheet_that_buckles_in_a_program_is_followed_by_the_host(tmp_path):
    """Sample 4's symmetric pattern is unstable at the last mu of the first point."""
    mapped = study(
        tmp_path,
        'case = "sample-4"\n[sweep]\nmu_start = -4.5\nsteps = 4\n[discretisation]\n'
        'spacing = 2.2\n[[parameters]]\nof = "mu_end"\nvalues = [-0.9178, -1.6]\n',
    )
    rows = run_map(mapped, tmp_path / "out", Inline(), device="cpu")
    assert [row["status"] for row in rows] == ["complete"] * 2
    assert [row["solver"] for row in rows] == ["host", "program"]
    by_host, by_program = (load_run(tmp_path / "out" / name).states for name in ("0000", "0001"))
    assert by_host["switched"].tolist() == [0, 0, 0, 1]
    assert set(by_program["symmetry"]) == {"D4"}  # an eighth of the plate is solved


@pytest.mark.slow
def test_derivatives_come_out_of_the_program_on_two_devices(tmp_path):
    """Those of the host, also of points that the last batch is filled with."""
    (tmp_path / "study.toml").write_text(
        ROUND.replace("[1.15, 1.12, 0.9, 2.5]", "[1.15, 1.12, 1.1]") + "[map]\ngradients = true\n"
    )
    tables = []
    for device in ([], ["--device", "cpu"]):
        out = tmp_path / f"out{len(device)}"
        command = [sys.executable, "-m", "jaxgel", "map", str(tmp_path / "study.toml"), *device]
        subprocess.run(
            [*command, "--out", str(out), "--workers", "1", "--quiet"],
            env=os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=2"},
            check=True,
        )
        tables.append(table(out))
    slopes = [name for name in tables[0][0] if name.startswith("d_")]
    for one, other in zip(*tables, strict=True):
        assert (one["solver"], other["solver"]) == ("host", "program")
        assert [name for name in slopes if one[name]] == [name for name in slopes if other[name]]
        np.testing.assert_allclose(
            [float(other[name]) for name in slopes if one[name]],
            [float(one[name]) for name in slopes if one[name]],
            rtol=1e-8,
        )
