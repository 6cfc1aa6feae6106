"""Waves: fields of a periodic cell up to a phase, and the onset of infinite lattices."""

from .._deprecated import old_names
from .bloch import BlochStates
from .cells import primitive_cell, translations
from .onset import LatticeOnset, lattice_onset
from .zone import long_wave_number, wave_vectors_of_zone

__all__ = [
    "BlochStates",
    "LatticeOnset",
    "lattice_onset",
    "long_wave_number",
    "primitive_cell",
    "translations",
    "wave_vectors_of_zone",
]

__getattr__ = old_names(__name__)
