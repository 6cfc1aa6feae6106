"""A run's folder as an xarray Dataset, and as a netCDF (HDF5) file for programs that read those.

Needs the extra ``[netcdf]``. Dimensions: state (an accepted state), node, group (a volume group),
xy, and point_0 ... (of the outline of each hole). In transient swelling the states have the
coordinate t, and there is the dimension part (a wetted part of the boundary).
``xarray.open_dataset(folder)`` gives the same, see `xarray_engine`.
"""

import json
from collections.abc import Sequence
from pathlib import Path as File
from typing import Any

import numpy as np

from ..observables import BY_COLUMN, control_quantity
from .files import write_atomically
from .run import load_run


def dataset(folder: str | File) -> Any:
    """``xarray.Dataset`` of a run's folder: history, positions, pressures, outlines, dry nodes.

    Numbers are equal to the bit; positions have the axes (state, node, xy). Raises ValueError for a
    folder without a readable run.
    """
    import xarray

    run = load_run(folder)

    def variable(dimensions: Sequence[str], values: Any, units: str, text: str) -> tuple:
        return dimensions, values, {"long_name": text} | ({"units": units} if units else {})

    driven = control_quantity(*run.control)
    quantities = {driven.name: driven} | BY_COLUMN
    columns = {
        name: variable(("state",), np.asarray(values), quantities[name].unit, quantities[name].text)
        for name, values in run.history.items()
    }
    fields = {
        "x": variable(("state", "node", "xy"), run.x, "mm", "position of the nodes"),
        "nodes": variable(
            ("node", "xy"), run.states["nodes"], "mm", "position of the nodes in the dry gel"
        ),
        "pressure": variable(
            ("state", "group"), run.states["pressure"], "kT/v", "pressure of the volume groups"
        ),
    } | {
        f"outline_{i}": variable(
            ("state", f"point_{i}", "xy"), loop, "mm", f"outline of hole {i}, a closed loop"
        )
        for i, loop in enumerate(run.outlines)
    }
    if "potential" in run.states:
        fields["potential"] = variable(
            ("state", "group"),
            run.states["potential"],
            "kT",
            "chemical potential of the solvent in the groups",
        )
    if "supplied" in run.states:
        fields["supplied"] = variable(
            ("state", "part"),
            run.states["supplied"],
            "mm2",
            "solvent that has come in through each wetted part",
        )
    about = {"title": run.summary["case"]} | {
        name: json.dumps(run.summary[name]) for name in ("options", "versions", "status", "reason")
    }
    return xarray.Dataset(fields | columns, coords={"xy": ["x", "y"]}, attrs=about).set_coords(
        list({driven.name: None, "mu": None})
    )


def export(folder: str | File, out: str | File | None = None) -> File:
    """Write `dataset` as netCDF, to run.nc in the folder or to ``out``; returns the file.

    Raises ValueError as `dataset`, for a place that cannot be written, and if xarray or h5netcdf is
    missing.
    """
    try:
        import h5netcdf  # noqa: F401
        import xarray  # noqa: F401
    except ImportError as problem:
        raise ValueError(f"export: needs {problem.name}; pip install 'jaxgel[netcdf]'") from None
    file, content = (
        File(out) if out else File(folder) / "run.nc",
        dataset(folder).to_netcdf(engine="h5netcdf"),
    )
    try:
        write_atomically(file, lambda stream: stream.write(content))
    except OSError as problem:
        raise ValueError(f"out: cannot write {str(file)!r}: {problem.strerror}") from None
    return file
