"""Table and figures of Deng et al. (2020) reproduced, with a report."""

from .._deprecated import old_names
from .items import FINITE_ELEMENTS
from .least_squares import KINDS, cubic_spline_weight, shape_functions
from .newton import SchemePath, equilibria, scheme_path
from .runs import REPORT, run_paper
from .scheme import Scheme, make_scheme, scheme_energy
from .stress import paper_free_energy, paper_stress, paper_tangent, voigt

__all__ = [
    "FINITE_ELEMENTS",
    "KINDS",
    "REPORT",
    "Scheme",
    "SchemePath",
    "cubic_spline_weight",
    "equilibria",
    "make_scheme",
    "paper_free_energy",
    "paper_stress",
    "paper_tangent",
    "run_paper",
    "scheme_energy",
    "scheme_path",
    "shape_functions",
    "voigt",
]

__getattr__ = old_names(__name__)
