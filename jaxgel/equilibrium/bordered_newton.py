"""Equilibria with side conditions: bordered Newton's method for unknown forces or control.

The unknowns are the positions x and pressures p, forces s along given columns C and, if there is
one condition more than columns, the value of the control. The conditions are R (x - origin) + slope
(value - value_origin) = target. Newton's method factorises the tangent with these rows and columns
around it, which is regular if the tangent itself is singular. In the mixed form dp contains what
the control changes at given positions: -dmu, as the osmotic pressure at a given volume ratio falls
by what mu rises.
"""

import dataclasses

import numpy as np

from .._types import Array, Float, Scalar
from ..linalg import Bordered
from ..mechanics import Problem, condensed_rhs, gather, restrict, tangent
from .newton import NEWTON, Correction, advanced, iterate, starting
from .state import State, control_force

ROUND_OFF = 1e-13  # error of a condition, relative to the positions


@dataclasses.dataclass(frozen=True, eq=False)
class Conditions:
    """b conditions on a state: rows . (x - origin) + slopes (value - value_origin) = targets."""

    rows: Float[np.ndarray, "f b"]
    """On the free degrees of freedom."""
    slopes: Float[np.ndarray, " b"]
    """On the value of the control."""
    origin: Float[Array, "n 2"]
    """Positions, mm."""
    value_origin: float
    """Value of the control, in its unit."""
    targets: Float[np.ndarray, " b"]
    """Values."""


def solve_bordered(
    problem: Problem,
    value: Scalar,
    x: Float[Array, "n 2"],
    pressure: Float[Array, " g"],
    columns: Float[np.ndarray, "f m"],
    conditions: Conditions,
) -> tuple[State, Float[np.ndarray, " m"]]:
    """`State` under forces along ``columns`` that meets ``conditions``, and the forces, kT/v mm.

    There are m or m + 1 conditions. With m + 1 conditions the value of the control is unknown too.
    The state has a factor of its own tangent.
    """
    correction = _Bordered(
        columns,
        conditions,
        restrict(np.asarray(conditions.origin), problem.free),
        np.zeros(columns.shape[1]),
    )
    return iterate(problem, starting(problem, value, x, pressure), correction), correction.forces


def solve_pinned(
    problem: Problem,
    value: Scalar,
    x: Float[Array, "n 2"],
    pressure: Float[Array, " g"],
    mode: Float[np.ndarray, " f"],
    origin: Float[Array, "n 2"],
    amplitude: float,
) -> tuple[State, float]:
    """`State` with mode . (x - origin) = ``amplitude``, and the force along ``mode``, kT/v mm.

    One condition by two solves with the factor of the tangent itself, which may be indefinite but
    must not be singular.
    """
    conditions = Conditions(mode[:, None], np.zeros(1), origin, float(value), np.array([amplitude]))
    correction = _Pinned(
        mode[:, None], conditions, restrict(np.asarray(origin), problem.free), np.zeros(1)
    )
    found = iterate(problem, starting(problem, value, x, pressure), correction)
    return found, float(correction.forces[0])


@dataclasses.dataclass
class _Bordered(Correction):
    most = 15
    miss_most = 1e-10  # largest error of a condition, relative to its target

    columns: np.ndarray
    conditions: Conditions
    origin: np.ndarray
    forces: np.ndarray
    miss: np.ndarray | None = None

    def assess(self, problem, state):
        conditions, at = self.conditions, restrict(np.asarray(state.x), problem.free)
        linearisation, forces = state.linearisation, self.columns @ self.forces
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging iterate ends as a status
            missing = np.linalg.norm(gather(np.asarray(linearisation.rhs), problem.free) + forces)
        violation = float(linearisation.violation)
        size = float(missing * float(linearisation.per_force)) if np.isfinite(violation) else np.nan
        change = (at - self.origin) @ conditions.rows + conditions.slopes * (
            state.value - conditions.value_origin
        )
        self.miss = conditions.targets - change
        allowed = ROUND_OFF * np.linalg.norm(conditions.rows, axis=0) * np.linalg.norm(
            at
        ) + self.miss_most * np.abs(conditions.targets)
        solved = size < NEWTON.tolerance and violation < NEWTON.constraint_tolerance
        return size, solved and bool(np.all(np.abs(self.miss) <= allowed))

    def __call__(self, problem, state):
        (b, m), slopes = (
            (self.conditions.rows.shape[1], self.columns.shape[1]),
            self.conditions.slopes,
        )
        now, _ = problem.at(state.value)
        acting = now.with_pairs(state.pairs)
        pairs, pattern = (
            tangent(acting, state.x, state.pressure, state.linearisation),
            acting.pattern,
        )
        sides = (
            self.columns
            if b == m
            else np.concatenate([self.columns, -control_force(problem, state)[:, None]], axis=1)
        )
        corner = np.concatenate([np.zeros((b, m)), slopes[:, None]], axis=1)[:, :b]
        system = Bordered(
            pattern.tree.order, pattern.matrix(pairs), -sides, self.conditions.rows, corner
        )
        rhs = np.asarray(condensed_rhs(now, state.linearisation, state.linearisation))
        dx, change = system.solve(rhs + self.columns @ self.forces, self.miss)
        self.forces = self.forces + change[:m]
        return advanced(
            problem, state, dx, state.linearisation, step=float(change[m:].sum()), limited=False
        )

    def finish(self, problem, state):
        return super().finish(problem.at(state.value)[0], state)


class _Pinned(_Bordered):
    """The same with the factor of the tangent itself."""

    most = 30
    miss_most = 1e-9

    def __call__(self, problem, state):
        mode, made = self.columns[:, 0], super().finish(problem, state).factor
        now, _ = problem.at(state.value)
        rhs = (
            np.asarray(condensed_rhs(now, state.linearisation, state.linearisation))
            + self.forces * mode
        )
        both, _ = made.solve(np.stack([rhs, mode], axis=1))
        more = (self.miss - mode @ both[:, 0]) / (mode @ both[:, 1])
        self.forces = self.forces + more
        return advanced(problem, state, both[:, 0] + more * both[:, 1], state.linearisation)

    def finish(self, problem, state):  # noqa: ARG002
        return state
