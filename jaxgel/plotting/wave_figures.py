"""Figures of waves: the softest wave over the Brillouin zone, and the pattern it makes."""

import itertools
from types import SimpleNamespace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from .._deprecated import old_arguments
from .._types import Float
from ..cloud import boundary_edges
from ..discretisation import Model
from ..geometry import SYMMETRIES
from ..mechanics import deformation_of, periods_of
from ..observables import deformed_vertices
from ..waves import LatticeOnset
from .style import COLOURS, LINE, length_unit, state_text, styled

WAVE_SIZE = 0.06  # largest displacement of a wave that is drawn, over the cell's shorter side
FEWEST = 4  # cells along a side that a figure of a pattern shows


@styled
def plot_zone(onset: LatticeOnset, model: Model, *, ax: Axes | None = None) -> Axes:
    """Axes with the lowest eigenvalue over the Brillouin zone at onset, critical k dotted.

    A dot is the wave vector that becomes unstable. Of a strip, which is periodic along one side, a
    curve.
    """
    ax = plt.subplots(figsize=(3.6, 2.9), layout="constrained")[1] if ax is None else ax
    plate = model.cloud.plate
    shares = onset.zone * np.array([plate.width, plate.height]) / np.pi
    critical = onset.wave_vector * np.array([plate.width, plate.height]) / np.pi
    axis = np.flatnonzero(np.ptp(shares, axis=0))
    if len(axis) == 1:
        order = np.argsort(np.abs(shares[:, axis[0]]))
        ax.plot(np.abs(shares[order, axis[0]]), onset.eigenvalues[order], color=COLOURS[0])
        ax.axhline(0, color=LINE, linewidth=0.5)
        ax.plot(abs(critical[axis[0]]), 0, "o", color=COLOURS[1], markersize=4)
        ax.set(
            xlabel=f"$k_{'xy'[axis[0]]}$ (π / side)",
            ylabel=r"lowest eigenvalue $\lambda$",
            title=state_text(onset.mu),
        )
        return ax
    matrices = [np.eye(2), *(np.array(SYMMETRIES[name], dtype=float) for name in onset.group)]
    images = np.concatenate([sign * shares @ matrix.T for matrix in matrices for sign in (1, -1)])
    values = np.tile(onset.eigenvalues, 2 * len(matrices))
    edges = np.concatenate([images + shift for shift in itertools.product((-2, 0, 2), repeat=2)])
    inside = np.abs(edges).max(axis=1) <= 1 + 1e-9
    points, first = np.unique(edges[inside].round(9), axis=0, return_index=True)
    field = ax.tricontourf(*points.T, np.tile(values, 9)[inside][first], levels=24, cmap="cividis")
    ax.figure.colorbar(field, ax=ax, label=r"lowest eigenvalue $\lambda$")
    at = np.concatenate(
        [sign * critical @ matrix.T for matrix in matrices for sign in (1, -1)]
    ).reshape(-1, 2)
    ax.plot(*at.T, "o", color=COLOURS[1], markersize=4, clip_on=False)
    ax.set(
        xlabel="$k_x$ (π / width)",
        ylabel="$k_y$ (π / height)",
        aspect="equal",
        title=state_text(onset.mu),
    )
    return ax


@styled
@old_arguments
def plot_lattice(onset: LatticeOnset, model: Model, *, ax: Axes | None = None) -> Axes:
    """Axes with cells of the infinite lattice, before (colour) and along the critical wave.

    That is the wave that becomes unstable. As many cells are shown as make the pattern whole twice,
    and at least ``FEWEST`` along a side; the largest displacement is ``WAVE_SIZE`` times the cell's
    shorter side.
    """
    ax = plt.subplots(figsize=(3.3, 3.3), layout="constrained")[1] if ax is None else ax
    topology = model.lists.topology
    plate, wave = (
        model.cloud.plate,
        onset.modes[0] + (1j * onset.modes[1] if len(onset.modes) > 1 else 0.0),
    )
    sides = np.array([plate.width, plate.height])
    deformation = np.asarray(
        deformation_of(
            np.asarray(onset.x), periods_of(topology), np.array(topology.plate.dry_deformation)
        )
    )
    wave = wave * WAVE_SIZE * sides.min() / np.linalg.norm(np.abs(wave), axis=1).max()
    periodic = onset.periodic
    repeats = onset.periods or (1, 1)
    counts = [
        max(FEWEST, 2 * repeat) if along else 1
        for repeat, along in zip(repeats, periodic, strict=True)
    ]
    for cell in itertools.product(*(range(count) for count in counts)):
        shift = np.array(cell) * sides
        moved = np.asarray(onset.x) + np.real(wave * np.exp(1j * (onset.wave_vector @ shift)))
        for x, style in ((np.asarray(onset.x), _RESTING), (moved, _MOVED)):
            ax.add_collection(LineCollection(_outline(x, model) + shift @ deformation.T, **style))
    unit = length_unit(model.cloud)
    ax.autoscale_view()
    ax.set(
        aspect="equal", xlabel=f"$x$ ({unit})", ylabel=f"$y$ ({unit})", title=state_text(onset.mu)
    )
    return ax


_RESTING: dict[str, Any] = {"colors": COLOURS[1], "linewidths": 0.6}
_MOVED: dict[str, Any] = {"colors": LINE, "linewidths": 0.9}


def _outline(x: Float[np.ndarray, "n 2"], model: Model) -> Float[np.ndarray, "e 2 2"]:
    """Edges (e, 2, 2) of the holes' outlines and of the plate's free edges."""
    vertices = np.asarray(deformed_vertices(SimpleNamespace(model=model, x=x[None])))[0]
    edges = boundary_edges(np.asarray(model.cloud.triangles))
    dry, plate = np.asarray(model.cloud.vertices), model.cloud.plate
    on = [
        (np.abs(np.abs(dry[edges][:, :, axis]) - half).max(axis=1) < 1e-9 * half)
        & (plate.edges[edge] == "periodic")
        for edge, axis, half in (("left", 0, plate.width / 2), ("bottom", 1, plate.height / 2))
    ]
    return vertices[edges[~(on[0] | on[1])]]
