"""A run as a netCDF file."""

import sys

import numpy as np
import pytest
import xarray

from jaxgel.cli import command_line as cli
from jaxgel.io import Run, export, load_run
from jaxgel.observables import COLUMNS, history


def test_an_exported_run_is_read_back_to_the_bit(run_folder, tmp_path, capsys):
    file, run = tmp_path / "run.nc", load_run(run_folder)
    assert cli.main(["export", str(run_folder), "--out", str(file)]) == 0
    assert capsys.readouterr().out == f"{file}\n"
    with xarray.open_dataset(file, engine="h5netcdf") as found:
        assert found.x.dims == ("state", "node", "xy")
        assert found.mu.attrs == {"units": "kT", "long_name": "chemical potential of the solvent"}
        assert set(COLUMNS) <= set(found.variables)
        for name, values in (
            run.history
            | {"x": run.x, "nodes": run.states["nodes"], "pressure": run.states["pressure"]}
        ).items():
            np.testing.assert_array_equal(found[name].values, np.asarray(values))
            assert "long_name" in found[name].attrs
        for i, loop in enumerate(run.outlines):
            np.testing.assert_array_equal(found[f"outline_{i}"].values, loop)
        assert found.attrs["title"] == "sample-1"


@pytest.mark.slow
def test_a_run_in_time_has_times_with_their_unit_and_the_solvent(in_time, tmp_path, monkeypatch):
    """Of the arrays of states.npz that say what the solvent does."""
    summary = {"case": "two holes", "control": {"name": "t", "unit": "h"}} | dict.fromkeys(
        ("options", "versions", "status", "reason")
    )
    states = {
        "x": in_time.x,
        "nodes": np.asarray(in_time.model.nodes),
        "pressure": in_time.pressure,
        "value": in_time.t,
        "mu": in_time.mu,
    }
    states |= {"potential": in_time.potential, "supplied": in_time.supplied}
    monkeypatch.setattr(
        "jaxgel.io.netcdf.load_run", lambda folder: Run(folder, summary, history(in_time), states)
    )
    with xarray.open_dataset(export(tmp_path), engine="h5netcdf") as found:
        assert (
            found.coords["t"].attrs == {"units": "h", "long_name": "time"}
            and found.t.values.tolist() == in_time.t.tolist()
        )
        assert found.potential.dims == ("state", "group") and found.potential.attrs["units"] == "kT"
        assert (
            found.supplied.dims == ("state", "part")
            and found.supplied.attrs["units"] == found.uptake.attrs["units"] == "mm2"
        )
        np.testing.assert_allclose(found.supplied.sum("part"), found.uptake, rtol=1e-15, atol=0)


@pytest.mark.parametrize("missing", ["xarray", "h5netcdf"])
def test_a_missing_library_is_named(missing, run_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, missing, None)
    assert cli.main(["export", str(run_folder), "--out", str(tmp_path / "run.nc")]) == 2
    assert (
        capsys.readouterr().err
        == f"jaxgel: error: export: needs {missing}; pip install 'jaxgel[netcdf]'\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_exported_is_refused_in_one_line(run_folder, tmp_path, capsys):
    for folder, out, field in (
        (tmp_path, tmp_path / "run.nc", "folder"),
        (run_folder, tmp_path / "no" / "run.nc", "out"),
    ):
        assert cli.main(["export", str(folder), "--out", str(out)]) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"jaxgel: error: {field}: ") and error.count("\n") == 1


def test_xarray_opens_the_folder_of_a_run(run_folder, tmp_path):
    """By itself, by the engine's name, and without some variables.

    Other folders are not those of runs.
    """
    with xarray.open_dataset(run_folder) as found:
        assert found.x.sizes == {
            "state": 4,
            "node": found.sizes["node"],
            "xy": 2,
        } and found.xy.values.tolist() == ["x", "y"]
        assert found.mu.attrs["units"] == "kT" and found.x.attrs["units"] == "mm"
        at_last = found.swap_dims(state="mu").sel(mu=-0.9178, method="nearest").sel(xy="x").x
        np.testing.assert_array_equal(at_last, load_run(run_folder).x[-1, :, 0])
    with xarray.open_dataset(run_folder, engine="jaxgel", drop_variables=["x"]) as found:
        assert "x" not in found and "pressure" in found
    with pytest.raises(ValueError, match="did not find a match"):
        xarray.open_dataset(tmp_path)
