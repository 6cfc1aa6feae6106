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
ACCURACY = ("rotation", "core_rotation", "area_reduction", "J_mean", "energy", "min_gap", "surface_ratio", "surface_stability")
"""Quantities that get error bars unless others are asked for."""
FACTORS = (2**-0.5, 2**-0.25, 2**0.5)  # squares along a side over those of the given cloud, about: 4.2 times its nodes in all
FINER = 2**0.25  # in place of a cloud that leaves a ligament empty


@dataclasses.dataclass(frozen=True)
class Accuracy:
    """Error bars of the quantities of a path."""

    path: Path
    """The path on the cloud of the given spacing, whose values the bars belong to."""
    spacings: Float[np.ndarray, " c"]
    """Spacings of the clouds, mm, coarsest first."""
    nodes: Int[np.ndarray, " c"]
    """Numbers of their nodes."""
    bars: dict[str, ErrorBars]
    """Name of a quantity -> its `ErrorBars` at the states of the path."""
    ended: tuple[str, ...]
    """Why each cloud's path ended; bars beyond the end of one are taken from the others, or are nan."""

    def __repr__(self) -> str:
        """Sizes."""
        return f"Accuracy of {len(self.bars)} quantities at {len(self.path)} states from clouds of {', '.join(map(str, self.nodes))} nodes"


def accuracy(path_at: Callable[[float], Path], spacing: float, *, quantities: Sequence[str] = ACCURACY) -> Accuracy:
    """`Accuracy` of the path that ``path_at(spacing)`` returns for a plate on a cloud of that spacing, mm.

    ``path_at`` is called for the ``spacing`` and for others, coarser and finer by up to about sqrt(2), and must return states at the same
    values of the control each time. In place of one that ``path_at`` refuses, because it leaves a ligament empty, a finer one
    is taken. States that have lost their symmetry are compared up to their mirror image. ValueError for an unknown quantity and for paths
    at different values.
    """
    for name in quantities:
        one_of("quantities", name, QUANTITIES)
    own = path_at(spacing)
    check_kind("path_at", own, Path, "a function that returns a Path for a spacing")
    paths = on_clouds(lambda h: own if h == spacing else path_at(h), own.model.cloud.topology.plate, spacing)
    for h, path in paths.items():
        if not np.array_equal(path.value, own.value[: len(path)]):
            raise ValueError(
                f"path_at: the {path.control.name} at spacing {h:g} are not those at {spacing:g}; sweep given values, as own.value"
            )
    nodes = np.array([path.model.n_nodes for path in paths.values()])
    at = list(paths).index(float(spacing))
    bars = {name: error_bars(nodes**-0.5, _values(name, list(paths.values()), own), at) for name in quantities}
    return Accuracy(own, np.array(list(paths)), nodes, bars, tuple(path.stop_text for path in paths.values()))


def on_clouds(found_at: Callable[[float], T], plate: Plate, spacing: float) -> dict[float, T]:
    """Spacing, mm -> ``found_at(spacing)`` on the clouds of a plate that error bars need, coarsest first, with that of the given spacing.

    In place of a cloud that cannot be made, since it leaves a ligament empty, a finer one is taken.
    """
    found = {float(spacing): found_at(spacing)}
    for h in spacings_near(plate, spacing):
        with contextlib.suppress(Inadmissible):
            found[h] = found_at(h)
    found |= {h: found_at(h) for h in spacings_near(plate, spacing, [FINER]) if len(found) <= len(FACTORS) and h not in found}
    return dict(sorted(found.items(), reverse=True))


def spacings_near(plate: Plate, spacing: float, factors: Sequence[float] = FACTORS) -> list[float]:
    """Spacings of other clouds, mm: the shorter side of the plate has an even number of their squares, ``factors`` times as many or so."""
    shorter = min(plate.width, plate.height)
    counts = dict.fromkeys(max(2, 2 * round(factor * shorter / spacing / 2)) for factor in factors)
    return [shorter / count for count in counts if abs(shorter / count / spacing - 1) > 1e-6]


def _values(name, paths, own):
    """Values (c, k) of a quantity on every path, nan after its end, in the unit that people read."""
    quantity, table = QUANTITIES[name], np.full((len(paths), len(own)), np.nan)
    for row, path in zip(table, paths, strict=True):
        found = np.asarray(quantity.of(path), dtype=float) * quantity.scale
        row[: len(path)] = found * _sides(path, own) if quantity.mirrored else found
    return np.where(np.isfinite(table), table, np.nan)


def _sides(path, own):
    """Signs (k,): -1 where a path has buckled to the other side than its ``own`` one."""
    signs = np.ones(len(path))
    buckled = np.flatnonzero(path.switched == Change.BIFURCATION)
    if len(buckled):
        after = slice(int(buckled[0]), len(path))
        turned = [np.asarray(QUANTITIES["core_rotation"].of(one), dtype=float)[after] for one in (path, own)]
        signs[after] = np.where(np.nansum(turned[0] * turned[1]) < 0, -1.0, 1.0)
    return signs
