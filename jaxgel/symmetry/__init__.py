"""Symmetry: the group of a problem and of its states, the problem on a fundamental region, and the blocks of its tangent."""

from .groups import IDENTITY, NAMES, Images, images, symmetries_of, symmetries_of_field, symmetries_of_state
from .regions import Basis, Region, bases, region
from .representations import Representation, kept, representations

__all__ = [
    "IDENTITY",
    "NAMES",
    "Basis",
    "Images",
    "Region",
    "Representation",
    "bases",
    "images",
    "kept",
    "region",
    "representations",
    "symmetries_of",
    "symmetries_of_field",
    "symmetries_of_state",
]
