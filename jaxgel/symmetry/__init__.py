"""Symmetry: groups of problems and states, fundamental regions, and tangent blocks."""

from .._deprecated import old_names
from .groups import (
    IDENTITY,
    NAMES,
    Images,
    characters,
    images,
    symmetries_of,
    symmetries_of_field,
    symmetries_of_state,
)
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

__getattr__ = old_names(__name__)
