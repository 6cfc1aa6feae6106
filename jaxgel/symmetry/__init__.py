"""Symmetry: the group of a problem and of its states, the problem on a fundamental region, and the blocks of its tangent."""

from .groups import IDENTITY, NAMES, Images, characters, images, symmetries_of, symmetries_of_field, symmetries_of_state
from .irreducible import Representation, representation_of, representations
from .regions import Basis, Region, bases, region

__all__ = [
    "IDENTITY",
    "NAMES",
    "Basis",
    "Images",
    "Region",
    "Representation",
    "bases",
    "characters",
    "images",
    "region",
    "representation_of",
    "representations",
    "symmetries_of",
    "symmetries_of_field",
    "symmetries_of_state",
]
