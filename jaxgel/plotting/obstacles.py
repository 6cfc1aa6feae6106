"""Obstacles and the pressure of contact on axes."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon
from matplotlib.transforms import Affine2D

from .._types import Array, Float
from ..continuation import Path
from ..geometry import Plate
from ..observables import contact_pressure
from .style import COLOURS, WALL

FILL = "0.85"
LARGEST = 14.0  # points^2: area of the mark at the largest pressure


class Obstacles:
    """The obstacles of a plate on some axes, half-planes up to a ``size``, mm.

    `move` puts them elsewhere.
    """

    def __init__(self, ax: Axes, plate: Plate, size: float) -> None:
        self.ax, self.artists = ax, []
        for points, encloses in (obstacle.drawn(size) for obstacle in plate.obstacles):
            if encloses:
                self.artists.append(
                    ax.add_patch(Polygon(points, facecolor=FILL, edgecolor=WALL, linewidth=0.5))
                )
            else:
                self.artists.append(
                    ax.add_collection(LineCollection([points], colors=WALL, linewidths=1.0))
                )

    def move(self, by: Float[Array, "o 2"]) -> None:
        """Draw them displaced from where they are at rest, mm."""
        for artist, vector in zip(self.artists, by, strict=True):
            artist.set_transform(Affine2D().translate(*map(float, vector)) + self.ax.transData)


def draw_contact(ax: Axes, path: Path, k: int) -> None:
    """Draw marks at contact points of state ``k``, of an area that grows with the pressure."""
    if path.model.cloud.plate.obstacles:
        points, pressure = map(np.asarray, contact_pressure(path, k))
        if (touches := pressure > 0).any():
            ax.scatter(
                *points[touches].T,
                s=LARGEST * pressure[touches] / pressure.max(),
                color=COLOURS[1],
                linewidths=0,
                zorder=3,
            )
