"""DXF drawings as a viewer shows them, or a count of what is left out, by construct.

From above; each construct alone and beside a circle.
"""

import warnings

import numpy as np
import pytest
import shapely

from jaxgel.io import DrawingIncomplete, read_outlines

ezdxf = pytest.importorskip("ezdxf")
from ezdxf.render.forms import cube  # noqa: E402

AREA = 5e-4  # relative: chords are off by 1e-4 of the size, a circle then has 1.9e-4 less area
SQUARE = [(0, 0), (4, 0), (4, 4), (0, 4)]
DOWN = {"extrusion": (0, 0, -1)}  # seen from below: x is turned over


def lines(space, points, **attributes):
    for start, end in zip(points, [*points[1:], points[0]], strict=True):
        space.add_line(start, end, dxfattribs=attributes)


def slot(space, error=0.0, **attributes):
    """6 x 2 mm about the origin, area 8 + pi.

    Pieces in no order and of both directions, ends apart by ``error``.
    """
    space.add_arc((2, 0), 1 + error, -90, 90, dxfattribs=attributes)
    space.add_line((-2, 1), (2, 1), dxfattribs=attributes)
    space.add_line((-2, -1), (2, -1 + error), dxfattribs=attributes)
    space.add_arc((-2, 0), 1, 90, 270, dxfattribs=attributes)


def block(space, name="B", draw=lambda block: block.add_circle((1, 0), 1)):
    if name not in space.doc.blocks:
        draw(space.doc.blocks.new(name))
    return name


def insert(
    space,
    name="B",
    at=(0, 0),
    inside=lambda block: block.add_circle((1, 0), 1),
    array=None,
    **attributes,
):
    reference = space.add_blockref(block(space, name, inside), at, dxfattribs=attributes)
    if array:
        reference.grid((array[0], array[1]), (array[2], array[3]))
    return reference


def layer(space, name, state):
    getattr(space.doc.layers.add(name), state)()
    return name


def periodic_spline(space):
    space.add_spline().set_closed(
        [(3.0, 0.0, 0.0), (0.0, 2.0, 0.0), (-3.0, 0.0, 0.0), (0.0, -2.0, 0.0)], 3
    )


def area_of_periodic_spline():
    """The uniform cubic B-spline of four points, by its basis and 4000 chords (shoelace)."""
    points = np.array([(3, 0), (0, 2), (-3, 0), (0, -2)], dtype=float)
    t = np.arange(1000)[:, None] / 1000
    basis = (
        np.hstack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3])
        / 6
    )
    x, y = np.concatenate([basis @ np.roll(points, -k, axis=0) for k in range(4)]).T
    return abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2


def rational_circle(space, radius=2.0):
    corners = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0)]
    points = [(radius * x, radius * y, 0.0) for x, y in corners]
    spline = space.add_spline(degree=2)
    spline.control_points, spline.weights = points, [1, 0.5**0.5] * 4 + [1]
    spline.knots = [0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4]


def sheared(space):
    """A turned square of side 4 in a block with unequal scales: 2 x 0.5 keep the area, twice."""
    block(space, "INNER", lambda inner: inner.add_lwpolyline(SQUARE, close=True))
    insert(
        space,
        "OUTER",
        inside=lambda outer: insert(outer, "INNER", rotation=30, array=(1, 2, 9, 9)),
        xscale=2,
        yscale=0.5,
    )


def hatch(space, *boundaries, style=0, flags=1):
    found = space.add_hatch(dxfattribs={"hatch_style": style})
    for k, points in enumerate(boundaries):
        found.paths.add_polyline_path(points, is_closed=True, flags=flags if k == 0 else 16)
    return found


def hatched_slot(space):
    """Its edges run both ways round."""
    edges = space.add_hatch().paths.add_edge_path()
    edges.add_line((-2, -1), (2, -1))
    edges.add_arc((2, 0), 1, -90, 90)
    edges.add_line((-2, 1), (2, 1))
    edges.add_arc((-2, 0), 1, 90, 270)


def hatched_circle(space):
    space.add_hatch().paths.add_edge_path().add_arc((0, 0), 3, 0, 360)
    space.add_circle((0, 0), 3)


def smoothed(space):
    polyline = space.add_polyline2d([(0, 0), (4, 0), (4, 4), (0, 4)], close=True)
    polyline.append_vertices([(40, 40)], dxfattribs={"flags": 16})


def with_attribute(space):
    insert(space).add_attrib("NAME", "a", (0, 0))


def clipped(space):
    from ezdxf.xclip import XClip

    XClip(insert(space)).set_block_clipping_path([(0, 0), (1, 1)])


def dimensioned(space):
    space.add_linear_dim(base=(0, 5), p1=(0, 0), p2=(4, 0)).render()


def itself(space):
    insert(space, "LOOP", inside=lambda inner: insert(inner, "LOOP"))


def paper(space):
    space.doc.layout("Layout1").add_circle((0, 0), 1)


SHOWN = {  # drawing: the areas that a viewer shows, mm2, and what is counted as left out
    "circle": (lambda s: s.add_circle((0, 0), 3), [9 * np.pi], ""),
    "ellipse": (lambda s: s.add_ellipse((0, 0), (4, 0), 0.5), [8 * np.pi], ""),
    "arc of an ellipse": (
        lambda s: s.add_ellipse((0, 0), (4, 0), 0.5, 0, 3),
        [],
        "1 ELLIPSE on layer '0' (not closed)",
    ),
    "closed polyline": (lambda s: s.add_lwpolyline(SQUARE, close=True), [16], ""),
    "polyline back to its start": (lambda s: s.add_lwpolyline([*SQUARE, SQUARE[0]]), [16], ""),
    "open polyline": (
        lambda s: s.add_lwpolyline(SQUARE),
        [],
        "1 LWPOLYLINE on layer '0' (not closed)",
    ),
    "square far away": (
        lambda s: s.add_lwpolyline([(x + 4e5, y - 4e5) for x, y in SQUARE], close=True),
        [16],
        "",
    ),
    "circle of two bulges": (
        lambda s: s.add_lwpolyline([(-2, 0, 1), (2, 0, 1)], format="xyb", close=True),
        [4 * np.pi],
        "",
    ),
    "polyline of R12 with bulges": (
        lambda s: s.add_polyline2d(
            [(-2, -1, 0), (2, -1, 1), (2, 1, 0), (-2, 1, 1)], format="xyb", close=True
        ),
        [8 + np.pi],
        "",
    ),
    "smoothed polyline": (smoothed, [16], ""),
    "polyline in space": (
        lambda s: s.add_polyline3d([(x, y, 3 * x) for x, y in SQUARE], close=True),
        [16],
        "",
    ),
    "there and back": (
        lambda s: s.add_lwpolyline([(0, 0), (4, 0)], close=True),
        [],
        "1 LWPOLYLINE on layer '0' (no area)",
    ),
    "periodic spline": (periodic_spline, [area_of_periodic_spline()], ""),
    "rational spline": (rational_circle, [4 * np.pi], ""),
    "open spline": (
        lambda s: s.add_open_spline([(0, 0), (1, 2), (3, 2), (4, 0)]),
        [],
        "1 SPLINE on layer '0' (not closed)",
    ),
    "wide polyline": (
        lambda s: s.add_lwpolyline([(0, 0), (5, 0)], dxfattribs={"const_width": 2}),
        [10],
        "",
    ),
    "wide square": (
        lambda s: s.add_lwpolyline(SQUARE, close=True, dxfattribs={"const_width": 2}),
        [36, 4],
        "",
    ),
    "donut": (
        lambda s: s.add_lwpolyline([(-2, 0, 2, 2, 1), (2, 0, 2, 2, 1)], close=True),
        [9 * np.pi, np.pi],
        "",
    ),
    "tapered polyline": (lambda s: s.add_lwpolyline([(0, 0, 1, 3, 0), (5, 0)]), [10], ""),
    "solid": (lambda s: s.add_solid([(0, 0), (4, 0), (0, 4), (4, 4)]), [16], ""),
    "triangle": (lambda s: s.add_3dface([(0, 0), (4, 0), (0, 4), (0, 4)]), [8], ""),
    "circle from below": (lambda s: s.add_circle((2, 0), 3, dxfattribs=DOWN), [9 * np.pi], ""),
    "inclined circle": (
        lambda s: s.add_circle((0, 0), 3, dxfattribs={"extrusion": (0, 0.8, 0.6)}),
        [0.6 * 9 * np.pi],
        "",
    ),
    "upright circle": (
        lambda s: s.add_circle((0, 0), 3, dxfattribs={"extrusion": (1, 0, 0)}),
        [],
        "1 CIRCLE on layer '0' (no area)",
    ),
    "block": (insert, [np.pi], ""),
    "block scaled and turned": (
        lambda s: insert(s, xscale=2, yscale=2, rotation=30),
        [4 * np.pi],
        "",
    ),
    "block turned over": (lambda s: insert(s, inside=slot, xscale=-1), [8 + np.pi], ""),
    "block stretched": (lambda s: insert(s, xscale=2), [2 * np.pi], ""),
    "array of blocks": (lambda s: insert(s, array=(2, 3, 5, 7), rotation=20), [np.pi] * 6, ""),
    "array in a stretched block": (sheared, [16, 16], ""),
    "block with an attribute": (with_attribute, [np.pi], "1 ATTRIB on layer '0' (no outline)"),
    "block that is missing": (
        lambda s: s.add_blockref("NONE", (0, 0)),
        [],
        "1 INSERT on layer '0' (block missing)",
    ),
    "block of another file": (
        lambda s: (s.doc.add_xref_def("other.dxf", "OTHER"), s.add_blockref("OTHER", (0, 0))),
        [],
        "1 INSERT on layer '0' (external reference)",
    ),
    "block in itself": (itself, [], "1 INSERT on layer '0' (block contains itself)"),
    "block that is clipped": (clipped, [], "1 INSERT on layer '0' (block clipped)"),
    "block whose layer is off": (
        lambda s: insert(s, layer=layer(s, "GONE", "off")),
        [],
        "1 CIRCLE on layer 'GONE' (layer off)",
    ),
    "block whose layer is off with a layer of its own": (
        lambda s: insert(
            s,
            inside=lambda b: b.add_circle((0, 0), 1, {"layer": "SEEN"}),
            layer=layer(s, "GONE", "off"),
        ),
        [np.pi],
        "",
    ),
    "block whose layer is frozen": (
        lambda s: insert(
            s,
            inside=lambda b: b.add_circle((0, 0), 1, {"layer": "SEEN"}),
            layer=layer(s, "COLD", "freeze"),
        ),
        [],
        "1 INSERT on layer 'COLD' (layer frozen)",
    ),
    "layer off": (
        lambda s: s.add_circle((0, 0), 1, {"layer": layer(s, "GONE", "off")}),
        [],
        "1 CIRCLE on layer 'GONE' (layer off)",
    ),
    "layer frozen": (
        lambda s: s.add_circle((0, 0), 1, {"layer": layer(s, "COLD", "freeze")}),
        [],
        "1 CIRCLE on layer 'COLD' (layer frozen)",
    ),
    "invisible circle": (
        lambda s: s.add_circle((0, 0), 1, {"invisible": 1}),
        [],
        "1 CIRCLE on layer '0' (invisible)",
    ),
    "paper space": (paper, [], "1 CIRCLE on layer '0' (paper space)"),
    "square of lines": (lambda s: lines(s, SQUARE), [16], ""),
    "slot of lines and arcs": (slot, [8 + np.pi], ""),
    "slot with gaps": (lambda s: slot(s, 5e-4), [8 + np.pi], ""),
    "slot with wide gaps": (
        lambda s: slot(s, 0.1),
        [],
        "2 ARC on layer '0' (not closed), 2 LINE on layer '0' (not closed)",
    ),
    "slot from below": (lambda s: (slot(s, **DOWN),), [8 + np.pi], ""),
    "lens of an arc and a spline": (
        lambda s: (
            s.add_arc((0, 0), 2, 0, 180),
            s.add_open_spline([(2, 0), (2, -3), (-2, -3), (-2, 0)]),
        ),
        [2 * np.pi + 7.2],  # of a Bezier curve: 3/20 of its 3 x 4 and twice that
        "",
    ),
    "square of lines with a loose end": (
        lambda s: (lines(s, SQUARE), s.add_line((4, 4), (6, 6))),
        [16],
        "1 LINE on layer '0' (not closed)",
    ),
    # 16/3 less 4/3
    "crossing lines": (lambda s: lines(s, [(0, 0), (4, 4), (4, 0), (0, 2)]), [4], ""),
    "helix": (lambda s: s.add_helix(2, 1, 3), [], "1 HELIX on layer '0' (no outline)"),
    "squares with a common side": (
        lambda s: (lines(s, SQUARE), s.add_lwpolyline([(4, 0), (8, 0), (8, 4), (4, 4)])),
        [16, 16],
        "",
    ),
    "square of lines drawn twice": (lambda s: (lines(s, SQUARE), lines(s, SQUARE[::-1])), [16], ""),
    "square on two layers": (
        lambda s: (s.add_lwpolyline(SQUARE), s.add_line((0, 4), (0, 0), {"layer": "SIDE"})),
        [16],
        "",
    ),
    "square with a diagonal on another layer": (
        lambda s: (lines(s, SQUARE), s.add_line((0, 0), (4, 4), {"layer": "CENTRE"})),
        [16],
        "1 LINE on layer 'CENTRE' (not closed)",
    ),
    "hatch with an island": (
        lambda s: hatch(s, SQUARE, [(1, 1), (2, 1), (2, 2), (1, 2)]),
        [16, 1],
        "",
    ),
    "hatch over its island": (
        lambda s: hatch(s, SQUARE, [(1, 1), (2, 1), (2, 2), (1, 2)], style=2),
        [16],
        "1 HATCH on layer '0' (island ignored)",
    ),
    "hatch from below": (
        lambda s: s.add_hatch(dxfattribs=DOWN).paths.add_polyline_path(
            [(2, -1, 0), (6, -1, 1), (6, 1, 0), (2, 1, 1)], is_closed=True
        ),
        [8 + np.pi],
        "",
    ),
    "coordinate that is no number": (
        lambda s: s.add_circle((float("nan"), 0), 1),
        [],
        "1 CIRCLE on layer '0' (damaged)",
    ),
    "hatch of edges": (hatched_slot, [8 + np.pi], ""),
    "hatch of edges beside its border": (lambda s: (hatched_slot(s), slot(s)), [8 + np.pi], ""),
    "hatch beside its border": (hatched_circle, [9 * np.pi], ""),
    "circle drawn twice": (lambda s: [s.add_circle((0, 0), 3) for _ in range(2)], [9 * np.pi], ""),
    "thin ring": (
        lambda s: [s.add_circle((0, 0), r) for r in (3, 3.01)],
        [9 * np.pi, 9.0601 * np.pi],
        "",
    ),
    "multiline": (
        lambda s: s.add_mline(
            [(0, 0), (10, 0), (10, 10), (0, 10)],
            close=True,
            dxfattribs={"scale_factor": 2, "justification": 1},
        ),
        [64, 144],
        "",
    ),
    "text and dimension": (
        lambda s: (
            s.add_text("a"),
            s.add_text("b"),
            s.add_mtext("c"),
            dimensioned(s),
            s.add_point((0, 0)),
        ),
        [],
        ", ".join(
            f"{name} on layer '0' (no outline)"
            for name in ("2 TEXT", "1 MTEXT", "1 DIMENSION", "1 POINT")
        ),
    ),
    "meshes": (
        lambda s: (cube().render_mesh(s), s.add_polymesh((3, 3))),
        [],
        "1 MESH on layer '0' (mesh), 1 POLYLINE on layer '0' (mesh)",
    ),
}


def read(file):
    """Areas of the outlines of a file, and the text of its warning, or that of its refusal."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DrawingIncomplete)
        try:
            found = [shapely.Polygon(line).area for line in read_outlines(file)]
        except ValueError as problem:
            return [], str(problem)
    assert len(caught) <= 1
    return found, str(caught[0].message) if caught else ""


@pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside a circle"])
def test_drawing_is_taken_as_a_viewer_shows_it(beside, tmp_path):
    faults, file = [], tmp_path / "a.dxf"
    for name, (draw, areas, left_out) in SHOWN.items():
        document = ezdxf.new(units=ezdxf.units.MM)
        if beside:
            document.modelspace().add_circle((-50, -50), 2)
        draw(document.modelspace())
        document.saveas(file)
        found, text = read(file)
        areas = [4 * np.pi] * beside + areas
        without = f"file: {str(file)!r} is read without {left_out}" if left_out else ""
        wanted = (
            without if areas else f"file: {str(file)!r} has no closed outline; left out: {left_out}"
        )
        if text != wanted or sorted(found) != pytest.approx(sorted(areas), rel=AREA):
            faults.append(f"{name}: {found} instead of {areas}, {text!r} instead of {wanted!r}")
    assert not faults, "\n".join(faults)


INCH = 25.4
LENGTHS = [  # mm, by $INSUNITS
    *(
        1,
        INCH,
        12 * INCH,
        63360 * INCH,
        1,
        10,
        1000,
        1e6,
        1e-6 * INCH,
        1e-3 * INCH,
        36 * INCH,
        1e-7,
        1e-6,
        1e-3,
        100,
        1e4,
        1e5,
        1e12,
    ),
    *(1.496e14, 9.461e18, 3.0857e19, 304.8006096, 25.4000508, 914.4018288, 1609347.2187),
]


def test_length_has_the_unit_of_the_file(tmp_path):
    """As text: without a header, with a comment that names the variable, or only the unit.

    Astronomical lengths to four digits, others to eight.
    """
    circle = [
        (0, "SECTION"),
        (2, "ENTITIES"),
        (0, "CIRCLE"),
        (8, "0"),
        (10, 0.0),
        (20, 0.0),
        (40, 5.0),
        (0, "ENDSEC"),
        (0, "EOF"),
    ]
    for unit in (None, *range(25)):
        header = [
            (0, "SECTION"),
            (2, "HEADER"),
            (9, "$ACADVER"),
            (1, "AC1021"),
            (9, "$INSUNITS"),
            (70, unit),
            (0, "ENDSEC"),
        ]
        tags = [*([(999, "no $INSUNITS")] if unit is None else header), *circle]
        (tmp_path / "a.dxf").write_text("".join(f"{code}\n{value}\n" for code, value in tags))
        (outline,) = read_outlines(tmp_path / "a.dxf")
        size = 1 if unit is None else LENGTHS[unit]
        assert np.linalg.norm(outline, axis=1) == pytest.approx(
            5 * size, rel=1e-4 if size > 1e13 else 1e-8
        ), unit


def test_entities_that_are_not_known_are_counted(tmp_path):
    """Of any name and from any program, with and without subclasses.

    An ACIS body by its own reason.
    """
    tags = [
        (0, "SECTION"),
        (2, "HEADER"),
        (9, "$ACADVER"),
        (1, "AC1015"),
        (0, "ENDSEC"),
        (0, "SECTION"),
        (2, "ENTITIES"),
    ]
    tags += [
        (0, "WHEEL"),
        (8, "A"),
        (10, 0.0),
        (20, 0.0),
        (0, "REGION"),
        (5, "F1"),
        (100, "AcDbEntity"),
        (8, "C"),
    ]
    tags += [(100, "AcDbModelerGeometry"), (70, 1), (1, "abc")]
    tags += [(0, "GEAR"), (5, "F2"), (100, "AcDbEntity"), (8, "B"), (100, "AcDbGear"), (40, 1.0)]
    tags += [(0, "CIRCLE"), (8, "0"), (10, 0.0), (20, 0.0), (40, 5.0), (0, "ENDSEC"), (0, "EOF")]
    (tmp_path / "a.dxf").write_text("".join(f"{code}\n{value}\n" for code, value in tags))
    areas, text = read(tmp_path / "a.dxf")
    assert areas == pytest.approx([25 * np.pi], rel=AREA)
    assert text.split(" is read without ")[1] == (
        "1 WHEEL on layer 'A' (no outline), 1 REGION on layer 'C' (ACIS body), 1 GEAR on "
        "layer 'B' (no outline)"
    )


def test_unit_that_is_none_is_refused(tmp_path):
    document = ezdxf.new()
    document.header["$INSUNITS"] = 99
    document.modelspace().add_circle((0, 0), 1)
    document.saveas(tmp_path / "a.dxf")
    assert read(tmp_path / "a.dxf") == (
        [],
        (
            f"file: {str(tmp_path / 'a.dxf')!r} is no drawing that can be read: $INSUNITS: 99 is "
            "no unit; 0 to 24"
        ),
    )


def test_outlines_are_in_the_order_of_their_entities(tmp_path):
    """Also outlines of loose lines, by the first of them."""
    document = ezdxf.new(units=ezdxf.units.MM)
    space = document.modelspace()
    space.add_line((0, 0), (4, 0))
    space.add_circle((9, 9), 1)
    space.add_lwpolyline([(4, 0), (4, 4), (0, 4), (0, 0)])
    insert(space, at=(20, 0))
    document.saveas(tmp_path / "a.dxf")
    centres = [
        shapely.Polygon(line).centroid.coords[0] for line in read_outlines(tmp_path / "a.dxf")
    ]
    np.testing.assert_allclose(centres, [(2, 2), (9, 9), (21, 0)], atol=1e-6)
