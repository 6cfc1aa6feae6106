"""Figures of a path: deformed patterns, curves, an animation. Axes come in and go out.

Nothing is shown. Patterns are drawn in mm on the triangles of the integration cells, so holes keep
their true outline. In curves a solid line is a stable branch, a dashed line one with negative
pivots, and what follows a self-contact is shaded.
"""

from types import SimpleNamespace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from .._deprecated import old_arguments
from .._types import Float
from ..bifurcation import CriticalPoint
from ..cloud import Cloud
from ..continuation import Path
from ..controls import Control, Punch
from ..discretisation import Model
from ..geometry import edge_lines, held_components
from ..observables import (
    FIELDS,
    deformed_vertices,
    field_on_triangles,
    field_values,
    free_stretch,
    is_in_time,
    obstacle_displacement,
    outlines,
    parameter_values,
    state_at,
    uptake,
)
from .filled import Gel
from .obstacles import Obstacles, draw_contact
from .style import COLOURS, LINE, WALL, length_unit, state_text, styled

PARAMETERS = {"Nv": "$Nv$", "chi": r"$\chi$", "bulk": "bulk modulus of elastomers (kT/v)"}
MODE_SIZE = 0.05  # largest displacement of a mode that is drawn, over the plate's shorter side
BEYOND = 1e-2  # of a colour scale: values beyond it by more are marked
# ratio of the largest to the smallest value of a parameter above which its scale is logarithmic
WIDE = 30.0


@styled
def plot_pattern(
    path: Path,
    k: int = -1,
    *,
    ax: Axes | None = None,
    field: str | None = "stretch",
    limits: tuple[float, float] | None = None,
    colorbar: bool = True,
) -> Axes:
    """Axes with the deformed gel of state ``k``, filled by ``field``.

    "stretch" (largest principal), "J", "mu" or None for one colour. On plates with obstacles marks
    show the pressure of contact. ``limits`` (lowest, highest) fixes the colour scale, by default
    the range of this state. Raises ValueError for another field.
    """
    ax = plt.subplots(figsize=(3.6, 3.3), layout="constrained")[1] if ax is None else ax
    (vertices,), (values,) = pictured_states(path, [k], field)
    gel = Gel(ax, path.model.cloud, vertices, values, limits or colour_range([values], path, field))
    draw_frame(
        ax,
        path.model.cloud,
        [vertices],
        state_text(path.value[k], path.control),
        obstacle_displacement(path[[k]])[0],
    )
    draw_contact(ax, path, k)
    if colorbar and values is not None:
        add_colorbar(gel, [ax], [values], field)
    return ax


@styled
def plot_patterns(
    path: Path, at: Any = None, *, axes: Any = None, field: str | None = "stretch"
) -> np.ndarray:
    """A row of axes with patterns at states nearest to ``at``, one colour scale.

    Accepted states, values of the control. By default four states, evenly spaced in the free
    swelling, or in the uptake if the path is one in time, whose values are times; where the control
    comes back to a value the first state there. ValueError for a value beyond the ends of the path.
    """
    states = _nearest(path, at)
    if axes is None:
        axes = plt.subplots(
            1,
            len(states),
            figsize=(2.1 * len(states) + 0.9, 2.55),
            sharey=True,
            layout="constrained",
        )[1]
    axes = np.atleast_1d(axes)
    vertices, values = pictured_states(path, states, field)
    limits = colour_range(values, path, field)
    for ax, k, v, colours, moved in zip(
        axes, states, vertices, values, obstacle_displacement(path[states]), strict=True
    ):
        gel = Gel(ax, path.model.cloud, v, colours, limits)
        draw_frame(ax, path.model.cloud, vertices, state_text(path.value[k], path.control), moved)
        draw_contact(ax, path, k)
        ax.label_outer()
    if field is not None:
        add_colorbar(gel, list(axes), values, field)
    return axes


@styled
def plot_gel(path: Path, *, axes: Any = None) -> np.ndarray:
    """Axes, one per parameter of the gel that varies, with the dry plate filled by it."""
    values = {name: np.asarray(of_cells) for name, of_cells in parameter_values(path).items()}
    if axes is None:
        axes = plt.subplots(
            1, len(values), figsize=(3.6 * len(values), 3.3), layout="constrained", squeeze=False
        )[1]
    for ax, (name, of_cells) in zip(np.ravel(axes), values.items(), strict=True):
        cells = draw_cells(ax, path.model.cloud, of_cells, _scale(of_cells))
        ax.set(title="dry plate")
        ax.figure.colorbar(cells, ax=ax, label=PARAMETERS.get(name, name), shrink=0.85)
    return np.ravel(axes)


def draw_cells(
    ax: Axes,
    cloud: Cloud,
    of_cells: Float[np.ndarray, " c"],
    scale: tuple[float, float] | Normalize,
) -> Any:
    """The dry plate on axes, cells filled by values (c,) on the ``scale``; for a colour bar.

    It returns what a colour bar takes.
    """
    unit = length_unit(cloud)
    ax.set(aspect="equal", xlabel=f"$x$ ({unit})", ylabel=f"$y$ ({unit})")
    return Gel(
        ax, cloud, np.asarray(cloud.vertices), of_cells[np.asarray(cloud.cell_of_triangle)], scale
    ).cells


def _scale(values: Float[np.ndarray, " c"]) -> Normalize:
    """The colour scale of a parameter with these ``values`` (c,) in the cells."""
    low, high = values.min(), values.max()
    return LogNorm(low, high) if 0 < low * WIDE < high else Normalize(low, high)


@styled
@old_arguments
def plot_modes(
    model: Model, points: list[CriticalPoint], *, control: Control | None = None, axes: Any = None
) -> np.ndarray:
    """Axes, one per mode of `CriticalPoint`s: the gel moved along it, critical outlines dashed.

    ``control`` is that of the search. The largest displacement is ``MODE_SIZE`` times the plate's
    shorter side.
    """
    shown = [(point, mode) for point in points for mode in point.modes]
    if axes is None:
        axes = plt.subplots(
            1,
            len(shown),
            figsize=(2.3 * len(shown) + 0.5, 2.75),
            sharey=True,
            layout="constrained",
            squeeze=False,
        )[1]
    plate, axes = model.cloud.plate, np.ravel(axes)
    for ax, (point, mode) in zip(axes, shown, strict=True):
        moved = (
            point.x
            + MODE_SIZE * min(plate.width, plate.height) * mode / np.linalg.norm(mode, axis=1).max()
        )
        states = SimpleNamespace(model=model, x=np.stack([point.x, moved]))
        vertices = np.asarray(deformed_vertices(states))
        Gel(ax, model.cloud, vertices[1], None, None)
        for hole in outlines(states):
            ax.plot(
                *np.append(hole[0], hole[0, :1], axis=0).T,
                color=COLOURS[1],
                linewidth=0.8,
                linestyle=(0, (4, 2)),
            )
        draw_frame(
            ax,
            model.cloud,
            vertices,
            f"{point.kind}, {state_text(point.value, control)}",
            _moved(plate, control, point),
        )
        ax.label_outer()
    handles = [
        Line2D(
            [], [], color=COLOURS[1], linestyle=(0, (4, 2)), label="outline at the critical state"
        ),
        Line2D([], [], color=LINE, label="moved along the mode"),
    ]
    axes[0].figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=2 if len(shown) > 1 else 1,
        frameon=False,
        fontsize=7.5,
    )
    return axes


def _nearest(path: Path, at: Any) -> list[int]:
    """Numbers of states nearest to ``at``, by default up to four, evenly in free stretch.

    Values of the control. If that is not known, or does not grow, they are evenly spaced along the
    way of the control; in time along that of the uptake.
    """
    if at is not None:
        return list(dict.fromkeys(state_at(path, value) for value in at))
    if is_in_time(path):
        way = np.cumsum(np.abs(np.diff(np.asarray(uptake(path)), prepend=0.0)))
        return list(
            dict.fromkeys(
                int(np.abs(way - value).argmin()) for value in np.linspace(0.0, way[-1], 4)
            )
        )
    x, stretch = np.asarray(path.value, dtype=float), np.asarray(free_stretch(path))
    x = stretch if np.all(np.diff(stretch) > 0) else np.cumsum(np.abs(np.diff(x, prepend=x[0])))
    return list(
        dict.fromkeys(int(np.abs(x - value).argmin()) for value in np.linspace(x[0], x[-1], 4))
    )


def pictured_states(path: Path, states: Any, field: str | None) -> tuple[list, list]:
    """Lists over ``states``: vertices (v, 2), and triangle values (t,), or None without field."""
    chosen = path[states]
    vertices = np.asarray(deformed_vertices(chosen))
    values = (
        [None] * len(states) if field is None else list(field_on_triangles(chosen, vertices, field))
    )
    return list(vertices), values


def colour_range(values: list, path: Path, field: str | None) -> tuple[float, float] | None:
    """Lowest and highest of all values, or None without any.

    Of mu in transient swelling the range between the start and the baths. Beside a boundary layer
    mu of a nearly dry gel, a logarithm, is below both by round-off of the little solvent there.
    """
    if field == "mu" and is_in_time(path):
        baths = path.control.mu if path.control.parts is None else path.control.parts
        values = [np.mean(field_values(path[:1], "mu")), *np.ravel(baths)]
    return None if values[0] is None else (float(np.min(values)), float(np.max(values)))


def add_colorbar(gel: Gel, axes: list[Axes], values: list, field: str) -> None:
    """The colour bar of a field beside the axes, with a tip if values are beyond the colours."""
    low, high = gel.scale.vmin, gel.scale.vmax
    margin = BEYOND * (high - low)
    beyond = np.array([np.min(values) < low - margin, np.max(values) > high + margin])
    extend = {
        (False, False): "neither",
        (True, False): "min",
        (False, True): "max",
        (True, True): "both",
    }[tuple(beyond.tolist())]
    gel.ax.figure.colorbar(gel.cells, ax=axes, label=FIELDS[field], shrink=0.85, extend=extend)


def _moved(plate, control, point):
    """Displacement (o, 2) of the obstacles of a plate at a critical point of this control."""
    found = np.zeros((len(plate.obstacles), 2))
    if isinstance(control, Punch):
        found[control.obstacle] = point.value * np.asarray(control.direction)
    return found


def draw_frame(
    ax: Axes, cloud: Cloud, states: Any, title: str, moved: Float[np.ndarray, "o 2"]
) -> Obstacles:
    """Edges, obstacles ``moved`` (o, 2), labels, title, and limits for ``states``.

    They hold the gel in all of them, a list of vertices (v, 2).
    """
    _draw_edges(ax, cloud, np.array(states))
    obstacles = Obstacles(
        ax, cloud.plate, 3 * max(np.nanmax(np.abs(states)), cloud.plate.width, cloud.plate.height)
    )
    obstacles.move(moved)
    unit = length_unit(cloud)
    ax.set(aspect="equal", xlabel=f"$x$ ({unit})", ylabel=f"$y$ ({unit})", title=title)
    return obstacles


def _draw_edges(ax: Axes, cloud: Cloud, vertices: Float[np.ndarray, "k v 2"]) -> None:
    """Hatched bars along supported edges, and limits of all states (k, v, 2)."""
    plate, topology, thick = (
        cloud.plate,
        cloud.topology,
        0.025 * max(cloud.plate.width, cloud.plate.height),
    )
    dry, x = np.asarray(cloud.nodes), vertices[-1, topology.node_vertices]
    for edge, (axis, coordinate) in edge_lines(plate).items():
        wall = topology.edge_nodes[edge]
        if not held_components(plate.edges, edge) or len(wall) < 2:
            continue
        ends = wall[np.argsort(dry[wall, 1 - axis])[[0, -1]]]
        half = 0.5 * (plate.height, plate.width)[axis]
        # from corner to corner
        share = (np.array([-half, half]) - dry[ends[0], 1 - axis]) / np.ptp(dry[ends, 1 - axis])
        inner = x[ends[0]] + share[:, None] * (x[ends[1]] - x[ends[0]])
        outer = inner + np.sign(coordinate) * thick * np.eye(2)[axis]
        corners = np.concatenate([inner, outer[::-1]])
        hatch = "/////" if plate.edges[edge] == "roller" else "xxxxx"
        ax.add_patch(
            Polygon(corners, facecolor="white", edgecolor=WALL, linewidth=0.0, hatch=hatch)
        )
    gel = vertices[:, np.unique(np.asarray(cloud.triangles))]
    low = np.minimum(gel.min(axis=(0, 1)), [-plate.width / 2, -plate.height / 2]) - 1.5 * thick
    high = np.maximum(gel.max(axis=(0, 1)), [plate.width / 2, plate.height / 2]) + 1.5 * thick
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
