"""Outlines and holes from files: a list of points, a DXF or an SVG drawing.

Lengths in mm: DXF and SVG files and the names of columns may say their unit; if they do not, a
length of 1 is 1 mm. The y axis of SVG points down and is turned over. DXF and SVG drawings are read
by the libraries of the extra ``[outline]``.
"""

import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path as File
from typing import Any

import numpy as np
import shapely

from .._types import Float
from .._validation import NUMBER, PAIR, POSITIVE, TEXT, tabled, whole, word
from .drawing import Drawing, Omission, distinct, without_repeats
from .dxf import read_dxf
from .outline_fits import FITS, hole_entries
from .point_lists import read_points
from .svg import read_svg

OUTLINE: dict[str, Any] = tabled(
    {
        "kind": {"const": "outline"},
        "file": TEXT | {"$comment": "give the path of a CSV, DXF or SVG file"},
        "number": whole(0) | {"description": "Which of several closed outlines, counted from 0."},
        "fit": word(("fourier", "polygon")),
        "tolerance": POSITIVE | {"description": "Distance of the fit from the outline, mm."},
        "scale": NUMBER | {"description": "Multiplies lengths."},
        "centre": PAIR | {"description": "Where the centroid goes, mm."},
    },
    ["file"],
)  # rule of an entry of kind "outline"
# of the radius of a circle of the same area: default distance of the fit from the outline
TOLERANCE = 1e-2


class DrawingIncomplete(UserWarning):
    """A drawing holds more than its closed outlines.

    The text counts what was left out by kind, layer and reason.
    """


def hole_table(entry: dict[str, Any], folder: str | File, where: str) -> dict[str, Any]:
    """Case-file table of the Fourier hole or polygon of a ``kind = "outline"`` entry.

    ValueError that names ``where``. ``file`` is relative to ``folder``; ``number`` says which of
    several closed outlines; ``scale`` multiplies lengths and ``centre`` (2,) moves the centroid;
    ``fit`` is "fourier" or "polygon", within ``tolerance`` mm (1 % of the mean radius by default).
    """
    found = read_outlines(File(folder) / entry["file"])
    number = entry.get("number", 0 if len(found) == 1 else None)
    if number not in range(len(found)):
        raise ValueError(
            f"{where}.number: {number!r} is not one of the {len(found)} closed outlines of "
            f"{entry['file']!r}, counted from 0"
        )
    points = entry.get("scale", 1.0) * found[number]
    shape = shapely.Polygon(points)
    if not (shape.is_valid and shape.area > 0):
        raise ValueError(
            f"{where}.file: outline {number} of {entry['file']!r} crosses itself or has no area"
        )
    if "centre" in entry:
        points = points - shapely.get_coordinates(shape.centroid)[0] + np.array(entry["centre"])
    tolerance = entry.get("tolerance", TOLERANCE * np.sqrt(shape.area / np.pi))
    fit = entry.get("fit", "fourier")
    try:
        hole = FITS[fit](points, tolerance)
    except ValueError as problem:
        raise ValueError(f"{where}.fit: {problem}") from None
    return hole_entries(fit, hole)


def read_outlines(file: str | File) -> list[Float[np.ndarray, "_ 2"]]:
    """The closed outlines of a CSV, DXF or SVG file, each (m, 2) in mm without a repeated point.

    An outline drawn twice counts once. What is left out is counted in a `DrawingIncomplete`
    warning. ValueError, one line, for a file without a closed outline.
    """
    file = File(file)
    if file.suffix.lower() not in READERS:
        raise ValueError(f"file: {str(file)!r} is not a .csv, .dxf or .svg file")
    try:
        drawing = READERS[file.suffix.lower()](file)
    except OSError as problem:
        raise ValueError(
            f"file: cannot read {str(file)!r}: {problem.strerror or problem}"
        ) from None
    except ImportError as problem:
        raise ValueError(
            f"file: {str(file)!r} needs {problem.name}; pip install 'jaxgel[outline]'"
        ) from None
    except ValueError as problem:
        raise ValueError(
            f"file: {str(file)!r} is no drawing that can be read: {' '.join(str(problem).split())}"
        ) from None
    outlines = [without_repeats(np.asarray(line, dtype=float)) for line in drawing.outlines]
    omissions = drawing.omissions + Counter(
        Omission("outline", "", "no area") for line in outlines if not len(line)
    )
    outlines = distinct([line for line in outlines if len(line)])
    if not outlines:
        raise ValueError(
            f"file: {str(file)!r} has no closed outline"
            + (f"; left out: {_in_words(omissions)}" if omissions else "")
        )
    if omissions:
        warnings.warn(
            f"file: {str(file)!r} is read without {_in_words(omissions)}",
            DrawingIncomplete,
            stacklevel=2,
        )
    return outlines


def _in_words(omissions):
    """Omissions with their numbers, most frequent first."""
    return ", ".join(
        f"{number} {kind}{f' on layer {layer!r}' if layer else ''} ({reason})"
        for (kind, layer, reason), number in omissions.most_common()
    )


READERS: Mapping[str, Callable[[File], Drawing]] = {
    ".csv": read_points,
    ".txt": read_points,
    ".dxf": read_dxf,
    ".svg": read_svg,
}
"""Reader of a drawing by the suffix of its file."""
