"""Files: a run's folder, netCDF, ParaView, drawings of outlines.

The terminal, and the processes that calls run on.
"""

from .._validation import read_toml
from .drawings import OUTLINE, DrawingIncomplete, hole_table, read_outlines
from .files import (
    failure,
    one_line,
    open_folder,
    read_record,
    write_atomically,
    write_csv,
    write_json,
)
from .hole_pictures import IMAGE, hole_tables
from .masks import MASK, mask_table, mask_values, write_grey, write_mask
from .netcdf import export
from .outline_files import FORMATS, dry_gel, dry_regions, swollen_gel, write_outline
from .outline_fits import fit_fourier
from .recorder import NUMERICAL, Recorder, write_points
from .result_files import write_accuracy, write_loop, write_waves
from .run import STEP_ARRAYS, Run, load_run, read_summary
from .terminal import Progress, interruptible
from .um_bridge import ServedFunction, um_bridge_server
from .vtk import point_fields, write_series
from .workers import TRIES, InThisProcess, Workers, dask_executor, run_calls

__all__ = [
    "FORMATS",
    "IMAGE",
    "MASK",
    "NUMERICAL",
    "OUTLINE",
    "STEP_ARRAYS",
    "TRIES",
    "DrawingIncomplete",
    "InThisProcess",
    "Progress",
    "Recorder",
    "Run",
    "ServedFunction",
    "Workers",
    "dask_executor",
    "dry_gel",
    "dry_regions",
    "export",
    "failure",
    "fit_fourier",
    "hole_table",
    "hole_tables",
    "interruptible",
    "load_run",
    "mask_table",
    "mask_values",
    "one_line",
    "open_folder",
    "point_fields",
    "read_outlines",
    "read_record",
    "read_summary",
    "read_toml",
    "run_calls",
    "swollen_gel",
    "um_bridge_server",
    "write_accuracy",
    "write_atomically",
    "write_csv",
    "write_grey",
    "write_json",
    "write_loop",
    "write_mask",
    "write_outline",
    "write_points",
    "write_series",
    "write_waves",
]
