"""Controls that case files, tables, figures and commands know by name."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from . import edges, gels, setting
from .setting import Control


@dataclasses.dataclass(frozen=True)
class Kind:
    """What is known of a control before there is a case."""

    make: Callable[[Mapping[str, Any]], Control]
    """Makes it of the chemical potential ``mu`` (kT), the ``direction`` and the ``loads`` (n, 2) or None of a case, each by its name."""
    unit: str
    """Of its value; empty for a dimensionless one."""
    label: str
    """Of an axis, as Matplotlib writes it."""
    text: str
    """Phrase for tables and tooltips."""
    digits: str
    """Format of its value."""


def _driven(name):
    return lambda own: gels.driven(name, own["mu"])


def _load(own):
    if own["loads"] is None:
        raise ValueError("sweep.control: 'load' multiplies the loads of a case, and there are none; give a body_force or traction")
    return edges.Load(own["loads"], own["mu"])


CONTROLS: dict[str, Kind] = {
    "mu": Kind(lambda _: setting.ChemicalPotential(), "kT", r"chemical potential $\mu$", "chemical potential of the solvent", ".4f"),
    "temperature": Kind(_driven("temperature"), "°C", "temperature", "temperature of the gel", ".3f"),
    "chi": Kind(_driven("chi"), "", r"Flory's parameter $\chi$", "Flory's parameter of mixing", ".4f"),
    "pH": Kind(_driven("pH"), "", "pH", "pH of the bath", ".3f"),
    "salt": Kind(_driven("salt"), "mol/l", "salt", "salt concentration of the bath", ".5g"),
    "stretch": Kind(
        lambda own: edges.Stretch(own["direction"], own["mu"]),
        "",
        "stretch of the edges",
        "macroscopic stretch that the edges follow",
        ".4f",
    ),
    "load": Kind(_load, "", "load factor", "factor of the loads", ".4g"),
}
"""Name -> what is known of the control."""
