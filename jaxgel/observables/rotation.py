"""Rotation of the midline and of the core."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._compiled import compiled
from .._memo import once_per_owner
from .._types import Array, Bool, Float
from ..cloud import Topology
from ..discretisation import MIDLINE_POINTS, Model, core_probe, midline_points, midline_probe
from .states import States, of_path, with_room

ITERATIONS = 8  # of Newton's method along the midline, from the sampled extremum
# of the slopes at the ends of its reach, of one sign: above it the line has no extremum between
# them
FOUND = 1e-3
FLAT = 1e-9  # height over length up to which round-off chooses the extrema
EXTREMA = 16  # that are found together, or a multiple
DEGREE = 3  # of the polynomial that smooths the midline about a point
SAMPLES = 5  # least reach of that polynomial, in distances of the samples
# added to its moments, relative: a piece of the line may have fewer samples than the polynomial has
# coefficients
SINGULAR = 1e-13


def angle_of_extrema(x: Float[Array, "k n 2"], model: Model) -> Float[Array, " k"]:
    """Angle (k,) of the line through the midline's highest and lowest point, degrees.

    It is measured from the x axis in each state of ``x`` (k, n, 2).
    """
    line, topology = midline_probe(model), model.lists.topology
    kinks = _kinks(topology, model.dmax)
    count = len(line.points)
    kinks = np.append(kinks, np.ones(MIDLINE_POINTS - count, bool))
    samples = _next_to_extrema(
        with_room(x), line.with_room(MIDLINE_POINTS), kinks, count, model.dmax * topology.spacing
    )
    return _angle_between(_extrema(*samples), len(x))


def is_flat(x: Float[Array, "k n 2"], model: Model) -> Bool[Array, " k"]:
    """Whether (k,) the midline is level, to ``FLAT`` of its length, in each of ``x`` (k, n, 2)."""
    line = jax.vmap(midline_probe(model).position)(x)
    return jnp.ptp(line[:, :, 1], axis=1) < FLAT * jnp.ptp(line[:, :, 0], axis=1)


@once_per_owner
def _kinks(topology: Topology, dmax: float) -> Bool[np.ndarray, " p"]:
    """Whether (p-1,) the outline of a region lies between neighbouring samples of the midline."""
    return np.diff(topology.regions_at(midline_points(topology, dmax))) != 0


@compiled()
def _next_to_extrema(x, line, kinks, count, radius):
    """Arguments of `_extremum`: highest and lowest midline sample in each ``x`` (k, n, 2).

    The line has ``count`` points, and the last one again; they are padded with the first one: one
    program of the extrema serves most paths.
    """
    at, real = line.points[:, 0], jnp.arange(len(line.points)) < count
    apart = jnp.diff(at)
    least = _least(apart, real[1:])
    # a hole or kink: the line ends there, and an extremum is no root of its slope
    gap = (apart > 1.5 * least) | kinks
    end, piece = jnp.append(True, gap) | jnp.append(gap, True), jnp.cumsum(jnp.append(False, gap))
    radius = jnp.maximum(radius, SAMPLES * least)

    def one(x):
        position = line.position(x)
        # the first, no padding
        i = jnp.stack([jnp.argmax(position[:, 1]), jnp.argmin(position[:, 1])])
        return (
            at[i],
            position[i],
            end[i],
            piece == piece[i][:, None],
            *(jnp.stack([value] * 2) for value in (at, position, radius)),
        )

    def padded(values):
        values = values.reshape(-1, *values.shape[2:])
        return jnp.concatenate([values, jnp.repeat(values[:1], -len(values) % EXTREMA, axis=0)])

    return jax.tree.map(padded, jax.vmap(one)(x))


@compiled()
def _extrema(*samples):
    """`_extremum` (m, 2) of m samples."""
    return jax.vmap(_extremum)(*samples)


@compiled(static=("states",))
def _angle_between(extrema, states):
    """Angle (states,) of the line through each state's highest and lowest point, degrees.

    It is measured from the x axis.
    """
    run, rise = jnp.moveaxis(extrema[: 2 * states : 2] - extrema[1 : 2 * states : 2], 1, 0)
    return jnp.degrees(jnp.arctan(rise / jnp.where(run == 0, 1.0, run)))


def _extremum(start, sample, end, same, at, position, radius):
    """Point (2,) of the deformed midline extremal in y within ``radius`` of dry ``start``.

    It is the ``sample`` at an ``end`` and if the smoothed line has no extremum within reach.

    The line is smoothed: about each point it is the polynomial that fits the samples ``position``
    (p, 2) with dry coordinates ``at`` (p,) best on the ``same`` (p,) piece, weighted out to
    ``radius``. The extremum is where dy/ds = 0, and moves with the state as that equation says, in
    derivatives of every order.
    """
    low, high = (
        jnp.clip(bound, start - radius, start + radius)
        for bound in (_least(at, same), -_least(-at, same))
    )

    def fit(s):
        """Point and derivative by s / radius, (2,) each, of the polynomial about ``s``."""
        t = (at - s) / radius
        weight = jnp.where(same, jnp.maximum(1 - t**2, 0.0), 0.0) ** 3
        powers = jnp.stack([t**power for power in range(DEGREE + 1)])
        moments = (weight * powers) @ powers.T
        coefficients = jnp.linalg.solve(
            moments + SINGULAR * moments[0, 0] * jnp.eye(DEGREE + 1), (weight * powers) @ position
        )
        return coefficients[0], coefficients[1]

    def over(value, rate):
        return jnp.where(rate == 0, 0.0, value / jnp.where(rate == 0, 1.0, rate))

    def by_newton(slope, start):
        def step(_, s):
            return jnp.clip(s - over(*jax.jvp(slope, (s,), (1.0,))), low, high)

        return lax.fori_loop(0, ITERATIONS, step, start)

    found = lax.stop_gradient(by_newton(lambda s: fit(s)[1][1], start))
    slopes = jnp.stack([fit(low)[1][1], fit(high)[1][1]])
    # none next to a wall
    fixed = end | (
        (slopes[0] * slopes[1] > 0) & (jnp.abs(fit(found)[1][1]) > FOUND * jnp.max(jnp.abs(slopes)))
    )

    def slope(s):
        """dy/ds; for a ``fixed`` point, no root of it, a function with its root there.

        Second derivatives are else 0 times nan.
        """
        return jnp.where(fixed, s - start, fit(s)[1][1])

    s = lax.custom_root(
        slope, jnp.where(fixed, start, found), by_newton, lambda rate, value: over(value, rate(1.0))
    )
    return jnp.where(fixed, sample, fit(s)[0])


def _least(values, counted):
    return jnp.min(jnp.where(counted, values, jnp.inf))


@of_path
def rotation_angle(path: States) -> Float[Array, " k"]:
    """Rotation of the midline (k,), degrees: angle to the x axis of the line through its extrema.

    Arguments:

    - `path`: the `Path` of k states.

    The midline is the part of y = 0 in the dry gel, its extrema are its highest and its lowest
    point. In a periodic cell y = 0 is the middle of the frame that is computed, see
    `geometry.frame_of`. The midline is smoothed by a cubic over a support of the shape functions,
    as the interpolated slope, which vanishes at the extrema, oscillates from node to node. So the
    angle is a smooth function of the state until another extremum takes over. The angle of a level
    midline, such as that of the symmetric states of samples 4 and 7 and of the lattice, is 0 and
    has no derivative: differentiate `core_rotation` there.

    Source: Deng et al. (2020), section 5.5. Example: README.
    """
    return angle_of_extrema(path.x, path.model)


@of_path
def core_rotation(path: States) -> Float[Array, " k"]:
    """Polar rotation (k,) of the gel at `plate.core`, degrees: the angle of R in F = R U.

    Arguments:

    - `path`: the `Path` of k states.

    Returns nan if the core lies in a hole.

    >>> import types, jaxgel
    >>> model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.Plate(2.0, 2.0), spacing=0.5))
    >>> turned = model.nodes @ jnp.array([[0.0, 1.0], [-1.0, 0.0]])
    >>> states = types.SimpleNamespace(model=model, x=turned[None])  # a path has more
    >>> core_rotation(states).round(6)
    Array([90.], dtype=float64)
    """
    return _polar_rotation(with_room(path.x), core_probe(path.model))


@compiled()
def _polar_rotation(x, core):
    F = jnp.moveaxis(jax.vmap(core.deformation_gradient)(x)[:, 0], 0, -1)
    return jnp.degrees(jnp.arctan2(F[1, 0] - F[0, 1], F[0, 0] + F[1, 1]))
