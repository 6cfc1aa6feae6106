"""Symmetry: the group of a problem and of its states, the problem on a fundamental region, and the blocks of its tangent."""

from .cotangents import Orbits, orbits
from .groups import IDENTITY, NAMES, Images, characters, images, node_images, symmetries_of, symmetries_of_field, symmetries_of_state
from .irreducible import Representation, representation_of, representations
from .regions import Basis, Region, bases, region

__all__ = [
    "IDENTITY",
    "NAMES",
    "Basis",
    "Images",
    "Orbits",
    "Region",
    "Representation",
    "bases",
    "characters",
    "images",
    "node_images",
    "orbits",
    "region",
    "representation_of",
    "representations",
    "symmetries_of",
    "symmetries_of_field",
    "symmetries_of_state",
]
