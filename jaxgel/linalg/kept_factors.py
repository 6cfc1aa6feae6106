"""Recent factors, kept for the linear systems of derivatives."""

import collections
import threading
from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np

from .._types import Array, Float
from .factors import SingularTangent, factor
from .pattern import Pattern

REMEMBERED_BYTES = 2**29  # most that the factors kept for `solve_near` may fill, those of all patterns together


@runtime_checkable
class Kept(Protocol):
    """What the linear systems of derivatives need of a factorised tangent: a `Factor` has it."""

    @property
    def pattern(self) -> Pattern:
        """Pattern of the tangent."""
        ...

    @property
    def size(self) -> int:
        """Bytes it fills."""
        ...

    def is_of(self, pressure: Float[Array, " g"]) -> bool:
        """Whether it is of the very tangent of a state with this ``pressure``, at the positions with which it is kept."""
        ...

    def inverse(self, rhs: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
        """Solution (f,) for the right-hand side."""
        ...

    def solve_other(self, rhs: Float[np.ndarray, " f"], product: Callable[[np.ndarray], np.ndarray]) -> Float[np.ndarray, " f"] | None:
        """Solution (f,) for another matrix, see `solve_near_factor`."""
        ...


class FactorCache:
    """The latest factors, each with the nodal positions of its tangent.

    Together they fill at most ``bytes``, the latest one excepted: it stays however large it is. When a factor is added, the oldest ones
    are dropped until the rest fits. `nearest` returns the factor of the pattern, or of its narrower one, whose positions have the least
    distance from those asked for, and of several equally near ones the latest. A factor that was dropped changes no solution, only the
    time that it takes, since `solve_near` factorises anew. Threads may add and ask at the same time.
    """

    def __init__(self, bytes: float):  # noqa: A002
        self.bytes = bytes
        self._lock = threading.Lock()
        self._kept: collections.deque[tuple[Kept, Float[np.ndarray, "n 2"]]] = collections.deque()  # newest last

    def contents(self) -> list[tuple[Kept, Float[np.ndarray, "n 2"]]]:
        """The factors kept and their positions, oldest first."""
        with self._lock:
            return list(self._kept)

    def add(self, made: Kept, x: Float[Array, "n 2"]) -> None:
        """Keep a factor of a tangent at the nodal positions ``x``, or next to them."""
        with self._lock:
            self._kept.append((made, np.asarray(x)))
            while len(self._kept) > 1 and sum(kept.size for kept, _ in self._kept) > self.bytes:
                self._kept.popleft()

    def nearest(self, pattern: Pattern, x: Float[Array, "n 2"]) -> Kept | None:
        """The factor of the positions nearest ``x``; None where none of this pattern is kept."""
        candidates = [(made, at) for made, at in reversed(self.contents()) if made.pattern in (pattern, pattern.narrower)]
        nearest, least = None, np.inf
        for made, at in candidates:
            away = (at - x).ravel()
            if (distance := away @ away) < least:
                nearest, least = made, distance
            if not distance:
                break
        return nearest

    def exact(self, pattern: Pattern, x: Float[Array, "n 2"], pressure: Float[Array, " g"]) -> Kept | None:
        """The factor of the very tangent at the positions ``x`` and ``pressure``, none of one nearby; None where it is not kept."""
        for made, at in reversed(self.contents()):
            if np.array_equal(at, x) and made.is_of(pressure) and made.pattern in (pattern, pattern.narrower):
                return made
        return None


RECENT_FACTORS = FactorCache(REMEMBERED_BYTES)
"""The factors of this process; not kept by the patterns, which compiled programs keep alive."""


def remember(made: Kept, x: Float[Array, "n 2"]) -> None:
    """Keep the factor of a tangent at the nodal positions ``x``, or next to them, for `solve_near`."""
    RECENT_FACTORS.add(made, x)


def solve_near(
    pattern: Pattern,
    x: Float[Array, "n 2"],
    rhs: Float[np.ndarray, " f"],
    product: Callable[[np.ndarray], np.ndarray],
    pairs: Callable[[], Float[Array, "p 2 2"]],
) -> Float[np.ndarray, " f"]:
    """Solution for a tangent at the nodal positions ``x``, with the kept factor that is nearest if that will do.

    The factors of a differentiated sweep so serve its derivatives; the solution does not depend on which one was used. The tangent is
    given by its ``product`` with vectors (f,) and, where it must be factorised, by the pair blocks (p, 2, 2) that ``pairs()`` makes.
    NaN where it is singular: for use inside compiled programs, which cannot raise.
    """
    nearest = RECENT_FACTORS.nearest(pattern, x)
    solution = None if nearest is None else nearest.solve_other(rhs, product)
    if solution is None:
        try:
            made = factor(pattern, pairs())
            checked = made.solve(rhs)[0]  # a factor of round-off serves as preconditioner, but leaves a residual: see `Factor.solve`
            remember(made, x)
            solution = made.solve_other(rhs, product)
            solution = checked if solution is None else solution
        except SingularTangent:
            return np.full(np.shape(rhs), np.nan)
    return solution
