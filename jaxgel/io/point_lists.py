"""Closed outlines of a list of points: a text file with one point a row, mm by default.

Unless the names of its columns have another unit. A first row of names says which columns are x and
y; without names there are two columns. Columns are separated by commas, semicolons, tabs or spaces.
Blank rows, rows of nan, and a column such as ``shape`` or ``id`` whose values repeat separate
several outlines. Rows that begin with #, % or // are comments; the last one before the points may
name the columns.
"""

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path as File
from typing import NamedTuple

import numpy as np

from .._validation import is_number
from .drawing import Drawing, Omission

# mm
UNITS = {
    "nm": 1e-6,
    "um": 1e-3,
    "µm": 1e-3,
    "μm": 1e-3,
    "mm": 1.0,
    "cm": 10.0,
    "m": 1e3,
    "in": 25.4,
    "inch": 25.4,
}
FILLERS = ("coord", "coordinate", "coordinates", "pos", "position")  # words in the name of a column
# columns that name an outline
LABELS = (
    "shape", "id", "outline", "hole", "part", "group", "contour", "polygon", "ring", "loop", "name",
)  # fmt: skip
COMMENT = re.compile(r"\s*(#|%|//)")
DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
ACCEPTED = "two columns x and y, or more with a first row that names x and y"


class Row(NamedTuple):
    """A row of a file: its number, counted from 1, and its cells; none for a blank row."""

    number: int
    cells: list[str]


class Axis(NamedTuple):
    """The column of x or of y, and the mm of its unit."""

    column: int
    scale: float


def read_points(file: File) -> Drawing:
    """The outlines of a list of points.

    ValueError, with the number of the row, for a file that is not one.
    """
    rows, comment = _rows(_text(file.read_bytes()))
    first = next((row for row in rows if row.cells), None)
    if first is None:
        raise ValueError("it has no points")
    names: list[str] = []
    if not all(map(is_number, first.cells)) and _axes(first.cells):
        names = first.cells
        rows = [row for row in rows if row.cells != names]
    elif not any(map(is_number, first.cells)) and not any(
        map(DECIMAL_COMMA.fullmatch, first.cells)
    ):
        raise ValueError(
            f"row {first.number}: no columns x and y among {', '.join(map(repr, first.cells))}; "
            f"give {ACCEPTED}"
        )
    elif _axes(comment):
        names = comment
    if not any(row.cells for row in rows):
        raise ValueError("it has no points")
    width = len(names) or 2
    axes = _axes(names) or (Axis(0, 1.0), Axis(1, 1.0))
    for row in rows:
        _check(row, width, axes, bool(names))
    omissions = Counter(
        Omission("column", name, "not x or y") for name in _other_columns(names, rows, axes)
    )
    outlines = []
    for block in _blocks(rows, [k for k, name in enumerate(names) if name.lower() in LABELS]):
        if len(block) < 3:
            omissions[Omission("points", "", "fewer than 3")] += len(block)
        else:
            outlines.append(
                np.array(
                    [[axis.scale * float(row.cells[axis.column]) for axis in axes] for row in block]
                )
            )
    return Drawing(outlines, omissions)


def _text(content: bytes) -> str:
    """The text of a file in UTF-8, with or without a byte order mark, or in UTF-16 with one."""
    coding = (
        "utf-16" if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    )
    try:
        return content.decode(coding)
    except UnicodeDecodeError as problem:
        raise ValueError(
            f"byte {problem.start} is not {coding.removesuffix('-sig').upper()}; save the file as "
            "UTF-8"
        ) from None


def _rows(text) -> tuple[list[Row], list[str]]:
    """The rows of a text, and the cells of the last comment before them."""
    lines = text.splitlines()
    content = [
        line
        for line in lines
        if line.strip() and not COMMENT.match(line) and not line.lower().startswith("sep=")
    ]
    separator = next((mark for mark in "\t;" if content and mark in content[0]), None)
    if (
        separator is None
        and content
        and "," in content[0]
        and not re.fullmatch(r"\s*[-+]?\d+,\d+\s+[-+]?\d+,\d+\s*", content[0])
    ):
        separator = ","
    rows, comment = [], []
    for number, line in enumerate(lines, start=1):
        if COMMENT.match(line):
            comment = (
                comment
                if any(row.cells for row in rows)
                else _cells(COMMENT.sub("", line), separator)
            )
        elif not line.lower().startswith("sep="):
            cells = _cells(line, separator)
            rows.append(
                Row(number, [] if all(cell.lower() in ("", "nan") for cell in cells) else cells)
            )
    return rows, comment


def _cells(line, separator) -> list[str]:
    """The cells of a line, without empty ones at its end."""
    if separator is None:
        # a unit in brackets belongs to the name before it
        return re.sub(r"\s+(?=[(\[])", "", line).split()
    cells = [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _axes(names) -> tuple[Axis, Axis] | None:
    """The columns of x and y among names such as "x", "Y (mm)" or "x_cm".

    None if they are not there once each.
    """
    axes: dict[str, list[Axis]] = {"x": [], "y": []}
    for column, name in enumerate(names):
        letter, *unit = [
            word for word in re.split(r"[^a-zµμ]+", name.lower()) if word and word not in FILLERS
        ] or [""]
        if letter in axes and (not unit or (unit[-1] in UNITS and unit[:-1] in ([], ["in"]))):
            axes[letter].append(Axis(column, UNITS[unit[-1]] if unit else 1.0))
    return (axes["x"][0], axes["y"][0]) if len(axes["x"]) == len(axes["y"]) == 1 else None


def _check(row: Row, width: int, axes: Sequence[Axis], named: bool) -> None:
    """Raise ValueError for a row that is not a point."""
    if not row.cells:
        return
    if any(map(DECIMAL_COMMA.fullmatch, row.cells)):
        raise ValueError(
            f"row {row.number}: {' '.join(row.cells)!r} has decimal commas; write decimal points"
        )
    if len(row.cells) > width or len(row.cells) <= max(axis.column for axis in axes):
        wanted = f"the first row names {width}" if named else f"give {ACCEPTED}"
        raise ValueError(f"row {row.number}: number of columns {len(row.cells)}; {wanted}")
    for axis in axes:
        cell = row.cells[axis.column]
        if not (is_number(cell) and np.isfinite(float(cell))):
            raise ValueError(f"row {row.number}: {cell!r} is not a finite number")


def _other_columns(names, rows, axes) -> list[str]:
    """Names of columns that are neither x nor y, nor an index, nor the name of an outline."""
    points = [row.cells for row in rows if row.cells]
    others = []
    for column, name in enumerate(names):
        values = [cells[column] for cells in points if column < len(cells)]
        index = len(set(values)) == len(points) and all(value.isdigit() for value in values)
        if (
            column not in [axis.column for axis in axes]
            and not index
            and name.lower() not in LABELS
        ):
            others.append(name)
    return others


def _blocks(rows, labels) -> list[list[Row]]:
    """Rows of each outline: between blank rows, and of equal ``labels`` if these repeat.

    The labels are columns.
    """
    names = [[row.cells[k] for k in labels if k < len(row.cells)] for row in rows]
    points = sum(bool(row.cells) for row in rows)
    labelled = (
        len({tuple(name) for name, row in zip(names, rows, strict=True) if row.cells}) < points
    )
    blocks: list[list[Row]] = [[]]
    for k, row in enumerate(rows):
        if not row.cells or (labelled and blocks[-1] and names[k] != names[k - 1]):
            blocks.append([])
        if row.cells:
            blocks[-1].append(row)
    blocks = [block for block in blocks if block]
    # a blank row after every point, as some programs end lines
    if all(len(block) == 1 for block in blocks):
        blocks = [[block[0] for block in blocks]]
    return blocks
