"""jaxgel: a JAX differentiable meshless solver for the swelling of perforated hydrogel sheets.

The improved interpolating complex variable element free Galerkin method of Deng, He, Sun, Yi & Dai (2020), with one pressure per cell
against locking. Importing it switches JAX to 64-bit numbers, and XLA to what compiles fastest unless XLA_FLAGS says otherwise.
"""

import os

from .versions import quick_flags, warn_of_flags

warn_of_flags(os.environ.get("XLA_FLAGS", ""))
for flag in quick_flags():
    if flag.split("=")[0] not in os.environ.get("XLA_FLAGS", ""):
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flag}".strip()
if len(os.sched_getaffinity(0)) == 1 if hasattr(os, "sched_getaffinity") else os.cpu_count() == 1:
    os.environ.setdefault("NPROC", "2")  # XLA's threads: a host callback waits for its arguments on one, which another one copies
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # a program from JAX's compilation cache fills the terminal with its machine's features

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

from .branches import continue_branch, deflated, imperfection, switch  # noqa: E402
from .cloud import Cloud, make_cloud  # noqa: E402
from .critical import CriticalPoint, critical_points, folds  # noqa: E402
from .discretisation import Model, discretise  # noqa: E402
from .equilibrium import Status  # noqa: E402
from .geometry import Plate  # noqa: E402
from .holes import Circle, Ellipse, Fourier, Polygon, Rectangle, Superellipse  # noqa: E402
from .inverse import Design, DesignProblem, optimise, verify  # noqa: E402
from .loads import Loads, load_vector  # noqa: E402
from .material import ArrudaBoyce, Gel, Gent, free_energy, free_swelling, paper_stress, paper_tangent, uniaxial_swelling  # noqa: E402
from .objectives import Constraint, limit, misfit, reading, weighted_sum  # noqa: E402
from .observables import (  # noqa: E402
    area_reduction,
    area_reduction_per_hole,
    cauchy_stress,
    core_rotation,
    min_gap,
    outlines,
    rotation_angle,
    surface_ratio,
    volume_ratio,
)
from .path import Path  # noqa: E402
from .probe import make_probe  # noqa: E402
from .samples import sample, sample_names  # noqa: E402
from .shape_functions import shape_functions  # noqa: E402
from .sweep import sweep  # noqa: E402
from .traced import IllPosedDerivative  # noqa: E402

__all__ = [
    "ArrudaBoyce",
    "Circle",
    "Cloud",
    "Constraint",
    "CriticalPoint",
    "Design",
    "DesignProblem",
    "Ellipse",
    "Fourier",
    "Gel",
    "Gent",
    "IllPosedDerivative",
    "Loads",
    "Model",
    "Path",
    "Plate",
    "Polygon",
    "Rectangle",
    "Status",
    "Superellipse",
    "area_reduction",
    "area_reduction_per_hole",
    "cauchy_stress",
    "continue_branch",
    "core_rotation",
    "critical_points",
    "deflated",
    "discretise",
    "folds",
    "free_energy",
    "free_swelling",
    "imperfection",
    "limit",
    "load_vector",
    "make_cloud",
    "make_probe",
    "min_gap",
    "misfit",
    "optimise",
    "outlines",
    "paper_stress",
    "paper_tangent",
    "reading",
    "rotation_angle",
    "sample",
    "sample_names",
    "shape_functions",
    "surface_ratio",
    "sweep",
    "switch",
    "uniaxial_swelling",
    "verify",
    "volume_ratio",
    "weighted_sum",
]
