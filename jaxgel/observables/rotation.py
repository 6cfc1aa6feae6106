"""Rotation of the midline and of the core."""

import functools

import jax
import jax.numpy as jnp
from jax import lax

from .._types import Array, Bool, Float
from ..discretisation import NEIGHBOURS, Model, core_probe, in_plane, midline_probe, shape_functions
from .states import States

ITERATIONS = 8  # of Newton's method along the midline, from the sampled extremum
FLAT = 1e-9  # height over length up to which round-off chooses the extrema
EXTREMA = 16  # that are found together, or a multiple


def angle_of_extrema(x: Float[Array, "k n 2"], model: Model) -> Float[Array, " k"]:
    """Angle (k,) to the x axis, degrees, of the line through the midline's highest and lowest point in each state of ``x`` (k, n, 2)."""
    kind = "imls" if model.kind == "iicvmls" else model.kind  # its real twin
    samples = _next_to_extrema(x, model.cloud.nodes, midline_probe(model))
    return _angle_between(_extrema(*samples, basis=model.basis, kind=kind), len(x))


def is_flat(x: Float[Array, "k n 2"], model: Model) -> Bool[Array, " k"]:
    """Whether (k,) the midline is level, to ``FLAT`` of its length, in each state of ``x`` (k, n, 2)."""
    line = jax.vmap(midline_probe(model).position)(x)
    return jnp.ptp(line[:, :, 1], axis=1) < FLAT * jnp.ptp(line[:, :, 0], axis=1)


@jax.jit
def _next_to_extrema(x, dry_nodes, line):
    """The arguments of `_extremum` for the highest and the lowest sample of the midline in each state of ``x`` (k, n, 2).

    They are padded with the first one and with neighbours of no support: one program of the extrema serves most paths.
    """
    room = ((0, 0), (0, -line.nodes.shape[1] % (4 * NEIGHBOURS)))
    nodes, support = jnp.pad(line.nodes, room), jnp.pad(line.support, room)
    apart = jnp.diff(line.points[:, 0])
    gap = apart > 1.5 * jnp.min(apart)  # a hole: the line ends at both samples, and an extremum there is no root of its slope
    end = jnp.append(True, gap) | jnp.append(gap, True)

    def one(x):
        height = line.position(x)[:, 1]
        i = jnp.stack([jnp.argmax(height), jnp.argmin(height)])
        reach = jnp.where(end[i], 0.0, jnp.min(apart))
        return line.points[i], reach, dry_nodes[nodes[i]], support[i], x[nodes[i]]

    def padded(values):
        values = values.reshape(-1, *values.shape[2:])
        return jnp.concatenate([values, jnp.repeat(values[:1], -len(values) % EXTREMA, axis=0)])

    return jax.tree.map(padded, jax.vmap(one)(x))


@functools.partial(jax.jit, static_argnames=("basis", "kind"))
def _extrema(*samples, basis, kind):
    """`_extremum` (m, 2) of m samples."""
    return jax.vmap(functools.partial(_extremum, basis=basis, kind=kind))(*samples)


@functools.partial(jax.jit, static_argnames="states")
def _angle_between(extrema, states):
    """Angle (states,) to the x axis, degrees, of the line through the highest and the lowest point of each state."""
    run, rise = jnp.moveaxis(extrema[: 2 * states : 2] - extrema[1 : 2 * states : 2], 1, 0)
    return jnp.degrees(jnp.arctan(rise / jnp.where(run == 0, 1.0, run)))


def _extremum(start, reach, neighbours, support, values, *, basis, kind):
    """Point (2,) of the deformed midline that is extremal in y within ``reach`` of the dry point ``start`` (2,).

    Shape functions of the ``neighbours`` (a, 2) and their deformed positions ``values`` (a, 2) give the line. The extremum is where
    dy/ds = 0, and moves with the state as that equation says, in derivatives of every order; without reach it is the start.
    """

    def point(s):
        return in_plane(shape_functions(jnp.stack([s, start[1]]), neighbours, support, basis=basis, kind=kind) @ values)

    def slope(s):
        return jax.jvp(lambda s: point(s)[1], (s,), (1.0,))[1]

    def over(value, rate):
        return jnp.where(rate == 0, 0.0, value / jnp.where(rate == 0, 1.0, rate))

    def by_newton(slope, start):
        def step(_, s):
            return jnp.clip(s - over(*jax.jvp(slope, (s,), (1.0,))), start - reach, start + reach)

        return lax.fori_loop(0, ITERATIONS, step, start)

    s = lax.custom_root(slope, start[0], by_newton, lambda rate, value: over(value, rate(1.0)))
    return point(jnp.where(reach > 0, s, start[0]))


def rotation_angle(path: States) -> Float[Array, " k"]:
    """Rotation of the midline (k,), degrees: the angle to the x axis of the line through its highest and its lowest point.

    The midline is the part of y = 0 in the dry gel (Deng et al. 2020, section 5.5). The extrema are those of the interpolated line, not of
    samples, so the angle is a smooth function of the state until another extremum takes over. A level midline, such as that of the
    symmetric states of samples 4 and 7 and of the lattice, turns by 0 and has no derivative: differentiate ``core_rotation`` there.
    """
    return angle_of_extrema(jnp.asarray(path.x), path.model)


def core_rotation(path: States) -> Float[Array, " k"]:
    """Polar rotation (k,) of the gel at ``plate.core``, degrees: the angle of R in F = R U; nan where the core lies in a hole."""
    return _polar_rotation(jnp.asarray(path.x), core_probe(path.model))


@jax.jit
def _polar_rotation(x, core):
    F = jnp.moveaxis(jax.vmap(core.deformation_gradient)(x)[:, 0], 0, -1)
    return jnp.degrees(jnp.arctan2(F[1, 0] - F[0, 1], F[0, 0] + F[1, 1]))
