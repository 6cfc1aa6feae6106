"""Objectives of switching gels: functions of a loop along a control of their own.

Each is an objective, or the function of a `criteria.Constraint`, of a `DesignProblem`; its path
need not come near the switch. A design without such a point, or whose states are not found, is
invalid: `StateNotFound` says which. A control may be a function of the path, as one whose loads are
those of the path's model. Functions with the same values, control and loads share one loop for each
path.
"""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp

from .._memo import once_per_owner
from .._types import Array, Float
from ..bifurcation import barrier, critical_points, loop
from ..continuation import Path
from ..controls import ChemicalPotential, Control
from ..equilibrium import StateNotFound
from ..mechanics import Loads, Problem

BY_MU = ChemicalPotential()
Ends = tuple[float, float]
OfPath = Callable[[Path], Float[Array, ""]]
Driver = Control | Callable[[Path], Control]


def fold_up(values: Ends, control: Driver = BY_MU, loads: Loads | None = None) -> OfPath:
    """Function of a path: ``loop.fold_up`` of its model and gel under a ``control``, see `loop`."""
    drive = _Drive(values, control, loads)
    return lambda path: _value("fold_up", _loop(path, drive).fold_up)


def fold_down(values: Ends, control: Driver = BY_MU, loads: Loads | None = None) -> OfPath:
    """Function of a path: the value of ``loop.fold_down``, as `fold_up`."""
    drive = _Drive(values, control, loads)
    return lambda path: _value("fold_down", _loop(path, drive).fold_down)


def loop_width(values: Ends, control: Driver = BY_MU, loads: Loads | None = None) -> OfPath:
    """Function of a path: ``loop.width``, in the control's unit, as `fold_up`; 0 without jumps."""
    drive = _Drive(values, control, loads)

    def width(path):
        found = _loop(path, drive)
        if found.width is None:
            raise StateNotFound(f"it has no loop_width: {found.text}; {found.stop_text}")
        return jnp.asarray(found.width)

    return width


def barrier_height(
    at: float, values: Ends, control: Driver = BY_MU, loads: Loads | None = None
) -> OfPath:
    """Function of a path: barrier, kT/v mm^2, of the state at ``at`` on the way up.

    See `barrier`.
    """
    drive = _Drive(values, control, loads)

    @once_per_owner
    def height(path):
        between = _loop(path, drive, True)
        if between.down is None:
            raise StateNotFound(f"it has no barrier: the loop has no way down, {between.stop_text}")
        return barrier(drive.problem(path), at, between)[0].height

    return height


def onset(values: Ends, control: Driver = BY_MU, loads: Loads | None = None) -> OfPath:
    """Function of a path: the first of the `critical_points` between ``values``, as `fold_up`."""
    drive = _Drive(values, control, loads)

    @once_per_owner
    def first(path):
        points = critical_points(drive.problem(path), drive.values, most=1)
        return _value("onset", points[0] if points else None)

    return first


SWITCHES: dict[str, Callable[..., OfPath]] = {
    "fold_up": fold_up,
    "fold_down": fold_down,
    "loop_width": loop_width,
    "onset": onset,
    "barrier": barrier_height,
}
"""What makes the functions, by the name that study files have for it."""


@dataclasses.dataclass(frozen=True, eq=False)
class _Drive:
    """What drives the gel of a path; equal if values, control and loads are the same objects."""

    values: Ends
    control: Driver
    loads: Loads | None

    def __eq__(self, other):
        return (
            self.values == other.values
            and self.control is other.control
            and self.loads is other.loads
        )

    def __hash__(self):
        return hash((self.values, id(self.control), id(self.loads)))

    def problem(self, path):
        """The problem of the model and the gel of a path under the control and the loads."""
        control = self.control if isinstance(self.control, Control) else self.control(path)
        loads = None if self.loads is None else self.loads.of(path.model)
        return Problem(
            path.model, path.gel, loads=loads, control=control, contact=path.problem.has_contact
        )


@once_per_owner
def _loop(path, drive, unstable=False):
    """The loop of a path; with its unstable branch it is another one."""
    return loop(drive.problem(path), drive.values, unstable=unstable)


def _value(name, point):
    if point is None:
        raise StateNotFound(f"it has no {name}")
    return jnp.asarray(point.value)
