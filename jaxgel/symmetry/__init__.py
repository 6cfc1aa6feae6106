"""Symmetry: groups of problems and states, fundamental regions, and tangent blocks."""

from .._deprecated import old_names
from .groups import (
    IDENTITY,
    NAMES,
    Images,
    are_places_known,
    characters,
    has_symmetries,
    images,
    possible_symmetries,
    symmetries_of,
    symmetries_of_field,
    symmetries_of_state,
)
from .irreducible import Representation, representation_of, representations
from .regions import Basis, Region, bases, blocks_of_plate, region, spread

__all__ = [
    "IDENTITY",
    "NAMES",
    "Basis",
    "Images",
    "Region",
    "Representation",
    "are_places_known",
    "bases",
    "blocks_of_plate",
    "characters",
    "has_symmetries",
    "images",
    "possible_symmetries",
    "region",
    "representation_of",
    "representations",
    "spread",
    "symmetries_of",
    "symmetries_of_field",
    "symmetries_of_state",
]

__getattr__ = old_names(__name__)
