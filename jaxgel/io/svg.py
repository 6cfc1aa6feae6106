"""Closed outlines of an SVG file as a viewer shows them, in mm.

Size: if a length in the file has a unit (mm, cm, Q, in, pt, pc), the drawing has the size that
``width``, ``height``, ``viewBox`` and ``preserveAspectRatio`` declare, 96 pixels an inch. If none
has, a user unit is 1 mm. The origin is that of the user units; the y axis points up.

What is filled is an area, closed or not. What is only stroked is an outline if its ends meet, or
those of several lines. Source: SVG 2.
"""

import re
from collections import Counter
from pathlib import Path as File
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import shapely

from .._types import Float
from .drawing import THIN, Drawing, Omission, ends_meet, join, size_of
from .svg_values import (
    MEASURES,
    PHYSICAL,
    PIXEL,
    Styles,
    is_zero,
    length,
    shift,
    subpaths,
    transform,
    view_box,
    view_matrix,
)

SVG, XLINK, INKSCAPE = (
    "http://www.w3.org/2000/svg",
    "{http://www.w3.org/1999/xlink}",
    "{http://www.inkscape.org/namespaces/inkscape}",
)
SHAPES = {"path", "rect", "circle", "ellipse", "line", "polyline", "polygon"}
CONTAINERS = {"g", "a", "switch", "svg", "symbol", "use"}
NEVER_SHOWN = {
    "defs", "clipPath", "mask", "marker", "pattern", "linearGradient", "radialGradient",
    "meshgradient", "filter", "symbol", "style", "script", "title", "desc", "metadata", "view",
    "cursor", "font", "font-face", "color-profile", "solidcolor", "hatch", "animate",
    "animateTransform", "animateMotion", "animateColor", "set", "discard", "mpath", "stop",
}  # fmt: skip
# properties that change what is shown
UNKNOWN = ("translate", "rotate", "scale", "offset-path", "mask", "mask-image", "transform-box")
PAINTS = {"fill": "black", "stroke": "none"}  # initial values
MARKERS = ("marker", "marker-start", "marker-mid", "marker-end")
INHERITED = {"fill-opacity", "stroke-opacity", "stroke-width", "visibility", *PAINTS, *MARKERS}
ELEMENTS_MAX = 100_000  # that are drawn; elements that use each other multiply


class Place(NamedTuple):
    """What an element inherits from those that it is in."""

    matrix: Float[np.ndarray, "3 3"]
    """From its user units to those of the file, y down, mm."""
    viewport: tuple[float, float]
    """Width and height to which percentages refer; nan if unknown."""
    style: dict[str, str]
    """Inherited properties."""
    layer: str = ""
    """Label or id of the innermost group."""
    hidden: str = ""
    """Reason for which nothing is taken; empty if there is none."""
    clips: tuple[shapely.Geometry, ...] = ()
    """Regions outside which nothing is shown, in the units of the file."""
    used: tuple[Any, ...] = ()
    """Elements that are drawn by a ``<use>`` around this one."""


def read_svg(file: File) -> Drawing:
    """The closed outlines of an SVG file and a count of what else it has.

    ValueError for a file that is no SVG.
    """
    from cssselect2 import ElementWrapper

    try:
        content = file.read_bytes()
        # expat bounds what entities expand to and loads no file
        tree = ElementTree.fromstring(content)  # noqa: S314
        root = ElementWrapper.from_xml_root(tree)
        if root.local_name != "svg" or root.namespace_url not in (SVG, ""):
            raise ValueError(
                f"its first element is {root.local_name!r}; an SVG file begins with 'svg'"
            )
        styles = Styles(root)
        if b"<?xml-stylesheet" in content:
            styles.ignored.append("<?xml-stylesheet?>")
        viewport, scale = _size(root, styles)
        reader = _Reader(styles, {element.id: element for element in [*root.iter_subtree()][::-1]})
        reader.draw(root, Place(np.diag([*scale, 1.0]), viewport, {}))
        reader.join_loose()
    except (ElementTree.ParseError, LookupError, OverflowError, RecursionError) as problem:
        raise ValueError(str(problem)) from None
    reader.omissions.update(Omission("style", "", f"rule {rule}") for rule in styles.ignored)
    return Drawing([outline * [1.0, -1.0] for outline in reader.outlines], reader.omissions)


def _size(root, styles) -> tuple[tuple[float, float], Float[np.ndarray, "2"]]:
    """Width and height in user units, nan if unknown, and mm of a unit along x and y."""
    values = styles.of(root)
    drawn = [
        styles.of(element)
        for element in root.iter_subtree()
        if element.local_name in SHAPES | CONTAINERS
    ]
    physical = any(PHYSICAL.search(element.get(name, "")) for element in drawn for name in MEASURES)
    sides = np.full(2, np.nan)
    for k, name in enumerate(("width", "height")):
        if values.get(name, "auto") != "auto" and not values[name].endswith("%"):
            sides[k] = length(values[name])
    scale = np.ones(2)
    if "viewBox" in values:
        box = view_box(values["viewBox"])
        ratio = sides / box[2:]
        # one side alone keeps the proportions
        sides = np.where(np.isnan(sides), ratio[::-1] * box[2:], sides)
        if np.isfinite(sides).all():
            if not (sides > 0).all():
                raise ValueError(
                    f"width, height: {values.get('width')!r}, {values.get('height')!r} have no area"
                )
            scale = np.diag(view_matrix(box, values.get("preserveAspectRatio", ""), *sides))[:2]
        sides = np.array(box[2:])
    return tuple(sides.tolist()), scale * PIXEL if physical else scale / scale[0]


class _Reader:
    """Outlines, in mm with y down, and omissions of the elements that were drawn."""

    def __init__(self, styles: Styles, elements: dict[str | None, Any]):
        self.styles, self.elements = styles, elements
        self.outlines: list[np.ndarray] = []
        self.omissions: Counter[Omission] = Counter()
        self.loose: list[tuple[Omission, np.ndarray]] = []  # open lines
        self.count = 0

    def omit(self, kind: str, place: Place, reason: str) -> None:
        """Count an element that is left out."""
        self.omissions[Omission(kind, place.layer, reason)] += 1

    def draw(self, element: Any, place: Place, sides: dict[str, str] | None = None) -> bool:
        """Draw an element and what it holds; whether its conditions hold.

        ``sides`` are the width and height that a ``<use>`` gives.
        """
        kind = element.local_name
        if element.namespace_url not in (SVG, "") or (
            kind in NEVER_SHOWN and element not in place.used
        ):
            return False
        self.count += 1
        if self.count > ELEMENTS_MAX:
            raise OverflowError(f"more than {ELEMENTS_MAX} elements are drawn")
        values = self.styles.of(element) | (sides or {})
        applies = _applies(values)
        try:
            place = self._entered(
                kind,
                values,
                place if applies or place.hidden else place._replace(hidden="for another viewer"),
            )
            if kind in SHAPES:
                self._draw_shape(kind, values, place)
            elif kind == "use":
                self._draw_used(element, values, place)
            elif kind in ("svg", "symbol") and element.parent is not None:
                self._draw_children(element, _in_viewport(kind, values, place))
            elif kind in CONTAINERS:
                self._draw_children(element, place)
            else:
                self.omit(kind, place, place.hidden or "not an outline")
        except ValueError as problem:
            self.omit(kind, place, str(problem))
        return applies

    def _draw_children(self, element, place):
        """Draw what an element holds; of a ``<switch>`` the first child that applies."""
        other = (
            place._replace(hidden=place.hidden or "alternative of a switch")
            if element.local_name == "switch"
            else place
        )
        for child in element.iter_children():
            if self.draw(child, place):
                place = other

    def _entered(self, kind, values, place) -> Place:
        """The place inside an element: with its style, label, transform and clip path."""
        style = place.style | {
            name: value
            for name, value in values.items()
            if name in INHERITED and value != "inherit"
        }
        place = place._replace(style=style)
        if kind == "g":
            place = place._replace(
                layer=values.get(f"{INKSCAPE}label", values.get("id", place.layer))
            )
        if place.hidden:
            return place
        if values.get("display") == "none" or is_zero(values.get("opacity", "1")):
            return place._replace(hidden="hidden")
        unknown = next(
            (
                name
                for name in UNKNOWN
                if values.get(name, "none") not in ("none", "view-box", "auto")
            ),
            None,
        )
        if unknown:
            return place._replace(hidden=f"property {unknown}")
        place = place._replace(matrix=place.matrix @ transform(values, place.viewport))
        return (
            self._clipped(values["clip-path"], place)
            if values.get("clip-path", "none") != "none"
            else place
        )

    def _clipped(self, text, place) -> Place:
        """The place with a clip path.

        Hidden if the clip path is not understood: a box of the shape, or one with holes or text.
        """
        name = re.fullmatch(r"""url\(\s*["']?#(.*?)["']?\s*\)""", text)
        element = self.elements.get(name[1]) if name else None
        values = self.styles.of(element) if element is not None else {}
        inside = _Reader(self.styles, self.elements)
        if element is not None and element.local_name == "clipPath" and element not in place.used:
            matrix = place.matrix @ transform(values, place.viewport)
            inside._draw_children(
                element, Place(matrix, place.viewport, {}, used=(*place.used, element))
            )
        shapes = (
            [child for child in element.iter_children() if child.local_name in (*SHAPES, "use")]
            if values
            else []
        )
        known = (
            values.get("clipPathUnits", "userSpaceOnUse") == "userSpaceOnUse"
            and values.get("clip-path", "none") == "none"
        )
        if (
            not known
            or inside.omissions
            or inside.loose
            or not 0 < len(inside.outlines) <= len(shapes)
        ):
            return place._replace(hidden="clip path")
        return place._replace(
            clips=(*place.clips, shapely.union_all([_area(outline) for outline in inside.outlines]))
        )

    def _draw_used(self, element, values, place):
        """Draw the element to which a ``<use>`` refers."""
        name = values.get("href", values.get(f"{XLINK}href", ""))
        target = self.elements.get(name[1:]) if name.startswith("#") else None
        if target is None:
            raise ValueError(f"{name!r} is not in the file")
        if target in (*place.used, element, *element.ancestors):
            raise ValueError(f"{name!r} holds it")
        moved = shift(
            *(
                length(values.get(side, "0"), whole)
                for side, whole in zip("xy", place.viewport, strict=True)
            )
        )
        place = place._replace(matrix=place.matrix @ moved, used=(*place.used, target))
        sized = target.local_name in ("symbol", "svg")
        self.draw(
            target,
            place,
            {side: values[side] for side in ("width", "height") if sized and side in values},
        )

    def _draw_shape(self, kind, values, place):
        """Take the outlines of a shape, or count it."""
        paints = {part: _is_painted(place.style, part) for part in PAINTS}
        if place.hidden or place.style.get("visibility", "visible") != "visible":
            self.omit(kind, place, place.hidden or "hidden")
            return
        if not any(paints.values()):
            self.omit(kind, place, "no fill and no stroke")
            return
        marked = any(place.style.get(name, "none") != "none" for name in MARKERS)
        if marked and kind in ("path", "line", "polyline", "polygon"):
            self.omit("marker", place, f"on a {kind}")
        if place.style.get("fill", "").startswith("url("):
            name = re.search("#([^\"')]*)", place.style["fill"])
            if name and name[1] in self.elements and self.elements[name[1]].local_name == "pattern":
                self.omit("pattern", place, f"fill of a {kind}")
        lines = subpaths(kind, values, place.viewport)
        if not lines:
            self.omit(kind, place, "no area")
        for line in lines:
            points = line @ place.matrix[:2, :2].T + place.matrix[:2, 2]
            if not ends_meet(points) and (len(points) < 3 or not paints["fill"]):
                if all(clip.covers(shapely.LineString(points)) for clip in place.clips):
                    self.loose.append((Omission(kind, place.layer, "not closed"), points))
                else:
                    self.omit(kind, place, "clipped")
            elif (
                shapely.convex_hull(shapely.multipoints(points)).area <= THIN * size_of(points) ** 2
            ):
                self.omit(kind, place, "no area")
            else:
                self._take(kind, points, place, paints["fill"])

    def join_loose(self) -> None:
        """Take the outlines that open lines form whose ends meet; count the others."""
        joined = join([points for _, points in self.loose])
        self.outlines += [outline for outline, _ in joined]
        used = set().union(*(lines for _, lines in joined))
        self.omissions.update(
            omission for k, (omission, _) in enumerate(self.loose) if k not in used
        )

    def _take(self, kind, points, place, filled):
        """Take an outline, or what the clip paths and viewports leave of a filled one."""
        if not place.clips:
            self.outlines.append(points)
            return
        area = _area(points)
        rest = shapely.intersection_all([area, *place.clips])
        if rest.area >= (1 - THIN) * area.area:
            self.outlines.append(points)
        elif rest.area <= THIN * area.area or not filled:
            self.omit(kind, place, "clipped")
        else:
            polygons = [
                part
                for part in shapely.get_parts(rest, return_index=False)
                if isinstance(part, shapely.Polygon)
            ]
            self.outlines += [
                np.asarray(ring.coords)
                for part in polygons
                for ring in (part.exterior, *part.interiors)
            ]


def _area(points) -> shapely.Geometry:
    return shapely.make_valid(shapely.Polygon(points))


def _is_painted(style, part) -> bool:
    """Whether the fill or the stroke of a shape is shown."""
    paint = style.get(part, PAINTS[part])
    zero = is_zero(style.get(f"{part}-opacity", "1")) or (
        part == "stroke" and is_zero(style.get("stroke-width", "1"))
    )
    return paint.lower() not in ("none", "transparent") and not zero


def _applies(values) -> bool:
    """Whether the conditions of an element hold in an English viewer without extensions."""
    languages = values.get("systemLanguage", "en").split(",")
    return "requiredExtensions" not in values and any(
        name.strip().lower().split("-")[0] == "en" for name in languages
    )


def _in_viewport(kind, values, place) -> Place:
    """The place inside a nested ``<svg>`` or a ``<symbol>`` in use."""
    x, y = (
        length(values.get(side, "0"), whole) if kind == "svg" else 0.0
        for side, whole in zip("xy", place.viewport, strict=True)
    )
    words = [values.get(side, "auto") for side in ("width", "height")]
    sides = [
        whole if word == "auto" else length(word, whole)
        for word, whole in zip(words, place.viewport, strict=True)
    ]
    known = np.isfinite(sides).all()
    if "viewBox" in values and not known:
        raise ValueError("size unknown")
    if not known:
        return place._replace(matrix=place.matrix @ shift(x, y))
    if min(sides) <= 0:
        return place._replace(hidden="no area")
    outer = place.matrix @ shift(x, y)
    clips = place.clips
    if values.get("overflow", "hidden") not in ("visible", "auto"):
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * sides
        clips = (*clips, shapely.Polygon(corners @ outer[:2, :2].T + outer[:2, 2]))
    if "viewBox" not in values:
        return place._replace(matrix=outer, viewport=tuple(sides), clips=clips)
    box = view_box(values["viewBox"])
    inner = outer @ view_matrix(box, values.get("preserveAspectRatio", ""), *sides)
    return place._replace(matrix=inner, viewport=(box[2], box[3]), clips=clips)
