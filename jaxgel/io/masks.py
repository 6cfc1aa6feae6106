"""Pictures that cover a plate: masks of printed gels, read and written, and of the gel.

Their first row is at the upper edge; of the gel drawings are written.
"""

import io
from collections.abc import Callable
from pathlib import Path as File
from typing import Any

import jax
import numpy as np
import shapely

from .._types import Float, Int
from .._validation import FLAG, NUMBER, TEXT, exactly_one, listed, not_both, tabled, whole
from ..cloud import Cloud
from ..discretisation import NodalField
from ..geometry import Frame
from ..materials import WithHoles
from .files import write_atomically

WHITE = 255  # of an 8-bit grey picture; black is 0
GREY = ("1", "L")  # modes of such pictures
LONGER_SIDE = 2000  # most pixels of a written picture if its scale is not given
MOST_PIXELS = 2**24  # of a written picture
INCH = 25.4  # mm
FINEST = 1e8  # pixels per inch that a PNG file can say
_MASK = tabled(
    {
        "file": TEXT
        | {"description": "A PNG file, black and white or 8-bit grey, that covers the plate."},
        "pixels": listed(listed(whole(0, WHITE), 1), 1)
        | {"description": "Its grey values instead, row by row from the top."},
        "values": listed(listed(NUMBER, 1), 1)
        | {"description": "The parameter at each pixel instead, row by row from the top."},
        "low": NUMBER | {"description": "Value where the picture is black."},
        "high": NUMBER | {"description": "Value where the picture is white."},
        "smooth": FLAG
        | {
            "description": (
                "Whether quadratic B-splines join the pixels, without kinks, or it is bilinear "
                "between them."
            )
        },
        "with_holes": FLAG
        | {
            "description": (
                "Whether it moves with the material around holes that a study moves, or stays on "
                "the plate."
            )
        },
    }
) | exactly_one(("file", "pixels", "values"))
_GREY_RANGE = {"dependentRequired": {"file": ["low", "high"], "pixels": ["low", "high"]}}
_NO_RANGE = {"allOf": [not_both(("values", "low")), not_both(("values", "high"))]}
# rule of a parameter of the gel that is a picture
MASK: dict[str, Any] = _MASK | _GREY_RANGE | _NO_RANGE


def mask_table(entry: dict[str, Any], folder: str | File | None, where: str) -> dict[str, Any]:
    """The table of a parameter with its picture's pixels in place of the ``file``.

    That is relative to ``folder``. ValueError: see `grey_pixels`.
    """
    if "file" not in entry:
        return entry
    return {key: value for key, value in entry.items() if key != "file"} | {
        "pixels": grey_pixels(entry["file"], folder, where).tolist()
    }


def grey_pixels(file: str, folder: str | File | None, where: str) -> Int[np.ndarray, "r c"]:
    """Grey values of a black and white or 8-bit grey picture in ``folder``, from the top.

    Row by row, black 0 and white 255. ValueError that names ``where`` and the file for any other
    picture or file, and without a folder.
    """
    if folder is None:
        raise ValueError(
            f"{where}.file: {file!r} belongs in a case file; name that file by case = instead of "
            "repeating what is in it"
        )
    from PIL import Image

    try:
        with Image.open(File(folder) / file) as picture:
            mode, pixels = (
                picture.mode,
                np.asarray(picture.convert("L") if picture.mode in GREY else picture),
            )
    # of a file that is none, a damaged and a huge picture
    except (OSError, SyntaxError, Image.DecompressionBombError) as problem:
        reason = " ".join(str(problem).split())
        raise ValueError(f"{where}.file: {file!r} cannot be read as a picture: {reason}") from None
    if mode not in GREY:
        raise ValueError(
            f"{where}.file: {file!r} is a picture of mode {mode}, it must be black and white or "
            "8-bit grey"
        )
    return pixels


def check_cover(shape: tuple[int, ...], size: tuple[float, float], where: str) -> None:
    """ValueError that names ``where`` for a picture that does not fit the plate to a pixel.

    It must cover the plate with square pixels. ``shape`` are the rows and columns of the picture,
    ``size`` the width and height of the plate, mm.
    """
    (r, c), (width, height) = shape, size
    if abs(r - c * height / width) > 1 and abs(c - r * width / height) > 1:
        raise ValueError(
            f"{where}: a picture of {c} x {r} pixels does not cover a plate of {width:g} x "
            f"{height:g} with square pixels"
        )


def mask_values(
    entry: dict[str, Any], size: tuple[float, float], where: str
) -> Float[np.ndarray, "r c"]:
    """Value of each pixel of a `mask_table`.

    ValueError that names ``where`` for rows of different lengths, and see `check_cover`.
    """
    key = "pixels" if "pixels" in entry else "values"
    rows = entry[key]
    if len({len(row) for row in rows}) > 1:
        raise ValueError(
            f"{where}.{key}: rows of {min(map(len, rows))} to {max(map(len, rows))} pixels, all "
            "must be equally long"
        )
    values = np.array(rows, dtype=float)
    check_cover(values.shape, size, where)
    return (
        values
        if key == "values"
        else entry["low"] + (entry["high"] - entry["low"]) * values / WHITE
    )


def write_mask(
    field: Callable[..., Any],
    size: tuple[float, float],
    file: str | File,
    *,
    low: float,
    high: float,
    pixels_per_mm: float | None = None,
    cloud: Cloud | None = None,
    frame: Frame | None = None,
) -> File:
    """Write a field on a plate of that ``size`` as a grey PNG, ``low`` black, ``high`` white.

    The size is width and height, mm; returns the file. ``field`` is a function of the position
    (2,), mm, as for a gel; each pixel has its value at the pixel's centre, black where there is
    none. ``pixels_per_mm`` is by default the largest of 1, 2 and 5 times a power of ten with at
    most ``LONGER_SIDE`` pixels along a side; the file says its size in mm. On a plate whose holes
    have moved, ``cloud`` is the cloud placed there: fields that move with the material are read
    where a point was before. The picture is that of a periodic cell in its ``frame``, by default as
    given. ValueError for a picture without pixels or with more than ``MOST_PIXELS``.
    """
    (r, c), (width, height) = _shape(size, pixels_per_mm), size
    x, y = width * ((np.arange(c) + 0.5) / c - 0.5), height * (0.5 - (np.arange(r) + 0.5) / r)
    back = (
        _before(cloud)
        if cloud is not None and isinstance(field, WithHoles | NodalField)
        else lambda points: points
    )
    given = (
        (lambda points: points)
        if frame is None or isinstance(field, NodalField)
        else frame.to_given
    )
    read = field.at if isinstance(field, NodalField) else jax.jit(jax.vmap(field))
    values = np.stack(
        [np.asarray(read(given(back(np.stack([x, np.full(c, own)], axis=1))))) for own in y]
    )
    return write_grey((values - low) / (high - low or 1.0), size, file)


def write_drawing(
    gel: shapely.Geometry, file: str | File, pixels_per_mm: float | None = None
) -> File:
    """Write a polygon (shapely, mm) as a grey PNG of its bounds by covered shares of pixels.

    Black in holes. ``pixels_per_mm`` and ValueError as in `write_mask`.
    """
    left, low, right, high = gel.bounds
    r, c = _shape((right - left, high - low), pixels_per_mm)
    w, h = (right - left) / c, (high - low) / r
    shapely.prepare(gel)
    covered = shapely.contains_xy(
        gel, *np.meshgrid(left + w * (np.arange(c) + 0.5), high - h * (np.arange(r) + 0.5))
    ).astype(float)
    edge = shapely.get_coordinates(shapely.segmentize(gel.boundary, min(w, h) / 4))
    at = np.stack([(high - edge[:, 1]) / h, (edge[:, 0] - left) / w], axis=1).astype(int)
    i, j = np.unique(np.clip(at, 0, [r - 1, c - 1]), axis=0).T
    pixels = shapely.box(left + j * w, high - (i + 1) * h, left + (j + 1) * w, high - i * h)
    covered[i, j] = shapely.area(shapely.intersection(gel, pixels)) / (w * h)
    return write_grey(covered, (right - left, high - low), file)


def _shape(size, pixels_per_mm):
    """Rows and columns of a picture of that size, mm."""
    if pixels_per_mm is None:
        power = 10.0 ** np.floor(np.log10(LONGER_SIDE / max(size)))
        pixels_per_mm = max(
            digit * power for digit in (1, 2, 5) if digit * power * max(size) <= LONGER_SIDE
        )
    c, r = (round(pixels_per_mm * side) for side in size)
    if min(r, c) < 1 or r * c > MOST_PIXELS:
        text = (
            f"{size[0]:g} x {size[1]:g} mm in {c:g} x {r:g} pixels, there must be at least 1 and "
            f"at most {MOST_PIXELS} pixels"
        )
        raise ValueError(f"pixels_per_mm: {pixels_per_mm:g} gives {text}")
    return r, c


def _before(cloud):
    """Function of points (p, 2) of a placed cloud: their former places, linear in triangles."""
    # not with jaxgel, of whose import it is a large part
    from scipy.interpolate import LinearNDInterpolator

    before = LinearNDInterpolator(np.asarray(cloud.vertices), cloud.topology.partition.vertices)

    def back(points):
        found = before(points)
        return np.where(np.isnan(found), points, found)

    return back


def write_grey(
    shares: Float[np.ndarray, "r c"], size: tuple[float, float], file: str | File
) -> File:
    """Write shares of white (r, c) as a grey PNG that opens in that ``size``; returns the file.

    The size is width and height, mm.
    """
    from PIL import Image

    pixels = np.rint(WHITE * np.clip(np.nan_to_num(shares), 0.0, 1.0)).astype(np.uint8)
    stream = io.BytesIO()
    dpi = np.minimum(INCH * np.array(pixels.shape[::-1]) / size, FINEST)
    Image.fromarray(pixels).save(stream, "png", dpi=tuple(dpi))
    write_atomically(File(file), lambda target: target.write(stream.getvalue()))
    return File(file)
