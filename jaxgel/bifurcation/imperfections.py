"""Imperfections: perturbation loads along the mode of a bifurcation, and sweeps under them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._deprecated import old_arguments
from .._tracing import is_traced
from .._types import Array, Float
from .._validation import Inadmissible, check_kind, keywords_of
from ..continuation import Path, StabilityAnalysis, SweepOptions, sweep
from ..controls import CONTROLS
from ..discretisation import Model
from ..materials import AnyGel
from ..mechanics import Problem, restrict
from .critical import check_untraced, critical_points
from .points import CriticalPoint


def problem_by_options(
    model: Model,
    gel: AnyGel,
    options: SweepOptions,
    *,
    loads: Float[Array, "n 2"] | None = None,
    push: Float[Array, "n 2"] | None = None,
) -> Problem:
    """The `Problem` of a model and a gel with the options' control, contact and ``loads``.

    Their imperfection, kT/v mm, is one of the loads. A load factor multiplies the loads, but not
    the imperfection, whose place ``push`` (n, 2), kT/v mm, takes. ValueError for an imperfection if
    there is no bifurcation, or if model, gel or loads are traced: its load has no derivative.
    """
    dead = None if CONTROLS[options.control].multiplies_loads else loads
    contact = dict(contact=options.contact == "on", contact_range=options.contact_range)
    problem = Problem(model, gel, loads=dead, control=options.driver(loads), **contact)
    push = _push(problem, options) if push is None else push
    return problem if push is None else problem.replace(loads=problem.loads + push)


def sweep_by_options(
    problem: Problem, options: SweepOptions, *, values: Any = None, **keywords: Any
) -> Path:
    """`Path` of a problem along the options' branch, with further ``keywords`` of `sweep`.

    Its values are the options' or others.
    """
    values = options.values if values is None else values
    return sweep(
        problem,
        values,
        until_contact=options.contact == "stop",
        **keywords_of(options, "sweep"),
        **keywords,
    )


def _push(problem, options):
    """Nodal forces of the options' imperfection along the first bifurcation of a problem, kT/v mm.

    None if it is 0.
    """
    if not options.imperfection:
        return None
    if is_traced(problem):
        raise ValueError(
            f"sweep.imperfection: {options.imperfection:g} is not accepted here, as its load has "
            "no derivative; leave it out"
        )
    points = [
        point
        for point in critical_points(problem, options.ends, most=1)
        if point.kind == "bifurcation"
    ]
    if not points:
        raise Inadmissible(
            f"sweep.imperfection: {options.imperfection:g} has no mode to push along, the branch "
            "does not bifurcate"
        )
    return imperfection(problem, points[0], options.imperfection)


@old_arguments
def imperfection(
    problem: Problem,
    point: CriticalPoint,
    size: float,
    *,
    direction: Float[Array, " m"] | None = None,
) -> Float[Array, "n 2"]:
    """Dead nodal loads (n, 2), kT/v mm, along a mode: a sweep under them has no bifurcation there.

    Arguments:

    - `problem`: the `Problem`.
    - `point`: the bifurcation, a `CriticalPoint` of `critical_points`.
    - `size`: largest displacement, in node spacings, that the loads cause in the dry network alone;
      its sign chooses the side.
    - `direction` (m,): combination of the modes of a multiple bifurcation, dimensionless; the first
      mode by default.

    Returns the loads, to be given as `Problem(..., loads=loads)`.

    Raises `ValueError` if `point` is no `CriticalPoint`, and for a traced problem.

    See docs/howto/bifurcation.md.
    """
    check_kind(
        "point", point, CriticalPoint, "a CriticalPoint, one of those that critical_points returns"
    )
    check_untraced("imperfection", problem)
    analysis = StabilityAnalysis(problem.prepared)
    direction = (
        np.eye(point.multiplicity)[0] if direction is None else np.asarray(direction, dtype=float)
    )
    mode, free = np.tensordot(direction, point.modes, 1), analysis.problem.free
    force = (
        analysis.stiffness
        @ restrict(mode, free)
        * (size * problem.model.cloud.spacing / np.linalg.norm(mode, axis=1).max())
    )
    (loads,) = jax.linear_transpose(lambda field: restrict(field, free), jnp.asarray(mode))(
        jnp.asarray(force)
    )
    return loads  # one node takes the force of nodes that move together
