"""Pieces of outlines inside the plate, points along them, and points in holes.

Lengths in mm; the plate is centred at the origin. ``arc_points`` and what it calls are pure
functions of the hole parameters. ``arcs``, ``equal_arc_length`` and ``inside_holes`` work on the
host and need concrete parameters.
"""

import dataclasses
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from numpy.polynomial.legendre import leggauss

from .._compiled import compiled
from .._sizes import at_numbers
from .._tracing import is_traced
from .._types import Array, Bool, Float, Scalar
from .boundary import EDGES
from .hole import Hole, outline_points
from .plate import Plate, edge_lines

OUTLINE_SAMPLES = 2048  # points per outline among which arcs are searched
# of the quadrature of a smooth stretch's arc length: panels, and Gauss points of each
PANELS, POINTS = 256, 16
NEWTON_STEPS = 8  # for the t at which a moved outline meets the plate's edge


@dataclasses.dataclass(frozen=True)
class Arc:
    """A piece of one hole's outline inside the plate; static, found once on the reference plate."""

    hole: int
    """Index of the hole."""
    start: float
    """t of the first end, in [0, 1)."""
    end: float
    """t of the second end, above ``start``.

    ``start`` + 1 for a whole hole, which starts at t = 0.
    """
    start_edge: str | None = None
    """Edge of the plate on which the first end lies; None for a whole hole."""
    end_edge: str | None = None
    """Edge of the plate on which the second end lies; None for a whole hole."""

    @property
    def closed(self) -> bool:
        """Whether the arc is a whole hole."""
        return self.start_edge is None


def arcs(plate: Plate) -> list[Arc]:
    """All pieces of hole outlines inside the plate, hole by hole and anticlockwise along each.

    A hole inside the plate, also one that touches the edge in a point, gives one closed arc; a hole
    cut by the edge gives open arcs whose ends are on the edge to round-off.
    """
    return [arc for k, hole in enumerate(plate.holes) for arc in _arcs_of_hole(plate, k, hole)]


def arc_parameter(plate: Plate, arc: Arc, s: Float[Array, "..."] | Scalar) -> Float[Array, "..."]:
    """Outline parameter t () at the share ``s`` () in [0, 1] of the arc, also of moved holes.

    The ends of an open arc stay on their edge: they solve 'normal coordinate of ``point(t)`` = the
    edge's' by Newton's method from the ends on the reference plate, so all derivatives pass through
    them.
    """
    hole, ends = plate.holes[arc.hole], ((arc.start, arc.start_edge), (arc.end, arc.end_edge))
    met = [
        t if edge is None else _meet(hole, np.asarray(t, dtype=float), *edge_lines(plate)[edge])
        for t, edge in ends
    ]
    start, end = met if is_traced(met) else np.array(met)
    return start + s * (end - start)


def arc_points(plate: Plate, arc: Arc, s: Float[Array, " m"] | list[float]) -> Float[Array, "m 2"]:
    """Points (m, 2) in mm at the shares ``s`` (m,) of the arc; compiled once per kind of hole."""
    return outline_points(plate.holes[arc.hole], arc_parameter(plate, arc, np.asarray(s)))


def equal_arc_length(plate: Plate, arc: Arc, n_intervals: int) -> Float[np.ndarray, " m"]:
    """Shares s along the arc that cut it into pieces of equal length, corners being cuts.

    (n_intervals + 1,) with both ends for an open arc, (n_intervals,) from t = 0 on for a whole
    hole. Between corners the number of pieces goes with the length (largest remainder, at least
    one). Exact to 1e-10 of the arc for smooth outlines. Raises ValueError if there are fewer
    intervals than stretches between corners.
    """
    hole = plate.holes[arc.hole]
    stops = np.array([arc.start, *corners_between(hole, arc.start, arc.end), arc.end])
    tables = [_length_table(hole, a, b) for a, b in itertools.pairwise(stops)]
    shares = _largest_remainder(np.array([lengths[-1] for _, lengths in tables]), n_intervals, arc)
    t = np.concatenate(
        [_cuts(hole, *table, n) for table, n in zip(tables, shares, strict=True)] + [[arc.end]]
    )
    s = (t - arc.start) / (arc.end - arc.start)
    s[-1] = 1.0
    return s[:-1] if arc.closed else s


def corners_between(hole: Hole, start: float, end: float) -> list[float]:
    """Ascending t of an outline's corners between ``start`` and ``end``, which may exceed 1."""
    return sorted(
        {c + turn for c in hole.corners for turn in (0, 1) if start + 1e-9 < c + turn < end - 1e-9}
    )


def inside_holes(
    plate: Plate, points: Float[Array, "p 2"] | list[Any], tolerance: float = 0.0
) -> Bool[np.ndarray, " p"]:
    """Whether (p,) each of ``points`` (p, 2) lies in a hole, or within ``tolerance`` mm of it.

    A point on its outline counts as inside.
    """
    points, inside = np.asarray(points, dtype=float), np.zeros(len(points), dtype=bool)
    for hole in plate.holes:
        inside |= at_numbers(_excess, hole, points) <= tolerance
    return inside


@compiled(static=("axis",))  # compiled once per kind of hole
def _meet(hole, t, axis, coordinate):
    """The t at which the hole's outline meets the line of an edge, from the guess ``t``."""

    def newton_step(_, t):
        value, slope = jax.value_and_grad(lambda t: hole.point(t)[axis])(t)
        return t - (value - coordinate) / slope

    return jax.lax.fori_loop(0, NEWTON_STEPS, newton_step, t)


@compiled()
def _speeds(hole, t):
    return jnp.linalg.norm(
        jax.vmap(lambda t: jax.jvp(hole.point, (t,), (jnp.ones_like(t),))[1])(t), axis=-1
    )


@compiled()
def _excess(hole, points):
    return jax.vmap(hole.excess)(points)


def outward(plate: Plate, points: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "p 4"]:
    """Distances (p, 4) of points outside the lines of ``EDGES``, mm; negative inside."""
    return np.stack(
        [np.sign(c) * points[:, axis] - abs(c) for axis, c in edge_lines(plate).values()], axis=1
    )


def _arcs_of_hole(plate, k, hole):
    def beyond(t):
        return outward(plate, at_numbers(outline_points, hole, np.atleast_1d(t)))

    t = _outline_samples(hole, lambda t: beyond(t).max(axis=1))
    distances = beyond(t)
    outside = distances.max(axis=1) > 1e-12 * max(plate.width, plate.height)
    if not outside.any():
        return [Arc(k, 0.0, 1.0)]
    found = []
    for i in np.flatnonzero(outside & ~np.roll(outside, -1)):  # last sample outside before the arc
        length = np.argmax(np.roll(outside, -i - 1))  # samples of the arc
        j = (i + length) % len(t)  # its last sample
        start, start_edge = _crossing(beyond, t[(i + 1) % len(t)], t[i])
        end, end_edge = _crossing(beyond, t[j], t[(j + 1) % len(t)])
        start = start % 1.0 % 1.0  # a tiny negative number first gives 1
        found.append(Arc(k, start, start + (end - start) % 1.0, start_edge, end_edge))
    return sorted(found, key=lambda arc: arc.start)


def _outline_samples(hole, outward):
    """Increasing t in [0, 1) around every crossing: samples, corners, and near-edge extrema."""
    even = np.arange(OUTLINE_SAMPLES) / OUTLINE_SAMPLES
    t = np.union1d(even, hole.corners)
    d = outward(t)
    before, after = np.roll(d, 1), np.roll(d, -1)
    # the extremum between samples may have the other sign
    near = np.abs(d) < np.maximum(np.abs(after - d), np.abs(before - d))
    sign = np.sign(d)
    nearest = near & (sign * d <= sign * before) & (sign * d <= sign * after)
    extra = []
    for i in np.flatnonzero(nearest):
        bounds = (t[i] - 1 / OUTLINE_SAMPLES, t[i] + 1 / OUTLINE_SAMPLES)
        best = scipy.optimize.minimize_scalar(
            lambda u, i=i: sign[i] * outward(u)[0],
            bounds=bounds,
            method="bounded",
            options={"xatol": 1e-12},
        )
        extra.append(best.x % 1.0)
    return np.union1d(t, extra)


def _crossing(outward, inside, outside):
    """(t, edge) of the first edge between the t ``inside`` and the next sample ``outside``.

    The t are inside and outside of the plate.
    """
    outside += round(inside - outside)  # neighbours, so at most one turn apart
    found = []
    for column, edge in enumerate(EDGES):
        ends = [outward(t)[0, column] for t in (inside, outside)]
        if ends[1] > 0:
            t = (
                inside
                if ends[0] >= 0
                else scipy.optimize.brentq(
                    lambda t, c=column: outward(t)[0, c], inside, outside, xtol=1e-15
                )
            )
            found.append((abs(t - inside), t, edge))
    return min(found)[1:]


def _length_table(hole, start, end):
    """Panel ends (p,) of a smooth stretch from ``start`` to ``end``, and arc length (p,), mm.

    Both are t; the arc length is that up to the ends.
    """
    t = np.linspace(start, end, PANELS + 1)
    x, w = leggauss(POINTS)
    at = t[:-1, None] + (x + 1) / 2 * np.diff(t)[:, None]
    lengths = at_numbers(_speeds, hole, at.ravel()).reshape(at.shape) @ w * np.diff(t) / 2
    return t, np.concatenate([[0.0], np.cumsum(lengths)])


def _cuts(hole, t, lengths, n):
    """The t (n,) that cut a stretch, given by its length table, into n pieces of equal length.

    Without its end.
    """
    target = lengths[-1] * np.arange(n) / n
    panel = np.clip(np.searchsorted(lengths, target, side="right") - 1, 0, len(t) - 2)
    left, right = t[panel], t[panel + 1]
    cut = left + (right - left) * (target - lengths[panel]) / (lengths[panel + 1] - lengths[panel])
    x, w = leggauss(POINTS)
    for _ in range(4):
        at = left[:, None] + (x + 1) / 2 * (cut - left)[:, None]
        speeds = at_numbers(_speeds, hole, np.concatenate([at.ravel(), cut]))
        length = speeds[: at.size].reshape(at.shape) @ w * (cut - left) / 2
        cut = np.clip(cut - (length - (target - lengths[panel])) / speeds[at.size :], left, right)
    return cut


def _largest_remainder(lengths, n, arc):
    """Shares (len(lengths),) of n intervals in proportion to the lengths, at least one each."""
    if n < len(lengths):
        raise ValueError(
            f"n_intervals: {n} on an arc of holes[{arc.hole}] with {len(lengths)} sides; give at "
            "least one per side"
        )
    free = n - len(lengths)
    wish = np.maximum(n * lengths / lengths.sum() - 1, 0)
    wish *= free / max(wish.sum(), 1e-300)
    shares = np.floor(wish + 1e-9).astype(int)
    rest = np.argsort(shares - wish, kind="stable")[: free - shares.sum()]
    shares[rest] += 1
    return shares + 1
