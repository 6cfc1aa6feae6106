"""Values of a control along a sweep."""

from collections.abc import Sequence

import numpy as np

from .._types import Array, Float, Scalar


def check_values(
    values: Sequence[float] | Float[Array, " k"] | Scalar,
    name: str = "mu",
    unit: str = "kT",
    *,
    rising: bool = False,
) -> Float[np.ndarray, " k"]:
    """Values (k,) of a control in the order in which a sweep takes them; they may rise and fall.

    ValueError, one line, for what are no finite numbers, and if a value is repeated, or does not
    exceed the one before it if they must be ``rising``.
    """
    try:
        numbers = np.atleast_1d(np.asarray(values, dtype=float))
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    what = f"({unit})" if unit else "(dimensionless)"
    if numbers.ndim != 1 or len(numbers) == 0 or not np.all(np.isfinite(numbers)):
        raise ValueError(
            f"{name}: {values} is not accepted, it must be a list of finite numbers {what}"
        )
    steps = np.diff(numbers)
    wrong = steps <= 0 if rising else steps == 0
    if np.any(wrong):
        k = int(np.argmax(wrong))
        rule = "increase" if rising else "differ from one to the next"
        raise ValueError(
            f"{name}: {numbers[k]:g} is followed by {numbers[k + 1]:g}, the values must {rule}"
        )
    return numbers


def turning_points(values: Sequence[float] | Float[Array, " k"]) -> list[float]:
    """The first of some values, those at which they turn, and the last.

    >>> turning_points([25.0, 30.0, 40.0, 25.0])
    [25.0, 40.0, 25.0]
    """
    numbers = np.asarray(values, dtype=float)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(numbers)))) + 1
    return numbers[np.unique([0, *turns, len(numbers) - 1])].tolist()
