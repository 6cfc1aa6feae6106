"""Options of the cloud and the discretisation."""

import dataclasses

from .._validation import POSITIVE, check_options, option, whole, word
from ..linalg import SOLVERS

BASES = ("linear", "quadratic")
METHODS = ("mixed", "displacement")
QUADRATURES = ("conforming", "paper")


@dataclasses.dataclass(frozen=True)
class DiscretisationOptions:
    """Choices of `cloud.make_cloud` and `discretisation.discretise`; None leaves the default of the plate or the method."""

    spacing: float | None = option(None, POSITIVE)
    """Distance of the background nodes, mm."""
    nodes_per_hole: int | None = option(None, whole(3))
    """Nodes on the outline of a whole hole."""
    across: int | None = option(None, whole(2))
    """Least number of nodes across every ligament, by local refinement."""
    basis: str = option("quadratic", word(BASES))
    """Basis of the shape functions"""
    dmax: float | None = option(None, POSITIVE | {"maximum": 10.0})
    """Support radius over spacing."""
    method: str = option("mixed", word(METHODS))
    """One pressure per cell, or displacement only"""
    quadrature: str = option("conforming", word(QUADRATURES))
    """Cells along the true outline, or the paper's"""
    solver: str = option("auto", word(SOLVERS))
    """How linear systems are solved, see `linear_solve`"""

    def __post_init__(self):
        check_options("discretisation", self)
