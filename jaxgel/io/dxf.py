"""Outlines from DXF drawings as seen from above, by the extra ``[outline]``.

Lengths in mm: files say their unit; 1 is 1 mm if they do not. The matrices are those of ezdxf,
which take points of a block to the drawing.
"""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np
import shapely

from .drawing import FLATNESS, Drawing, Omission, ends_meet, join, without_repeats

FOOT = 1.2e6 / 3937  # mm, of the US survey: 39.37 inches are 1 m
UNITS = (  # mm, by the number of $INSUNITS
    # none, in, ft, mi, mm, cm, m, km, uin, mil, yd
    *(1.0, 25.4, 304.8, 1609344.0, 1.0, 10.0, 1e3, 1e6, 25.4e-6, 25.4e-3, 914.4),
    # A, nm, um, dm, ... pc
    *(
        1e-7,
        1e-6,
        1e-3,
        1e2,
        1e4,
        1e5,
        1e12,
        1.495978707e14,
        9.4607304725808e18,
        3.0856775814913673e19,
    ),
    *(FOOT, FOOT / 12, 3 * FOOT, 5280 * FOOT),  # of the US survey: foot, inch, yard, mile
)
# in the header of a text or a binary file
UNIT = re.compile(rb"^[ \t]*9[ \t]*\r?\n[ \t]*\$INSUNITS|\x09\0?\$INSUNITS\0", re.MULTILINE)
ARCS = 24  # least number of Bezier curves of a circle: off by 1e-9 of the radius
SPANS = 512  # least number of chords of a spline
BAND = 256  # chords of a circle drawn with a wide pen
ROUND_OFF = 1e-12  # of a coordinate: smallest distance of chords
GAP = 1e-6  # of its size: width of the seams between the parts of a band
CURVES = (
    "LINE", "ARC", "CIRCLE", "ELLIPSE", "LWPOLYLINE", "POLYLINE", "SPLINE", "SOLID", "TRACE",
    "3DFACE", "HATCH", "MPOLYGON",
)  # fmt: skip
COMPOSED = ("MLINE", "ACAD_PROXY_ENTITY")  # of lines
SOLIDS = {
    "REGION": "ACIS body",
    "3DSOLID": "ACIS body",
    "BODY": "ACIS body",
    "SURFACE": "ACIS body",
    "MESH": "mesh",
}


class _Curve(NamedTuple):
    """A line of an entity in the coordinates of its block."""

    points: np.ndarray
    """Points (m, 3)."""
    is_closed: bool
    boundary: int | None = None
    """Number of the boundary of a hatch of which it is a part."""


class _Line(NamedTuple):
    """An open line of the drawing."""

    points: np.ndarray
    """Points (m, 2), mm."""
    entity: int
    """Number of its entity."""
    layer: str
    boundary: tuple[int, int] | None
    """Entity and number of the boundary of a hatch of which it is a part."""


def read_dxf(file: File) -> Drawing:
    """Closed outlines of a DXF file's model space, mm, in order, and a count of other entities.

    Curves are followed to `FLATNESS` of their size, and open lines joined if their ends meet: first
    those of a boundary of a hatch, then those of a layer, then all. ValueError for a unit that is
    none.
    """
    import ezdxf

    try:
        document = ezdxf.readfile(file)
    except (
        ezdxf.DXFError,
        ArithmeticError,
        AttributeError,
        LookupError,
        StopIteration,
        TypeError,
        ValueError,
    ) as problem:
        raise ValueError(str(problem)) from problem
    # without one ezdxf gives the default of new files, metres
    unit = document.units if UNIT.search(file.read_bytes()) else 0
    if unit not in range(len(UNITS)):
        raise ValueError(f"$INSUNITS: {unit} is no unit; 0 to {len(UNITS) - 1}")
    omissions, shown, outlines, lines, curves_of = Counter(), [], [], [], {}
    for entity, layer, matrix in _shown(document.modelspace(), document.layers, omissions):
        kind = entity.dxftype()
        if id(entity) not in curves_of:
            curves_of[id(entity)] = entity, *_curves(entity)
        _, curves, reason = curves_of[id(entity)]
        number = len(shown)
        shown.append((kind, layer))
        if reason:
            omissions[Omission(kind, layer, reason)] += 1
        for points, is_closed, boundary in curves:
            points = (
                UNITS[unit]
                * (points if matrix is None else np.array(list(matrix.transform_vertices(points))))[
                    :, :2
                ]
            )
            if is_closed or ends_meet(points):
                outlines.append((number, without_repeats(points)))
            else:
                lines.append(
                    _Line(points, number, layer, None if boundary is None else (number, boundary))
                )
    joined, left = _joined(lines)
    outlines += joined
    omissions.update(
        Omission(*shown[number], "not closed") for number in sorted({line.entity for line in left})
    )
    omissions.update(
        Omission(*shown[number], "no area") for number, line in outlines if not len(line)
    )
    for layout in document.layouts:
        if not layout.is_modelspace:
            paper = (entity for entity in layout if entity.dxftype() != "VIEWPORT")
            omissions.update(
                Omission(entity.dxftype(), _layer(entity), "paper space") for entity in paper
            )
    return Drawing(
        [line for _, line in sorted(outlines, key=lambda outline: outline[0]) if len(line)],
        omissions,
    )


def _joined(lines: list[_Line]) -> tuple[list[tuple[int, np.ndarray]], list[_Line]]:
    """Outlines of open lines, each with its first entity's number, and the lines left."""
    outlines = []
    for key in ("boundary", "layer", ""):
        groups, left = {}, []
        for line in lines:
            groups.setdefault(getattr(line, key) if key else "all", []).append(line)
        left = groups.pop(None, [])
        for group in groups.values():
            closed = join([line.points for line in group])
            outlines += [
                (min(group[k].entity for k in parts), without_repeats(outline))
                for outline, parts in closed
            ]
            used = set().union(*(parts for _, parts in closed))
            left += [line for k, line in enumerate(group) if k not in used]
        lines = left
    return outlines, lines


def _shown(
    entities: Any,
    layers: Any,
    omissions: Counter[Omission],
    matrix: Any = None,
    parent: Any = None,
    blocks: tuple[str, ...] = (),
) -> Iterator[tuple[Any, str, Any]]:
    """Visible entities with layer and matrix, None outside block references; counts the others.

    The matrix is that of the block references around them. Entities of a block on layer 0 have the
    layer of its reference, the ``parent``; a layer that is off hides its entities, a frozen one
    also what its block references hold.
    """
    for entity in entities:
        kind, layer = entity.dxftype(), _layer(entity)
        layer = parent if layer == "0" and parent is not None else layer
        entry = layers.get(layer) if layers.has_entry(layer) else None
        reason = ""
        if entry is not None and entry.is_frozen():
            reason = "layer frozen"
        elif entry is not None and entry.is_off() and kind != "INSERT":
            reason = "layer off"
        elif entity.dxf.is_supported("invisible") and entity.dxf.get("invisible", 0):
            reason = "invisible"
        elif kind == "INSERT":
            reason = _obstacle(entity, blocks)
        if reason:
            omissions[Omission(kind, layer, reason)] += 1
        elif kind == "INSERT":
            yield from ((text, _layer(text), matrix) for text in entity.attribs)
            # its value is in the reference
            inside = [part for part in entity.block() if part.dxftype() != "ATTDEF"]
            for single in entity.multi_insert() if entity.mcount > 1 else [entity]:
                placed = single.matrix44() if matrix is None else single.matrix44() @ matrix
                yield from _shown(
                    inside, layers, omissions, placed, layer, (*blocks, entity.dxf.name)
                )
        elif kind in COMPOSED:
            yield from _shown(
                list(entity.virtual_entities()), layers, omissions, matrix, layer, blocks
            )
        else:
            yield entity, layer, matrix


def _layer(entity):
    """Name of the layer of an entity, also of one unknown to ezdxf."""
    if entity.dxf.is_supported("layer"):
        return entity.dxf.get("layer", "0")
    return entity.graphic_properties().get("layer") or entity.base_class.get_first_value(8, "0")


def _obstacle(insert, blocks):
    """Why a block reference cannot be followed, or an empty text."""
    from ezdxf.xclip import XClip

    block = insert.block()
    if block is None:
        return "block missing"
    if block.block.is_xref or block.block.is_xref_overlay:
        return "external reference"
    if insert.dxf.name in blocks:
        return "block contains itself"
    clip = XClip(insert)
    return "block clipped" if clip.has_clipping_path and clip.is_clipping_enabled else ""


def _curves(entity):
    """The curves of an entity, and why it has none.

    Both are given if a viewer does not show some.
    """
    from ezdxf import DXFError

    try:
        curves, reason = _drawn(entity)
    except (ValueError, ArithmeticError, DXFError):
        return [], "damaged"
    return (
        (curves, reason)
        if all(np.isfinite(curve.points).all() for curve in curves)
        else ([], "damaged")
    )


def _drawn(entity):
    kind = entity.dxftype()
    if kind not in CURVES:
        return [], SOLIDS.get(kind, "no outline")
    if kind in ("HATCH", "MPOLYGON"):
        return _boundaries(entity)
    if kind == "SPLINE":
        return [_spline(entity)], ""
    if kind == "POLYLINE" and (entity.is_polygon_mesh or entity.is_poly_face_mesh):
        return [], "mesh"
    if (
        kind == "LWPOLYLINE" or (kind == "POLYLINE" and entity.is_2d_polyline)
    ) and entity.has_width:
        return _band(entity), ""
    return [_path(entity)], ""


def _path(entity):
    """The curve of a line, an arc, a polygon or a polyline."""
    from ezdxf.path import make_path

    kind = entity.dxftype()
    if kind == "POLYLINE":  # a polyline that was smoothed holds the vertices of its frame too
        entity.vertices[:] = [
            vertex
            for vertex in entity.vertices
            if not vertex.dxf.flags & vertex.SPLINE_FRAME_CONTROL_POINT
        ]
    path = make_path(entity, segments=ARCS)
    if not len(path):
        return _Curve(np.zeros((2, 3)), True)
    vertices = np.array(path.control_vertices())
    if not np.isfinite(vertices).all():  # flattening would not end
        raise ValueError("a coordinate is not finite")
    chord = max(FLATNESS * np.ptp(vertices, axis=0).max(), ROUND_OFF * np.abs(vertices).max())
    is_closed = kind in ("CIRCLE", "SOLID", "TRACE", "3DFACE") or getattr(
        entity, "is_closed", False
    )
    return _Curve(np.array(list(path.flattening(chord))), bool(is_closed))


def _spline(entity):
    """The curve of a spline between the ends of its range, inside its knots if periodic."""
    from scipy.interpolate import BSpline  # not with jaxgel, of whose import it is a large part

    spline = entity.construction_tool()
    weights = np.array(spline.weights() if spline.is_rational else np.ones(spline.count))[:, None]
    curve = BSpline(
        spline.knots(),
        np.hstack([weights * np.array(spline.control_points), weights]),
        spline.degree,
    )
    knots = np.unique(curve.t[spline.degree : spline.count + 1])
    chords = max(16, -(-SPANS // (len(knots) - 1)))
    at = np.interp(np.arange(chords * (len(knots) - 1) + 1) / chords, np.arange(len(knots)), knots)
    points = curve(at)
    return _Curve(points[:, :3] / points[:, 3:], False)


def _band(entity):
    """The outlines of a polyline drawn with a wide pen."""
    from ezdxf.render.trace import TraceBuilder

    elevation = (
        entity.dxf.elevation
        if entity.dxftype() == "LWPOLYLINE"
        else entity.dxf.get("elevation", (0, 0, 0))[2]
    )
    faces = TraceBuilder.from_polyline(entity, BAND).faces()
    parts = shapely.make_valid(
        [shapely.Polygon([(corner.x, corner.y) for corner in face]) for face in faces]
    )
    width, height = np.ptp(shapely.total_bounds(parts).reshape(2, 2), axis=0)
    band = shapely.union_all(parts, grid_size=GAP * max(width, height))
    rings = [
        ring
        for part in shapely.get_parts(band)
        if part.area
        for ring in (part.exterior, *part.interiors)
    ]
    ocs = entity.ocs()
    return [
        _Curve(np.array(list(ocs.points_to_wcs([(x, y, elevation) for x, y in ring.coords]))), True)
        for ring in rings
    ]


def _boundaries(entity):
    """The boundaries of a hatch that its style shows, and whether it hides some."""
    from ezdxf.explode import virtual_boundary_path_entities

    paths = entity.paths
    shown = {id(path) for path in paths.rendering_paths(entity.dxf.get("hatch_style", 0))}
    numbers = [k for k, path in enumerate(paths) if id(path) in shown]
    for path in paths:
        path.is_closed = True
    paths.polyline_to_edge_paths(just_with_bulge=False)
    boundaries, curves = virtual_boundary_path_entities(entity), []
    for k in numbers:
        edges = [
            _spline(edge) if edge.dxftype() == "SPLINE" else _path(edge) for edge in boundaries[k]
        ]
        curves += [edge._replace(boundary=k) for edge in edges if np.ptp(edge.points, axis=0).any()]
    return curves, "island ignored" if len(numbers) < len(boundaries) else ""
