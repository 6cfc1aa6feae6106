"""Outlines from and to files: a hole from a list of points, a DXF or an SVG drawing; a pattern as DXF, SVG, extruded STL or PNG.

Lengths in mm. DXF files say their unit; where they do not, and in SVG files and lists of points, a length of 1 is 1 mm. The y axis of
SVG points down and is turned over. DXF and SVG drawings are read by the libraries of the extra ``[outline]``.
"""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path as File
from typing import Any

import numpy as np
import shapely

from .._types import Float
from .._validation import NUMBER, PAIR, POSITIVE, TEXT, is_number, tabled, whole, word
from ..cloud import boundary_edges
from ..continuation import Path
from ..controls import control_name
from ..geometry import Fourier, Hole, Plate, Polygon, outline_points
from ..observables import deformed_vertices
from .files import write_atomically
from .masks import write_drawing

FORMATS = ("dxf", "svg", "stl", "png")
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
FLATNESS = 1e-3  # of an outline's size: distance of a curve's chords when a drawing is read
TOLERANCE = 1e-2  # of the radius of a circle of the same area: default distance of the fit from the outline
MOST_TERMS = 24  # of a Fourier outline
SAMPLES = 720  # points of a hole's outline in a file


def hole_table(entry: dict[str, Any], folder: str | File, where: str) -> dict[str, Any]:
    """The case-file table of the Fourier hole or polygon that a ``kind = "outline"`` entry describes; ValueError that names ``where``.

    ``file`` is relative to ``folder``; ``number`` says which of several closed outlines; ``scale`` multiplies lengths and ``centre``
    (2,) moves the centroid; ``fit`` is "fourier" or "polygon", within ``tolerance`` mm (1 % of the mean radius by default).
    """
    found = read_outlines(File(folder) / entry["file"])
    number = entry.get("number", 0 if len(found) == 1 else None)
    if number not in range(len(found)):
        raise ValueError(f"{where}.number: {number!r} is not one of the {len(found)} closed outlines of {entry['file']!r}, counted from 0")
    points = entry.get("scale", 1.0) * found[number]
    shape = shapely.Polygon(points)
    if not (shape.is_valid and shape.area > 0):
        raise ValueError(f"{where}.file: outline {number} of {entry['file']!r} crosses itself or has no area")
    if "centre" in entry:
        points = points - shapely.get_coordinates(shape.centroid)[0] + np.array(entry["centre"])
    tolerance = entry.get("tolerance", TOLERANCE * np.sqrt(shape.area / np.pi))
    fit = entry.get("fit", "fourier")
    try:
        hole = FITS[fit](points, tolerance)
    except ValueError as problem:
        raise ValueError(f"{where}.fit: {problem}") from None
    return hole_entries(fit, hole)


def hole_entries(kind: str, hole: Hole) -> dict[str, Any]:
    """The case-file table of a hole of that kind."""
    return {"kind": kind} | {name: np.asarray(value).tolist() for name, value in hole.theta.items()}


def read_outlines(file: str | File) -> list[Float[np.ndarray, "_ 2"]]:
    """The closed outlines of a CSV, DXF or SVG file, each (m, 2) in mm without a repeated point; ValueError, one line, without any."""
    file = File(file)
    readers = {".csv": _read_csv, ".txt": _read_csv, ".dxf": _read_dxf, ".svg": _read_svg}
    if file.suffix.lower() not in readers:
        raise ValueError(f"file: {str(file)!r} is not a .csv, .dxf or .svg file")
    try:
        found = [np.asarray(line, dtype=float) for line in readers[file.suffix.lower()](file)]
    except OSError as problem:
        raise ValueError(f"file: cannot read {str(file)!r}: {problem.strerror or problem}") from None
    except ImportError as problem:
        raise ValueError(f"file: {str(file)!r} needs {problem.name}; pip install 'jaxgel[outline]'") from None
    except Exception as problem:  # the libraries raise exceptions of their own for a damaged file
        raise ValueError(f"file: {str(file)!r} is no drawing that can be read: {' '.join(str(problem).split())}") from None
    found = [line[:-1] if len(line) > 1 and np.allclose(line[0], line[-1]) else line for line in found]
    found = [line for line in found if len(line) >= 3 and np.isfinite(line).all()]
    if not found:
        raise ValueError(f"file: {str(file)!r} has no closed outline")
    return found


def _read_csv(file: File) -> list:
    """One outline: two columns x, y; a first row of words is skipped."""
    rows = [row for row in csv.reader(io.StringIO(file.read_text(encoding="utf-8"))) if row and not row[0].lstrip().startswith("#")]
    if rows and not is_number(rows[0][0]):
        rows = rows[1:]
    if any(len(row) < 2 for row in rows):
        raise ValueError("a row has no two columns")
    return [[(float(row[0]), float(row[1])) for row in rows]]


def _read_dxf(file: File) -> list:
    import ezdxf
    from ezdxf import units
    from ezdxf.path import bbox, make_path

    document = ezdxf.readfile(file)
    scale = units.conversion_factor(document.units, units.MM) if document.units else 1.0
    lines = []
    for entity in document.modelspace():
        try:
            path = make_path(entity)
        except TypeError:
            continue  # a text or a dimension
        if not path.is_closed:
            continue
        size = max(bbox([path]).size)
        lines.append([(scale * p.x, scale * p.y) for p in path.flattening(FLATNESS * size)])
    return lines


def _read_svg(file: File) -> list:
    from svgpathtools import Document, Line

    lines = []
    for compound in Document(str(file)).paths():
        for path in compound.continuous_subpaths():
            if not path.isclosed():
                continue
            pieces = [1 if isinstance(part, Line) else int(np.ceil(np.pi / np.sqrt(FLATNESS))) for part in path]
            z = np.concatenate([[part.point(k / n) for k in range(n)] for part, n in zip(path, pieces, strict=True)])
            lines.append(np.stack([z.real, -z.imag], axis=1))
    return lines


def fit_fourier(points: Float[np.ndarray, "m 2"], tolerance: float) -> Fourier:
    """The ``holes.Fourier`` with the fewest terms that stays within ``tolerance`` mm of the closed outline (m, 2); ValueError for none.

    Its centre is where the first harmonics vanish. The outline must be star-shaped about its centre.
    """
    points = _equidistant(points)
    for terms in range(1, MOST_TERMS + 1):
        centre = points.mean(axis=0)
        for _ in range(50):
            d = points - centre
            phi = np.unwrap(np.arctan2(d[:, 1], d[:, 0]))
            if not (np.all(np.diff(phi) > 0) and phi[-1] - phi[0] < 2 * np.pi):
                raise ValueError("the outline is not seen whole from its middle; use fit = 'polygon'")
            k = np.arange(1, terms + 2)
            waves = np.concatenate([np.ones((len(phi), 1)), np.cos(phi[:, None] * k), np.sin(phi[:, None] * k)], axis=1)
            radius, *rest = np.linalg.lstsq(waves, np.linalg.norm(d, axis=1), rcond=None)[0]
            cos, sin = np.split(np.array(rest), 2)
            shift = np.array([cos[0], sin[0]])
            centre = centre + shift
            if np.linalg.norm(shift) < 1e-12 * radius:
                break
        hole = Fourier(centre, radius, cos[1:] / radius, sin[1:] / radius)
        miss = shapely.hausdorff_distance(*(shapely.LinearRing(line) for line in (_hole_points(hole), points)))
        if miss <= tolerance:
            return hole
    raise ValueError(
        f"{MOST_TERMS} terms miss the outline by {miss:.3g} mm; raise the tolerance of {tolerance:.3g} mm or take fit = 'polygon'"
    )


def fit_polygon(points: Float[np.ndarray, "m 2"], tolerance: float) -> Polygon:
    """The ``holes.Polygon`` of those points of a closed outline (m, 2) that keep it within ``tolerance`` mm (Douglas and Peucker)."""
    ring = shapely.simplify(shapely.Polygon(points), tolerance).normalize()
    return Polygon(np.asarray(shapely.orient_polygons(ring).exterior.coords)[:-1])


FITS: Mapping[str, Callable[[np.ndarray, float], Hole]] = {"fourier": fit_fourier, "polygon": fit_polygon}
"""Kind of the hole that an outline becomes, and the function that fits it."""


def _equidistant(points: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "s 2"]:
    """``SAMPLES`` points at equal distances along the closed outline (m, 2), anticlockwise."""
    ring = shapely.orient_polygons(shapely.Polygon(points)).exterior
    return shapely.get_coordinates(shapely.line_interpolate_point(ring, np.arange(SAMPLES) / SAMPLES, normalized=True))


def _hole_points(hole: Any) -> Float[np.ndarray, "s 2"]:
    return np.asarray(outline_points(hole, np.union1d(np.arange(SAMPLES) / SAMPLES, hole.corners)))


def dry_gel(plate: Plate) -> shapely.Geometry:
    """The dry gel of a plate as a shapely polygon, mm."""
    box = shapely.box(-plate.width / 2, -plate.height / 2, plate.width / 2, plate.height / 2)
    return shapely.difference(box, shapely.union_all([shapely.Polygon(_hole_points(hole)) for hole in plate.holes]))


def dry_regions(plate: Plate) -> list[shapely.Polygon]:
    """The parts of a dry plate's regions in the plate, shapely polygons, mm; holes in them are not cut out."""
    box = shapely.box(-plate.width / 2, -plate.height / 2, plate.width / 2, plate.height / 2)
    inside = [shapely.intersection(box, shapely.Polygon(_hole_points(region))) for region in plate.regions]
    return [part for part in shapely.get_parts(inside) if isinstance(part, shapely.Polygon)]


def swollen_gel(path: Path, k: int) -> shapely.Geometry:
    """The gel of state ``k`` of a path as a shapely polygon, mm; ValueError where its outline crosses itself."""
    chosen = path.chosen([k])
    vertices, edges = np.asarray(deformed_vertices(chosen))[0], boundary_edges(np.asarray(path.model.cloud.triangles))
    faces = shapely.get_parts(shapely.polygonize(shapely.linestrings(vertices[edges])))
    gel = max(faces, key=lambda face: face.area, default=shapely.Polygon())
    if not gel.is_valid or len(faces) == 0:
        raise ValueError(f"state: the outline at {control_name(path.control)} = {float(path.value[k]):.6g} crosses itself")
    return gel


def write_outline(
    gel: shapely.Geometry,
    file: str | File,
    height: float = 1.0,
    pixels_per_mm: float | None = None,
    regions: Sequence[shapely.Polygon] = (),
) -> File:
    """Write a polygon (shapely, mm) to a .dxf, .svg, .stl or .png ``file``; returns the file.

    STL is extruded by ``height`` mm; for PNG and its ``pixels_per_mm`` see `write_drawing`. The outlines of ``regions`` have a layer of
    their own in DXF and thin lines in SVG.
    """
    file = File(file)
    kind = file.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise ValueError(f"file: {str(file)!r} does not end in one of {', '.join('.' + name for name in FORMATS)}")
    if not (np.isfinite(height) and height > 0):
        raise ValueError(f"height: {height} is not a positive length in mm")
    if kind == "png":
        return write_drawing(gel, file, pixels_per_mm)
    gel = shapely.orient_polygons(gel)
    content = {"dxf": _dxf, "svg": _svg, "stl": lambda gel, _: _stl(gel, height)}[kind](gel, regions)
    write_atomically(file, lambda stream: stream.write(content))
    return file


def _rings(gel: shapely.Polygon) -> list[np.ndarray]:
    """Closed lines of a polygon, the outer one first, each (m, 2) without a repeated point."""
    return [np.asarray(ring.coords)[:-1] for ring in (gel.exterior, *gel.interiors)]


def _dxf(gel: shapely.Polygon, regions: Sequence[shapely.Polygon]) -> bytes:
    try:
        import ezdxf
    except ImportError:
        raise ValueError("format: dxf needs ezdxf; pip install 'jaxgel[outline]'") from None
    document = ezdxf.new("R2010", units=ezdxf.units.MM)
    lines = [("HOLES" if k else "PLATE", ring) for k, ring in enumerate(_rings(gel))]
    for layer, ring in lines + [("REGIONS", _rings(region)[0]) for region in regions]:
        document.modelspace().add_lwpolyline(ring.tolist(), close=True, dxfattribs={"layer": layer})
    stream = io.StringIO()
    document.write(stream)
    return stream.getvalue().encode(document.output_encoding)


def _svg(gel: shapely.Polygon, regions: Sequence[shapely.Polygon]) -> bytes:
    left, low, right, high = gel.bounds
    size = f'width="{right - left:.6f}mm" height="{high - low:.6f}mm" viewBox="{left:.6f} {-high:.6f} {right - left:.6f} {high - low:.6f}"'
    drawn = [(0.002, _rings(gel)), *((0.001, _rings(region)[:1]) for region in regions)]
    paths = "\n".join(
        f'<path fill="none" stroke="black" stroke-width="{width * (right - left):.6f}" d="{" ".join(map(_svg_loop, rings))}"/>'
        for width, rings in drawn
    )
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<svg xmlns="http://www.w3.org/2000/svg" {size}>\n{paths}\n</svg>\n'.encode()


def _svg_loop(ring: Float[np.ndarray, "m 2"]) -> str:
    return "M" + "L".join(f"{x:.6f},{-y:.6f}" for x, y in ring) + "Z"


def _stl(gel: shapely.Polygon, height: float) -> bytes:
    """Binary STL of the polygon between z = 0 and ``height``; every edge belongs to two triangles."""
    flat = shapely.get_parts(shapely.constrained_delaunay_triangles(gel))
    top = shapely.get_coordinates(shapely.orient_polygons(flat)).reshape(-1, 4, 2)[:, :3]
    parts = [_raised(top, height), _raised(top[:, ::-1], 0.0)]
    for ring in _rings(gel):
        a, b = (_raised(line[:, None], z)[:, 0] for line, z in ((ring, 0.0), (np.roll(ring, -1, axis=0), 0.0)))
        up = np.array([0.0, 0.0, height])
        parts += [np.stack([a, b, b + up], axis=1), np.stack([a, b + up, a + up], axis=1)]
    corners = np.concatenate(parts)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    records = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    records["normal"], records["corners"] = normal / np.linalg.norm(normal, axis=1, keepdims=True), corners
    return b"jaxgel".ljust(80) + np.uint32(len(records)).tobytes() + records.tobytes()


def _raised(points: np.ndarray, z: float) -> np.ndarray:
    """Points (..., 2) with a third coordinate."""
    return np.concatenate([points, np.full((*points.shape[:-1], 1), z)], axis=-1)
