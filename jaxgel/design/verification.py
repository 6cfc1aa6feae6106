"""A design on a fresh cloud, and the confidence intervals of fitted parameters."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from .._types import Array, Float
from .._validation import Inadmissible
from ..cloud import Cloud
from ..continuation import Path
from ..equilibrium import StateNotFound
from ..observables import CURVES, OF_EQUILIBRIA, is_in_time, min_gap, surface_ratio
from ..verification import FEWEST, error_bars
from .lagrangian import Invalid
from .problem import DesignProblem
from .search import check_path, check_reported

STEP = 2**-0.25  # spacing of a cloud of a refinement over that of the one before
# of the objective's scale and of the constraints': error bars that end a refinement
TOLERANCE = 0.01


def verify(
    problem: DesignProblem,
    parameters: dict[str, Any],
    *,
    spacing: float | tuple[float, float],
    mu: Sequence[float] | None = None,
    scale: float = 0.0,
    tolerance: float = TOLERANCE,
) -> tuple[dict[str, Any], Path]:
    """Objective, constraints and state of a design on a fresh cloud: a dict, and the `Path`.

    Arguments:

    - `problem`: the `DesignProblem`.
    - `parameters`: name -> value of the design, as `Design.parameters`.
    - `spacing`: node spacing, mm, or two spacings (first, finest) for a sequence of clouds.
    - `mu` (k,): values of the control; by default the problem's with one between every two, in time
      its times with half the steps.
    - `scale`: least value of the objective, in its unit, to which `tolerance` is relative.
    - `tolerance`: relative error bar that ends a sequence of clouds (0.01).

    The cloud is built from the final holes. The dict holds value, constraints (name -> smallest
    value, in its unit), valid (bool), reason (one line), nodes, spacing, the worst negative_pivots,
    min_gap and surface_ratio of the path, `last`, the quantities of `objectives.CURVES` at its last
    mu, and `reported`, the numbers that the problem reports; a number without a value is None.

    With two spacings the design is computed on ever finer clouds, three at least, until it is
    valid, the error bar of its objective (see `verification.error_bars`) is at most `tolerance`
    times its value, or times `scale` if that is larger, and each constraint is met by more than its
    bar, or known to within `tolerance` times its scale. Dict and path are those of the last cloud;
    the dict has two more entries: `clouds`, a list of the spacing, nodes and value of each, and
    `errors`, the error bars of value, constraints, last and reported, None if there is none. A
    cloud that leaves a ligament without a node is left out, unless it is the finest.

    Raises `ValueError` or `ArithmeticError` if the (finest) cloud or its first state is not found.

    Example: design/bistable.py; see docs/howto/design.md.
    """
    if not isinstance(spacing, tuple):
        return _on_cloud(problem, parameters, float(spacing), mu)
    tried, (first, finest) = [], spacing
    count = max(FEWEST - 1, round(np.log(finest / first) / np.log(STEP)))
    for step in range(count + 1):
        try:
            tried.append(
                _on_cloud(problem, parameters, first * (finest / first) ** (step / count), mu)
            )
        except (Inadmissible, StateNotFound):
            if step == count:
                raise
            continue
        errors = _errors([found for found, _ in tried])
        if _is_settled(problem, tried[-1][0], errors, scale, tolerance):
            break
    clouds = [{key: found[key] for key in ("spacing", "nodes", "value")} for found, _ in tried]
    found, path = tried[-1]
    return found | {"clouds": clouds, "errors": errors}, path


def _on_cloud(problem, parameters, spacing, mu):
    """What `verify` returns for one spacing."""
    parameters = {name: jnp.asarray(value) for name, value in parameters.items()}
    plate = problem.plate(parameters)
    values = problem.refined if mu is None else mu
    cloud = problem.make_cloud(plate, spacing)
    path, made = problem.path(parameters, cloud, values), problem.as_made(parameters, cloud, values)
    reason = "valid: stable, no self-contact"
    try:
        for one in (path, *made):
            if not one.stop.ok:
                raise Invalid(one.stop_text)
            check_path(one, problem.allow_unstable)
        check_reported({name: float(function(path)) for name, function in problem.reported.items()})
        problem.value(path, made)
    except (Invalid, StateNotFound) as invalid:
        reason = str(invalid)
    end = path[-1:]
    missing = OF_EQUILIBRIA if is_in_time(path) else ()
    last = {
        name: np.nan if name in missing else quantity(end)[0] for name, quantity in CURVES.items()
    }
    dry = plate, path.model.cloud, problem.gel_at(parameters)
    without = {
        c.name: float(np.min(c.without_sweep(*dry)))
        for c in problem.constraints
        if c.dry or c.of_gel
    }
    found = dict(
        value=_value(lambda path: problem.value(path, made), path),
        constraints={
            c.name: without[c.name] if c.name in without else _value(c.function, path)
            for c in problem.constraints
        },
        valid=reason.startswith("valid"),
        reason=reason,
        nodes=path.model.n_nodes,
        spacing=spacing,
        negative_pivots=int(np.max(path.negative_pivots)),
        min_gap=_number(np.min(min_gap(path))),
        surface_ratio=_number(np.max(surface_ratio(path))),
        last={name: _number(value) for name, value in last.items()},
        reported={name: _value(function, path) for name, function in problem.reported.items()},
    )
    return found, path


def _is_settled(problem, found, errors, scale, tolerance):
    """Whether the numbers of a design no longer move beyond a tolerance."""
    if (
        not found["valid"]
        or errors["value"] is None
        or errors["value"] > tolerance * max(abs(found["value"]), scale)
    ):
        return False
    known = [
        (errors["constraints"][c.name], found["constraints"][c.name], c.scale)
        for c in problem.constraints
    ]
    return all(
        error is not None and error <= max(abs(margin), tolerance * scale)
        for error, margin, scale in known
    )


def _errors(found):
    """Error bars of the numbers of the last of several `verify` dicts, coarsest cloud first."""
    names = [
        ("value", None),
        *(
            (group, name)
            for group in ("constraints", "last", "reported")
            for name in found[-1][group]
        ),
    ]
    values = [
        [one[group] if name is None else one[group][name] for group, name in names] for one in found
    ]
    sizes = np.array([one["nodes"] for one in found]) ** -0.5
    bars = error_bars(sizes, np.array(values, dtype=float), len(found) - 1).error
    errors = {"value": None, "constraints": {}, "last": {}, "reported": {}}
    for (group, name), bar in zip(names, map(_number, bars), strict=True):
        if name is None:
            errors[group] = bar
        else:
            errors[group][name] = bar
    return errors


def _value(function, path):
    """The least value of a function of a path, None if the path does not have it."""
    try:
        return _number(np.min(function(path)))
    except StateNotFound:
        return None


def _number(value):
    """A float that JSON can hold, None if there is none."""
    return float(value) if np.isfinite(value) else None


def intervals(
    problem: DesignProblem,
    parameters: dict[str, Any],
    curve: Callable[[Path], Float[Array, " k"]],
    noise: float,
    *,
    cloud: Cloud | None = None,
) -> tuple[dict[str, Any], Float[Array, "d d"]]:
    """Standard deviations and covariance of parameters fitted to ``curve`` with the given noise.

    It is a function of the path, (k,). Gauss and Newton's Hessian of the sum of squares over 2
    noise^2, J^T J / noise^2, inverted: a dict name -> standard deviation, and the covariance (n, n)
    in the order of `jax.flatten_util.ravel_pytree`. ``noise`` is the standard deviation of
    independent errors.
    """
    flat, unravel = ravel_pytree(
        {name: jnp.asarray(value, dtype=float) for name, value in parameters.items()}
    )
    cloud = problem.make_cloud(problem.plate(unravel(flat))) if cloud is None else cloud
    slopes = np.asarray(jax.jacfwd(lambda v: curve(problem.path(unravel(v), cloud)))(flat))
    scale = np.abs(np.asarray(flat)) + (np.asarray(flat) == 0)
    covariance = (
        noise**2 * np.linalg.inv((slopes * scale).T @ (slopes * scale)) * np.outer(scale, scale)
    )
    return {
        name: np.asarray(v)
        for name, v in unravel(jnp.sqrt(jnp.diag(jnp.asarray(covariance)))).items()
    }, covariance
