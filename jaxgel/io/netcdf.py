"""A run's folder as an xarray Dataset, and as a netCDF (HDF5) file for programs that read those; needs the extra ``[netcdf]``.

Dimensions: state (an accepted state), node, group (a volume group, see `energy`), xy, and point_0 ... (of the outline of each hole).
"""

import json
from pathlib import Path as File

import numpy as np

from .files import write_atomically
from .run import load_run

QUANTITIES = {
    "mu": ("kT", "chemical potential of the solvent"),
    "free_stretch": ("1", "in-plane stretch of the freely swelling gel"),
    "status": ("", "what happened on the way to the state"),
    "newton_iterations": ("1", "number of Newton corrections"),
    "residual": ("1", "residual over the forces of the network"),
    "energy": ("kT/v mm2", "total energy"),
    "J_min": ("1", "smallest volume ratio of a cell"),
    "J_max": ("1", "largest volume ratio of a cell"),
    "J_mean": ("1", "mean volume ratio"),
    "area_reduction": ("1", "reduction of the area of the holes"),
    "rotation_deg": ("degree", "rotation of the midline"),
    "core_rotation_deg": ("degree", "rotation of the core"),
    "negative_pivots": ("1", "number of negative pivots of the tangent, 0 for a stable state"),
    "lowest_eigenvalue": ("1", "lowest eigenvalue of the tangent over the network's stiffness"),
    "min_gap": ("mm", "smallest gap between the sides of a hole"),
    "surface_ratio": ("1", "largest ratio of normal to tangential stretch along the outlines"),
}


def dataset(folder):
    """``xarray.Dataset`` of a run's folder: its history, positions (state, node, xy), pressures, outlines and dry nodes, to the bit.

    Raises ValueError for a folder without a readable run, and where xarray or h5netcdf is missing.
    """
    try:
        import h5netcdf  # noqa: F401
        import xarray
    except ImportError as problem:
        raise ValueError(f"export: needs {problem.name}; pip install 'jaxgel[netcdf]'") from None
    run = load_run(folder)

    def variable(dimensions, values, units, text):
        return dimensions, values, {"long_name": text} | ({"units": units} if units else {})

    columns = {name: variable(("state",), np.asarray(run.history[name]), *QUANTITIES[name]) for name in run.history}
    fields = {
        "x": variable(("state", "node", "xy"), run.x, "mm", "position of the nodes"),
        "nodes": variable(("node", "xy"), run.states["nodes"], "mm", "position of the nodes in the dry gel"),
        "pressure": variable(("state", "group"), run.states["pressure"], "kT/v", "pressure of the volume groups"),
    } | {
        f"outline_{i}": variable(("state", f"point_{i}", "xy"), loop, "mm", f"outline of hole {i}, a closed loop")
        for i, loop in enumerate(run.outlines)
    }
    about = {"title": run.summary["case"]} | {name: json.dumps(run.summary[name]) for name in ("options", "versions", "status", "reason")}
    return xarray.Dataset(fields | columns, coords={"xy": ["x", "y"]}, attrs=about).set_coords("mu")


def export(folder, out=None):
    """Write `dataset` as netCDF, to run.nc in the folder or to ``out``; returns the file. ValueError as `dataset`, and for a bad place."""
    file, content = File(out) if out else File(folder) / "run.nc", dataset(folder).to_netcdf(engine="h5netcdf")
    try:
        write_atomically(file, lambda stream: stream.write(content))
    except OSError as problem:
        raise ValueError(f"out: cannot write {str(file)!r}: {problem.strerror}") from None
    return file
