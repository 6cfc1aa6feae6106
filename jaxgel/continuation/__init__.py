"""Continuation: many states along a branch, and their stability."""

from .._deprecated import old_names
from .autodiff import IllPosedDerivative, warn_of_ill_posed
from .batched import DEVICES, GROUPS, Batched, Device, check_for_batches, columns_of, devices_of
from .eigenvalue import lowest_eigenvalue
from .first import SweepFailed, first_state_failed
from .follow import BRANCHES, Followed, Following
from .frames import group_of_sweep
from .options import SweepOptions, check_sweep
from .path import OF_SOLVENT, SCALARS, Path, check_is_path
from .predictor import extrapolated, predict
from .stability import ACCURACY, StabilityAnalysis, oriented
from .steps import STEP_CONTROL, Adaptive, StepControl, given_values
from .sweeps import sweep
from .switching import across
from .traced_search import RESIDUAL, TracedSearch, padded_columns

__all__ = [
    "ACCURACY",
    "BRANCHES",
    "DEVICES",
    "GROUPS",
    "OF_SOLVENT",
    "RESIDUAL",
    "SCALARS",
    "STEP_CONTROL",
    "Adaptive",
    "Batched",
    "Device",
    "Followed",
    "Following",
    "IllPosedDerivative",
    "Path",
    "StabilityAnalysis",
    "StepControl",
    "SweepFailed",
    "SweepOptions",
    "TracedSearch",
    "across",
    "check_for_batches",
    "check_is_path",
    "check_sweep",
    "columns_of",
    "devices_of",
    "extrapolated",
    "first_state_failed",
    "given_values",
    "group_of_sweep",
    "lowest_eigenvalue",
    "oriented",
    "padded_columns",
    "predict",
    "sweep",
    "warn_of_ill_posed",
]

__getattr__ = old_names(__name__)
