"""Homogeneous states of a gel that swells freely: all of them at one control, where they become unstable, and where two coexist.

W(J) - mu (J - 1) is the energy of a gel that swells by J, and its states are where W'(J) = mu: stable where W' rises. A gel with two phases
has a W' that falls between two rising branches. These end at the limits of stability (spinodals), W'' = 0, and coexist where they have
the same energy: the areas between W' and mu are equal (Maxwell). The energy of an interface, and the stress of phases that must fit
together, are left out.

The search is on the host, by scanning; what it finds is differentiable by the implicit function theorem, outside ``jax.jit``.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from .._types import Array, Bool, Float, Scalar
from .._validation import finite_numbers
from .checks import check_gel, check_number
from .composite import Composite
from .curve import SwellingCurve, bend_at, energy_at, slope_at
from .fields import varies
from .gel import check_stretched_network
from .swelling import _free, _isotropic, _uniaxial

ENERGIES = {"isotropic": _isotropic, "plane strain": _free, "uniaxial": _uniaxial}  # W of J by the kind of swelling
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
    """W(J) - mu (J - 1) per dry volume, kT/v: the stable state with the smallest is the phase, other stable ones are metastable."""


class StabilityLimits(NamedTuple):
    """Limits of stability (spinodals)."""

    control: Float[Array, " r"]
    """mu in kT, or the control of a family of gels."""
    J: Float[Array, " r"]
    """Volume ratio at which a phase ends there."""


class Coexistence(NamedTuple):
    """Where two neighbouring phases have the same energy at one control."""

    control: Float[Array, " r"]
    """mu in kT, or the control of a family of gels."""
    J: Float[Array, "r 2"]
    """Volume ratios of the shrunken and the swollen phase."""


def homogeneous_states(gel: Any, mu: Scalar = 0.0, swelling: str = "isotropic") -> HomogeneousStates:
    """All states of the gel at ``mu``, kT, that swells freely.

    ``swelling`` is ``"isotropic"`` in all directions, ``"plane strain"`` at diag(l, l, 1), or ``"uniaxial"`` at diag(1, l, 1). Of these
    states `isotropic_swelling`, `free_swelling` and `uniaxial_swelling` give the one that is connected with the dry state as mu rises, and
    NaN where that one has ended. ValueError for a gel that varies from place to place.

    >>> from jaxgel.materials import Pnipam
    >>> homogeneous_states(Pnipam(temperature=32.0)).J.round(4)
    Array([1.5481, 2.2741, 6.7911], dtype=float64)
    """
    energy = _energy_of(gel, swelling)
    check_gel(gel)
    check_number("mu", mu, math.isfinite, "a finite number (chemical potential in kT)")
    J = _solution(_Problem(energy, _state_residual, _state_rows, 1), _numbers((gel, mu)))[:, 0]
    bends, values = (jax.vmap(functools.partial(part, energy), (0, None))(J, gel) for part in (bend_at, energy_at))
    return HomogeneousStates(J, bends > 0, values - mu * (J - 1))


def limits_of_stability(
    gel: Any, mu: Scalar | None = None, between: tuple[float, float] | None = None, swelling: str = "isotropic"
) -> StabilityLimits:
    """The controls and volume ratios at which a homogeneous state loses stability, W' = mu and W'' = 0; none where the gel has one phase.

    The control of a gel is mu, and its limits come in the order of J. ``gel`` may also be a function that gives the gel of a control,
    such as a temperature; then it is that control, ``between`` two numbers and in rising order, at a fixed ``mu`` (0 by default).
    ``swelling`` as of `homogeneous_states`; an isotropic gel has one more limit at its largest mu, above 0.

    >>> from jaxgel.materials import Pnipam
    >>> limits_of_stability(lambda T: Pnipam(temperature=T), between=(20.0, 45.0)).control.round(4)
    Array([31.5877, 32.6551], dtype=float64)
    """
    found = _located(_limit_residual, _limit_points, gel, mu, between, swelling)
    return StabilityLimits(found[:, 1], found[:, 0])


def coexistence(gel: Any, mu: Scalar | None = None, between: tuple[float, float] | None = None, swelling: str = "isotropic") -> Coexistence:
    """The controls at which two neighbouring phases have the same energy, and their J; none where the gel has one phase.

    Arguments as of `limits_of_stability`.

    >>> from jaxgel.materials import Pnipam
    >>> coexistence(lambda T: Pnipam(temperature=T), between=(20.0, 45.0)).control.round(4)
    Array([32.2364], dtype=float64)
    """
    found = _located(_phase_residual, _phase_points, gel, mu, between, swelling)
    return Coexistence(found[:, 2], found[:, :2])


@dataclasses.dataclass(frozen=True, eq=False)
class _Problem:
    """Equations for points, and the search for them. Both take what is ``given``: the gel, or the constants of its family, and mu."""

    energy: Callable
    residual: Callable
    """(problem, unknowns (m,), given) -> (m,)."""
    rows: Callable
    """(problem, given) -> approximate unknowns of all points, on the host."""
    count: int
    """m."""
    gel_at: Callable | None = None
    """The gel of (control, *constants); None where the control is mu."""
    between: tuple[float, float] = (math.nan, math.nan)
    """Bounds of the control of a family."""

    def at(self, control, given):
        """The gel and mu at a control."""
        return (given[0], control) if self.gel_at is None else (self.gel_at(control, *given[0]), given[1])


def _state_residual(problem, y, given):
    gel, mu = given
    return slope_at(problem.energy, y[0], gel)[None] - mu


def _limit_residual(problem, y, given):
    J, control = y
    gel, mu = problem.at(control, given)
    return jnp.stack([slope_at(problem.energy, J, gel) - mu, bend_at(problem.energy, J, gel)])


def _phase_residual(problem, y, given):
    first, second, control = y
    gel, mu = problem.at(control, given)
    slopes = [slope_at(problem.energy, J, gel) - mu for J in (first, second)]
    work = energy_at(problem.energy, second, gel) - energy_at(problem.energy, first, gel) - mu * (second - first)
    return jnp.stack([*slopes, work])


def _state_rows(problem, given):
    gel, mu = given
    curve = SwellingCurve(problem.energy, gel)
    return [(curve.root(*piece, mu),) for piece in curve.pieces if (curve.slope(piece[0]) < mu) != (curve.slope(piece[1]) < mu)]


def _limit_points(curve):
    """The mu at each limit of stability, and the unknowns besides the control."""
    return [(curve.slope(u), (1 + math.exp(u),)) for u in curve.turns]


def _phase_points(curve):
    """The mu at which neighbouring phases coexist, and the unknowns besides the control."""
    rising = [piece for piece in curve.pieces if curve.slope(piece[0]) < curve.slope(piece[1])]
    found = [curve.maxwell(*neighbours) for neighbours in itertools.pairwise(rising)]
    return [point for point in found if point]


def _energy_of(gel, swelling):
    if swelling not in ENERGIES:
        raise ValueError(f"swelling: {swelling!r} is not accepted, it must be one of {', '.join(map(repr, ENERGIES))}")
    if isinstance(gel, Composite) or varies(gel):
        raise ValueError("gel: a gel that varies from place to place is not accepted, it must be that of one place")
    if swelling == "isotropic":
        check_stretched_network(gel)
    return ENERGIES[swelling]


def _located(residual, points, gel, mu, between, swelling):
    """Unknowns (r, m) of the limits or of the coexisting phases, the control last."""
    count = 2 if residual is _limit_residual else 3
    if not callable(gel):
        if mu is not None or between is not None:
            raise ValueError("mu, between: not accepted with a gel, whose control is mu; give a function of another control")
        check_gel(gel)
        rows = functools.partial(_rows_of_gel, points)
        return _solution(_Problem(_energy_of(gel, swelling), residual, rows, count), _numbers((gel, 0.0)))
    bounds = finite_numbers(between, (2,), "between")
    if not bounds[0] < bounds[1]:
        raise ValueError(f"between: {between!r} is not accepted, it must be a lower and an upper control")
    mu = 0.0 if mu is None else mu
    check_number("mu", mu, math.isfinite, "a finite number (chemical potential in kT)")
    gel_at, constants = jax.closure_convert(gel, bounds[0])  # what else it depends on, for derivatives
    rows = functools.partial(_rows_of_family, points)
    problem = _Problem(_energy_of(gel(bounds[0]), swelling), residual, rows, count, gel_at, bounds)
    return _solution(problem, _numbers((constants, mu)))


def _numbers(tree):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)


def _rows_of_gel(points, problem, given):
    return [(*unknowns, mu) for mu, unknowns in points(SwellingCurve(problem.energy, given[0]))]


def _rows_of_family(points, problem, given):
    """Where the control brings a point of the gel to mu, enclosed by bisection between scanned controls."""
    low, high = problem.between

    def excess(control):
        gel, mu = problem.at(control, given)
        check_gel(gel)
        return [(own - mu, unknowns) for own, unknowns in points(SwellingCurve(problem.energy, gel))]

    def enclosed(a, of_a, b, of_b):
        same = len(of_a) == len(of_b)  # phases may appear between a and b
        changed = [one[1] for one, other in zip(of_a, of_b, strict=False) if (one[0] < 0) != (other[0] < 0)]
        if same and not changed:
            return []
        middle = (a + b) / 2
        if b - a < FINEST * (high - low):
            return [(*unknowns, middle) for unknowns in changed] if same else []
        of_middle = excess(middle)
        return enclosed(a, of_a, middle, of_middle) + enclosed(middle, of_middle, b, of_b)

    scanned = [(control, excess(control)) for control in np.linspace(low, high, CONTROLS)]
    return [row for one, other in itertools.pairwise(scanned) for row in enclosed(*one, *other)]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _solution(problem, given):
    """The unknowns (r, m) of all points: as the search finds them, improved by Newton's method."""
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(given)):
        raise ValueError("gel: traced numbers of jax.jit and jax.vmap are not accepted, the search for phases is on the host")

    residual = functools.partial(problem.residual, problem)
    unknowns = []
    for row in problem.rows(problem, given):
        y, step = jnp.asarray(row, float), jnp.inf
        for _ in range(NEWTON_STEPS):
            step = jnp.linalg.solve(jax.jacfwd(residual)(y, given), residual(y, given))
            y = y - step
        if not jnp.max(jnp.abs(step) / (1 + jnp.abs(y))) < CONVERGED:
            raise ValueError(f"gel: at the control {float(row[-1]):.6g} two phases are nearer to a critical point than the search resolves")
        unknowns.append(y)
    return jnp.stack(unknowns) if unknowns else jnp.zeros((0, problem.count))


@_solution.defjvp
def _solution_jvp(problem, primals, tangents):
    """residual(y, given) = 0 gives residual_y dy = -residual_given dgiven at every point."""
    residual = functools.partial(problem.residual, problem)

    def change(y):
        _, own = jax.jvp(lambda given: residual(y, given), primals, tangents)
        return -jnp.linalg.solve(jax.jacfwd(residual)(y, *primals), own)

    unknowns = _solution(problem, *primals)
    return unknowns, jax.vmap(change)(unknowns)
