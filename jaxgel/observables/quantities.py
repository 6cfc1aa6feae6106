"""Table of a path's quantities: function, unit, label, digits and column, for figures and files."""

import dataclasses
from collections.abc import Callable
from operator import attrgetter
from typing import Any

import numpy as np

from .._types import Array, Shaped
from ..continuation import lowest_eigenvalue
from ..controls import CONTROLS
from ..equilibrium import Change
from ..geometry import Plate
from ..transient import Time
from .areas import area_reduction
from .contact import leak_area, total_obstacle_force
from .fields import free_stretch, host_volume_ratio, macroscopic_deformation, mean_volume_ratio
from .gaps import gap, min_gap_once, status_texts
from .rotation import core_rotation, rotation_angle
from .solvent import is_in_time, uptake
from .surface import crease_indicator, surface_ratio
from .wrinkling import surface_stability


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A quantity of a path, with one value per state."""

    name: str
    """Name in studies and figures."""
    function: Callable[[Any], Shaped[Array, " k"] | list[str]]
    """Path -> (k,) values in ``unit``."""
    unit: str
    """Unit as netCDF writes it; "1" for a pure number, "" for a text."""
    label: str
    """Label of an axis as Matplotlib writes it, without the unit."""
    text: str
    """What the quantity is, in a phrase."""
    digits: str = ".4g"
    """Format specification for values that people read, of `shown`."""
    percent: bool = False
    """Whether people read the values in percent."""
    differentiable: bool = False
    """Whether JAX differentiates ``function``."""
    column: str | None = None
    """Column of ``history.csv``; None for a quantity that is not in the table."""
    kind: type = float
    """Type of the values in ``history.csv``."""
    recorded: str | None = None
    """Field of the path that the table takes instead of evaluating ``function``."""
    studied: bool = False
    """Whether design studies take it; ``function`` is differentiable then."""
    plotted: tuple[str, str] | None = None
    """The figure of curves that shows it, see `plotting.CURVES`, and its words in the legend.

    None for none.
    """
    viewed: bool = False
    """Whether the page of a run shows its curve."""
    of_cells: bool = False
    """Whether a ``column`` is that of periodic cells with free macroscopic deformation.

    Only their tables have it.
    """
    of_obstacles: bool = False
    """Whether only the tables of plates with obstacles have its ``column``."""
    in_time: bool = False
    """Whether only transient swelling has it."""
    mirrored: bool = False
    """Whether the mirror image of a state has the opposite value."""

    @property
    def scale(self) -> float:
        """Factor from ``unit`` to the unit that people read."""
        return 100.0 if self.percent else 1.0

    @property
    def read_unit(self) -> str:
        """Unit that people read, as files write it; "" for a pure number."""
        return "%" if self.percent else "" if self.unit == "1" else self.unit

    def shown_unit(self, length: str = "mm") -> str:
        """Unit as a figure writes it, "" for a pure number.

        ``length`` is the plate's unit of length.
        """
        area = f"{length}²" if " " not in length else f"({length})²"
        return (
            "%"
            if self.percent
            else {
                "": "",
                "1": "",
                "kT": "$kT$",
                "degree": "°",
                "mm": length,
                "mm2": area,
                "kT/v mm2": f"kT/v {area}",
            }.get(self.unit, self.unit)
        )

    def axis_label(self, length: str = "mm") -> str:
        """Label of an axis, with the unit that people read."""
        unit = self.shown_unit(length)
        return f"{self.label} ({unit})" if unit else self.label

    def plain_label(self, length: str = "mm") -> str:
        """`axis_label` as plain text."""
        return (
            self.axis_label(length).replace(r"$\mu$", "μ").replace(r"$\chi$", "χ").replace("$", "")
        )

    def shown(self, value: Any) -> str:
        """One value as people read it, without its unit."""
        return f"{100.0 * value if self.percent else self.kind(value):{self.digits}}"

    def of(self, path: Any) -> Shaped[Array, " k"] | list[str]:
        """Values of the table at every state of a path."""
        return getattr(path, self.recorded) if self.recorded else self.function(path)


def _macroscopic(i, j):
    """`Quantity` F_ij."""
    name = f"F{i + 1}{j + 1}"

    def component(path: Any) -> Shaped[Array, " k"]:
        return macroscopic_deformation(path)[:, i, j]

    label, text = (
        f"macroscopic deformation $F_{{{i + 1}{j + 1}}}$",
        f"component {i + 1}{j + 1} of the macroscopic deformation gradient",
    )
    options = dict(differentiable=True, column=name, of_cells=True, studied=True, mirrored=i != j)
    return Quantity(name, component, "1", label, text, ".4f", **options)


def _uptake(path: Any) -> Shaped[Array, " k"]:
    """`uptake`; nan for a path without it."""
    return uptake(path) if is_in_time(path) else np.full(len(path), np.nan)


def reasons(path: Any) -> list[str]:
    """Texts (k) of ``path.switched``."""
    return [Change(int(change)).text for change in path.switched]


def _column(name: str, *given: Any, **options: Any) -> Quantity:
    """`Quantity` whose column has its name."""
    return Quantity(name, *given, **{"column": name} | options)


_STUDIED: dict[str, Any] = dict(differentiable=True, studied=True)
_SEEN: dict[str, Any] = _STUDIED | dict(viewed=True)

_TABLE = (
    _column(
        "mu",
        attrgetter("mu"),
        "kT",
        r"chemical potential $\mu$",
        "chemical potential of the solvent",
        ".4f",
    ),
    _column(
        "free_stretch",
        free_stretch,
        "1",
        "free-swelling stretch",
        "in-plane stretch of the freely swelling gel",
        ".4f",
    ),
    _column(
        "status", status_texts, "", "status", "what happened on the way to the state", "", kind=str
    ),
    _column(
        "switched",
        reasons,
        "",
        "change of branch",
        "why it does not continue the states before",
        "",
        kind=str,
    ),
    _column(
        "newton_iterations",
        attrgetter("newton_iterations"),
        "1",
        "Newton iterations",
        "number of Newton corrections",
        "d",
        kind=int,
    ),
    _column(
        "residual",
        attrgetter("residual"),
        "1",
        "residual",
        "residual over the forces of the network",
        ".1e",
    ),
    _column(
        "energy",
        attrgetter("energy"),
        "kT/v mm2",
        "energy",
        "total energy",
        ".6g",
        differentiable=True,
        viewed=True,
    ),
    _column(
        "J_min",
        lambda path: host_volume_ratio(path).min(axis=1),
        "1",
        "smallest volume ratio $J$",
        "smallest volume ratio of a cell",
        ".4f",
    ),
    _column(
        "J_max",
        lambda path: host_volume_ratio(path).max(axis=1),
        "1",
        "largest volume ratio $J$",
        "largest volume ratio of a cell",
        ".4f",
    ),
    _column(
        *("J_mean", mean_volume_ratio, "1", "mean volume ratio $J$", "mean volume ratio", ".4f"),
        **dict(differentiable=True, plotted=("J", "mean"), viewed=True),
    ),
    _column(
        *(
            "area_reduction",
            area_reduction,
            "1",
            "area reduction",
            "reduction of the area of the holes",
            ".3f",
        ),
        **_SEEN | dict(percent=True, plotted=("area_reduction", "all holes")),
    ),
    _column(
        *("rotation", rotation_angle, "degree", "rotation", "rotation of the midline", ".3f"),
        **_SEEN | dict(column="rotation_deg", plotted=("rotation", "midline"), mirrored=True),
    ),
    _column(
        *("core_rotation", core_rotation, "degree", "core rotation", "rotation of the core", ".3f"),
        **_SEEN | dict(column="core_rotation_deg", plotted=("rotation", "core"), mirrored=True),
    ),
    _column(
        *("negative_pivots", attrgetter("negative_pivots"), "1", "negative pivots"),
        *("number of negative pivots of the tangent, 0 for a stable state", "d"),
        kind=int,
    ),
    _column(
        *("lowest_eigenvalue", lowest_eigenvalue, "1", "lowest eigenvalue over the network's"),
        "lowest eigenvalue of the tangent over the network's stiffness",
        **_SEEN | dict(recorded="lowest_eigenvalue"),
    ),
    _column(
        *(
            "min_gap",
            min_gap_once,
            "mm",
            "smallest gap",
            "smallest gap between the sides of a hole",
            ".3f",
        ),
        plotted=("min_gap", "within a hole"),
        viewed=True,
    ),
    Quantity(
        "gap",
        gap,
        "mm",
        "smallest gap",
        "smallest gap between the sides of a hole, with derivatives",
        ".3f",
        **_STUDIED,
    ),
    _column(
        *("surface_ratio", surface_ratio, "1", "surface stretch ratio"),
        "largest ratio of normal to tangential stretch along the outlines",
        **_SEEN | dict(plotted=("surface_ratio", "largest")),
    ),
    _column(
        *("surface_stability", surface_stability, "1", "surface stability"),
        "least stability of the free surfaces to short waves: below 0 they wrinkle",
        **_SEEN | dict(plotted=("surface_stability", "least")),
    ),
    Quantity(
        *("crease_indicator", crease_indicator, "1", "softened surface stretch ratio"),
        "softened largest ratio of normal to tangential stretch along the outlines",
        **_STUDIED,
    ),
    *(_macroscopic(i, j) for i, j in ((0, 0), (1, 1), (0, 1))),
    _column(
        *(
            "obstacle_force",
            total_obstacle_force,
            "kT/v mm",
            "force on obstacles",
            "sum of the magnitudes of the forces on all obstacles",
        ),
        **_SEEN | dict(plotted=("obstacle_force", "all obstacles"), of_obstacles=True),
    ),
    _column(
        *(
            "leak_area",
            leak_area,
            "mm",
            "open area beside obstacles per depth",
            "open area between the gel and the obstacles, per depth",
        ),
        **_SEEN | dict(plotted=("leak_area", "all obstacles"), of_obstacles=True),
    ),
    _column(
        *(
            "uptake",
            _uptake,
            "mm2",
            "solvent taken up",
            "solvent that has come in through wetted boundary",
            ".4g",
        ),
        **dict(
            differentiable=True, plotted=("uptake", "all wetted parts"), viewed=True, in_time=True
        ),
    ),
)

QUANTITIES = {quantity.name: quantity for quantity in _TABLE}
"""Name -> `Quantity`."""
BY_COLUMN = {quantity.column: quantity for quantity in _TABLE if quantity.column}
"""Column of ``history.csv`` -> its `Quantity`, in the order of the columns."""
COLUMNS = tuple(
    column
    for column, quantity in BY_COLUMN.items()
    if not (quantity.of_cells or quantity.of_obstacles or quantity.in_time)
)
"""Columns of ``history.csv`` of every plate, in order."""
OF_CELLS = tuple(column for column, quantity in BY_COLUMN.items() if quantity.of_cells)
"""Those that follow for a periodic cell with a free macroscopic deformation."""
OF_OBSTACLES = tuple(column for column, quantity in BY_COLUMN.items() if quantity.of_obstacles)
"""Those that follow for a plate with obstacles."""
IN_TIME = tuple(column for column, quantity in BY_COLUMN.items() if quantity.in_time)
"""Those that follow for transient swelling."""
_SOLVED = (
    "mu",
    "obstacle_force",
    "energy",
    "residual",
    "newton_iterations",
    "negative_pivots",
    "lowest_eigenvalue",
)
OF_POSITIONS = tuple(
    name
    for name, quantity in QUANTITIES.items()
    if quantity.kind is not str and name not in _SOLVED and not quantity.in_time
)
"""Quantities of positions, pressures and control alone, also of limits of stability."""


def columns_of(plate: Plate, control: str = "mu") -> tuple[str, ...]:
    """Columns of ``history.csv`` of a plate, in order; a control other than mu comes first.

    It has that name.
    """
    own = (*COLUMNS, *OF_CELLS) if plate.free_strains else COLUMNS
    own = (*own, *OF_OBSTACLES) if plate.obstacles else own
    own = (*own, *IN_TIME) if control == Time.name else own
    return tuple(dict.fromkeys((control, *own)))


CURVES = {quantity.name: quantity.function for quantity in _TABLE if quantity.studied}
"""Quantities of design studies: name -> differentiable function of a path, (k,) values."""
OF_EQUILIBRIA = ("lowest_eigenvalue",)
"""Those that states of transient swelling do not have."""


def control_quantity(name: str = "mu", unit: str = "kT") -> Quantity:
    """The `Quantity` of a path that is the value of its control with this name and unit.

    >>> control_quantity("temperature", "°C").axis_label()
    'temperature (°C)'
    """
    if name == "mu":
        return QUANTITIES["mu"]
    if name == Time.name:
        return Quantity(
            name, attrgetter("value"), unit or "1", "time $t$", "time", ".3g", column=name
        )
    kind = CONTROLS.get(name)
    label, text, digits = (
        (kind.label, kind.text, kind.digits) if kind else (name, f"control {name}", ".5g")
    )
    return Quantity(name, attrgetter("value"), unit or "1", label, text, digits, column=name)
