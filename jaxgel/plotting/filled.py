"""The filled gel on axes: triangles of the integration cells, outlines and interfaces."""

import numpy as np
import scipy.sparse
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Lines
from matplotlib.tri import Triangulation

from .._types import Array, Float, Int
from ..cloud import Cloud, boundary_edges, loop
from .style import GEL, LINE


class Gel:
    """The filled gel and its outline on some axes; `move` draws another state.

    A field is the mean of the cells around each vertex, and linear in the triangles; it jumps
    across the outlines of regions.
    """

    def __init__(
        self,
        ax: Axes,
        cloud: Cloud,
        vertices: Array,
        values: Array | None,
        limits: tuple[float, float] | Normalize | None,
    ) -> None:
        self.ax, self.cells = ax, None
        self.scale = (
            limits if isinstance(limits, Normalize) else Normalize(*(limits or (None, None)))
        )
        self.corners, self.triangles, self.mean = _by_region(cloud)
        self.boundary = boundary_edges(np.asarray(cloud.triangles))
        between = [
            np.stack([line[:-1], line[1:]], axis=1) for line in map(loop, cloud.topology.interfaces)
        ]
        self.between = np.concatenate([np.zeros((0, 2), dtype=int), *between])
        self.outline, self.interfaces = (
            ax.add_patch(
                PathPatch(
                    _lines(np.zeros((0, 2, 2))),
                    fill=False,
                    edgecolor=LINE,
                    linewidth=width,
                    capstyle="round",
                    zorder=2,
                )
            )
            for width in (0.7, 0.35)
        )
        self.move(vertices, values)

    @property
    def artists(self) -> list[Artist]:
        """What `move` draws anew."""
        return [self.cells, self.outline, self.interfaces]

    def move(self, vertices: Float[Array, "v 2"], values: Float[Array, " t"] | None) -> None:
        """Draw another state: vertices (v, 2) and triangle values (t,), None for a plain fill."""
        if self.cells is not None:
            self.cells.remove()
        mesh = Triangulation(*vertices[self.corners].T, self.triangles)
        if values is None:
            plain = {
                "facecolors": np.zeros(len(self.triangles)),
                "cmap": ListedColormap([GEL]),
                "antialiased": False,
            }
            self.cells = self.ax.tripcolor(mesh, rasterized=True, **plain)
        else:
            colours = {"cmap": "cividis", "norm": self.scale, "shading": "gouraud"}
            self.cells = self.ax.tripcolor(mesh, self.mean @ values, rasterized=True, **colours)
        self.outline.set_path(_lines(vertices[self.boundary]))
        self.interfaces.set_path(_lines(vertices[self.between]))


def _lines(ends):
    """Straight lines between pairs of points (s, 2, 2) as one path of Matplotlib."""
    return Lines(ends.reshape(-1, 2), np.tile([Lines.MOVETO, Lines.LINETO], len(ends)))


def _by_region(
    cloud: Cloud,
) -> tuple[Int[np.ndarray, " w"], Int[np.ndarray, "t 3"], scipy.sparse.sparray]:
    """Vertices (w,) of the regions, separate on interfaces, and triangles (t, 3).

    Vertices between two regions are there once for each. The sparse matrix (w, t) takes values on
    triangles to the mean over the cells of the region around each vertex.
    """
    triangles, cells = np.asarray(cloud.triangles), np.asarray(cloud.cell_of_triangle)
    key = cloud.topology.partition.region_of_cell[cells][:, None] * len(cloud.vertices) + triangles
    keys, corner = np.unique(key, return_inverse=True)
    corner = corner.reshape(triangles.shape)
    # values are constant in a cell: one triangle stands for it
    _, representative = np.unique(cells, return_index=True)
    pairs = np.unique(np.stack([corner.ravel(), np.repeat(representative[cells], 3)]), axis=1)
    touches = scipy.sparse.csr_array(
        (np.ones(pairs.shape[1]), tuple(pairs)), shape=(len(keys), len(triangles))
    )
    return keys % len(cloud.vertices), corner, touches / touches.sum(axis=1)[:, None]
