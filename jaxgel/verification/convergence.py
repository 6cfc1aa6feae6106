"""Error bars of numbers from clouds, or grids, of several spacings."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy

from .._types import Float

SAFETY = 1.25  # of three grids: Roache 1994; Celik et al. 2008, Eq. 7
ORDERS = (0.5, 8.0)  # between which an observed order says that errors fall with the spacing
FORMAL = 2.0  # order of the trend; what a cloud does not follow of it counts as scatter
# an error bar: so many times what is left to the extrapolated value, and the scatter about the
# trend
OF_TREND, OF_NOISE = 1.25, 3.0
FEWEST = 3  # clouds of an error bar: two for the trend and one for the scatter
ROUND_OFF = 1e-12  # of the values: differences below it have no order


@dataclasses.dataclass(frozen=True)
class GridConvergence:
    """Grid convergence index of a number on three grids, finest first.

    Celik et al. 2008, J. Fluids Eng. 130, 078001.
    """

    order: float
    """Observed order; nan if the values have none."""
    extrapolated: float
    """Value extrapolated from the two finest grids."""
    index: tuple[float, float]
    """Index of the two finest and the two coarsest grids, relative; nan without an order.

    It is a share of the finer value.
    """
    reason: str
    """Why there is no index; empty if there is one."""


def grid_convergence_index(
    sizes: Sequence[float] | Float[np.ndarray, "3"],
    values: Sequence[float] | Float[np.ndarray, "3"],
    *,
    formal: float | None = None,
) -> GridConvergence:
    """`GridConvergence` of a number on three grids, finest first.

    Arguments:

    - `sizes` (3,): representative sizes of the cells, rising, in any unit of length.
    - `values` (3,): the number on each grid.
    - `formal`: formal order of convergence, dimensionless; no comparison by default.

    Returns no index, and a reason, if the values oscillate, do not converge, or converge with an
    order that differs from `formal` by more than a factor of two.

    Raises `ValueError` for sizes that do not rise, and unless there are three of each.

    Source: Celik et al. (2008), J. Fluids Eng. 130, 078001.

    >>> sizes = 1 / 18000**0.5, 1 / 8000**0.5, 1 / 4500**0.5
    >>> found = grid_convergence_index(sizes, (6.063, 5.972, 5.863))
    >>> round(found.order, 2), round(100 * found.index[0], 2), round(100 * found.index[1], 2)
    (1.53, 2.17, 4.11)
    """
    h, f = np.asarray(sizes, dtype=float), np.asarray(values, dtype=float)
    if h.shape != (3,) or f.shape != (3,) or not (np.all(np.diff(h) > 0) and h[0] > 0):
        raise ValueError(
            f"sizes: {sizes!r} are not three sizes of cells that rise from the finest grid to the "
            "coarsest"
        )
    fine, coarse = f[1] - f[0], f[2] - f[1]
    order = _order(h, fine, coarse)
    reason = _why_not(f, fine, coarse, order, formal)
    if reason:
        return GridConvergence(order, float(f[0]), (np.nan, np.nan), reason)
    ratios = h[1] / h[0], h[2] / h[1]
    index = tuple(
        float(SAFETY * abs(step / value) / (ratio**order - 1))
        for step, value, ratio in ((fine, f[0], ratios[0]), (coarse, f[1], ratios[1]))
    )
    return GridConvergence(order, float(f[0] - fine / (ratios[0] ** order - 1)), index, "")


def _order(h, fine, coarse):
    """Order p of three values: coarse / fine = (h3^p - h2^p) / (h2^p - h1^p); else nan.

    nan if there is none in `ORDERS`.
    """
    if fine * coarse <= 0:
        return np.nan
    low, high = ORDERS
    ratio = coarse / fine

    def excess(p):
        return (h[2] ** p - h[1] ** p) / (h[1] ** p - h[0] ** p) - ratio

    return scipy.optimize.brentq(excess, low, high) if excess(low) <= 0 <= excess(high) else np.nan


def _why_not(f, fine, coarse, order, formal):
    """Why three values have no index; empty if they have one."""
    if max(abs(fine), abs(coarse)) <= ROUND_OFF * np.abs(f).max():
        return "the values differ by round-off alone"
    if fine * coarse <= 0:
        return "the values oscillate from grid to grid"
    if np.isnan(order):
        return f"the observed order is not between {ORDERS[0]:g} and {ORDERS[1]:g}"
    if formal is not None and not formal / 2 <= order <= 2 * formal:
        return f"the observed order {order:.2g} is far from the formal one, {formal:g}"
    return ""


@dataclasses.dataclass(frozen=True)
class ErrorBars:
    """A quantity at k states on c clouds, coarsest first, and its error bar on one of them.

    How far its values there can be trusted. Values follow the trend a + b h^2 in the distance h of
    the nodes, and scatter about it: another cloud as fine has other values.
    """

    values: Float[np.ndarray, "c k"]
    """Values on every cloud; nan if a path has ended or the quantity is not defined."""
    own: Float[np.ndarray, " k"]
    """Those on the cloud that the bars belong to."""
    extrapolated: Float[np.ndarray, " k"]
    """Values of the trend for ever finer clouds."""
    error: Float[np.ndarray, " k"]
    """Half of the bar: distance to the extrapolated value, and scatter; nan below three values."""
    order: Float[np.ndarray, " k"]
    """Observed order of coarsest, own and finest cloud; nan if scatter hides it."""


def error_bars(
    sizes: Float[np.ndarray, " c"], values: Float[np.ndarray, "c k"], own: int
) -> ErrorBars:
    """`ErrorBars` of cloud ``own`` by the values on all clouds of node distances ``sizes``.

    >>> import numpy as np
    >>> sizes = np.array([1.4, 1.2, 1.0, 0.7])
    >>> found = error_bars(sizes, (28.6 + 0.2 * sizes**2)[:, None], 2)
    >>> print(found.extrapolated.round(6), found.error.round(6), found.order.round(6))
    [28.6] [0.25] [2.]
    """
    sizes, values = np.asarray(sizes, dtype=float), np.asarray(values, dtype=float)
    trend = np.stack([np.ones(len(sizes)), (sizes / sizes[own]) ** FORMAL], axis=1)
    extrapolated, error, order = np.full((3, values.shape[1]), np.nan)
    known = np.isfinite(values)
    for rows in np.unique(known, axis=1).T:
        at = (known == rows[:, None]).all(axis=0)
        if rows.sum() < FEWEST or not rows[own]:
            continue
        found, limits = (
            values[rows][:, at],
            np.linalg.lstsq(trend[rows], values[rows][:, at], rcond=None)[0],
        )
        scatter = np.sqrt(((found - trend[rows] @ limits) ** 2).sum(axis=0) / (rows.sum() - 2))
        extrapolated[at] = limits[0]
        error[at] = OF_TREND * np.abs(values[own, at] - limits[0]) + OF_NOISE * scatter
        three = np.flatnonzero(rows)[[0, -1]]
        if three[0] < own < three[1]:
            h = sizes[[three[1], own, three[0]]]
            order[at] = [
                _order(h, b - a, c - b) for a, b, c in values[[three[1], own, three[0]]][:, at].T
            ]
    return ErrorBars(values, values[own], extrapolated, error, order)
