"""Imperfections: loads that push along a bifurcation's mode, and sweeps under them, as `SweepOptions` say for every command."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float
from .._validation import Inadmissible, check_kind, keywords_of
from ..continuation import Path, StabilityAnalysis, SweepOptions, is_traced, sweep
from ..controls import Control
from ..discretisation import Model
from ..equilibrium import State
from ..materials import AnyGel
from ..mechanics import check_model, prepare, restrict
from .critical import check_untraced, critical_points
from .points import CriticalPoint


def sweep_by_options(
    model: Model,
    gel: AnyGel,
    options: SweepOptions,
    *,
    values: Any = None,
    control: Control | None = None,
    loads: Float[Array, "n 2"] | None = None,
    push: Float[Array, "n 2"] | None = None,
    on_step: Callable[[State], object] | None = None,
    start: State | None = None,
) -> Path:
    """`Path` of a model along the options' branch, with their control and contact, and under their imperfection besides ``loads``, kT/v mm.

    The control "load" multiplies the loads, but not the imperfection. ``values``, ``control`` and ``push`` (n, 2), kT/v mm, take the place
    of the options' own values, control and imperfection. The sweep goes on from ``start``, see `sweep`. ValueError for an imperfection if
    there is no bifurcation, or if model, gel or values are traced: its load has no derivative.
    """
    control = options.driver(loads) if control is None else control
    values = options.values if values is None else values
    push = imperfection_load(model, gel, options, loads=loads) if push is None else push
    dead = [part for part in (push, None if options.control == "load" else loads) if part is not None]
    driven = {"mu": values} if control is None else {"control": control, "values": values}
    keywords = keywords_of(options, "sweep") | {"loads": sum(dead) if dead else None, "on_step": on_step, "start": start}
    return sweep(model, gel, **driven, **keywords)


def imperfection_load(
    model: Model, gel: AnyGel, options: SweepOptions, *, loads: Float[Array, "n 2"] | None = None
) -> Float[Array, "n 2"] | None:
    """Nodal forces of the options' imperfection along the first bifurcation under the ``loads``, kT/v mm; None where it is 0.

    ValueError where the branch does not bifurcate between the options' ends.
    """
    if not options.imperfection:
        return None
    if is_traced((model, gel, loads)):
        raise ValueError(f"sweep.imperfection: {options.imperfection:g} is not accepted here, as its load has no derivative; leave it out")
    points = [p for p in points_by_options(model, gel, options, most=1, loads=loads) if p.kind == "bifurcation"]
    if not points:
        raise Inadmissible(f"sweep.imperfection: {options.imperfection:g} has no mode to push along, the branch does not bifurcate")
    return imperfection(model, gel, points[0], options.imperfection)


def points_by_options(
    model: Model, gel: AnyGel, options: SweepOptions, *, most: int = 4, loads: Float[Array, "n 2"] | None = None
) -> list[CriticalPoint]:
    """`critical_points` between the ends of the options' first way, under their control and the ``loads``, kT/v mm."""
    control = options.driver(loads)
    if control is None:
        return critical_points(model, gel, mu=options.ends, most=most, loads=loads)
    dead = None if options.control == "load" else loads
    return critical_points(model, gel, control=control, values=options.ends, most=most, loads=dead)


def imperfection(
    model: Model, gel: AnyGel, point: CriticalPoint, size: float, *, direction: Float[Array, " m"] | None = None
) -> Float[Array, "n 2"]:
    """Dead nodal loads, kT/v mm, that push along a bifurcation's mode: a sweep under them buckles without a bifurcation.

    ``size`` is the largest displacement, in node spacings, that they would cause in the dry network alone; its sign chooses the side.
    """
    check_model(model, gel)
    check_kind("point", point, CriticalPoint, "a CriticalPoint, one of those that critical_points returns")
    check_untraced("imperfection", model, gel)
    analysis = StabilityAnalysis(prepare(model, gel))
    direction = np.eye(point.multiplicity)[0] if direction is None else np.asarray(direction, dtype=float)
    mode, free = np.tensordot(direction, point.modes, 1), analysis.problem.free
    force = analysis.stiffness @ restrict(mode, free) * (size * model.cloud.spacing / np.linalg.norm(mode, axis=1).max())
    (loads,) = jax.linear_transpose(lambda field: restrict(field, free), jnp.asarray(mode))(jnp.asarray(force))
    return loads  # one node takes the force of nodes that move together
