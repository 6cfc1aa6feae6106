"""The gel: free energy, stress, free and uniaxial swelling."""

from .deng2020 import paper_free_energy, paper_stress, paper_tangent, voigt
from .gel import ArrudaBoyce, Gel, Gent, bulk_stiffness, cauchy_stress, flory_huggins, flory_rehner, free_energy, neo_hookean, osmotic
from .swelling import check_gel, free_swelling, largest_mu, largest_pressure, uniaxial_swelling, volume_ratio_at

__all__ = [
    "ArrudaBoyce",
    "Gel",
    "Gent",
    "bulk_stiffness",
    "cauchy_stress",
    "check_gel",
    "flory_huggins",
    "flory_rehner",
    "free_energy",
    "free_swelling",
    "largest_mu",
    "largest_pressure",
    "neo_hookean",
    "osmotic",
    "paper_free_energy",
    "paper_stress",
    "paper_tangent",
    "uniaxial_swelling",
    "voigt",
    "volume_ratio_at",
]
