"""Outlines of a dry plate and of a swollen gel, and their files: DXF, SVG, extruded STL or PNG.

Lengths in mm. The y axis of SVG points down and is turned over. DXF is written by the library of
the extra ``[outline]``.
"""

import io
from collections.abc import Sequence
from pathlib import Path as File

import numpy as np
import shapely

from .._types import Float
from ..continuation import Path
from ..geometry import Plate, check_plate, frame_of, image_offsets, reference_plate
from ..observables import deformed_boundary
from .files import write_atomically
from .masks import write_drawing
from .outline_fits import hole_points

FORMATS = ("dxf", "svg", "stl", "png")


def dry_gel(plate: Plate) -> shapely.Geometry:
    """The dry gel of a plate as a shapely polygon, mm.

    Of a periodic cell in the frame that is computed, see `geometry.frame_of`. ValueError for a
    plate that `check_plate` refuses, such as one in two parts.
    """
    check_plate(plate)
    box = shapely.box(-plate.width / 2, -plate.height / 2, plate.width / 2, plate.height / 2)
    return shapely.difference(box, shapely.union_all(_shapes(plate, "holes")))


def _shapes(plate, name):
    """Polygons of ``holes`` or ``regions`` in the reference plate's frame, with periodic images."""
    outlines = getattr(frame_of(reference_plate(plate)).of(plate), name)
    own = np.array([shapely.Polygon(hole_points(outline)) for outline in outlines], dtype=object)
    return np.concatenate(
        [shapely.transform(own, lambda at, by=by: at + by) for by in image_offsets(plate)]
    )


def dry_regions(plate: Plate) -> list[shapely.Polygon]:
    """The parts of a dry plate's regions in the plate, shapely polygons, mm.

    Holes in them are not cut out.
    """
    box = shapely.box(-plate.width / 2, -plate.height / 2, plate.width / 2, plate.height / 2)
    inside = shapely.intersection(box, _shapes(plate, "regions"))
    return [part for part in shapely.get_parts(inside) if isinstance(part, shapely.Polygon)]


def swollen_gel(path: Path, k: int) -> shapely.Geometry:
    """The gel of state ``k`` of a path as a shapely polygon, mm.

    ValueError if its outline crosses itself.
    """
    sides = shapely.linestrings(deformed_boundary(path[[k]])[0])
    if not shapely.multilinestrings(sides).is_simple:
        raise ValueError(
            f"state: the outline at {path.control.name} = {float(path.value[k]):.6g} crosses itself"
        )
    faces = shapely.get_parts(shapely.polygonize(sides))
    # the gel's outer line is around its holes, also large ones
    return max(faces, key=lambda face: shapely.Polygon(face.exterior).area)


def write_outline(
    gel: shapely.Geometry,
    file: str | File,
    height: float = 1.0,
    pixels_per_mm: float | None = None,
    regions: Sequence[shapely.Polygon] = (),
) -> File:
    """Write polygons (shapely, mm) to a .dxf, .svg, .stl or .png ``file``; returns the file.

    STL is extruded by ``height`` mm; for PNG and its ``pixels_per_mm`` see `write_drawing`. The
    outlines of ``regions`` have a layer of their own in DXF and thin lines in SVG.
    """
    file = File(file)
    kind = file.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise ValueError(
            f"file: {str(file)!r} does not end in one of "
            f"{', '.join('.' + name for name in FORMATS)}"
        )
    if not (np.isfinite(height) and height > 0):
        raise ValueError(f"height: {height} is not a positive length in mm")
    if kind == "png":
        return write_drawing(gel, file, pixels_per_mm)
    gel = shapely.orient_polygons(gel)
    content = {"dxf": _dxf, "svg": _svg, "stl": lambda gel, _: _stl(gel, height)}[kind](
        gel, regions
    )
    write_atomically(file, lambda stream: stream.write(content))
    return file


def _rings(gel: shapely.Geometry) -> list[np.ndarray]:
    """Closed lines (m, 2) of polygons, the outer one of each first, no point repeated."""
    polygons = [part for part in shapely.get_parts(gel) if isinstance(part, shapely.Polygon)]
    return [
        np.asarray(ring.coords)[:-1]
        for part in polygons
        for ring in (part.exterior, *part.interiors)
    ]


def _dxf(gel: shapely.Geometry, regions: Sequence[shapely.Polygon]) -> bytes:
    try:
        import ezdxf
    except ImportError:
        raise ValueError("format: dxf needs ezdxf; pip install 'jaxgel[outline]'") from None
    document = ezdxf.new("R2010", units=ezdxf.units.MM)
    lines = [
        ("HOLES" if k else "PLATE", ring)
        for part in shapely.get_parts(gel)
        for k, ring in enumerate(_rings(part))
    ]
    for layer, ring in lines + [("REGIONS", _rings(region)[0]) for region in regions]:
        document.modelspace().add_lwpolyline(ring.tolist(), close=True, dxfattribs={"layer": layer})
    stream = io.StringIO()
    document.write(stream)
    return stream.getvalue().encode(document.output_encoding)


def _svg(gel: shapely.Geometry, regions: Sequence[shapely.Polygon]) -> bytes:
    left, low, right, high = gel.bounds
    size = (
        f'width="{right - left:.9g}mm" height="{high - low:.9g}mm" viewBox="{left:.9g} '
        f'{-high:.9g} {right - left:.9g} {high - low:.9g}"'
    )
    drawn = [(0.002, _rings(gel)), *((0.001, _rings(region)[:1]) for region in regions)]
    paths = "\n".join(
        f'<path fill="none" stroke="black" stroke-width="{width * (right - left):.9g}" '
        f'd="{" ".join(map(_svg_loop, rings))}"/>'
        for width, rings in drawn
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>\n{paths}\n</svg>\n'.encode()
    )


def _svg_loop(ring: Float[np.ndarray, "m 2"]) -> str:
    return "M" + "L".join(f"{x:.9g},{-y:.9g}" for x, y in ring) + "Z"


def _stl(gel: shapely.Geometry, height: float) -> bytes:
    """Binary STL of the polygon between z = 0 and ``height``.

    Every edge belongs to two triangles.
    """
    flat = shapely.get_parts(shapely.constrained_delaunay_triangles(gel))
    top = shapely.get_coordinates(shapely.orient_polygons(flat)).reshape(-1, 4, 2)[:, :3]
    parts = [_raised(top, height), _raised(top[:, ::-1], 0.0)]
    for ring in _rings(gel):
        a, b = (
            _raised(line[:, None], z)[:, 0]
            for line, z in ((ring, 0.0), (np.roll(ring, -1, axis=0), 0.0))
        )
        up = np.array([0.0, 0.0, height])
        parts += [np.stack([a, b, b + up], axis=1), np.stack([a, b + up, a + up], axis=1)]
    corners = np.concatenate(parts)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    records = np.zeros(
        len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    records["normal"], records["corners"] = (
        normal / np.linalg.norm(normal, axis=1, keepdims=True),
        corners,
    )
    return b"jaxgel".ljust(80) + np.uint32(len(records)).tobytes() + records.tobytes()


def _raised(points: np.ndarray, z: float) -> np.ndarray:
    """Points (..., 2) with a third coordinate."""
    return np.concatenate([points, np.full((*points.shape[:-1], 1), z)], axis=-1)
