"""Cases and studies in TOML files: plates, gels, options, parameter maps, interrupted runs."""

from .case import Case, from_table, load_case
from .error_bars import accuracy_of, point_accuracy_of, slope_accuracy_of
from .map_runs import POINT, TABLE, run_map
from .page import write_page
from .parameter_map import MapStudy, load_map, load_parameters, resumed_map
from .response import DIFFERENTIABLE, RESPONSES, Response
from .resume import load_path, other_versions, path_of, recorder_of, resumed
from .salib import PROBLEM
from .samples import GRID, SIDE, case_names, sample, sample_names
from .schema import OutputOptions, case_schema
from .sensitivities import Sensitivity, map_sensitivity, sensitivity
from .starts import OPTIMA, draw_starts
from .study import Study, load_study, study_from_table
from .study_runs import VERIFIED, resumed_study, run_study
from .toml import case_text, example, explicit
from .uncertain import (
    UncertainInput,
    sampled_deviations,
    uncertain_inputs,
    uncertain_samples,
    uncertainty_of,
)

__all__ = [
    "DIFFERENTIABLE",
    "GRID",
    "OPTIMA",
    "POINT",
    "PROBLEM",
    "RESPONSES",
    "SIDE",
    "TABLE",
    "VERIFIED",
    "Case",
    "MapStudy",
    "OutputOptions",
    "Response",
    "Sensitivity",
    "Study",
    "UncertainInput",
    "accuracy_of",
    "case_names",
    "case_schema",
    "case_text",
    "draw_starts",
    "example",
    "explicit",
    "from_table",
    "load_case",
    "load_map",
    "load_parameters",
    "load_path",
    "load_study",
    "map_sensitivity",
    "other_versions",
    "path_of",
    "point_accuracy_of",
    "recorder_of",
    "resumed",
    "resumed_map",
    "resumed_study",
    "run_map",
    "run_study",
    "sample",
    "sample_names",
    "sampled_deviations",
    "sensitivity",
    "slope_accuracy_of",
    "study_from_table",
    "uncertain_inputs",
    "uncertain_samples",
    "uncertainty_of",
    "write_page",
]
