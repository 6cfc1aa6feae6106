"""Waves: fields of a periodic cell that differ by a phase from cell to cell; onset of infinite lattices, dispersion of oscillations."""

from .bands import Dispersion, dispersion
from .bloch import BlochStates
from .cells import check_periodic, primitive_cell, translations
from .onset import LatticeOnset, lattice_onset
from .zone import brillouin_path, long_wave_number, wave_vectors_of_zone

__all__ = [
    "BlochStates",
    "Dispersion",
    "LatticeOnset",
    "brillouin_path",
    "check_periodic",
    "dispersion",
    "lattice_onset",
    "long_wave_number",
    "primitive_cell",
    "translations",
    "wave_vectors_of_zone",
]
