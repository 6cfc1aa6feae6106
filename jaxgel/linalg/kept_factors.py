"""Recent factors, kept for the linear systems of derivatives."""

import collections
import threading

import numpy as np

from .factors import SingularTangent, factor

REMEMBERED_BYTES = 2**29  # most that the factors kept for `solve_near` may fill, those of all patterns together


def remember(made, x):
    """Keep the ``Factor`` of a tangent at the nodal positions ``x`` (n, 2), or next to them, for `solve_near`.

    The oldest ones are forgotten where they fill too much memory together.
    """
    with _remembering:
        _remembered.append((made, np.asarray(x)))
        while len(_remembered) > 1 and sum(kept.size for kept, _ in _remembered) > REMEMBERED_BYTES:
            _remembered.popleft()


_remembering = threading.Lock()
_remembered = collections.deque()  # the latest factors, newest last; not kept by the patterns, which compiled programs keep alive


def solve_near(pattern, x, rhs, product, pairs):
    """Solution (f,) for a tangent at the nodal positions ``x`` (n, 2), with the remembered factor that is nearest if that will do.

    The factors of a differentiated sweep so serve its derivatives; the solution does not depend on which one was used. The tangent is
    given by its ``product`` with vectors (f,) and, where it must be factorised, by the pair blocks (n_pairs, 2, 2) that ``pairs()`` makes.
    NaN where it is singular: for use inside compiled programs, which cannot raise.
    """
    nearest = _nearest(pattern, x)
    solution = None if nearest is None else nearest.solve_other(rhs, product)
    if solution is None:
        try:
            made = factor(pattern, pairs())
            remember(made, x)
            solution = made.solve_other(rhs, product)
            solution = made.solve(rhs)[0] if solution is None else solution
        except SingularTangent:
            return np.full(np.shape(rhs), np.nan)
    return solution


def _nearest(pattern, x):
    """The remembered factor, the latest one, of the positions nearest ``x``; None without."""
    with _remembering:
        known = [(made, at) for made, at in reversed(_remembered) if made.pattern in (pattern, pattern.narrower)]
    nearest, least = None, np.inf
    for made, at in known:
        away = (at - x).ravel()
        if (distance := away @ away) < least:
            nearest, least = made, distance
        if not distance:
            break
    return nearest
