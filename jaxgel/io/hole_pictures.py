"""Holes from a picture of the plate: half-grey contours as Fourier outlines or polygons.

They are in the plate's frame. The picture covers the plate, its first row is the upper edge. Its
grey values are those at the centres of the pixels and vary linearly between them, so smooth edges
give outlines that are finer than a pixel. Lengths in mm.
"""

from pathlib import Path as File
from typing import Any

import numpy as np
import shapely

from .._types import Int
from .._validation import POSITIVE, TEXT, tabled, word
from .masks import WHITE, check_cover, grey_pixels
from .outline_fits import FITS, hole_entries

SHADES = ("dark", "light")
IMAGE: dict[str, Any] = tabled(
    {
        "kind": {"const": "image"},
        "file": TEXT
        | {
            "description": (
                "A PNG file, black and white or 8-bit grey, that covers the plate; all its holes "
                "are taken."
            )
        },
        "shade": word(SHADES) | {"description": "What is a hole.", "default": SHADES[0]},
        "fit": word(FITS) | {"default": "fourier"},
        "tolerance": POSITIVE
        | {"description": "Distance of the fit from the outline at half grey, mm."},
    },
    ["file"],
)  # rule of an entry of kind "image"
# of a pixel: default distance of the fit; the outline of a black and white picture is off by up to
# half a pixel
TOLERANCE = 0.75
COARSEST = 0.1  # of the plate's shorter side: largest tolerance
SPECK = 8.0  # pixels: area of the smallest hole


def hole_tables(
    entry: dict[str, Any], folder: str | File | None, size: tuple[float, float], where: str
) -> list[dict[str, Any]]:
    """Case-file tables of all holes of a ``kind = "image"`` entry, from the top left on.

    ``file`` is relative to ``folder``; ``size`` is that of the plate (width and height, mm);
    ``fit`` is "fourier" or "polygon", within ``tolerance`` mm of the outline at half grey (3/4 of a
    pixel by default). Polygons that the edge cuts go on straight across it. ValueError, one line
    that names ``where`` and the file: for another than a grey picture, no hole, a hole of fewer
    than ``SPECK`` pixels, gel inside a hole, an outline that cannot be fitted, and a Fourier
    outline across the edge.
    """
    name, pixels = repr(entry["file"]), grey_pixels(entry["file"], folder, where)
    check_cover(pixels.shape, size, where)
    shade, fit, pixel = (
        entry.get("shade", SHADES[0]),
        entry.get("fit", "fourier"),
        max(size) / max(pixels.shape),
    )
    tolerance = entry.get("tolerance", TOLERANCE * pixel)
    if tolerance > COARSEST * min(size):
        raise ValueError(
            f"{where}.tolerance: {tolerance:g} mm is more than a tenth of the plate's shorter "
            f"side, {min(size):g} mm"
        )
    depth = pixels if shade == "light" else WHITE - pixels
    if depth.max() < WHITE / 2 or depth.min() > WHITE / 2:
        raise ValueError(
            f"{where}.file: {name} has no hole: grey values from {pixels.min()} to {pixels.max()} "
            "do not cross half grey"
        )
    box, to_plate = (
        shapely.box(0, 0, *pixels.shape[::-1]),
        (np.array(size) / pixels.shape[::-1] * [1, -1], np.array(size) / 2 * [-1, 1]),
    )
    tables = []
    for outline in _outlines(depth, tolerance / pixel):
        shape = shapely.transform(outline, lambda points: points * to_plate[0] + to_plate[1])
        x, y = shapely.get_coordinates(shape.centroid)[0]
        at, area = f"at ({x:.4g}, {y:.4g}) mm", shapely.intersection(outline, box).area
        if area < SPECK:
            raise ValueError(
                f"{where}.file: {name} has a {shade} speck of {area:.2g} pixels {at}, a hole must "
                f"have at least {SPECK:g}"
            )
        if shape.interiors:
            raise ValueError(
                f"{where}.file: {name} has gel inside the hole {at}; a hole must have one outline"
            )
        if fit == "fourier" and not box.contains(outline):
            raise ValueError(
                f"{where}.fit: the edge of {name} cuts the hole {at}; take fit = 'polygon'"
            )
        try:
            hole = FITS[fit](shapely.get_coordinates(shape)[:-1], tolerance)
        except ValueError as problem:
            raise ValueError(f"{where}.fit: {name}, hole {at}: {problem}") from None
        tables.append((-round(y / pixel), x, hole_entries(fit, hole)))
    return [table for *_, table in sorted(tables, key=lambda entry: entry[:2])]


def _outlines(depth: Int[np.ndarray, "r c"], tolerance: float) -> list[shapely.Polygon]:
    """Contour of a hole's ``depth`` at half grey, in pixels from the upper left, y down.

    ``tolerance`` is in pixels. What the edge cuts goes on straight across it, farther than a fit
    moves it.
    """
    from contourpy import FillType, contour_generator

    margin = int(np.ceil(2 * tolerance)) + 2
    padded = np.pad(np.pad(depth.astype(float), margin, mode="edge"), 1)
    found = contour_generator(z=padded, fill_type=FillType.OuterOffset).filled(WHITE / 2, 2 * WHITE)
    shift = 0.5 - margin - 1
    rings = [
        np.split(points + shift, offsets[1:-1]) for points, offsets in zip(*found, strict=True)
    ]
    return [shapely.Polygon(outer, inner) for outer, *inner in rings]
