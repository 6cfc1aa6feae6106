"""The table and figures of Deng et al. (2020) computed again, with a report."""

from .counts import PRINTED, table_1
from .items import CLOSING, CONDITION, CONFIRMED, CONTRADICTED, FINITE_ELEMENTS, Claim, Entry, Number, Runs, at, bow, crossing, stability
from .newton import SchemePath, equilibria, scheme_path
from .report import REPORT
from .runs import run_paper
from .scheme import Scheme, make_scheme, scheme_energy
from .square import METHODS, TIMED
from .stress import paper_free_energy, paper_stress, paper_tangent, voigt

__all__ = [
    "CLOSING",
    "CONDITION",
    "CONFIRMED",
    "CONTRADICTED",
    "FINITE_ELEMENTS",
    "METHODS",
    "PRINTED",
    "REPORT",
    "TIMED",
    "Claim",
    "Entry",
    "Number",
    "Runs",
    "Scheme",
    "SchemePath",
    "at",
    "bow",
    "crossing",
    "equilibria",
    "make_scheme",
    "paper_free_energy",
    "paper_stress",
    "paper_tangent",
    "run_paper",
    "scheme_energy",
    "scheme_path",
    "stability",
    "table_1",
    "voigt",
]
