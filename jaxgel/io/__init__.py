"""Files: a run's folder, netCDF, ParaView, drawings of outlines; the terminal, and the processes that calls run on."""

from .._validation import read_toml
from .drawings import FORMATS, OUTLINE, dry_gel, dry_regions, fit_fourier, hole_table, read_outlines, swollen_gel, write_outline
from .files import one_line, open_folder, read_record, write_atomically, write_csv, write_json
from .hole_pictures import IMAGE, hole_tables
from .loop_files import write_loop
from .masks import MASK, mask_table, mask_values, write_grey, write_mask
from .netcdf import export
from .recorder import NUMERICAL, Recorder, write_points
from .run import STEP_ARRAYS, Run, load_run, read_summary
from .terminal import Progress, interruptible
from .vtk import point_fields, write_series
from .wave_files import write_waves
from .workers import TRIES, InThisProcess, Workers, dask_executor, run_calls

__all__ = [
    "FORMATS",
    "IMAGE",
    "MASK",
    "NUMERICAL",
    "OUTLINE",
    "STEP_ARRAYS",
    "TRIES",
    "InThisProcess",
    "Progress",
    "Recorder",
    "Run",
    "Workers",
    "dask_executor",
    "dry_gel",
    "dry_regions",
    "export",
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
