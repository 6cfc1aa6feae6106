"""Error bars of a path's numbers, from the same problem on clouds of several spacings."""

import contextlib
import dataclasses
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from .._types import Float, Int
from .._validation import Inadmissible, check_kind, one_of
from ..continuation import Path
from ..equilibrium import Change
from ..geometry import Plate
from ..observables import QUANTITIES
from .convergence import ErrorBars, error_bars

T = TypeVar("T")
ACCURACY = (
    "rotation",
    "core_rotation",
    "area_reduction",
    "J_mean",
    "energy",
    "min_gap",
    "surface_ratio",
    "surface_stability",
)
"""Quantities with error bars by default."""
# squares along a side over those of the given cloud, about: 4.2 times its nodes in all
FACTORS = (2**-0.5, 2**-0.25, 2**0.5)
FINER = 2**0.25  # in place of a cloud that leaves a ligament empty


@dataclasses.dataclass(frozen=True)
class Accuracy:
    """Error bars of the quantities of a path; `accuracy` returns it."""

    path: Path
    """The path on the cloud of the given spacing, to whose values the bars belong."""
    spacings: Float[np.ndarray, " c"]
    """Spacings of the clouds, mm, coarsest first."""
    nodes: Int[np.ndarray, " c"]
    """Numbers of nodes of the clouds."""
    bars: dict[str, ErrorBars]
    """Name of a quantity -> its `ErrorBars` at the states of the path, in its unit."""
    ended: tuple[str, ...]
    """Why each cloud's path ended.

    Bars beyond the end of one are taken from the others, or are nan.
    """

    def __repr__(self) -> str:
        """Sizes."""
        return (
            f"Accuracy of {len(self.bars)} quantities at {len(self.path)} states from clouds of "
            f"{', '.join(map(str, self.nodes))} nodes"
        )


def accuracy(
    path_at: Callable[[float], Path], spacing: float, *, quantities: Sequence[str] = ACCURACY
) -> Accuracy:
    """`Accuracy` of the path of a plate: error bars from clouds of several spacings.

    Arguments:

    - `path_at`: function of a spacing, mm, that returns the `Path` on a cloud of it, with states at
      the same values of the control each time.
    - `spacing`: that of the path whose error bars are computed, mm.
    - `quantities`: names in `observables.QUANTITIES`.

    `path_at` is called for `spacing` and for others, coarser and finer by up to about sqrt(2). For
    a spacing that it refuses, because a ligament is left without a node, a finer one is taken.
    States that have lost their symmetry are compared up to their mirror image.

    Raises `ValueError` for an unknown quantity and for paths at different values.

    Example: docs/howto/trust.md.
    """
    for name in quantities:
        one_of("quantities", name, QUANTITIES)
    own = path_at(spacing)
    check_kind("path_at", own, Path, "a function that returns a Path for a spacing")
    paths = on_clouds(
        lambda h: own if h == spacing else path_at(h), own.model.cloud.topology.plate, spacing
    )
    for h, path in paths.items():
        if not np.array_equal(path.value, own.value[: len(path)]):
            raise ValueError(
                f"path_at: the {path.control.name} at spacing {h:g} are not those at {spacing:g}; "
                "sweep given values, as own.value"
            )
    nodes = np.array([path.model.n_nodes for path in paths.values()])
    at = list(paths).index(float(spacing))
    bars = {
        name: error_bars(nodes**-0.5, _values(name, list(paths.values()), own), at)
        for name in quantities
    }
    return Accuracy(
        own, np.array(list(paths)), nodes, bars, tuple(path.stop_text for path in paths.values())
    )


def on_clouds(found_at: Callable[[float], T], plate: Plate, spacing: float) -> dict[float, T]:
    """Spacing, mm -> ``found_at(spacing)`` on the clouds of error bars, coarsest first.

    The given spacing is included. In place of a cloud that cannot be made, since it leaves a
    ligament empty, a finer one is taken.
    """
    found = {float(spacing): found_at(spacing)}
    for h in spacings_near(plate, spacing):
        with contextlib.suppress(Inadmissible):
            found[h] = found_at(h)
    found |= {
        h: found_at(h)
        for h in spacings_near(plate, spacing, [FINER])
        if len(found) <= len(FACTORS) and h not in found
    }
    return dict(sorted(found.items(), reverse=True))


def spacings_near(plate: Plate, spacing: float, factors: Sequence[float] = FACTORS) -> list[float]:
    """Spacings of other clouds, mm: even numbers of squares on the shorter side, by ``factors``.

    The plate's shorter side has that many of their squares, or so.
    """
    shorter = min(plate.width, plate.height)
    counts = dict.fromkeys(max(2, 2 * round(factor * shorter / spacing / 2)) for factor in factors)
    return [shorter / count for count in counts if abs(shorter / count / spacing - 1) > 1e-6]


def _values(name, paths, own):
    """Values (c, k) of a quantity on every path, in display units, nan after its end."""
    quantity, table = QUANTITIES[name], np.full((len(paths), len(own)), np.nan)
    for row, path in zip(table, paths, strict=True):
        found = np.asarray(quantity.of(path), dtype=float) * quantity.scale
        row[: len(path)] = found * _sides(path, own) if quantity.mirrored else found
    return np.where(np.isfinite(table), table, np.nan)


def _sides(path, own):
    """Signs (k,): -1 if a path has buckled to the other side than its ``own`` one."""
    signs = np.ones(len(path))
    buckled = np.flatnonzero(path.switched == Change.BIFURCATION)
    if len(buckled):
        after = slice(int(buckled[0]), len(path))
        turned = [
            np.asarray(QUANTITIES["core_rotation"].of(one), dtype=float)[after]
            for one in (path, own)
        ]
        signs[after] = np.where(np.nansum(turned[0] * turned[1]) < 0, -1.0, 1.0)
    return signs
