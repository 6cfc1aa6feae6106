"""The one table of a path's quantities: function, unit, label, digits and column; tables, figures, files and studies derive from it."""

import dataclasses
from collections.abc import Callable
from operator import attrgetter
from typing import Any

from .._types import Array, Shaped
from ..continuation import lowest_eigenvalue
from ..controls import CONTROLS
from ..equilibrium import Change
from ..geometry import Plate
from .areas import area_reduction
from .fields import (
    free_stretch,
    largest_volume_ratio,
    macroscopic_deformation,
    mean_volume_ratio,
    smallest_volume_ratio,
)
from .gaps import gap, min_gap_once, status_texts
from .rotation import core_rotation, rotation_angle
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
    """The figure of curves that shows it, see `plotting.CURVES`, and its words in the legend; None for none."""
    viewed: bool = False
    """Whether the page of a run shows its curve."""
    of_cells: bool = False
    """Whether only the tables of periodic cells with a free macroscopic deformation have its ``column``."""

    @property
    def scale(self) -> float:
        """Factor from ``unit`` to the unit that people read."""
        return 100.0 if self.percent else 1.0

    def shown_unit(self, length: str = "mm") -> str:
        """Unit as a figure writes it, "" for a pure number; ``length`` is the plate's unit of length."""
        area = f"{length}²" if " " not in length else f"({length})²"
        return (
            "%"
            if self.percent
            else {"": "", "1": "", "kT": "$kT$", "degree": "°", "mm": length, "kT/v mm2": f"kT/v {area}"}.get(self.unit, self.unit)
        )

    def axis_label(self, length: str = "mm") -> str:
        """Label of an axis, with the unit that people read."""
        unit = self.shown_unit(length)
        return f"{self.label} ({unit})" if unit else self.label

    def plain_label(self, length: str = "mm") -> str:
        """`axis_label` as plain text."""
        return self.axis_label(length).replace(r"$\mu$", "μ").replace(r"$\chi$", "χ").replace("$", "")

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

    label, text = f"macroscopic deformation $F_{{{i + 1}{j + 1}}}$", f"component {i + 1}{j + 1} of the macroscopic deformation gradient"
    return Quantity(name, component, "1", label, text, ".4f", differentiable=True, column=name, of_cells=True, studied=True)


def reasons(path: Any) -> list[str]:
    """Texts (k) of ``path.switched``."""
    return [Change(int(change)).text for change in path.switched]


_ANGLE: dict[str, Any] = dict(unit="degree", digits=".3f", viewed=True)
_RATIO: dict[str, Any] = dict(unit="1", digits=".4f")
_STUDIED: dict[str, Any] = dict(differentiable=True, studied=True)
_COUNT: dict[str, Any] = dict(unit="1", digits="d", kind=int)

_TABLE = (
    Quantity("mu", attrgetter("mu"), "kT", r"chemical potential $\mu$", "chemical potential of the solvent", ".4f", column="mu"),
    Quantity(
        "free_stretch",
        free_stretch,
        label="free-swelling stretch",
        text="in-plane stretch of the freely swelling gel",
        column="free_stretch",
        **_RATIO,
    ),
    Quantity("status", status_texts, "", "status", "what happened on the way to the state", "", column="status", kind=str),
    Quantity("switched", reasons, "", "change of branch", "why it does not continue the states before", "", column="switched", kind=str),
    Quantity(
        "newton_iterations",
        attrgetter("newton_iterations"),
        label="Newton iterations",
        text="number of Newton corrections",
        column="newton_iterations",
        **_COUNT,
    ),
    Quantity("residual", attrgetter("residual"), "1", "residual", "residual over the forces of the network", ".1e", column="residual"),
    Quantity(
        "energy", attrgetter("energy"), "kT/v mm2", "energy", "total energy", ".6g", differentiable=True, column="energy", viewed=True
    ),
    Quantity(
        "J_min", smallest_volume_ratio, label="smallest volume ratio $J$", text="smallest volume ratio of a cell", column="J_min", **_RATIO
    ),
    Quantity(
        "J_max", largest_volume_ratio, label="largest volume ratio $J$", text="largest volume ratio of a cell", column="J_max", **_RATIO
    ),
    Quantity(
        "J_mean",
        mean_volume_ratio,
        label="mean volume ratio $J$",
        text="mean volume ratio",
        column="J_mean",
        plotted=("J", "mean"),
        viewed=True,
        **_RATIO,
    ),
    Quantity(
        "area_reduction",
        area_reduction,
        unit="1",
        label="area reduction",
        text="reduction of the area of the holes",
        digits=".3f",
        percent=True,
        column="area_reduction",
        plotted=("area_reduction", "all holes"),
        viewed=True,
        **_STUDIED,
    ),
    Quantity(
        "rotation",
        rotation_angle,
        label="rotation",
        text="rotation of the midline",
        column="rotation_deg",
        plotted=("rotation", "midline"),
        **_ANGLE | _STUDIED,
    ),
    Quantity(
        "core_rotation",
        core_rotation,
        label="core rotation",
        text="rotation of the core",
        column="core_rotation_deg",
        plotted=("rotation", "core"),
        **_ANGLE | _STUDIED,
    ),
    Quantity(
        "negative_pivots",
        attrgetter("negative_pivots"),
        label="negative pivots",
        text="number of negative pivots of the tangent, 0 for a stable state",
        column="negative_pivots",
        **_COUNT,
    ),
    Quantity(
        "lowest_eigenvalue",
        lowest_eigenvalue,
        unit="1",
        label="lowest eigenvalue over the network's",
        text="lowest eigenvalue of the tangent over the network's stiffness",
        column="lowest_eigenvalue",
        recorded="lowest_eigenvalue",
        viewed=True,
        **_STUDIED,
    ),
    Quantity(
        "min_gap",
        min_gap_once,
        "mm",
        "smallest gap",
        "smallest gap between the sides of a hole",
        ".3f",
        column="min_gap",
        plotted=("min_gap", "within a hole"),
        viewed=True,
    ),
    Quantity("gap", gap, "mm", "smallest gap", "smallest gap between the sides of a hole, with derivatives", ".3f", **_STUDIED),
    Quantity(
        "surface_ratio",
        surface_ratio,
        unit="1",
        label="surface stretch ratio",
        text="largest ratio of normal to tangential stretch along the outlines",
        column="surface_ratio",
        plotted=("surface_ratio", "largest"),
        viewed=True,
        **_STUDIED,
    ),
    Quantity(
        "surface_stability",
        surface_stability,
        unit="1",
        label="surface stability",
        text="least stability of the free surfaces to short waves: below 0 they wrinkle",
        column="surface_stability",
        plotted=("surface_stability", "least"),
        viewed=True,
        **_STUDIED,
    ),
    Quantity(
        "crease_indicator",
        crease_indicator,
        unit="1",
        label="softened surface stretch ratio",
        text="softened largest ratio of normal to tangential stretch along the outlines",
        **_STUDIED,
    ),
    *(_macroscopic(i, j) for i, j in ((0, 0), (1, 1), (0, 1))),
)

QUANTITIES = {quantity.name: quantity for quantity in _TABLE}
"""Name -> `Quantity`."""
BY_COLUMN = {quantity.column: quantity for quantity in _TABLE if quantity.column}
"""Column of ``history.csv`` -> its `Quantity`, in the order of the columns."""
COLUMNS = tuple(column for column, quantity in BY_COLUMN.items() if not quantity.of_cells)
"""Columns of ``history.csv`` of every plate, in order."""
OF_CELLS = tuple(column for column, quantity in BY_COLUMN.items() if quantity.of_cells)
"""Those that follow for a periodic cell with a free macroscopic deformation."""
_SOLVED = ("mu", "energy", "residual", "newton_iterations", "negative_pivots", "lowest_eigenvalue")
OF_POSITIONS = tuple(name for name, quantity in QUANTITIES.items() if quantity.kind is not str and name not in _SOLVED)
"""Quantities that need nothing of a state but its positions, pressures and control: limits of stability have them, too."""


def columns_of(plate: Plate, control: str = "mu") -> tuple[str, ...]:
    """Columns of ``history.csv`` of a plate, in order, under a control of that name: another than mu comes first."""
    own = (*COLUMNS, *OF_CELLS) if plate.free_strains else COLUMNS
    return own if control == "mu" else (control, *own)


CURVES = {quantity.name: quantity.function for quantity in _TABLE if quantity.studied}
"""Quantities that design studies take: name -> differentiable function of a path, with (k,) values."""


def control_quantity(name: str = "mu", unit: str = "kT") -> Quantity:
    """The `Quantity` of a path that is the value of its control with this name and unit.

    >>> control_quantity("temperature", "°C").axis_label()
    'temperature (°C)'
    """
    if name == "mu":
        return QUANTITIES["mu"]
    kind = CONTROLS.get(name)
    label, text, digits = (kind.label, kind.text, kind.digits) if kind else (name, f"control {name}", ".5g")
    return Quantity(name, attrgetter("value"), unit or "1", label, text, digits, column=name)
