"""A run's folder has the sweep's states, survives any stop; damaged files give one error."""

import csv
import dataclasses
import json
import shutil
import zipfile

import numpy as np
import pytest

from jaxgel.cases import case as cases
from jaxgel.cases import load_path
from jaxgel.equilibrium import Change
from jaxgel.io import Recorder, load_run, write_atomically
from jaxgel.observables import BY_COLUMN, COLUMNS, SELF_CONTACT, events, history, outlines

INTERFACE = (
    "mu, free_stretch, status, switched, newton_iterations, residual, energy, J_min, J_max, "
    "J_mean, area_reduction, rotation_deg, "
    "core_rotation_deg, negative_pivots, lowest_eigenvalue, min_gap, surface_ratio, "
    "surface_stability"
)


@pytest.fixture
def copy(run_folder, tmp_path):
    """A copy of the run's folder, without its figures, to be damaged."""
    folder = tmp_path / "copy"
    folder.mkdir()
    for name in ("summary.json", "history.csv", "states.npz"):
        shutil.copy(run_folder / name, folder)
    return folder


def table(**columns):
    """Columns of a made-up history with nothing special in them, but for what is given."""
    k = len(next(iter(columns.values())))
    plain = {"mu": np.arange(k) - 5.0, "negative_pivots": np.zeros(k, dtype=int)}
    plain |= {name: np.ones(k) for name in ("surface_ratio", "surface_stability", "min_gap")}
    return plain | {name: np.asarray(column) for name, column in columns.items()}


def steps_of(path, switched=None):
    """The steps that the path was made from; number ``switched`` went over to another branch."""
    return [
        dataclasses.replace(path[k], switched=Change(int(k == switched))) for k in range(len(path))
    ]


def test_history_has_exactly_the_columns_of_the_interface_and_a_row_per_state(run_folder, path):
    with (run_folder / "history.csv").open(newline="") as stream:
        header, *rows = csv.reader(stream)
    assert ", ".join(header) == INTERFACE == ", ".join(COLUMNS)
    assert [float(row[0]) for row in rows] == list(path.mu)


@pytest.mark.thorough
def test_history_repeats_the_observables_to_the_last_digit(run_folder, path):
    saved, again = load_run(run_folder).history, history(path)
    assert saved["status"] == ["converged"] * len(path.mu)
    assert saved["switched"] == again["switched"]
    for name in COLUMNS:
        if name not in ("status", "switched", "free_stretch"):
            # states computed one by one and all together may round differently
            np.testing.assert_allclose(
                saved[name], again[name], rtol=1e-12, atol=1e-13, err_msg=name
            )


def test_saved_states_are_those_of_the_sweep(run_folder, path):
    run = load_run(run_folder)
    np.testing.assert_array_equal(run.x, path.x)
    np.testing.assert_array_equal(run.states["nodes"], path.model.cloud.nodes)
    for saved, line in zip(run.outlines, outlines(path), strict=True):
        np.testing.assert_allclose(saved, line, atol=1e-12)


def test_mean_volume_ratio_and_area_reduction_obey_the_rigid_box(run_folder, path):
    """The holes lose what the gel gains: R = (<J> - 1) (1 - phi) / phi with the porosity phi."""
    run, plate = load_run(run_folder), path.model.cloud.plate
    porosity = float(sum(hole.area() for hole in plate.holes)) / (plate.width * plate.height)
    expected = (run.history["J_mean"] - 1) * (1 - porosity) / porosity
    # 5e-4 is required of the default cloud; this one has twice its spacing, and the error is of
    # second order
    np.testing.assert_allclose(run.history["area_reduction"], expected, rtol=4 * 5e-4)


def test_summary_names_case_options_versions_and_outcome(run_folder):
    summary = json.loads((run_folder / "summary.json").read_text())
    assert summary["case"] == "sample-1"
    assert summary["options"]["discretisation"]["spacing"] == 1.1
    assert {"jaxgel", "jax", "jaxlib", "numpy", "scipy", "python"} <= set(summary["versions"])
    assert summary["status"] == "complete"
    assert summary["mu_reached"] == pytest.approx(-0.9178, abs=1e-12)
    assert summary["states"] == 4
    assert summary["wall_seconds"] > 0


def test_a_change_of_negative_pivots_is_a_bifurcation():
    found = events(table(negative_pivots=[0, 0, 2, 2, 1]))
    assert [(e["event"], e["mu"], e["mu_before"]) for e in found] == [
        ("bifurcation", -3.0, -4.0),
        ("bifurcation", -1.0, -2.0),
    ]
    assert "from 0 to 2" in found[0]["text"]


@pytest.mark.thorough
def test_a_step_to_the_stable_branch_is_a_bifurcation(path, tmp_path):
    recorder = Recorder(tmp_path, cases.load_case("sample-1"), path.problem)
    for step in steps_of(path, switched=2):
        recorder(step)
    run = load_run(tmp_path)
    assert run.history["status"] == [
        "converged",
        "converged",
        "switched to the stable branch",
        "converged",
    ]
    assert {
        "event": "bifurcation",
        "mu": path.mu[2],
        "mu_before": path.mu[1],
    }.items() <= run.summary["events"][0].items()
    np.testing.assert_array_equal(run.states["switched"], [False, False, True, False])


def set_gaps(monkeypatch, gaps):
    """Other smallest gaps, ``gaps(path)``, in the table of a path."""
    monkeypatch.setitem(
        BY_COLUMN, "min_gap", dataclasses.replace(BY_COLUMN["min_gap"], function=gaps)
    )
    monkeypatch.setattr("jaxgel.observables.gaps.min_gap_once", gaps)


@pytest.mark.thorough
def test_a_step_to_the_stable_branch_into_contact_is_both(path, tmp_path, monkeypatch):
    # mm; contact acts below 22/80
    set_gaps(monkeypatch, lambda p: np.where(p.mu < path.mu[2], 0.9, 0.2))
    recorder = Recorder(tmp_path, cases.load_case("sample-1"), path.problem)
    for step in steps_of(path, switched=2):
        recorder(step)
    run = load_run(tmp_path)
    assert run.history["status"][2:] == [
        "switched to the stable branch, a hole's sides touch",
        "a hole's sides touch",
    ]
    assert [(e["event"], e["mu"]) for e in run.summary["events"][:2]] == [
        ("bifurcation", path.mu[2]),
        ("contact", path.mu[2]),
    ]


def test_crease_and_self_contact_are_reported_once_where_they_first_show():
    found = events(table(surface_ratio=[1.0, 2.4, 2.5, 3.0], min_gap=[0.5, 0.2, 0.1, 0.0]))
    assert [(e["event"], e["mu"]) for e in found] == [("crease", -3.0), ("self-contact", -2.0)]
    assert events(table(min_gap=[-0.1]))[0]["mu_before"] is None


def test_a_branch_that_is_left_for_another_volume_is_a_leap_and_no_bifurcation():
    """ln J by 0.9 and by 0.1: the volume of a gel that buckles changes little."""
    status = ["converged", "switched to the stable branch", "switched to the stable branch"]
    for volume, kinds in (
        ([3.7, 1.5, 1.5], ["leap", "bifurcation"]),
        ([3.7, 3.4, 3.4], ["bifurcation", "bifurcation"]),
    ):
        found = events(table(status=status, J_mean=volume, negative_pivots=[0, 0, 0]))
        assert [event["event"] for event in found] == kinds
    assert (
        "mean J from 3.700 to 1.500, between mu = "
        in events(table(status=status, J_mean=[3.7, 1.5, 1.5]))[0]["text"]
    )


def test_plates_without_holes_have_no_events():
    assert events(table(surface_ratio=[np.nan] * 3, min_gap=[np.inf] * 3)) == []


@pytest.mark.thorough
def test_rows_from_the_first_self_contact_on_are_invalid(path, tmp_path, monkeypatch):
    # mm; contact would act below 0.55
    gaps = dict(zip(path.mu, [0.9, -0.01, 0.2, -0.3], strict=True))
    set_gaps(monkeypatch, lambda p: np.array([gaps[mu] for mu in p.mu]))
    expected = ["converged", SELF_CONTACT, SELF_CONTACT, SELF_CONTACT]
    assert history(path)["status"] == expected
    recorder = Recorder(tmp_path, cases.load_case("sample-1"), path.problem)
    for step in steps_of(path):
        recorder(step)
    assert load_run(tmp_path).history["status"] == expected
    assert {"event": "self-contact", "mu": path.mu[1]}.items() <= load_run(tmp_path).summary[
        "events"
    ][0].items()


def test_after_every_step_the_folder_can_be_read(path, tmp_path, monkeypatch):
    recorder, synced = Recorder(tmp_path, cases.load_case("sample-1"), path.problem), []
    recorder.begin()
    monkeypatch.setattr("os.fsync", synced.append)
    with pytest.raises(ValueError, match="no accepted state"):
        load_run(tmp_path)
    for k, step in enumerate(steps_of(path), start=1):
        recorder(step)
        run = load_run(tmp_path)
        assert run.summary["status"] == "running"
        np.testing.assert_array_equal(run.mu, path.mu[:k])
    assert len(synced) == 3 * len(path.mu)
    recorder.finish("complete", "")
    assert len(synced) == 3 * len(path.mu) + 2
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.slow
def test_states_recorded_together_have_the_rows_and_outlines_of_those_recorded_one_by_one(
    path, tmp_path
):
    together, singly = (Recorder(tmp_path, None, path.problem) for _ in range(2))
    steps = [*steps_of(path), steps_of(path)[-1]]  # of 5 states, to which 1 is added
    together.add(steps)
    for step in steps:
        singly.add([step])
    for (_, row, loops), (_, other, others) in zip(together.records, singly.records, strict=True):
        assert {k: v for k, v in row.items() if isinstance(v, str)} == {
            k: v for k, v in other.items() if isinstance(v, str)
        }
        numbers = [k for k, v in row.items() if not isinstance(v, str)]
        np.testing.assert_allclose(
            [row[k] for k in numbers], [other[k] for k in numbers], rtol=1e-9, atol=1e-12
        )
        np.testing.assert_array_equal(loops, others)


def test_ctrl_c_between_a_row_and_its_states_loses_neither(path, tmp_path, monkeypatch):
    recorder = Recorder(tmp_path, cases.load_case("sample-1"), path.problem)

    def pressed(**_):
        raise KeyboardInterrupt

    *before, last = steps_of(path)
    for step in before:
        recorder(step)
    with monkeypatch.context() as patch:
        patch.setattr(recorder, "_write_states", pressed)
        with pytest.raises(KeyboardInterrupt):
            recorder(last)
    assert len(load_run(tmp_path).mu) == len(path.mu) - 1
    recorder.finish("interrupted", "stopped by the user")
    np.testing.assert_array_equal(load_run(tmp_path).mu, path.mu)


def test_a_new_run_clears_its_own_files_and_no_others_when_it_begins(path, tmp_path):
    for name in ("pattern.png", "notes.txt"):
        (tmp_path / name).write_text("before")
    (tmp_path / "vtu").mkdir()
    recorder = Recorder(tmp_path, cases.load_case("sample-1"), path.problem)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["notes.txt", "pattern.png", "vtu"]
    recorder.begin()
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "history.csv",
        "notes.txt",
        "summary.json",
    ]


def test_a_row_cut_off_by_a_crash_is_left_out(copy):
    file = copy / "history.csv"
    file.write_bytes(file.read_bytes()[:-30])
    assert len(load_run(copy).mu) == len(load_run(copy).history["mu"]) == 3


def test_a_table_of_other_columns_is_read(copy):
    """As of a version without the surface's stability and the smallest gap, but more.

    It had another quantity.
    """
    with (copy / "history.csv").open(newline="") as stream:
        rows = [dict(row) for row in csv.DictReader(stream)]
    kept = [name for name in rows[0] if name not in ("surface_stability", "min_gap")]
    expected = load_run(copy).history
    lines = [
        ",".join(["porosity", *kept]),
        *(",".join(["0.5", *(row[name] for name in kept)]) for row in rows),
    ]
    (copy / "history.csv").write_text("\n".join(lines) + "\n")
    found = load_run(copy).history
    assert list(found) == list(expected) and np.isnan(found["min_gap"]).all()
    np.testing.assert_array_equal(found["energy"], expected["energy"])
    (copy / "history.csv").write_text("mu,energy\n-1.0,2.0\n")
    with pytest.raises(ValueError, match=r"history\.csv.*: it has no column status$"):
        load_run(copy)


def test_a_failed_write_leaves_the_old_file(tmp_path):
    file = tmp_path / "summary.json"
    file.write_text("old")

    def fail(stream):
        stream.write(b"ne")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_atomically(file, fail)
    assert file.read_text() == "old"


def test_pickled_arrays_are_refused(copy):
    arrays = dict(np.load(copy / "states.npz"))
    np.savez(copy / "states.npz", **(arrays | {"mu": np.array([{"a": 1}], dtype=object)}))
    with pytest.raises(ValueError, match=r"states\.npz.*damaged or not written by jaxgel"):
        load_run(copy)


def test_files_above_the_size_limit_are_not_read(copy, monkeypatch):
    monkeypatch.setattr("jaxgel.io.files.MAX_BYTES", 1000)
    with pytest.raises(ValueError, match="bytes"):
        load_run(copy)


def test_an_array_that_claims_more_than_its_bytes_is_refused(copy):
    header = (
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }".ljust(117) + b"\n"
    )
    with zipfile.ZipFile(copy / "states.npz", "w") as archive:
        archive.writestr(
            "mu.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(8)
        )
    with pytest.raises(ValueError, match=r"states\.npz.*damaged or not written by jaxgel"):
        load_run(copy)


def test_a_folder_without_a_run_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"summary\.json"):
        load_run(tmp_path)


def test_a_folder_of_another_cloud_is_refused(copy):
    summary = json.loads((copy / "summary.json").read_text())
    summary["options"]["discretisation"]["spacing"] = 2.2
    (copy / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(ValueError, match="run the case again"):
        load_path(copy)


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path, path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="out: cannot write in"):
        Recorder(tmp_path / "file" / "run", cases.load_case("sample-1"), path.problem)
