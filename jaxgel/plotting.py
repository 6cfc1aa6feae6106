"""Figures of a path: deformed patterns, curves, an animation. Axes come in and go out; nothing is shown.

Patterns are drawn in mm on the triangles of the integration cells, so holes keep their true outline. In curves a solid line is
a stable branch, a dashed line one with negative pivots, and what follows a self-contact is shaded.
"""

import dataclasses
import functools
from types import SimpleNamespace

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle
from matplotlib.tri import Triangulation

from .edges import edge_lines, held_components
from .observables import deformed_vertices, free_stretch, outlines, volume_ratio
from .results import CREASE_RATIO, SELF_CONTACT, WRINKLE_RATIO, events, history

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
FIELDS = {"J": "volume ratio $J$", "stretch": "largest principal stretch"}
MU = r"chemical potential $\mu$ ($kT$)"

CURVES = {
    "rotation": ("rotation (°)", {"rotation_deg": "midline", "core_rotation_deg": "core"}),
    "area_reduction": ("area reduction (%)", {"area_reduction": "all holes"}),
    "J": ("volume ratio $J$", {"J_mean": "mean"}),
    "surface_ratio": ("surface stretch ratio", {"surface_ratio": "largest"}),
    "min_gap": ("smallest gap ({unit})", {"min_gap": "within a hole"}),
}
AGAINST = {"mu": MU, "free_stretch": "free-swelling stretch"}
MARKS = {"bifurcation": ":", "crease": "-.", "wrinkle": (0, (5, 1, 1, 1, 1, 1)), "contact": "--", "self-contact": "-"}


def _styled(draw):
    """``draw`` with the style of this module, the caller's settings untouched."""

    @functools.wraps(draw)
    def styled(*args, **kwargs):
        with mpl.rc_context(STYLE):
            return draw(*args, **kwargs)

    return styled


@_styled
def plot_pattern(path, k=-1, *, ax=None, field="stretch", limits=None, colorbar=True):
    """Axes with the deformed gel of state ``k``, filled by ``field``: "stretch" (largest principal), "J" or None for one colour.

    ``limits`` (lowest, highest) fixes the colour scale, by default the range of this state. Raises ValueError for another field.
    """
    ax = plt.subplots(figsize=(3.6, 3.3), layout="constrained")[1] if ax is None else ax
    (vertices,), (values,) = _pictured(path, [k], field)
    gel = _Gel(ax, path.model.cloud, vertices, values, limits or _range([values]))
    _frame(ax, path.model.cloud, [vertices], path.mu[k])
    if colorbar and values is not None:
        ax.figure.colorbar(gel.cells, ax=ax, label=FIELDS[field], shrink=0.85)
    return ax


@_styled
def plot_patterns(path, at=None, *, axes=None, field="stretch"):
    """A row of axes with the patterns at the accepted states nearest to the ``at`` in mu (by default four), one colour scale."""
    states = _nearest(path, at)
    if axes is None:
        axes = plt.subplots(1, len(states), figsize=(2.1 * len(states) + 0.9, 2.55), sharey=True, layout="constrained")[1]
    axes = np.atleast_1d(axes)
    vertices, values = _pictured(path, states, field)
    limits = _range(values)
    for ax, k, v, colours in zip(axes, states, vertices, values, strict=True):
        gel = _Gel(ax, path.model.cloud, v, colours, limits)
        _frame(ax, path.model.cloud, vertices, path.mu[k])
        ax.label_outer()
    if field is not None:
        axes[0].figure.colorbar(gel.cells, ax=list(axes), label=FIELDS[field], shrink=0.85)
    return axes


@_styled
def plot_curve(path, quantity, *, ax=None, against="mu", table=None):
    """Axes with one quantity of ``CURVES`` ("rotation", "area_reduction", "J", "surface_ratio", "min_gap") of every state.

    ``against`` is "mu" or "free_stretch"; ``table`` saves computing `results.history` again. Raises ValueError for other names.
    """
    _one_of("quantity", quantity, CURVES)
    _one_of("against", against, AGAINST)
    ax = plt.subplots(figsize=(3.6, 2.6), layout="constrained")[1] if ax is None else ax
    table = history(path) if table is None else table
    label, columns = CURVES[quantity]
    unstable = np.asarray(table["negative_pivots"]) > 0
    for (name, text), colour in zip(columns.items(), COLOURS, strict=False):
        values = np.asarray(table[name]) * (100.0 if quantity == "area_reduction" else 1.0)
        _draw_branch(ax, table[against], values, unstable, colour, text)
    if quantity == "J":
        ax.fill_between(table[against], table["J_min"], table["J_max"], color=COLOURS[0], alpha=0.25, linewidth=0, label="all cells")
    if quantity == "surface_ratio":
        ax.axhline(CREASE_RATIO, color=WALL, linewidth=0.7, linestyle=(0, (1, 1)), label="crease limit")
        ax.axhline(WRINKLE_RATIO, color=WALL, linewidth=0.7, linestyle=(0, (3, 2)), label="wrinkle limit")
    _mark_events(ax, table, against)
    ax.set(xlabel=AGAINST[against], ylabel=label.replace("{unit}", _unit(path.model.cloud)))
    ax.margins(x=0.02)
    if len(ax.get_legend_handles_labels()[1]) > 1:
        ax.legend(frameon=False, fontsize=7.5)
    return ax


@_styled
def plot_curves(path, *, axes=None, table=None):
    """A (5, 2) array of axes: every quantity of ``CURVES`` against mu on the left and against the free-swelling stretch on the right.

    ``table`` saves computing `results.history` again.
    """
    if axes is None:
        axes = plt.subplots(len(CURVES), 2, figsize=(6.9, 8.8), sharex="col", sharey="row", layout="constrained")[1]
    table = history(path) if table is None else table
    for row, quantity in zip(axes, CURVES, strict=True):
        for ax, against in zip(row, AGAINST, strict=True):
            plot_curve(path, quantity, ax=ax, against=against, table=table)
            ax.label_outer()
        if row[1].get_legend() is not None:
            row[1].get_legend().remove()
    marks = [
        Line2D([], [], color=WALL, linewidth=0.9, linestyle=MARKS[e], label=e) for e in dict.fromkeys(e["event"] for e in events(table))
    ]
    if np.any(np.asarray(table["negative_pivots"]) > 0):
        marks.append(Line2D([], [], color=LINE, linestyle="--", label="unstable branch"))
    if SELF_CONTACT in table["status"]:
        marks.append(Rectangle((0, 0), 1, 1, color=SHADE, label="invalid after self-contact"))
    if marks:
        axes[0, 0].figure.legend(handles=marks, loc="outside upper center", ncols=len(marks), frameon=False, fontsize=7.5)
    return axes


@_styled
def plot_modes(model, points, *, axes=None, size=0.05):
    """Axes, one per mode of the `critical.CriticalPoint`s: the gel moved along the mode, and the outlines of the critical state dashed.

    The largest displacement is ``size`` times the plate's shorter side.
    """
    shown = [(point, mode) for point in points for mode in point.modes]
    if axes is None:
        axes = plt.subplots(1, len(shown), figsize=(2.3 * len(shown) + 0.5, 2.75), sharey=True, layout="constrained", squeeze=False)[1]
    plate, axes = model.cloud.plate, np.ravel(axes)
    for ax, (point, mode) in zip(axes, shown, strict=True):
        moved = point.x + size * min(plate.width, plate.height) * mode / np.linalg.norm(mode, axis=1).max()
        states = SimpleNamespace(model=model, x=np.stack([point.x, moved]))
        vertices = np.asarray(deformed_vertices(states))
        _Gel(ax, model.cloud, vertices[1], None, None)
        for loop in outlines(states):
            ax.plot(*np.append(loop[0], loop[0, :1], axis=0).T, color=COLOURS[1], linewidth=0.8, linestyle=(0, (4, 2)))
        _frame(ax, model.cloud, vertices, float(point.mu))
        ax.set_title(f"{point.kind}, {_mu_text(point.mu)}")
        ax.label_outer()
    handles = [
        Line2D([], [], color=COLOURS[1], linestyle=(0, (4, 2)), label="outline at the critical state"),
        Line2D([], [], color=LINE, label="moved along the mode"),
    ]
    axes[0].figure.legend(handles=handles, loc="outside lower center", ncols=2 if len(shown) > 1 else 1, frameon=False, fontsize=7.5)
    return axes


@_styled
def animate_pattern(path, file, *, field="stretch", seconds=6.0, most_frames=60):
    """Write a GIF of the pattern over all states of a path (at most ``most_frames`` of them, evenly chosen), ``seconds`` long.

    A ``file`` whose name ends in .mp4 becomes a film (H.264) by the program ffmpeg, that on the PATH or, else, that of the package
    imageio-ffmpeg (extra ``[view]``); ValueError where there is neither.
    """
    kind, settings = _writer_of(file)
    states = np.unique(np.linspace(0, len(path.mu) - 1, min(most_frames, len(path.mu))).round().astype(int))
    vertices, values = _pictured(path, states, field)
    figure, ax = plt.subplots(figsize=(4.4, 3.8), layout="constrained")
    gel = _Gel(ax, path.model.cloud, vertices[0], values[0], _range(values))
    _frame(ax, path.model.cloud, vertices, path.mu[states[0]])
    if field is not None:
        figure.colorbar(gel.cells, ax=ax, label=FIELDS[field], shrink=0.85)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # every frame as the first one is laid out
    writer = kind(fps=max(1.0, len(states) / seconds))
    with mpl.rc_context(settings), writer.saving(figure, str(file), dpi=110):
        for k, v, colours in zip(states, vertices, values, strict=True):
            gel.move(v, colours)
            ax.set_title(_mu_text(path.mu[k]))
            writer.grab_frame()
    plt.close(figure)


def _writer_of(file):
    """Matplotlib's writer for a file's name, and the settings it needs."""
    if not str(file).lower().endswith(".mp4"):
        return PillowWriter, {}
    if FFMpegWriter.isAvailable():
        return FFMpegWriter, {}
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return FFMpegWriter, {"animation.ffmpeg_path": get_ffmpeg_exe()}
    except (ImportError, RuntimeError):
        raise ValueError(
            f"file: {str(file)!r} needs the program ffmpeg; install it, or pip install 'jaxgel[view]', or write a GIF"
        ) from None


def field_values(path, field):
    """Values (k, t) of a field of ``FIELDS`` on the triangles of a path's cloud, constant in each cell; ValueError for another name.

    "J" is `observables.volume_ratio`; with the paper's quadrature, whose cells are other squares, and for "stretch" it follows
    from the deformation gradient between the vertices, averaged over the dry volume of a cell.
    """
    return _field_on_triangles(path, np.asarray(deformed_vertices(path)), field)


def _field_on_triangles(path, vertices, field):
    """Values (k, t) of a field, with the deformed vertices (k, v, 2) at hand."""
    _one_of("field", field, FIELDS)
    triangles, cells = np.asarray(path.model.cloud.triangles), np.asarray(path.model.cloud.cell_of_triangle)
    if field == "J" and path.model.quadrature == "conforming":
        return np.asarray(volume_ratio(path))[:, cells]
    dry = _edges(np.asarray(path.model.cloud.vertices)[triangles])
    F = _edges(vertices[:, triangles]) @ np.linalg.inv(dry)
    volume = np.linalg.det(dry)
    average = scipy.sparse.csr_array((volume, (cells, np.arange(len(cells)))), shape=(cells.max() + 1, len(cells)))
    average = average / average.sum(axis=1)[:, None]
    F = np.stack([(average @ state.reshape(-1, 4)).reshape(-1, 2, 2) for state in F])
    values = np.linalg.det(F) if field == "J" else np.linalg.svd(F, compute_uv=False)[..., 0]
    return values[:, cells]


def _edges(corners):
    """Two edge vectors as columns (..., 2, 2) of triangles (..., 3, 2)."""
    return np.stack([corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]], axis=-1)


def _pictured(path, states, field):
    """Vertices (v, 2) and triangle values (t,), or None without a field, of each of the given states, as two lists."""
    chosen = dataclasses.replace(path, x=np.asarray(path.x)[states])
    vertices = np.asarray(deformed_vertices(chosen))
    values = [None] * len(states) if field is None else list(_field_on_triangles(chosen, vertices, field))
    return list(vertices), values


def _range(values):
    """Lowest and highest of all values, or None without any."""
    return None if values[0] is None else (float(np.min(values)), float(np.max(values)))


class _Gel:
    """The filled gel and its outline on some axes, which `move` takes to another state.

    A field is drawn as the mean of the cells around each vertex and linear in the triangles.
    """

    def __init__(self, ax, cloud, vertices, values, limits):
        self.ax, self.limits, self.cells = ax, limits or (None, None), None
        self.triangles, self.mean = np.asarray(cloud.triangles), _vertex_mean(cloud)
        self.boundary = boundary_edges(self.triangles)
        self.outline = ax.add_collection(LineCollection([], colors=LINE, linewidths=0.7, capstyle="round"))
        self.move(vertices, values)

    def move(self, vertices, values):
        """Draw another state: vertices (v, 2) and triangle values (t,), or None for a plain fill."""
        if self.cells is not None:
            self.cells.remove()
        mesh = Triangulation(*vertices.T, self.triangles)
        if values is None:
            plain = {"facecolors": np.zeros(len(self.triangles)), "cmap": ListedColormap([GEL]), "antialiased": False}
            self.cells = self.ax.tripcolor(mesh, rasterized=True, **plain)
        else:
            lowest, highest = self.limits
            colours = {"cmap": "cividis", "vmin": lowest, "vmax": highest, "shading": "gouraud"}
            self.cells = self.ax.tripcolor(mesh, self.mean @ values, rasterized=True, **colours)
        self.outline.set_segments(vertices[self.boundary])


def _frame(ax, cloud, states, mu):
    """Walls, labels, and limits that hold the gel in all ``states``, a list of vertices (v, 2)."""
    _draw_walls(ax, cloud, np.array(states))
    unit = _unit(cloud)
    ax.set(aspect="equal", xlabel=f"$x$ ({unit})", ylabel=f"$y$ ({unit})", title=_mu_text(mu))


def _unit(cloud):
    """Unit of lengths as Matplotlib writes it."""
    return cloud.topology.plate.unit.replace("1e-3", "$10^{-3}$")


def _mu_text(mu):
    return rf"$\mu = {float(mu):.4f}\,kT$"


def _vertex_mean(cloud):
    """Sparse matrix (v, t) that takes values on triangles to the mean over the cells around each vertex."""
    triangles, cells = np.asarray(cloud.triangles), np.asarray(cloud.cell_of_triangle)
    _, representative = np.unique(cells, return_index=True)  # values are constant in a cell: one triangle stands for it
    pairs = np.unique(np.stack([triangles.ravel(), np.repeat(representative[cells], 3)]), axis=1)
    touches = scipy.sparse.csr_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(len(cloud.vertices), len(triangles)))
    return touches / np.maximum(touches.sum(axis=1), 1.0)[:, None]


def boundary_edges(triangles):
    """Edges (e, 2) that belong to one triangle only."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    return unique[count == 1]


def _draw_walls(ax, cloud, vertices):
    """Hatched bars along the supported edges of the plate, and limits that hold all states (k, v, 2)."""
    plate = cloud.plate
    w, h, thick = plate.width, plate.height, 0.025 * max(plate.width, plate.height)
    for edge, (axis, coordinate) in edge_lines(plate).items():
        if not held_components(plate.edges, edge):
            continue
        inner = 0.5 * np.array([[-w, -h], [w, h]])
        inner[:, axis] = coordinate
        inner = inner @ np.array(plate.deformation).T + plate.displacement[edge]
        outer = inner + np.sign(coordinate) * thick * np.eye(2)[axis]
        corners = np.concatenate([inner, outer[::-1]])
        hatch = "/////" if plate.edges[edge] == "roller" else "xxxxx"
        ax.add_patch(Polygon(corners, facecolor="white", edgecolor=WALL, linewidth=0.0, hatch=hatch))
    gel = vertices[:, np.unique(np.asarray(cloud.triangles))]
    low = np.minimum(gel.min(axis=(0, 1)), [-w / 2, -h / 2]) - 1.5 * thick
    high = np.maximum(gel.max(axis=(0, 1)), [w / 2, h / 2]) + 1.5 * thick
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def _draw_branch(ax, x, y, unstable, colour, label):
    """One curve, solid where both ends of a piece are stable and dashed elsewhere, with a dot per state."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    dashed = unstable.copy()
    dashed[1:] |= unstable[:-1]
    dashed[:-1] |= unstable[1:]
    ax.plot(x, np.where(unstable, np.nan, y), color=colour, label=label, marker="o", markersize=2.0)
    ax.plot(x, np.where(dashed, y, np.nan), color=colour, linestyle="--")
    ax.plot(x[unstable], y[unstable], color=colour, linestyle="none", marker="o", markersize=2.0, markerfacecolor="white")


def _mark_events(ax, table, against):
    """Vertical lines at the events of a table, shade from the first self-contact on."""
    mu, x = np.asarray(table["mu"]), np.asarray(table[against])
    for event in events(table):
        at = x[np.searchsorted(mu, event["mu"])]
        ax.axvline(at, color=WALL, linewidth=0.9, linestyle=MARKS[event["event"]], zorder=0.5)
        if event["event"] == "self-contact":
            ax.axvspan(at, x[-1], color=SHADE, linewidth=0, zorder=0)


def _nearest(path, at):
    """Numbers of the states nearest to the chemical potentials ``at``, by default up to four evenly spread in the free swelling."""
    x = np.asarray(free_stretch(path) if at is None else path.mu)
    at = np.linspace(x[0], x[-1], 4) if at is None else at
    states = [int(np.abs(x - value).argmin()) for value in at]
    return list(dict.fromkeys(states))


def _one_of(name, value, known):
    if value not in known:
        raise ValueError(f"{name}: {value!r} is not one of {', '.join(known)}")
