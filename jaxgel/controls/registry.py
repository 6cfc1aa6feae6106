"""Registry of the controls that case files, tables, figures and commands use by name."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from .._types import Scalar
from . import edges, gels, setting
from .setting import Control


@dataclasses.dataclass(frozen=True)
class Kind:
    """What is known of a control before there is a case."""

    make: Callable[[Mapping[str, Any]], Control]
    """Makes it from a case's ``mu`` (kT), ``direction``, ``loads``, ``obstacle``, ``displacement``.

    These are given by name; ``loads`` are (n, 2) or None.
    """
    unit: str
    """Of its value; empty for a dimensionless one."""
    label: str
    """Of an axis, as Matplotlib writes it."""
    text: str
    """Phrase for tables and tooltips."""
    digits: str
    """Format of its value."""
    scale: float = 1.0
    """See `Control`; of a parameter of the gel."""
    moves_edges: bool = False
    """Whether its value is a stretch, above 0, that edges follow along the case's direction."""
    multiplies_loads: bool = False
    """Whether its value is the factor of the case's loads."""
    moves_obstacle: bool = False
    """Whether its value is the factor of the displacement of one of the case's obstacles."""


def _driven(name):
    return lambda own: driven(name, own["mu"])


def _load(own):
    if own["loads"] is None:
        raise ValueError(
            "sweep.control: 'load' multiplies the loads of a case, and there are none; give a "
            "body_force or traction"
        )
    return edges.Load(own["loads"], own["mu"])


CONTROLS: dict[str, Kind] = {
    "mu": Kind(
        lambda _: setting.ChemicalPotential(),
        "kT",
        r"chemical potential $\mu$",
        "chemical potential of the solvent",
        ".4f",
    ),
    "temperature": Kind(
        _driven("temperature"), "°C", "temperature", "temperature of the gel", ".3f", 10.0
    ),
    "chi": Kind(
        _driven("chi"), "", r"Flory's parameter $\chi$", "Flory's parameter of mixing", ".4f", 0.1
    ),
    "pH": Kind(_driven("pH"), "", "pH", "pH of the bath", ".3f"),
    "salt": Kind(_driven("salt"), "mol/l", "salt", "salt concentration of the bath", ".5g", 0.1),
    "stretch": Kind(
        lambda own: edges.Stretch(own["direction"], own["mu"]),
        "",
        "stretch of the edges",
        "macroscopic stretch that the edges follow",
        ".4f",
        moves_edges=True,
    ),
    "load": Kind(_load, "", "load factor", "factor of the loads", ".4g", multiplies_loads=True),
    "punch": Kind(
        lambda own: edges.Punch(own["displacement"], own["obstacle"], own["mu"]),
        "mm",
        "displacement of the punch",
        "displacement of an obstacle",
        ".4g",
        moves_obstacle=True,
    ),
}
"""Name -> what is known of the control."""


def driven(name: str, mu: Scalar = 0.0) -> gels.DrivenParameter:
    """Control by the gel's parameter of this ``name`` at the chemical potential ``mu`` (kT)."""
    kind = CONTROLS.get(name)
    return (
        gels.DrivenParameter(name, mu)
        if kind is None
        else gels.DrivenParameter(name, mu, unit=kind.unit, scale=kind.scale)
    )


def temperature(mu: Scalar = 0.0) -> gels.DrivenParameter:
    """Control by the temperature, in degrees Celsius, of a gel that has one."""
    return driven("temperature", mu)


def chi(mu: Scalar = 0.0) -> gels.DrivenParameter:
    """Control by Flory's parameter, dimensionless."""
    return driven("chi", mu)


def pH(mu: Scalar = 0.0) -> gels.DrivenParameter:
    """Control by the pH of the bath around a gel with acidic groups."""
    return driven("pH", mu)


def salt(mu: Scalar = 0.0) -> gels.DrivenParameter:
    """Control by the salt concentration, mol/l, of the bath around a gel with charges."""
    return driven("salt", mu)
