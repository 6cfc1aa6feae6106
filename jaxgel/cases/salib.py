"""Exchange of points between SALib and parameter maps: sample matrices and problem.json.

SALib (https://salib.readthedocs.io) describes the parameters by a dict ``problem`` with num_vars,
names and bounds, samples them as a matrix (p, d), and analyses values (p,) in the same order.
``numpy.savetxt("samples.csv", matrix, delimiter=",", header=",".join(problem["names"]))`` writes
the matrix as it is read here.
"""

import csv
from collections import Counter
from collections.abc import Sequence
from pathlib import Path as File

import numpy as np

from .._types import Float
from .._validation import MOST, did_you_mean

PROBLEM = "problem.json"
ROUND_OFF = 1e-12  # of a value at one of its bounds, relative


def salib_problem(names: Sequence[str], bounds: Float[np.ndarray, "d 2"]) -> dict:
    """SALib's ``problem`` of parameters with these names and bounds (d, 2); JSON can hold it."""
    return {"num_vars": len(names), "names": list(names), "bounds": np.asarray(bounds).tolist()}


def read_samples(
    file: File | str, names: Sequence[str], bounds: Float[np.ndarray, "d 2"]
) -> Float[np.ndarray, "p d"]:
    """The samples (p, d) of a CSV file, its columns in the order of ``names``.

    The first line names them, maybe after a #. ValueError, one line, for a file that cannot be
    read, columns that are missing or unknown, and a value that is not a number within its bounds
    (d, 2).
    """
    try:
        with File(file).open(newline="", encoding="utf-8-sig") as stream:
            header, *lines = [
                [cell.strip() for cell in line]
                for line in csv.reader(stream)
                if any(map(str.strip, line))
            ] or [[]]
    except (OSError, ValueError, csv.Error) as problem:
        raise ValueError(
            f"map.points: cannot read {str(file)!r}: "
            f"{getattr(problem, 'strerror', None) or problem}"
        ) from None
    columns = [*(cell.removeprefix("#").strip() for cell in header[:1]), *header[1:]]
    for name in columns:
        if name not in names:
            raise ValueError(
                f"map.points: the column {name!r} of {str(file)!r} is unknown; "
                f"{did_you_mean(name, names)}"
            )
    for name in names:
        if Counter(columns)[name] != 1:
            count = "missing" if name not in columns else "there twice"
            raise ValueError(
                f"map.points: the column {name!r} is {count} in {str(file)!r}; give one for each "
                f"of {', '.join(names)}"
            )
    if not 1 <= len(lines) <= MOST:
        raise ValueError(
            f"map.points: {str(file)!r} has {len(lines)} rows below the names of its columns; "
            f"give 1 to {MOST}"
        )
    order = [columns.index(name) for name in names]
    samples = np.empty((len(lines), len(names)))
    for k, line in enumerate(lines):
        if len(line) != len(columns):
            raise ValueError(
                f"map.points: row {k} of {str(file)!r} has {len(line)} values; give "
                f"{len(columns)}, as the first line"
            )
        samples[k] = [
            _number(f"map.points: row {k}, {columns[column]}", line[column]) for column in order
        ]
        check_bounds(f"map.points: row {k}, ", names, samples[k], bounds)
    return samples


def check_bounds(
    where: str,
    names: Sequence[str],
    vector: Float[np.ndarray, " d"],
    bounds: Float[np.ndarray, "d 2"],
) -> None:
    """Raise ValueError, one line from ``where`` on, unless components (d,) obey bounds (d, 2)."""
    if np.shape(vector) != (len(names),):
        raise ValueError(
            f"{where}parameters: {np.size(vector)} numbers are not accepted; give {len(names)}: "
            f"{', '.join(names)}"
        )
    for name, value, (lower, upper) in zip(names, vector, bounds, strict=True):
        if not lower - ROUND_OFF * abs(lower) <= value <= upper + ROUND_OFF * abs(upper):
            raise ValueError(
                f"{where}{name}: {value:.6g} is not a number between lower = {lower:g} and upper "
                f"= {upper:g}"
            )


def _number(where, cell):
    try:
        return float(cell)
    except ValueError:
        raise ValueError(f"{where}: {cell!r} is not a finite number") from None
