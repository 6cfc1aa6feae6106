"""Phases of a freely swelling gel: homogeneous states, spinodals and coexistence (binodal).

W(J) - mu (J - 1) is the energy of a gel that swells by J, and its states are where W'(J) = mu:
stable if W' rises. A gel with two phases has a W' that falls between two rising branches. These end
at the limits of stability (spinodals), W'' = 0, and coexist if they have the same energy: the areas
between W' and mu are equal (Maxwell). The energy of an interface, and the stress of phases that
must fit together, are left out.

The search is on the host, by scanning; what it finds is differentiable, outside ``jax.jit``.
"""

import itertools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from .._compiled import compiled
from .._tracing import is_traced
from .._types import Array, Bool, Float, Scalar
from .._validation import finite_numbers, one_of
from .checks import check_gel, check_number
from .composite import Composite
from .fields import varies
from .gel import check_stretched_network
from .swelling import LARGEST_SWELLING, SMALLEST_SWELLING, _free, _isotropic, _uniaxial

# W of J by the kind of swelling
ENERGIES = {"isotropic": _isotropic, "plane strain": _free, "uniaxial": _uniaxial}
# of u = ln(J - 1)
SCAN = np.linspace(math.log(SMALLEST_SWELLING), math.log(LARGEST_SWELLING), 2**12)
STRAIGHT = 1e9  # W and its derivatives beyond the J at which chains are straight, kT/v
CLOSEST = {"xtol": 1e-15, "rtol": 1e-14}  # of bracketed roots
CONTROLS = 33  # scanned between two controls
FINEST = 1e-5  # of the range of the control: how closely a point is enclosed before Newton's method
NEWTON_STEPS = 3  # from there
CONVERGED = 1e-7  # relative size of the last step, whose square is the error


class HomogeneousStates(NamedTuple):
    """All homogeneous states at one control, by rising volume ratio."""

    J: Float[Array, " r"]
    """Volume ratios."""
    stable: Bool[Array, " r"]
    """Whether the energy has a minimum there."""
    energy: Float[Array, " r"]
    """W(J) - mu (J - 1), kT/v per dry volume: the stable state of least energy is the phase.

    Other stable ones are metastable.
    """


class PhasePoints(NamedTuple):
    """Spinodals (limits of stability), or coexistence points of two neighbouring phases.

    Coexisting phases have the same energy.
    """

    control: Float[Array, " r"]
    """mu in kT, or the control of a family of gels."""
    J: Float[Array, " r"] | Float[Array, "r 2"]
    """Volume ratio at which a phase ends, or those of the shrunken and the swollen phase."""


def homogeneous_states(
    gel: Any, mu: Scalar = 0.0, swelling: str = "isotropic"
) -> HomogeneousStates:
    """All homogeneous states of a freely swelling gel at one chemical potential.

    Arguments:

    - `gel`: a `Gel` or another, the same everywhere.
    - `mu` (): chemical potential, kT.
    - `swelling`: "isotropic" in all directions, "plane strain" at diag(l, l, 1), or "uniaxial" at
      diag(1, l, 1).

    Returns `HomogeneousStates` with J (r,), stable (r,) and energy (r,), kT/v. Of these states
    `isotropic_swelling`, `free_swelling` and `uniaxial_swelling` give the one that is connected
    with the dry state as mu rises, and NaN if that one has ended.

    Raises `ValueError` for an unknown `swelling`, and for a gel that varies from place to place.

    >>> from jaxgel.materials import Pnipam
    >>> homogeneous_states(Pnipam(temperature=32.0)).J.round(4)
    Array([1.5481, 2.2741, 6.7911], dtype=float64)
    """
    energy = _energy_of(gel, swelling)
    check_gel(gel)
    check_number("mu", mu, math.isfinite, "a finite number (chemical potential in kT)")

    def residual(y, given):
        return _derivatives(energy, y, given[0])[1] - given[1]

    J = _points(residual, lambda given: _Curve(energy, given[0]).states(given[1]), 1, (gel, mu))[
        :, 0
    ]
    W, _, bends = _derivatives(energy, J, gel)
    return HomogeneousStates(J, bends > 0, W - mu * (J - 1))


def limits_of_stability(
    gel: Any,
    mu: Scalar | None = None,
    between: tuple[float, float] | None = None,
    swelling: str = "isotropic",
) -> PhasePoints:
    """Controls and volume ratios at which a homogeneous state loses stability (spinodals).

    Arguments:

    - `gel`: a `Gel` or another, the same everywhere, whose control is mu; or a function that gives
      the gel of a control, such as a temperature.
    - `mu` (): fixed chemical potential, kT, if `gel` is a function; 0 by default.
    - `between`: (first, last) of the control, in its unit, if `gel` is a function.
    - `swelling`: as for `homogeneous_states`.

    Returns `PhasePoints` with W' = mu and W'' = 0: control (r,) and J (r,), empty if the gel has
    one phase; in the order of J, or in rising order of the control of a function. An isotropic gel
    has one more limit at its largest mu, above 0.

    Raises `ValueError` for an unusable gel or control.

    >>> from jaxgel.materials import Pnipam
    >>> limits_of_stability(lambda T: Pnipam(temperature=T), between=(20.0, 45.0)).control.round(4)
    Array([31.5877, 32.6551], dtype=float64)
    """
    found = _located(_Curve.limits, 1, gel, mu, between, swelling)
    return PhasePoints(found[:, 1], found[:, 0])


def coexistence(
    gel: Any,
    mu: Scalar | None = None,
    between: tuple[float, float] | None = None,
    swelling: str = "isotropic",
) -> PhasePoints:
    """Controls at which two neighbouring phases have the same energy, and their volume ratios.

    Arguments: `gel`, `mu`, `between` and `swelling` as for `limits_of_stability`.

    Returns `PhasePoints`: control (r,) and J (r, 2), shrunken and swollen; empty if the gel has one
    phase.

    Raises `ValueError` as `limits_of_stability`.

    >>> from jaxgel.materials import Pnipam
    >>> coexistence(lambda T: Pnipam(temperature=T), between=(20.0, 45.0)).control.round(4)
    Array([32.2364], dtype=float64)
    """
    found = _located(_Curve.phases, 2, gel, mu, between, swelling)
    return PhasePoints(found[:, 2], found[:, :2])


@compiled(static=("energy",))
def _derivatives(energy, J, gel):
    """W, W' and W'' (3, n) at the volume ratios ``J`` (n,)."""

    def values(J):
        slope = jax.grad(energy)
        values = jnp.stack([energy(J, gel), slope(J, gel), jax.grad(slope)(J, gel)])
        return jnp.where(jnp.isfinite(values).all(), values, STRAIGHT)

    return jax.vmap(values, out_axes=1)(J)


class _Curve:
    """W' of one gel over u = ln(J - 1), as numbers."""

    def __init__(self, energy, gel):
        self._values = lambda u: np.asarray(_derivatives(energy, 1 + np.exp(np.atleast_1d(u)), gel))
        self._scan = self._values(SCAN)
        self._turns = self._roots(2)

    def _root(self, mu, ends, order=1):
        """The u between ``ends`` at which a derivative is ``mu``, or the end that is nearest."""

        def excess(u):
            return self._values(u)[order, 0] - mu

        # each alone: of several at once the last bit may differ (jax 0.10.1)
        at_ends = np.array([excess(u) for u in ends])
        return (
            scipy.optimize.brentq(excess, *ends, **CLOSEST)
            if at_ends.prod() < 0
            else ends[np.argmin(np.abs(at_ends))]
        )

    def _roots(self, order, mu=0.0):
        below = self._scan[order] < mu
        return [
            self._root(mu, SCAN[k : k + 2], order) for k in np.flatnonzero(below[1:] != below[:-1])
        ]

    def states(self, mu):
        """(J,) of the states."""
        return [(1 + math.exp(u),) for u in self._roots(1, mu)]

    def limits(self):
        """(mu, J) of the limits of stability."""
        return [(self._values(u)[1, 0], 1 + math.exp(u)) for u in self._turns]

    def phases(self):
        """(mu, J, J) of coexistences between neighbouring pieces on which W' rises."""
        pieces = [
            ends
            for ends in itertools.pairwise([SCAN[0], *self._turns, SCAN[-1]])
            if np.diff(self._values(ends)[1]) > 0
        ]
        return [point for both in itertools.pairwise(pieces) if (point := self._maxwell(both))]

    def _maxwell(self, pieces):
        def states(mu):
            return np.array([self._root(mu, ends) for ends in pieces])

        def work(mu):
            u = states(mu)
            return float(np.diff(self._values(u)[0] - mu * np.exp(u))[0])

        slopes = self._values(np.ravel(pieces))[1]
        lowest, highest = slopes[::2].max(), slopes[1::2].min()
        if not work(lowest) > 0 > work(highest):
            return None
        mu = scipy.optimize.brentq(work, lowest, highest, **CLOSEST)
        return mu, *(1 + np.exp(states(mu)))


def _energy_of(gel, swelling):
    one_of("swelling", swelling, tuple(ENERGIES))
    if isinstance(gel, Composite) or varies(gel):
        raise ValueError(
            "gel: a gel that varies from place to place is not accepted, it must be that of one "
            "place"
        )
    if swelling == "isotropic":
        check_stretched_network(gel)
    return ENERGIES[swelling]


def _located(points, count, gel, mu, between, swelling):
    """Unknowns (r, m) of the ``points`` of a curve: ``count`` volume ratios, then the control."""

    def residual(y, given):
        gel, mu = at(y[-1], given)
        W, slope, bend = _derivatives(energy, y[:-1], gel)
        return jnp.append(slope - mu, bend if count == 1 else jnp.diff(W - mu * y[:-1]))

    def excess(control, given):
        gel, mu = at(control, given)
        check_gel(gel)
        return [(own - mu, *J) for own, *J in points(_Curve(energy, gel))]

    if not callable(gel):
        if mu is not None or between is not None:
            raise ValueError(
                "mu, between: not accepted with a gel, whose control is mu; give a function of "
                "another control"
            )
        energy, at = _energy_of(gel, swelling), lambda control, gel: (gel, control)
        return _points(
            residual, lambda gel: [(*J, mu) for mu, *J in excess(0.0, gel)], count + 1, gel
        )
    bounds = finite_numbers(between, (2,), "between")
    if not bounds[0] < bounds[1]:
        raise ValueError(
            f"between: {between!r} is not accepted, it must be a lower and an upper control"
        )
    mu = 0.0 if mu is None else mu
    check_number("mu", mu, math.isfinite, "a finite number (chemical potential in kT)")
    # what else it depends on, for derivatives
    gel_at, constants = jax.closure_convert(gel, bounds[0])
    energy, at = (
        _energy_of(gel(bounds[0]), swelling),
        lambda control, given: (gel_at(control, *given[0]), given[1]),
    )
    return _points(
        residual,
        lambda given: _enclosed(lambda control: excess(control, given), *bounds),
        count + 1,
        (constants, mu),
    )


def _enclosed(excess, low, high):
    """Unknowns of a family's points where ``excess(control)`` is 0, by bisection.

    It changes its sign between scanned controls.
    """

    def halved(a, of_a, b, of_b):
        same = len(of_a) == len(of_b)  # phases may appear between a and b
        changed = [
            one[1:]
            for one, other in zip(of_a, of_b, strict=False)
            if (one[0] < 0) != (other[0] < 0)
        ]
        if same and not changed:
            return []
        middle = (a + b) / 2
        if b - a < FINEST * (high - low):
            return [(*J, middle) for J in changed] if same else []
        of_middle = excess(middle)
        return halved(a, of_a, middle, of_middle) + halved(middle, of_middle, b, of_b)

    scanned = [(control, excess(control)) for control in np.linspace(low, high, CONTROLS)]
    return [row for one, other in itertools.pairwise(scanned) for row in halved(*one, *other)]


def _points(residual, search, count, given):
    """Roots (r, ``count``) of ``residual(y, given)`` from ``search(given)`` by Newton's method.

    Its steps are differentiable, and each doubles the order to which derivatives by what is given
    are right.
    """
    given = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), given)
    numbers = jax.lax.stop_gradient(given)  # leaves JAX's differentiation, not jit
    if is_traced(numbers):
        raise ValueError(
            "gel: traced numbers of jax.jit and jax.vmap are not accepted, the search for phases "
            "is on the host"
        )
    y = jnp.array(search(numbers), dtype=float).reshape(-1, count)
    for _ in range(NEWTON_STEPS):
        step = jax.vmap(
            lambda y: jnp.linalg.solve(jax.jacfwd(residual)(y, given), residual(y, given))
        )(y)
        y = y - step
    step, found = (np.asarray(jax.lax.stop_gradient(part)) for part in (step, y))
    poor = found[~(np.abs(step) < CONVERGED * (1 + np.abs(found))).all(axis=1)]
    if len(poor):
        raise ValueError(
            f"gel: at the control {float(poor[0, -1]):.6g} two phases are nearer to a critical "
            "point than the search resolves"
        )
    return y
