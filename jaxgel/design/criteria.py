"""Objectives and constraints: differentiable functions of a swollen path or of the dry plate.

An objective is any function of a `path.Path` that gives a number; `value_at` and `misfit` make the
usual ones. A constraint is a function of the path, or of the plate, that is met if it is not
negative. Lengths in mm, angles in degrees.
"""

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._primitives import differentiated_value
from .._tracing import is_traced
from .._types import Array, Float
from .._validation import Inadmissible
from ..cloud import Cloud
from ..continuation import Path
from ..equilibrium import StateNotFound
from ..geometry import (
    Plate,
    arcs,
    edge_lines,
    frame_of,
    image_offsets,
    outline_points,
    periods,
    reference_plate,
)
from ..materials import AnyGel, WithHoles, matrix_of, values_at
from ..observables import CURVES, at_time, is_in_time, time_to

LIGAMENT_SAMPLES = 128  # points per outline among which the nearest pair is looked for
ROUND_OFF = 1e-9  # of the control's values: beyond it a value lies outside the path
NEWTON_STEPS = 4  # from there to the nearest points themselves


def value_at(
    quantity: Callable[[Path], Float[Array, " k"]], mu: float
) -> Callable[[Path], Float[Array, ""]]:
    """Function of a path: a quantity () at one value of the control, linear between states.

    Arguments: `quantity`, a function of a `Path` to values (k,), such as `rotation_angle`; `mu`, a
    value of the control, kT for mu. Under another control all states then have different values. In
    transient swelling `mu` is a time, and `at_time` interpolates. Beyond the ends of the path the
    function raises `ValueError`, or returns nan if the path stopped early.

    >>> import jaxgel
    >>> cloud = jaxgel.make_cloud(jaxgel.Plate(1.0, 1.0, edges={"top": "free"}), spacing=0.25)
    >>> problem = jaxgel.Problem(jaxgel.discretise(cloud), jaxgel.Gel(1e-3, 0.1), contact=False)
    >>> path = jaxgel.sweep(problem, [-0.5, -0.4])
    >>> value_at(lambda path: path.mu, -0.45)(path).round(9)
    Array(-0.45, dtype=float64)
    """
    return lambda path: _read(path, quantity, mu)


def time_of(
    quantity: Callable[[Path], Float[Array, " k"]], value: float, name: str = "the quantity"
) -> Callable[[Path], Float[Array, ""]]:
    """Function of a path in time: first time at which ``quantity(path)`` (k,) has a ``value``.

    A design whose quantity, of that ``name`` in messages, does not reach it is invalid:
    StateNotFound; nan for a path that stopped before its last time.
    """

    def first(path):
        if not path.stop.ok:
            return jnp.asarray(jnp.nan)
        values = quantity(path)
        numbers = np.asarray(differentiated_value(values))
        if not numbers.min() <= value <= numbers.max():
            raise StateNotFound(
                f"{name} does not reach {value:g} until t = {float(path.value[-1]):g}, "
                f"its values are {numbers.min():.4g} ... {numbers.max():.4g}"
            )
        return time_to(path, values, value)

    return first


def misfit(
    quantity: Callable[[Path], Float[Array, " k"]],
    mu: Sequence[float],
    curve: Sequence[float] | Float[Array, " k"],
) -> Callable[[Path], Float[Array, ""]]:
    """Function of a path: mean square () of the difference of a quantity from a curve.

    Arguments: `quantity`, and the values `mu` (k,) of the control, as in `value_at`, which also
    says what is raised; `curve` (k,), in the unit of `quantity`, whose nan are left out.
    """
    at, wanted = np.asarray(mu, dtype=float), np.asarray(curve, dtype=float)
    given = np.isfinite(wanted)
    return lambda path: jnp.mean((_read(path, quantity, at[given]) - wanted[given]) ** 2)


def _read(path, quantity, at):
    """The quantity at values of the path's control, which may fall, linear between its states.

    Beyond a path that stopped nan.
    """
    if is_in_time(path):
        return at_time(path, quantity, at) if path.stop.ok else jnp.full(np.shape(at), jnp.nan)
    numbers, at = differentiated_value(path.value), np.asarray(at, dtype=float)
    if not is_traced(numbers) and (path.stop is None or path.stop.ok):
        low, high = float(np.min(numbers)), float(np.max(numbers))
        reach = ROUND_OFF * max(-low, high)
        beyond = at[(at < low - reach) | (at > high + reach)]
        if beyond.size:
            name = path.control.name
            raise ValueError(
                f"{name}: {beyond[0]:g} is beyond the path, which runs from {low:g} to {high:g}; "
                "ask for a value within"
            )
    return _interpolated(at, path.value, quantity(path))


@compiled()
def _interpolated(at, values, of_states):
    """The quantity ``of_states`` (k,) at control ``values`` (k,), linear between; nan beyond."""
    order = jnp.argsort(values)
    low, high = (jax.lax.stop_gradient(values)[order[end]] for end in (0, -1))
    reach = ROUND_OFF * jnp.maximum(-low, high)
    inside = jnp.where((at < low - reach) | (at > high + reach), jnp.nan, 1.0)
    return jnp.interp(at, values[order], jnp.asarray(of_states)[order]) * inside


def weighted_sum(
    weights: Sequence[float], functions: Sequence[Callable[..., Any]]
) -> Callable[[Path], Float[Array, ""]]:
    """Function of a path: the sum of functions, each times its weight.

    Arguments: `weights`, numbers; `functions`, as many functions of a path to numbers, else
    `ValueError`.

    >>> weighted_sum((1.0, 2.0), (min, max))([3.0, 4.0])
    11.0
    """
    pairs = list(zip(weights, functions, strict=True))
    return lambda path: sum(weight * function(path) for weight, function in pairs)


@dataclasses.dataclass(frozen=True)
class Constraint:
    """Constraint of a design, met if all values of `function` are >= 0; see also `bound`."""

    name: str
    """Name in histories and messages."""
    function: Callable
    """Function of the path, or of the plate if `dry`, that gives a number or an array (c,)."""
    scale: float = 1.0
    """Violation, in the function's unit, that weighs as much as the objective's start value."""
    dry: bool = False
    """Whether `function` needs the plate only: neither its value nor its gradient costs a sweep."""
    of_gel: bool = False
    """Whether it is `function(cloud, gel)` of the dry cloud and the gel, which costs no sweep."""

    def without_sweep(self, plate: Plate, cloud: Cloud, gel: AnyGel) -> Float[Array, " c"]:
        """Values (c,) of a constraint that is ``dry`` or ``of_gel``."""
        return jnp.ravel(self.function(cloud, gel) if self.of_gel else self.function(plate))


def ligaments(plate: Plate) -> Float[Array, " c"]:
    """Widths (c,) of the dry ligaments, mm: between holes, then between holes and walls.

    Walls that cross the hole are left out. A periodic edge is no wall. Of a periodic cell there are
    the widths between a hole and the nearest images of each other one, 3 or 9, and between a hole
    and its own images, 1 or 4. The nearest ones are those of the reference plate and their
    neighbours, so that each width is smooth while holes move by less than a period. Exact for
    smooth outlines, with the derivatives of the nearest pair of points; without meaning if holes
    overlap.
    """
    reference, offsets = reference_plate(plate), image_offsets(plate)
    nearest = _nearest_images(reference)
    # one of each pair of opposite ones
    own = offsets[(offsets[:, 0] > 0) | ((offsets[:, 0] == 0) & (offsets[:, 1] > 0))]
    pairs = itertools.combinations(range(len(plate.holes)), 2)
    widths = [
        _widths_between(plate.holes[i], plate.holes[j], nearest[i, j] + offsets) for i, j in pairs
    ]
    widths += [_widths_between(hole, hole, own) for hole in plate.holes if len(own)]
    for hole, crossed in zip(plate.holes, _crossed_walls(reference), strict=True):
        walls = [
            (axis, line)
            for edge, (axis, line) in edge_lines(plate).items()
            if edge not in crossed and plate.edges[edge] != "periodic"
        ]
        widths += [_width_to_wall(hole, line, axis)[None] for axis, line in walls]
    return jnp.concatenate(widths) if widths else jnp.zeros(0)


def hole_areas(plate: Plate) -> Float[Array, " holes"]:
    """Dry area (holes,) of each hole, mm^2; ValueError if an edge cuts one that is not periodic."""
    if any(_crossed_walls(reference_plate(plate))):
        raise Inadmissible(
            "hole_areas: the plate's edge cuts a hole; areas are those of whole holes"
        )
    return jnp.stack([hole.area() for hole in plate.holes])


def porosity(plate: Plate) -> Float[Array, "1"]:
    """Share (1,) of the dry plate that is hole.

    ValueError if an edge cuts one that is not periodic.
    """
    return jnp.sum(hole_areas(plate), keepdims=True) / (plate.width * plate.height)


def parameter_mean(name: str) -> Callable[[Cloud, AnyGel], Float[Array, "1"]]:
    """Function of a cloud and a gel: mean (1,) of the parameter over the dry gel by quadrature.

    Holes are left out, and regions with a material of their own.
    """

    def mean(cloud, gel):
        parameter, quadrature = getattr(matrix_of(gel), name), cloud.topology.quadrature
        if not callable(parameter):
            return jnp.reshape(jnp.asarray(parameter, dtype=float), (1,))
        outside = cloud.topology.partition.region_of_cell[quadrature.owner] == 0
        area = jnp.where(outside, quadrature.weights(cloud.vertices), 0.0)
        places = (
            jnp.asarray(cloud.topology.partition.vertices)
            if isinstance(parameter, WithHoles)
            else cloud.vertices
        )
        points = cloud.topology.frame.to_given(quadrature.points(places))
        return jnp.sum(area * values_at(parameter, points), keepdims=True) / jnp.sum(area)

    return mean


DRY = {"ligament": ligaments, "porosity": porosity, "hole_area": hole_areas}
"""Quantities of the dry plate by name; each gives (c,) values."""
OF_GEL = {f"{name}_mean": parameter_mean(name) for name in ("Nv", "chi")}
"""Quantities of the dry cloud and the gel by name; each gives (c,) values."""


def bound(
    name: str,
    *,
    above: float | None = None,
    below: float | None = None,
    within: float | None = None,
    at: float | None = None,
    control: str = "mu",
    of: Callable[[Path], Array] | None = None,
) -> Constraint:
    """`Constraint` that keeps a quantity above or below a value, or its magnitude within one.

    Arguments:

    - `name`: of a quantity of `CURVES`, `DRY` or `OF_GEL`, or any name if `of` is given.
    - `above`, `below`, `within`: the limit in the unit of the quantity; exactly one of them.
    - `at`: value of the control at which it holds; by default at every state (the worst one
      counts).
    - `control`: name of the control, for the text of the constraint.
    - `of`: function of a path, such as those of `switches`, in place of the quantity of that name.

    Raises `ValueError` unless one limit is given, `KeyError` for an unknown name.

    >>> bound("area_reduction", below=0.5, at=-0.1).name
    'area_reduction <= 0.5 at mu = -0.1'
    """
    given = {
        key: value
        for key, value in dict(above=above, below=below, within=within).items()
        if value is not None
    }
    if len(given) != 1:
        raise ValueError(
            f"bound: {name} has {len(given)} limits; give one of above, below and within"
        )
    (kind, value), dry, of_gel = next(iter(given.items())), name in DRY, name in OF_GEL
    quantity = (CURVES | DRY | OF_GEL)[name] if of is None else of

    def room(*source):
        values = (
            quantity(*source) if dry or of_gel or at is None else value_at(quantity, at)(*source)
        )
        room = {
            "above": values - value,
            "below": value - values,
            "within": value - jnp.abs(values),
        }[kind]
        return room if dry or of_gel else jnp.min(room)

    words = {
        "above": f"{name} >= {value:g}",
        "below": f"{name} <= {value:g}",
        "within": f"|{name}| <= {value:g}",
    }[kind]
    return Constraint(
        words + (f" at {control} = {at:g}" if at is not None else ""),
        room,
        abs(value) or 1.0,
        dry,
        of_gel,
    )


def _nearest_images(plate):
    """Translations (h, h, 2) of each hole, second index, to its image nearest each one.

    The plate is concrete; 0 if it is not periodic.
    """
    along, t = periods(plate), np.arange(LIGAMENT_SAMPLES) / LIGAMENT_SAMPLES
    if not along.any():
        return np.zeros((len(plate.holes), len(plate.holes), 2))
    middles = np.array(
        [np.asarray(outline_points(hole, t)).mean(axis=0) for hole in plate.holes]
    ).reshape(-1, 2)
    return along * np.round((middles[:, None] - middles) / np.where(along > 0, along, 1.0))


@compiled()
def _widths_between(hole, other, offsets):
    """Smallest distances (m,) between two outlines, the second one moved by ``offsets`` (m, 2).

    Compiled once per pair of kinds.
    """
    return jax.vmap(lambda by: _width_between(hole, other, by))(offsets)


def _width_between(hole, other, by):
    """Smallest distance () between two outlines, the second one translated ``by`` a vector (2,)."""
    t = jnp.arange(LIGAMENT_SAMPLES) / LIGAMENT_SAMPLES
    squared = jnp.sum(
        (outline_points(hole, t)[:, None] - outline_points(other, t)[None] - by) ** 2, axis=2
    )
    start = t[jnp.stack(jnp.unravel_index(jnp.argmin(squared), squared.shape))]
    fixed = jax.lax.stop_gradient((hole, other))
    nearest = _refine(
        lambda t: jnp.sum((fixed[0].point(t[0]) - fixed[1].point(t[1]) - by) ** 2), start
    )
    return jnp.linalg.norm(hole.point(nearest[0]) - other.point(nearest[1]) - by)


@compiled(static=("axis",))
def _width_to_wall(hole, line, axis):
    """Distance () from an outline to the wall ``axis`` = ``line``; negative beyond it.

    The smallest one; ``axis`` is a coordinate.
    """
    t, inwards = jnp.arange(LIGAMENT_SAMPLES) / LIGAMENT_SAMPLES, -jnp.sign(line)
    start = t[jnp.argmin(inwards * outline_points(hole, t)[:, axis])][None]
    fixed = jax.lax.stop_gradient(hole)
    nearest = _refine(lambda t: inwards * fixed.point(t[0])[axis], start)
    return inwards * (hole.point(nearest[0])[axis] - line)


def _refine(function, t):
    """Minimiser near the sampled one ``t`` by Newton's method, kept within a sample.

    ``t`` if that does not lower the function. The distance is stationary in it, so its own motion
    adds nothing to the derivatives of the distance.
    """

    def newton(_, at):
        curvature = jax.hessian(function)(at) + 1e-12 * jnp.eye(len(t))
        return jnp.clip(
            at - jnp.linalg.solve(curvature, jax.grad(function)(at)),
            t - 1 / LIGAMENT_SAMPLES,
            t + 1 / LIGAMENT_SAMPLES,
        )

    refined = jax.lax.fori_loop(0, NEWTON_STEPS, newton, t)
    return jnp.where(function(refined) < function(t), refined, t)


def _crossed_walls(plate):
    """Per hole the set of edges that cut it; periodic ones cut none."""
    plate = frame_of(plate).of(plate)
    crossed = [set() for _ in plate.holes]
    for arc in arcs(plate):
        crossed[arc.hole] |= {edge for edge in (arc.start_edge, arc.end_edge) if edge is not None}
    return crossed
