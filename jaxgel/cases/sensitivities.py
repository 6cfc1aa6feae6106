"""Derivative-based global sensitivity measures (DGSM) of uniform, independent parameters.

Sobol' & Kucherenko (2009), Math. Comput. Simul. 79, 3009-3017: nu_i, the mean of the square of
df/dx_i, bounds the total Sobol' index of x_i on [a_i, b_i] by nu_i (b_i - a_i)^2 / (pi^2 D), with D
the variance of f. It follows from the Poincare inequality of the uniform distribution and is sharp
for cos(pi (x_i - a_i) / (b_i - a_i)).
"""

import csv
import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path as File

import numpy as np

from .._types import Float
from .._validation import did_you_mean
from ..observables import QUANTITIES
from .map_runs import TABLE
from .response import RESPONSES, derivative_columns
from .salib import PROBLEM


@dataclasses.dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivative-based measures of one quantity."""

    names: Sequence[str]
    """Names of the parameters (d)."""
    mean_squares: Float[np.ndarray, " d"]
    """nu_i: the mean of (df/dx_i)^2, in the unit of f^2 / x_i^2."""
    variance: float
    """D, the variance of the quantity."""
    total_bounds: Float[np.ndarray, " d"]
    """Upper bounds of the total Sobol' indices; one above 1 says nothing."""


def sensitivity(
    gradients: Sequence[Sequence[float]] | Float[np.ndarray, "p d"],
    values: Sequence[float] | Float[np.ndarray, " p"],
    bounds: Sequence[Sequence[float]] | Float[np.ndarray, "d 2"],
    names: Sequence[str] = (),
) -> Sensitivity:
    """`Sensitivity` of a function by ``values`` (p,) and ``gradients`` (p, d) at uniform samples.

    These lie between ``bounds``. ValueError for fewer than two samples, and for values that are not
    finite or do not vary.
    """
    gradients, values, bounds = (
        np.asarray(array, dtype=float) for array in (gradients, values, bounds)
    )
    if (
        values.ndim != 1
        or len(values) < 2
        or gradients.shape != (len(values), len(bounds))
        or bounds.shape[1:] != (2,)
    ):
        raise ValueError(
            f"gradients: arrays of the shapes {gradients.shape}, {values.shape} and "
            f"{bounds.shape} are not accepted; "
            "give gradients (p, d), values (p,) and bounds (d, 2), with p of at least 2"
        )
    variance = float(np.var(values))
    if not (np.all(np.isfinite(gradients)) and variance > 0 and np.isfinite(variance)):
        raise ValueError(
            "values: they, or the gradients, are not finite, or all values are equal; give finite "
            "values that vary"
        )
    mean_squares = np.mean(gradients**2, axis=0)
    widths = bounds[:, 1] - bounds[:, 0]
    names = names or [f"x{i}" for i in range(len(bounds))]
    return Sensitivity(
        names, mean_squares, variance, mean_squares * widths**2 / (np.pi**2 * variance)
    )


def map_sensitivity(folder: File | str, quantity: str) -> Sensitivity:
    """`Sensitivity` of a quantity of a map with ``gradients = true``, from its complete points.

    The map's samples should be uniform and independent, of "sobol" or of a file with such.
    ValueError for another folder or quantity.
    """
    if quantity not in RESPONSES:
        raise ValueError(f"quantity: {quantity!r} is unknown; {did_you_mean(quantity, RESPONSES)}")
    try:
        problem = json.loads((File(folder) / PROBLEM).read_bytes())
        with (File(folder) / TABLE).open(newline="", encoding="utf-8") as stream:
            rows = [row for row in csv.DictReader(stream) if row["status"] == "complete"]
    except (OSError, ValueError, KeyError) as fault:
        raise ValueError(
            f"folder: {str(folder)!r} is not accepted ({fault}); give one written by jaxgel map"
        ) from None
    names = problem["names"]
    columns = [QUANTITIES[quantity].column, *derivative_columns(names, [quantity]).values()]
    if rows and not set(columns) <= rows[0].keys():
        raise ValueError(
            f"folder: {str(folder)!r} has no derivatives of {quantity}; set gradients = true in "
            "[map]"
        )
    numbers = np.array(
        [
            [float(row[name]) for name in columns]
            for row in rows
            if all(row[name] for name in columns)
        ]
    )
    numbers = numbers.reshape(-1, len(columns))
    return sensitivity(numbers[:, 1:], numbers[:, 0], problem["bounds"], names)
