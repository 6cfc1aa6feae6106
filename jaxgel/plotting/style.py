"""Colours, line styles and labels of all figures."""

import functools

import matplotlib as mpl

STYLE = {
    "font.size": 8.5,
    "axes.titlesize": 8.5,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.2,
    "hatch.linewidth": 0.5,
    "savefig.dpi": 200,
    "figure.dpi": 120,
}
GEL, LINE, WALL, SHADE = "#b7cfe2", "#1c2733", "#5c6670", "#e9e4de"
COLOURS = ("#0072b2", "#d55e00", "#009e73")  # Okabe and Ito: told apart with every kind of colour vision
MU = r"chemical potential $\mu$ ($kT$)"


def _styled(draw):
    """``draw`` with the style of this module, the caller's settings untouched."""

    @functools.wraps(draw)
    def styled(*args, **kwargs):
        with mpl.rc_context(STYLE):
            return draw(*args, **kwargs)

    return styled


def _unit(cloud):
    """Unit of lengths as Matplotlib writes it."""
    return cloud.topology.plate.unit.replace("1e-3", "$10^{-3}$")


def _mu_text(mu):
    return rf"$\mu = {float(mu):.4f}\,kT$"
