"""Shape functions on a cloud and the ``Model``, by which an energy is integrated over the gel."""

from .._deprecated import old_names
from .body import NONE, Body, PatchBlock, numbered
from .connectivity import Connectivity, plate_edge_ends
from .consistency import consistent_gradients
from .interpolation import Interpolation, evaluate_points
from .ladder import PAIRS
from .layout import Cells, cells_of
from .model import Model, discretise
from .moving_least_squares import (
    BASES,
    KINDS,
    definite_inverse,
    monomials,
    n_monomials,
    shape_functions,
    shape_functions_and_gradients,
)
from .neighbours import pad_nodes, pairs_in_reach, reaching_nodes
from .options import DiscretisationOptions
from .placement import SPENT, Quality, cell_sizes, placed, quality, refreshed
from .pressures import SIGNS, group_weights, n_carrying
from .probes import (
    MIDLINE_POINTS,
    NodalField,
    core_probe,
    make_probe,
    midline_points,
    midline_probe,
)
from .weights import safe_sqrt, singular_weight

__all__ = [
    "BASES",
    "KINDS",
    "MIDLINE_POINTS",
    "NONE",
    "PAIRS",
    "SIGNS",
    "SPENT",
    "Body",
    "Cells",
    "Connectivity",
    "DiscretisationOptions",
    "Interpolation",
    "Model",
    "NodalField",
    "PatchBlock",
    "Quality",
    "cell_sizes",
    "cells_of",
    "consistent_gradients",
    "core_probe",
    "definite_inverse",
    "discretise",
    "evaluate_points",
    "group_weights",
    "make_probe",
    "midline_points",
    "midline_probe",
    "monomials",
    "n_carrying",
    "n_monomials",
    "numbered",
    "pad_nodes",
    "pairs_in_reach",
    "placed",
    "plate_edge_ends",
    "quality",
    "reaching_nodes",
    "refreshed",
    "safe_sqrt",
    "shape_functions",
    "shape_functions_and_gradients",
    "singular_weight",
]

__getattr__ = old_names(__name__)
