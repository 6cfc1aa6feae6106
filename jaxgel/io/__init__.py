"""Files: a run's folder, netCDF, ParaView, drawings of outlines; and the terminal."""

from .._validation import read_toml
from .drawings import FORMATS, OUTLINE, dry_gel, fit_fourier, hole_table, read_outlines, swollen_gel, write_outline
from .files import open_folder, write_atomically
from .netcdf import export
from .recorder import NUMERICAL, Recorder, write_points
from .run import STEP_ARRAYS, Run, load_run, read_summary
from .terminal import Progress, interruptible
from .vtk import point_fields, write_series

__all__ = [
    "FORMATS",
    "NUMERICAL",
    "OUTLINE",
    "STEP_ARRAYS",
    "Progress",
    "Recorder",
    "Run",
    "dry_gel",
    "export",
    "fit_fourier",
    "hole_table",
    "interruptible",
    "load_run",
    "open_folder",
    "point_fields",
    "read_outlines",
    "read_summary",
    "read_toml",
    "swollen_gel",
    "write_atomically",
    "write_outline",
    "write_points",
    "write_series",
]
