"""The table and figures of Deng et al. (2020) computed again, with a report."""

from .counts import PRINTED, table_1
from .items import CLOSING, CONDITION, CONFIRMED, CONTRADICTED, FINITE_ELEMENTS, Claim, Entry, Number, Runs, at, bow, crossing, stability
from .report import REPORT
from .runs import run_paper
from .square import METHODS, TIMED

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
    "at",
    "bow",
    "crossing",
    "run_paper",
    "stability",
    "table_1",
]
