"""Interpolation in time between the states of a path.

Between two states a quantity is the cubic polynomial through the two states before and the two
after. Its variable is the logarithm of the time since the last kink of the bath, time 0 included;
if the first of the four states is at this kink, where the logarithm is infinite, the square root of
the time since. No polynomial reaches across a kink: near one, and near the ends of a path, the four
states are the nearest on the same side. With three states it is quadratic, with two linear, and
linear in time between two states around a kink.

Index letters: ``k`` state, ``i`` interval between two states, ``j`` kink, ``p`` time, ``s`` state
of a polynomial.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from .._compiled import compiled
from .._types import Array, Bool, Float, Int

STATES = 4  # of a cubic polynomial
ROUNDING = 1e-12  # relative error of times that are the same
HALVINGS = 60  # of the interval in which a value is reached
# of Newton's method there: the first and second derivatives of what follows are those of the root
CORRECTIONS = 2
LINEAR, ROOT, LOGARITHM = range(3)  # variables of a polynomial


class Pieces(NamedTuple):
    """The polynomials of the intervals."""

    states: Int[Array, "i s"]
    """Their states."""
    real: Bool[Array, "i s"]
    """Which of these there are."""
    since: Float[Array, " i"]
    """Time of the last kink."""
    variable: Int[Array, " i"]
    """``LINEAR``, ``ROOT`` or ``LOGARITHM``."""


def pieces(times: Float[Array, " k"], kinks: Float[Array, " j"]) -> Pieces:
    """`Pieces` between at least two ``times``, which rise from 0 or later.

    ``kinks`` are those of the bath.
    """
    kinks = jnp.sort(jnp.append(kinks, 0.0))
    # kinks at or before each state
    reached = jnp.sum(kinks <= times[:, None] * (1 + ROUNDING), axis=1)
    passed = jnp.sum(kinks < times[:, None] * (1 - ROUNDING), axis=1)  # those before it
    segment, number = reached[:-1], jnp.arange(len(times) - 1)
    smooth = passed[1:] == segment
    first = jnp.where(smooth, jnp.sum(reached < segment[:, None], axis=1), number)
    last = jnp.where(smooth, jnp.sum(passed <= segment[:, None], axis=1) - 1, number + 1)
    start = jnp.clip(number - 1, first, jnp.maximum(last - STATES + 1, first))
    states = start[:, None] + jnp.arange(STATES)
    at_kink = (reached[start] == segment) & (passed[start] < segment)
    variable = jnp.where(smooth, jnp.where(at_kink, ROOT, LOGARITHM), LINEAR)
    return Pieces(
        jnp.minimum(states, len(times) - 1), states <= last[:, None], kinks[segment - 1], variable
    )


def _to_variable(t, since, variable):
    """The variable at times ``t`` after the kink at ``since``."""
    elapsed = jnp.where(t > since, t - since, 1.0)
    found = jnp.where(variable == ROOT, jnp.sqrt(elapsed), jnp.log(elapsed))
    return jnp.where(variable == LINEAR, t - since, jnp.where(t > since, found, 0.0))


def _to_time(s, since, variable):
    """The inverse of `_to_variable`."""
    return since + jnp.where(
        variable == LINEAR,
        s,
        jnp.where(variable == ROOT, s**2, jnp.exp(jnp.where(variable == LOGARITHM, s, 0.0))),
    )


def _weights(s, nodes, real):
    """Lagrange's weights (s,) at ``s`` of the nodes (s,) that are real."""
    away = nodes[:, None] - nodes
    others = real[:, None] & real & ~jnp.eye(len(nodes), dtype=bool)
    return jnp.where(
        real,
        jnp.prod(jnp.where(others, (s - nodes) / jnp.where(others, away, 1.0), 1.0), axis=1),
        0.0,
    )


def _piece(times, polynomials, i):
    """Nodes (s,) of the polynomial of the interval ``i`` and the rest of its `Pieces`."""
    states, real, since, variable = jax.tree.map(lambda values: values[i], polynomials)
    return states, _to_variable(times[states], since, variable), real, since, variable


@compiled()
def interpolated(
    times: Float[Array, " k"],
    kinks: Float[Array, " j"],
    values: Float[Array, "k ..."],
    t: Float[Array, " p"],
) -> Array:
    """Values (p, ...) at the times ``t`` (p,); nan beyond the states."""
    polynomials = pieces(times, kinks)

    def at(t):
        i = jnp.clip(jnp.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
        states, nodes, real, since, variable = _piece(times, polynomials, i)
        return jnp.tensordot(
            _weights(_to_variable(t, since, variable), nodes, real), values[states], axes=1
        )

    reach = ROUNDING * times[-1]
    inside = (t >= times[0] - reach) & (t <= times[-1] + reach)
    found = jax.vmap(at)(jnp.clip(t, times[0], times[-1]))
    return jnp.where(inside.reshape(-1, *[1] * (found.ndim - 1)), found, jnp.nan)


@compiled()
def rates(
    times: Float[Array, " k"], kinks: Float[Array, " j"], values: Float[Array, "k ..."]
) -> Array:
    """Time derivatives (k, ...) at the states, of the interval that ends there.

    The first state has those of the first interval. nan at the start of a polynomial in the root of
    time, where the derivative may be infinite.
    """
    polynomials = pieces(times, kinks)

    def at(t, i):
        states, nodes, real, since, variable = _piece(times, polynomials, i)
        s = _to_variable(t, since, variable)
        slopes = jax.jacfwd(_weights)(s, nodes, real)
        elapsed = jnp.where(t > since, t - since, 1.0)
        of_root = jnp.where(variable == ROOT, 0.5 / jnp.sqrt(elapsed), 1 / elapsed)
        rate = jnp.tensordot(slopes, values[states], axes=1) * jnp.where(
            variable == LINEAR, 1.0, of_root
        )
        return jnp.where((variable == LINEAR) | (t > since), rate, jnp.nan)

    return jax.vmap(at)(times, jnp.maximum(jnp.arange(len(times)) - 1, 0))


@compiled()
def first_time(
    times: Float[Array, " k"],
    kinks: Float[Array, " j"],
    values: Float[Array, " k"],
    value: Float[Array, ""],
) -> Array:
    """Time () at which ``values`` (k,) first reach a ``value``; nan if they do not.

    In the first interval at whose end the value is reached the root is found by halving; the steps
    of Newton's method that follow give it its derivatives.
    """
    polynomials, side = pieces(times, kinks), jnp.sign(values[0] - value)
    reached = (values - value) * side <= 0
    end = jnp.argmax(reached)
    i = jnp.maximum(end - 1, 0)
    states, nodes, real, since, variable = _piece(times, polynomials, i)

    def missing(s, nodes, of_states, value):
        return _weights(s, nodes, real) @ of_states - value

    fixed = lax.stop_gradient((nodes, values[states], value))

    def halved(_, ends):
        middle = (ends[0] + ends[1]) / 2
        before = missing(middle, *fixed) * lax.stop_gradient(side) > 0
        return jnp.where(before, middle, ends[0]), jnp.where(before, ends[1], middle)

    ends = tuple(_to_variable(lax.stop_gradient(times)[at], since, variable) for at in (i, i + 1))
    s = lax.stop_gradient(sum(lax.fori_loop(0, HALVINGS, halved, ends)) / 2)
    for _ in range(CORRECTIONS):
        off, slope = jax.value_and_grad(missing)(s, nodes, values[states], value)
        s = s - off / jnp.where(slope == 0, 1.0, slope)
    found = jnp.where(end == 0, times[0], _to_time(s, since, variable))
    return jnp.where(jnp.any(reached), found, jnp.nan)
