"""What a gel that switches is judged by: functions of a path's model and gel that drive it up and down by a control of their own.

Each is an objective, or the function of a `criteria.Constraint`, of a `DesignProblem`; its path need not come near the switch. Where there
is no such point the value is nan, and the design invalid. Every function drives the gel anew.
"""

from collections.abc import Callable

import jax.numpy as jnp

from .._types import Array, Float
from ..bifurcation import barrier, critical_points, loop
from ..continuation import Path
from ..controls import Control
from ..mechanics import Loads

Ends = tuple[float, float]
OfPath = Callable[[Path], Float[Array, ""]]


def fold_up(values: Ends, control: Control | None = None, loads: Loads | None = None) -> OfPath:
    """Function of a path: the value of ``loop.fold_up`` of its model and gel under a ``control``, mu in kT without one, see `loop`."""
    return lambda path: _value(_loop(path, values, control, loads).fold_up)


def fold_down(values: Ends, control: Control | None = None, loads: Loads | None = None) -> OfPath:
    """Function of a path: the value of ``loop.fold_down``, as `fold_up`."""
    return lambda path: _value(_loop(path, values, control, loads).fold_down)


def loop_width(values: Ends, control: Control | None = None, loads: Loads | None = None) -> OfPath:
    """Function of a path: ``loop.width``, in the unit of the control, as `fold_up`; 0 without jumps."""
    return lambda path: jnp.asarray(_loop(path, values, control, loads).width)


def barrier_height(at: float, values: Ends, control: Control | None = None, loads: Loads | None = None) -> OfPath:
    """Function of a path: the barrier, kT/v mm^2, that keeps the gel at the value ``at`` in its state on the way up, see `barrier`."""

    def height(path):
        driven = {"mu": at} if control is None else {"control": control, "value": at}
        between = _loop(path, values, control, loads, unstable=True)
        if between.down is None:
            return jnp.asarray(jnp.nan)
        try:
            return barrier(path.model, path.gel, between=between, loads=_of(loads, path), **driven)[0].height
        except ArithmeticError:  # one stable state, or no saddle
            return jnp.asarray(jnp.nan)

    return height


def onset(values: Ends, control: Control | None = None, loads: Loads | None = None) -> OfPath:
    """Function of a path: the value of the first of the `critical_points` between the ``values``, as `fold_up`."""

    def first(path):
        points = critical_points(path.model, path.gel, **_driven(values, control), loads=_of(loads, path), most=1)
        return _value(points[0] if points else None)

    return first


def _loop(path, values, control, loads, unstable=False):
    contact = "off" if path.model.contact is None else "on"
    return loop(path.model, path.gel, **_driven(values, control), contact=contact, loads=_of(loads, path), unstable=unstable)


def _driven(values, control):
    return {"mu": values} if control is None else {"control": control, "values": values}


def _of(loads, path):
    return None if loads is None else loads.of(path.model)


def _value(point):
    return jnp.asarray(jnp.nan if point is None else point.value)
