"""SVG files as viewers show them: number, area, place of outlines, and elements left out."""

import numpy as np
import pytest
import shapely

from jaxgel.io import read_outlines
from jaxgel.io.drawing import Omission
from jaxgel.io.svg import read_svg

CIRCLE = '<circle cx="3" cy="4" r="2"/>'
DISC = 4 * np.pi
STROKED = 'fill="none" stroke="black"'
HEART = "M0,0c0,-3 4,-3 4,0s-4,3 -4,0z"  # two cubic Bezier curves


def drawing(body, folder, root='viewBox="0 0 20 20"'):
    """The drawing of a file with these elements."""
    file = folder / "drawing.svg"
    names = (
        'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        'xmlns:i="http://www.inkscape.org/namespaces/inkscape"'
    )
    file.write_text(f"<svg {names} {root}>\n{body}\n</svg>", encoding="utf-8")
    return read_svg(file)


def areas(outlines):
    return [shapely.Polygon(line).area for line in outlines]


def centres(outlines):
    return [shapely.Polygon(line).centroid.coords[0] for line in outlines]


def cubic_area(*corners):
    """Area between a closed chain of cubic Bezier curves: integral of x dy by Gauss's rule.

    The rule is exact to degree 5.
    """
    nodes, weights = np.polynomial.legendre.leggauss(3)
    t = (nodes + 1) / 2
    total = 0.0
    for p in np.asarray(corners, dtype=float):
        basis = np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
        slope = 3 * np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2]).T @ np.diff(p, axis=0)
        total += np.sum(weights / 2 * (basis.T @ p)[:, 0] * slope[:, 1])
    return abs(total)


HEART_AREA = cubic_area([(0, 0), (0, -3), (4, -3), (4, 0)], [(4, 0), (4, 3), (0, 3), (0, 0)])

SHOWN = {  # elements: areas
    "circle": (CIRCLE, [DISC]),
    "ellipse": ('<ellipse cx="3" cy="4" rx="2" ry="1"/>', [2 * np.pi]),
    "ellipse with one radius": ('<ellipse cx="3" cy="4" rx="2"/>', [DISC]),
    "rectangle": ('<rect x="1" y="2" width="4" height="3"/>', [12]),
    "corner radius": ('<rect width="8" height="6" rx="1"/>', [48 - 4 + np.pi]),
    "corner radii beyond half a side": (
        '<rect width="8" height="6" rx="100" ry="100"/>',
        [12 * np.pi],
    ),
    "corner radius beyond half of the shorter side": (
        '<rect width="8" height="4" rx="3"/>',
        [32 - 4 * 3 * 2 + 6 * np.pi],
    ),
    "corner radius of zero": ('<rect width="8" height="6" rx="0" ry="2"/>', [48]),
    "polygon": ('<polygon points="0,0 4 0,4,3"/>', [6]),
    "filled polyline": ('<polyline points="0,0 4 0,4,3"/>', [6]),
    "closed polyline": (f'<polyline {STROKED} points="0,0 4 0,4,3 0,0"/>', [6]),
    "path": ('<path d="M1 1H5V4H1Z"/>', [12]),
    "relative path": ('<path d="m1 1h4v3h-4zm10 0 h1v1h-1z"/>', [12, 1]),
    "subpath after a closed one": ('<path d="M1 1h4v3h-4z h-1 v-1 z"/>', [12, 0.5]),
    "cubic curves": (f'<path d="{HEART}"/>', [HEART_AREA]),
    "quadratic curves": ('<path d="M0,0q2,4 4,0t-4,0z"/>', [2 * 2 / 3 * 8]),
    "arcs": ('<path d="M5,0a5,5 0,1,0-10,0a5,5 0,1,0,10,0"/>', [25 * np.pi]),
    "arcs with joined flags": ('<path d="M5 0a5 5 0 10-10 0z"/>', [12.5 * np.pi]),
    "arc with radii too small": ('<path d="M0 0A1 1 0 0 1 10 0z"/>', [12.5 * np.pi]),
    "filled path that is open": ('<path d="M0 0H4V3"/>', [6]),
    "path that closes but for round-off": (
        f'<path {STROKED} d="m.1 .1 .2 0 0 .2 -.2 0 .00000001-.2"/>',
        [0.04],
    ),
    "far from the origin": ('<path d="M400000 0h4v4h-4z"/>', [16]),
    "repeated points": ('<path d="M0 0L0 0L4 0L4 0L4 3L4 3L0 0z"/>', [6]),
    "compound path": ('<path fill-rule="evenodd" d="M0 0h6v6h-6z M1 1h2v2h-2z"/>', [36, 4]),
    "link": (f'<a xlink:href="https://example.org">{CIRCLE}</a>', [DISC]),
    "group": (f"<g><g>{CIRCLE}</g></g>", [DISC]),
    "clone": (
        '<rect id="a" width="1" height="2"/><use xlink:href="#a" x="5"/><use href="#a" y="5"/>',
        [2, 2, 2],
    ),
    "clone before its original": (
        '<use href="#a" x="5"/><rect id="a" width="1" height="2"/>',
        [2, 2],
    ),
    "clone of a group": (
        (
            '<g id="a"><rect width="1" height="2"/><rect x="2" width="2" height="2"/></g><use '
            'href="#a" y="4"/>'
        ),
        [2, 4, 2, 4],
    ),
    "clone of a clone": (
        (
            '<defs><rect id="a" width="1" height="2"/><use id="b" href="#a" x="2"/></defs><use '
            'href="#b" x="2"/>'
        ),
        [2],
    ),
    "clone that is scaled": (
        '<defs><rect id="a" width="1" height="2"/></defs><use href="#a" transform="scale(3)"/>',
        [18],
    ),
    "clone that is mirrored": (
        '<defs><path id="a" d="M0 0h2v1z"/></defs><use href="#a" x="-9" transform="scale(-1 1)"/>',
        [1],
    ),
    "symbol": (
        (
            '<symbol id="a" viewBox="0 0 4 2"><rect width="4" height="2"/></symbol><use href="#a" '
            'width="8" height="8"/>'
        ),
        [32],
    ),
    "symbol of any size": (
        '<symbol id="a"><rect width="4" height="2"/></symbol><use href="#a" x="2"/>',
        [8],
    ),
    "definitions": (f"<defs>{CIRCLE}</defs><rect width='1' height='2'/>", [2]),
    "clip path, marker, pattern and mask": (
        "".join(
            f"<{kind} id='{kind}'>{CIRCLE}</{kind}>"
            for kind in ("clipPath", "marker", "pattern", "mask", "symbol")
        )
        + "<rect width='1' height='2'/>",
        [2],
    ),
    "drawing in a drawing": (
        (
            '<svg x="2" y="3" width="10" height="10" viewBox="0 0 5 5"><rect width="3" '
            'height="2"/></svg>'
        ),
        [24],
    ),
    "drawing in a drawing without viewBox": (
        '<svg x="2" y="3"><rect width="3" height="2"/></svg>',
        [6],
    ),
    "drawing in a drawing in percent": (
        '<svg width="50%" height="50%"><rect width="10%" height="50%"/></svg>',
        [5],
    ),
    "stretched drawing": (
        (
            '<svg width="10" height="4" viewBox="0 0 2 2" preserveAspectRatio="none"><rect '
            'width="1" height="1"/></svg>'
        ),
        [10],
    ),
    "sliced drawing": (
        (
            '<svg width="10" height="4" viewBox="0 0 2 2" preserveAspectRatio="xMinYMin '
            'slice"><rect width=".5" height=".5"/></svg>'
        ),
        [6.25],
    ),
    "clipped shape": (
        (
            '<clipPath id="c"><rect width="4" height="9"/></clipPath><rect clip-path="url(#c)" '
            'x="2" y="1" width="6" height="3"/>'
        ),
        [6],
    ),
    "clip path beyond the shape": (
        (
            '<clipPath id="c"><circle r="9"/></clipPath><g clip-path="url(#c)"><rect width="1" '
            'height="2"/></g>'
        ),
        [2],
    ),
    "shape cut by the drawing that it is in": (
        '<svg width="4" height="4"><rect x="1" y="1" width="9" height="2"/></svg>',
        [6],
    ),
    "transforms": (
        (
            '<g transform="translate(3 2) rotate(30, 1, 1)"><rect transform="scale(2,.5) '
            'skewX(20)" width="2" height="3"/></g>'
        ),
        [6],
    ),
    "matrix": ('<rect transform="matrix(2 0 0,3 5 5)" width="1" height="1"/>', [6]),
    "transform in a style": (
        (
            '<rect style="transform: translate(10px, 1e1%) scale(200%) rotate(.25turn)" width="2" '
            'height="3"/>'
        ),
        [24],
    ),
    "transform in a style sheet": (
        "<style>rect {transform: scaleX(3)}</style><rect width='2' height='3'/>",
        [18],
    ),
    "style sheet after the shape": ("<circle r='2'/><style>.b {display: none}</style>", [DISC]),
    "visible in a hidden group": (
        "<g visibility='hidden'><rect visibility='visible' width='2' height='3'/></g>",
        [6],
    ),
    "clone of something hidden": (
        (
            '<defs><g id="a" style="display:inline"><rect width="2" height="3"/></g></defs><use '
            'href="#a"/>'
        ),
        [6],
    ),
    "stroke alone": (f"<rect {STROKED} width='2' height='3'/>", [6]),
    "paint from a style sheet": (
        "<style>/* a */ path{fill:none;stroke:#000}</style><path d='M0 0h2v2h-2z'/>",
        [4],
    ),
    "outline of loose lines": (
        (
            '<g stroke="black"><line x2="4"/><line x1="4" y1="3" x2="4"/><path fill="none" d="M0 '
            '0A 8 8 0 0 0 4 3"/></g>'
        ),
        [6 + 64 * np.arcsin(2.5 / 8) - 2.5 * np.sqrt(64 - 2.5**2)],
    ),
    "subpaths that meet": (f'<path {STROKED} d="M0 0H4M4 0V3M4 3L0 0"/>', [6]),
    "switch": (f'<switch><g systemLanguage="en-GB, de">{CIRCLE}</g></switch>', [DISC]),
    "style sheet for the screen": (
        (
            "<style>@media print {rect {display:none}} @media screen {circle "
            "{display:inline}}</style><rect width='2' height='3'/>"
        ),
        [6],
    ),
    "style sheet for paper": (
        "<style media='print'>rect {display:none}</style><rect width='2' height='3'/>",
        [6],
    ),
    "declaration that matters more": (
        (
            "<style>rect {display:inline !important}</style><rect style='display:none' width='2' "
            "height='3'/>"
        ),
        [6],
    ),
    "elements of other programs": (
        '<i:page width="10"/><metadata/><title>a</title><rect width="2" height="3"/>',
        [6],
    ),
}

LEFT_OUT = {  # elements: kind, reason and number of what is left out
    "text": ("<text>a <tspan>b</tspan></text>", {("text", "not an outline"): 1}),
    "image": ('<image href="a.png" width="4" height="4"/>', {("image", "not an outline"): 1}),
    "foreign object": (
        '<foreignObject><p xmlns="http://www.w3.org/1999/xhtml">a</p></foreignObject>',
        {("foreignObject", "not an outline"): 1},
    ),
    "line": ('<line x2="4" stroke="black"/>', {("line", "not closed"): 1}),
    "open path": (
        f'<path {STROKED} d="M0 0H4V3"/><polyline {STROKED} points="0,0 1,1 3,0"/>',
        {("path", "not closed"): 1, ("polyline", "not closed"): 1},
    ),
    "path that is a line": ('<path d="M0 0H4H2z"/>', {("path", "no area"): 1}),
    "not painted": (
        '<rect fill="none" width="4" height="3"/>',
        {("rect", "no fill and no stroke"): 1},
    ),
    "transparent": (
        '<rect fill-opacity="0" stroke="red" stroke-width="0" width="4" height="3"/>',
        {("rect", "no fill and no stroke"): 1},
    ),
    "hidden by an attribute": (
        '<g display="none"><rect width="4" height="3"/><g><rect width="4" height="3"/></g></g>',
        {("rect", "hidden"): 2},
    ),
    "hidden by a style": (
        '<rect style="display : none" width="4" height="3"/>',
        {("rect", "hidden"): 1},
    ),
    "invisible": (
        '<g style="visibility:hidden"><rect width="4" height="3"/></g>',
        {("rect", "hidden"): 1},
    ),
    "opacity of zero": ('<g opacity="0"><rect width="4" height="3"/></g>', {("rect", "hidden"): 1}),
    "hidden by class": (
        "<style>.a {display:none}</style><rect class='b a' width='4' height='3'/>",
        {("rect", "hidden"): 1},
    ),
    "hidden by id": (
        "<style>#a, #c {display:none}</style><rect id='a' width='4' height='3'/>",
        {("rect", "hidden"): 1},
    ),
    "hidden by element": (
        "<style>rect {visibility:hidden}</style><rect width='4' height='3'/>",
        {("rect", "hidden"): 1},
    ),
    "hidden by its group": (
        "<style>.a > rect {display:none}</style><g class='a'><rect width='4' height='3'/></g>",
        {("rect", "hidden"): 1},
    ),
    "hidden by a stronger rule": (
        "<style>#a {display:none} rect {display:inline}</style><rect id='a' width='4' height='3'/>",
        {("rect", "hidden"): 1},
    ),
    "hidden clone": (
        '<defs><rect id="a" width="4" height="3"/></defs><use href="#a" display="none"/>',
        {("rect", "hidden"): 1},
    ),
    "switch": (
        (
            '<switch><rect requiredExtensions="a" width="4" height="3"/><text '
            'systemLanguage="de">a</text><text/><line x2="1"/></switch>'
        ),
        {
            ("rect", "for another viewer"): 1,
            ("text", "for another viewer"): 1,
            ("text", "not an outline"): 1,
            ("line", "alternative of a switch"): 1,
        },
    ),
    "clone of nothing": (
        '<use href="#a"/><use href="b.svg#a"/>',
        {("use", "'#a' is not in the file"): 1, ("use", "'b.svg#a' is not in the file"): 1},
    ),
    "clone of itself": ('<g id="a"><use href="#a"/></g>', {("use", "'#a' holds it"): 1}),
    "clones of each other": (
        '<defs><g id="a"><use href="#b"/></g><g id="b"><use href="#a"/></g></defs><use href="#a"/>',
        {("use", "'#a' holds it"): 1},
    ),
    "damaged path": ('<path d="M0 0L10"/>', {("path", "path data that cannot be read"): 1}),
    "unknown unit": ('<circle r="2em"/>', {("circle", "length '2em'"): 1}),
    "unknown transform": (
        '<g transform="matrix3d(1)"><rect width="4" height="3"/></g>',
        {("g", "transform 'matrix3d(1)'"): 1},
    ),
    "mask": ('<rect mask="url(#a)" width="4" height="3"/>', {("rect", "property mask"): 1}),
    "clip path that is not understood": (
        '<rect clip-path="inset(1px)" width="4" height="3"/>',
        {("rect", "clip path"): 1},
    ),
    "shape that is clipped away": (
        '<svg width="4" height="4"><rect x="5" width="4" height="3"/></svg>',
        {("rect", "clipped"): 1},
    ),
    "line that is clipped": (
        f'<svg width="4" height="4"><rect {STROKED} x="2" width="4" height="3"/></svg>',
        {("rect", "clipped"): 1},
    ),
    "rectangle without a width": ('<rect height="3"/>', {("rect", "no area"): 1}),
    "circle without a radius": ('<circle/><circle r="-1"/>', {("circle", "no area"): 2}),
    "style sheet of another file": (
        "<?xml-stylesheet href='a.css'?>",
        {("style", "rule <?xml-stylesheet?>"): 1},
    ),
    "style sheet from elsewhere": (
        "<style>@import 'a.css';</style>",
        {("style", "rule @import"): 1},
    ),
}


@pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside a circle"])
def test_outlines_are_those_that_a_viewer_shows_and_what_is_not_taken_is_counted(beside, tmp_path):
    """Before a circle, or after it what is left out."""
    faults = []
    rows = [
        (name, body, f'{body}<circle cx="15" cy="15" r="2" style="all:unset"/>', shown, {})
        for name, (body, shown) in SHOWN.items()
    ]
    rows += [
        (name, body, CIRCLE + body, [], omissions) for name, (body, omissions) in LEFT_OUT.items()
    ]
    for name, alone, with_circle, shown, omissions in rows:
        read = drawing(with_circle if beside else alone, tmp_path)
        found, wanted = sorted(areas(read.outlines)), sorted([*shown, *[DISC] * beside])
        counted = {(kind, reason): count for (kind, _, reason), count in read.omissions.items()}
        # chords within 1e-4 of the size
        if found != pytest.approx(wanted, rel=1e-3) or counted != omissions:
            faults.append(
                f"{name}: {found} instead of {wanted}, without {counted} instead of {omissions}"
            )
    assert not faults, "\n".join(faults)


SQUARE, TEN = '<rect width="10" height="10"/>', '<circle cx="5" cy="5" r="5"/>'
SIZES = {  # root and elements: width of the outline in mm, height if it differs
    "nothing is declared": ("", SQUARE, 10),
    "units of the viewBox": ('viewBox="0 0 10 10"', SQUARE, 10),
    "pixels": ('width="100px" height="100px"', SQUARE, 10),
    "pixels of a viewBox": ('width="100" height="100" viewBox="0 0 10 10"', SQUARE, 10),
    "percent": ('width="100%" height="100%" viewBox="0 0 10 10"', SQUARE, 10),
    "millimetres": ('width="10mm" height="10mm" viewBox="0 0 10 10"', SQUARE, 10),
    "fifth": ('width="20mm" height="20mm" viewBox="0 0 100 100"', SQUARE, 2),
    "centimetres": ('width="10cm" height="10cm" viewBox="0 0 100 100"', SQUARE, 10),
    "inches": ('width="1in" height="1in" viewBox="0 0 96 96"', SQUARE, 254 / 96),
    "points": ('width="72pt" height="72pt" viewBox="0 0 72 72"', SQUARE, 254 / 72),
    "picas": ('width="6pc" height="6pc" viewBox="0 0 10 10"', SQUARE, 25.4),
    "quarters": ('width="40Q" height="40Q" viewBox="0 0 10 10"', SQUARE, 10),
    "width alone": ('width="20mm" viewBox="0 0 10 5"', SQUARE, 20),
    "height alone": ('height="20mm" viewBox="0 0 10 5"', SQUARE, 40),
    "no viewBox": ('width="20mm" height="20mm"', SQUARE, 254 / 96),
    "page of other proportions": ('width="20mm" height="40mm" viewBox="0 0 10 10"', SQUARE, 20),
    "page that is filled": (
        'width="20mm" height="40mm" viewBox="0 0 10 10" preserveAspectRatio="xMidYMid slice"',
        SQUARE,
        40,
    ),
    "page that is stretched": (
        'width="20mm" height="40mm" viewBox="0 0 10 10" preserveAspectRatio="none"',
        SQUARE,
        20,
        40,
    ),
    "pixels that are stretched": (
        'width="20" height="40" viewBox="0 0 10 10" preserveAspectRatio="none"',
        SQUARE,
        10,
        20,
    ),
    "a length with a unit": ("", '<circle r="10mm"/>', 20),
    "a length with a unit on a page": (
        'width="50mm" height="50mm" viewBox="0 0 100 100"',
        '<circle r="1in"/>',
        96,
    ),
    "a length with a unit in a style": ("", '<rect style="width:1cm" height="10mm"/>', 10),
    "percent of the viewBox": (
        'width="50mm" height="50mm" viewBox="0 0 100 100"',
        '<rect width="20%" height="20%"/>',
        10,
    ),
    "radius in percent": (
        'width="50mm" height="50mm" viewBox="0 0 100 100"',
        '<circle r="20%"/>',
        20,
    ),
    "shift with a unit": ("", '<g style="transform:translate(1mm)"><circle r="5mm"/></g>', 10),
    "drawing in a drawing": (
        'width="20mm" height="20mm" viewBox="0 0 40 40"',
        f'<svg viewBox="0 0 10 10">{TEN}</svg>',
        20,
    ),
}


def test_size_is_the_one_that_the_file_declares(tmp_path):
    for name, (root, body, *size) in SIZES.items():
        (outline,) = drawing(body, tmp_path, root).outlines
        np.testing.assert_allclose(
            np.ptp(outline, axis=0), np.resize(size, 2), rtol=2e-3, err_msg=name
        )


def test_outlines_lie_where_the_file_has_them(tmp_path):
    """y points up; the origin is that of the units of the file, wherever the page is."""
    body = (
        '<rect id="a" x="1" y="2" width="2" height="2"/><use href="#a" x="3" y="1"/><g '
        'transform="rotate(90)"><use href="#a"/></g>'
    )
    np.testing.assert_allclose(
        centres(drawing(body, tmp_path, 'viewBox="-10 -10 20 20"').outlines),
        [(2, -3), (5, -4), (-3, -2)],
        atol=1e-12,
    )
    body = (
        '<svg x="2" y="3" width="10" height="10" viewBox="0 0 4 2" '
        'preserveAspectRatio="xMaxYMax"><rect width="4" height="2"/></svg>'
    )
    np.testing.assert_allclose(centres(drawing(body, tmp_path).outlines), [(7, -10.5)], atol=1e-12)
    body = '<rect width="2" height="2" style="transform:rotate(180deg);transform-origin:10px 25%"/>'
    np.testing.assert_allclose(centres(drawing(body, tmp_path).outlines), [(19, -9)], atol=1e-12)


def test_curves_are_followed_to_a_ten_thousandth_of_their_size(tmp_path):
    for radius in (1e-3, 1e3):
        body = (
            f'<path d="M{radius},0a{radius},{radius} 0,0,1 {-2 * radius},0a{radius},{radius} '
            f'0,0,1 {2 * radius},0"/>'
        )
        (outline,) = drawing(body, tmp_path).outlines
        distance = np.linalg.norm((outline + np.roll(outline, 1, axis=0)) / 2, axis=1)
        assert 1 - 2e-4 <= distance.min() / radius <= distance.max() / radius <= 1 + 1e-9


def test_omission_names_the_innermost_group(tmp_path):
    rect = '<rect width="2" height="3"/>'
    body = (
        f'<g id="layer1" i:label="Construction" style="display:none"><g id="a">{rect}</g>{rect}</g>'
    )
    assert drawing(body, tmp_path).omissions == {
        Omission("rect", "a", "hidden"): 1,
        Omission("rect", "Construction", "hidden"): 1,
    }


def test_markers_and_patterns_are_counted(tmp_path):
    body = (
        '<pattern id="p"/><marker id="m"/><path style="marker:url(#m)" fill="url(#p)" d="M0 '
        '0H4V3z"/>'
    )
    read = drawing(body, tmp_path)
    assert areas(read.outlines) == pytest.approx([6])
    assert read.omissions == {
        Omission("marker", "", "on a path"): 1,
        Omission("pattern", "", "fill of a path"): 1,
    }


ENTITIES = "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(12))


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("<svg", "unclosed token"),
        ("<html/>", "its first element is 'html'; an SVG file begins with 'svg'"),
        (
            f'<!DOCTYPE svg [<!ENTITY a0 "1">{ENTITIES}]><svg><text>&a12;</text></svg>',
            "limit on input amplification factor",
        ),
        (
            '<!DOCTYPE svg [<!ENTITY a SYSTEM "file:///etc/passwd">]><svg><text>&a;</text></svg>',
            "undefined entity &a;",
        ),
        ('<svg viewBox="0 0 0 4"/>', "viewBox '0 0 0 4'"),
        (
            '<svg width="0mm" height="4mm" viewBox="0 0 1 1"/>',
            "width, height: '0mm', '4mm' have no area",
        ),
    ],
)
def test_file_that_is_no_drawing_is_refused(content, reason, tmp_path):
    (tmp_path / "a.svg").write_text(content)
    with pytest.raises(
        ValueError, match=r"^file: .*a.svg' is no drawing that can be read: "
    ) as problem:
        read_outlines(tmp_path / "a.svg")
    assert reason in str(problem.value) and "\n" not in str(problem.value)


def test_elements_that_multiply_are_refused(monkeypatch, tmp_path):
    """A million of them in a few lines."""
    monkeypatch.setattr("jaxgel.io.svg.ELEMENTS_MAX", 1000)
    body = "".join(f'<g id="a{k + 1}">' + f'<use href="#a{k}"/>' * 10 + "</g>" for k in range(6))
    with pytest.raises(ValueError, match=r"^more than 1000 elements are drawn$"):
        drawing(body + '<use href="#a6"/><g id="a0"><rect/></g>', tmp_path)


def test_document_type_with_entities_is_read(tmp_path):
    """As Illustrator writes it."""
    (tmp_path / "a.svg").write_text(
        '<?xml version="1.0" encoding="utf-16"?><!DOCTYPE svg PUBLIC "-//W3C//DTD SVG 1.1//EN" '
        '"http://www.w3.org/Graphics/SVG/1.1/DTD/svg11.dtd"'
        ' [<!ENTITY ns "http://www.w3.org/2000/svg">]><svg xmlns="&ns;"><rect width="2" '
        'height="3"/></svg>',
        encoding="utf-16",
    )
    assert areas(read_outlines(tmp_path / "a.svg")) == [6]
