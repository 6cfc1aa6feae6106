"""jaxgel: a JAX differentiable meshless solver for the swelling of perforated hydrogel sheets.

The improved interpolating complex variable element free Galerkin method of Deng, He, Sun, Yi & Dai (2020), with one pressure per cell
against locking. Importing it switches JAX to 64-bit numbers and changes nothing else.
"""

import jax

jax.config.update("jax_enable_x64", True)

from .cases import sample, sample_names  # noqa: E402
from .cloud import Cloud, make_cloud  # noqa: E402
from .continuation import (  # noqa: E402
    CriticalPoint,
    IllPosedDerivative,
    Path,
    continue_branch,
    critical_points,
    find_states_by_deflation,
    folds,
    imperfection,
    sweep,
    switch_branch,
)
from .design import Constraint, Design, DesignProblem, limit, misfit, optimise, reading, verify, weighted_sum  # noqa: E402
from .discretisation import Model, discretise, make_probe, shape_functions  # noqa: E402
from .equilibrium import Status  # noqa: E402
from .geometry import Circle, Ellipse, Fourier, Plate, Polygon, Rectangle, Superellipse  # noqa: E402
from .materials import ArrudaBoyce, Gel, Gent, free_energy, free_swelling, paper_stress, paper_tangent, uniaxial_swelling  # noqa: E402
from .mechanics import Loads, load_vector  # noqa: E402
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
    "find_states_by_deflation",
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
    "switch_branch",
    "uniaxial_swelling",
    "verify",
    "volume_ratio",
    "weighted_sum",
]
