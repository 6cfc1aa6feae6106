"""Colours, line styles and labels of all figures."""

import functools
import os
import textwrap
from collections.abc import Callable
from typing import Any, TypeVar, cast

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from .._types import Scalar
from ..cloud import Cloud
from ..controls import ChemicalPotential, Control
from ..observables import Quantity, control_quantity
from ..transient import Time

F = TypeVar("F", bound=Callable[..., Any])
BY_MU = ChemicalPotential()
STYLE: dict[str, Any] = {
    "font.size": 8.5,
    "axes.titlesize": 8.5,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.2,
    "hatch.linewidth": 0.5,
    "savefig.dpi": 200,
    "figure.dpi": 120,
}
WARNING_WIDTH = 90  # characters of a line below a figure
LEAST, LARGEST = 1e-3, 1e5  # of numbers that are written without a power of ten
GEL, LINE, WALL, SHADE = "#b7cfe2", "#1c2733", "#5c6670", "#e9e4de"
# Okabe and Ito: distinguishable with every kind of colour vision
COLOURS = ("#0072b2", "#d55e00", "#009e73")


def styled(draw: F) -> F:
    """``draw`` with the settings ``STYLE`` of Matplotlib, which are restored afterwards."""

    @functools.wraps(draw)
    def with_style(*args: Any, **kwargs: Any) -> Any:
        with mpl.rc_context(STYLE):
            return draw(*args, **kwargs)

    return cast(F, with_style)


def colour_scale(count: int) -> list[str]:
    """``count`` colours of a field, from its lowest value to its highest, as "#rrggbb".

    The map reads the same with all colour vision.
    """
    return [
        mpl.colors.to_hex(mpl.colormaps["cividis"](share)) for share in np.linspace(0, 1, count)
    ]


def save_figure(figure: Figure, file: str | os.PathLike[str]) -> None:
    """Write a figure to a file and close it."""
    import matplotlib.pyplot as plt

    figure.savefig(file)
    plt.close(figure)


def add_warning(figure: Figure, text: str) -> None:
    """A line below a figure that says why its numbers may be wrong."""
    figure.supxlabel("\n".join(textwrap.wrap(text, WARNING_WIDTH)), fontsize=7, color=COLOURS[1])


def length_unit(cloud: Cloud) -> str:
    """Unit of lengths as Matplotlib writes it."""
    return cloud.topology.plate.unit.replace("1e-3", "$10^{-3}$")


def quantity_of(control: Control) -> Quantity:
    """The quantity that a control is, for axes and tables."""
    return control_quantity(control.name, control.unit)


def state_text(value: Scalar, control: Control = BY_MU) -> str:
    """Title of a state at a ``value`` of its control."""
    if control.name == "mu":
        return rf"$\mu = {float(value):.4f}\,kT$"
    if control.name == Time.name:
        return f"$t = {_number(value)}$ {control.unit}".rstrip()
    quantity = quantity_of(control)
    return f"{quantity.label} = {quantity.shown(value)} {quantity.shown_unit()}".rstrip()


def _number(value: Scalar) -> str:
    """A number with three digits, as Matplotlib writes it."""
    rounded = float(f"{float(value):.3g}")
    if rounded == 0 or LEAST <= abs(rounded) < LARGEST:
        return f"{rounded:g}"
    mantissa, exponent = f"{rounded:e}".split("e")
    return rf"{float(mantissa):g} \times 10^{{{int(exponent)}}}"
