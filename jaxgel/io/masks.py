"""Grey pictures that cover a plate, their first row at the upper edge: masks of printed gels."""

from pathlib import Path as File
from typing import Any

import numpy as np

from .._types import Float, Int
from .._validation import FLAG, NUMBER, TEXT, exactly_one, listed, tabled, whole

WHITE = 255  # of an 8-bit grey picture; black is 0
GREY = ("1", "L")  # modes of such pictures
MASK: dict[str, Any] = tabled(
    {
        "file": TEXT | {"description": "A PNG file, black and white or 8-bit grey, that covers the plate."},
        "pixels": listed(listed(whole(0, WHITE), 1), 1) | {"description": "Its grey values instead, row by row from the top."},
        "low": NUMBER | {"description": "Value where the picture is black."},
        "high": NUMBER | {"description": "Value where the picture is white."},
        "with_holes": FLAG | {"description": "Whether it moves with the material around holes that a study moves, or stays on the plate."},
    },
    ["low", "high"],
) | exactly_one(("file", "pixels"))  # rule of a parameter of the gel that is a picture


def mask_table(entry: dict[str, Any], folder: str | File | None, where: str) -> dict[str, Any]:
    """The table of a parameter with the pixels of its picture in place of the ``file``, which is relative to ``folder``.

    ValueError: see `grey_pixels`.
    """
    if "file" not in entry:
        return entry
    return {key: value for key, value in entry.items() if key != "file"} | {"pixels": grey_pixels(entry["file"], folder, where).tolist()}


def grey_pixels(file: str, folder: str | File | None, where: str) -> Int[np.ndarray, "r c"]:
    """Grey values of a black and white or 8-bit grey picture in ``folder``, row by row from the top, black 0 and white 255.

    ValueError that names ``where`` and the file for any other picture or file, and without a folder.
    """
    if folder is None:
        raise ValueError(f"{where}.file: {file!r} belongs in a case file; name that file by case = instead of repeating what is in it")
    from PIL import Image

    try:
        with Image.open(File(folder) / file) as picture:
            mode, pixels = picture.mode, np.asarray(picture.convert("L") if picture.mode in GREY else picture)
    except (OSError, SyntaxError, Image.DecompressionBombError) as problem:  # of a file that is none, a damaged and a huge picture
        reason = " ".join(str(problem).split())
        raise ValueError(f"{where}.file: {file!r} cannot be read as a picture: {reason}") from None
    if mode not in GREY:
        raise ValueError(f"{where}.file: {file!r} is a picture of mode {mode}, it must be black and white or 8-bit grey")
    return pixels


def check_cover(shape: tuple[int, ...], size: tuple[float, float], where: str) -> None:
    """ValueError that names ``where`` for a picture that does not cover a plate with square pixels, to a pixel.

    ``shape`` are the rows and columns of the picture, ``size`` the width and height of the plate, mm.
    """
    (r, c), (width, height) = shape, size
    if abs(r - c * height / width) > 1 and abs(c - r * width / height) > 1:
        raise ValueError(f"{where}: a picture of {c} x {r} pixels does not cover a plate of {width:g} x {height:g} with square pixels")


def mask_values(entry: dict[str, Any], size: tuple[float, float], where: str) -> Float[np.ndarray, "r c"]:
    """Value of each pixel of a `mask_table`; ValueError that names ``where`` for rows of different lengths, and see `check_cover`."""
    rows = entry["pixels"]
    if len({len(row) for row in rows}) > 1:
        raise ValueError(f"{where}.pixels: rows of {min(map(len, rows))} to {max(map(len, rows))} pixels, all must be equally long")
    grey = np.array(rows, dtype=float) / WHITE
    check_cover(grey.shape, size, where)
    return entry["low"] + (entry["high"] - entry["low"]) * grey
