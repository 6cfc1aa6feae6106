"""The table and figures of Deng et al. (2020) computed again, with a report."""

from .items import FINITE_ELEMENTS
from .newton import SchemePath, equilibria, scheme_path
from .runs import REPORT, run_paper
from .scheme import Scheme, make_scheme, scheme_energy
from .stress import paper_free_energy, paper_stress, paper_tangent, voigt

__all__ = [
    "FINITE_ELEMENTS",
    "REPORT",
    "Scheme",
    "SchemePath",
    "equilibria",
    "make_scheme",
    "paper_free_energy",
    "paper_stress",
    "paper_tangent",
    "run_paper",
    "scheme_energy",
    "scheme_path",
    "voigt",
]
