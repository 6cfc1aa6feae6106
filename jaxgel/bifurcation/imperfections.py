"""Imperfections: loads that push along a bifurcation's mode, and sweeps under them, as `SweepOptions` say for every command."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Array, Float
from .._validation import keywords_of
from ..continuation import Path, StabilityAnalysis, SweepOptions, is_traced, sweep
from ..discretisation import Model
from ..equilibrium import State
from ..materials import AnyGel
from ..mechanics import prepare, restrict
from .critical import critical_points
from .points import CriticalPoint


def sweep_by_options(
    model: Model,
    gel: AnyGel,
    options: SweepOptions,
    *,
    mu: Any = None,
    loads: Float[Array, "n 2"] | None = None,
    on_step: Callable[[State], object] | None = None,
    before: Sequence[State] = (),
) -> Path:
    """`Path` of a model along the options' branch, with their contact, and under their imperfection besides the ``loads``, kT/v mm.

    ``mu`` takes the place of the options' values, as for `sweep`. ``before`` are the accepted states of an interrupted sweep, with which
    the path then begins. ValueError for an imperfection where there is no bifurcation, or where model, gel or mu are traced: its load
    has no derivative.
    """
    if mu is None:
        if before and before[-1].mu >= options.ends[1]:
            return Path.from_states(model, gel, before)
        mu = options.values[len(before) :] if options.given else options.values
    push = imperfection_load(model, gel, options, loads=loads)
    loads = push if loads is None else loads if push is None else loads + push
    return sweep(model, gel, mu=mu, loads=loads, on_step=on_step, start=list(before) or None, **keywords_of(options, "sweep"))


def imperfection_load(
    model: Model, gel: AnyGel, options: SweepOptions, *, loads: Float[Array, "n 2"] | None = None
) -> Float[Array, "n 2"] | None:
    """Nodal forces of the options' imperfection along the first bifurcation under the ``loads``, kT/v mm; None where it is 0.

    ValueError where the branch does not bifurcate between the options' ends of mu.
    """
    if not options.imperfection:
        return None
    if is_traced((model, gel, loads)):
        raise ValueError(f"sweep.imperfection: {options.imperfection:g} is not accepted here, as its load has no derivative; leave it out")
    points = [p for p in critical_points(model, gel, mu=tuple(options.ends), most=1, loads=loads) if p.kind == "bifurcation"]
    if not points:
        raise ValueError(f"sweep.imperfection: {options.imperfection:g} has no mode to push along, the branch does not bifurcate")
    return imperfection(model, gel, points[0], options.imperfection)


def imperfection(
    model: Model, gel: AnyGel, point: CriticalPoint, size: float, *, direction: Float[Array, " m"] | None = None
) -> Float[Array, "n 2"]:
    """Dead nodal loads, kT/v mm, that push along a bifurcation's mode: a sweep under them buckles without a bifurcation.

    ``size`` is the largest displacement, in node spacings, that they would cause in the dry network alone; its sign chooses the side.
    """
    analysis = StabilityAnalysis(prepare(model, gel))
    direction = np.eye(point.multiplicity)[0] if direction is None else np.asarray(direction, dtype=float)
    mode, free = np.tensordot(direction, point.modes, 1), analysis.problem.free
    force = analysis.stiffness @ restrict(mode, free) * (size * model.cloud.spacing / np.linalg.norm(mode, axis=1).max())
    (loads,) = jax.linear_transpose(lambda field: restrict(field, free), jnp.asarray(mode))(jnp.asarray(force))
    return loads  # one node takes the force of nodes that move together
