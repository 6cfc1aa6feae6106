"""Values in SVG files: style sheets, lengths, transforms, viewBox scale, shapes' points.

A user unit is a pixel of CSS, 1/96 inch. Matrices (3, 3) act on columns (x, y, 1). Sources: SVG 2,
CSS Transforms 1, CSS Values 3.
"""

import re
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from .._types import Float
from .drawing import FLATNESS

PIXEL = 25.4 / 96  # mm
# pixels
UNITS = {
    "px": 1.0,
    "mm": 1 / PIXEL,
    "cm": 10 / PIXEL,
    "q": 0.25 / PIXEL,
    "in": 96.0,
    "pt": 96 / 72,
    "pc": 16.0,
}
DEGREES = {"deg": 1.0, "grad": 0.9, "turn": 360.0, "rad": 180 / np.pi}
SHOWN = ("", "all", "screen")  # media of a viewer
SIDES = {"left": 0.0, "top": 0.0, "center": 0.5, "right": 1.0, "bottom": 1.0}
PHYSICAL = re.compile(r"\d\.?(mm|cm|q|in|pt|pc)\b", re.IGNORECASE)
MEASURES = (
    "x", "y", "width", "height", "cx", "cy", "r", "rx", "ry", "x1", "y1", "x2", "y2", "transform",
)  # fmt: skip


class Styles:
    """Attributes and properties of a file's elements, by the cascade of its ``<style>``."""

    def __init__(self, root: Any):
        from cssselect2 import Matcher

        self._matcher = Matcher()
        self._values: dict[Any, dict[str, str]] = {}
        self.ignored: list[str] = []
        """Rules that are not applied, such as "@import"."""
        for element in root.iter_subtree():
            if (
                element.local_name == "style"
                and element.etree_element.get("media", "all").lower() in SHOWN
            ):
                self._add("".join(element.etree_element.itertext()))

    def _add(self, text):
        import tinycss2
        from cssselect2 import SelectorError, compile_selector_list

        for rule in tinycss2.parse_stylesheet(text, skip_comments=True, skip_whitespace=True):
            if rule.type == "at-rule" and rule.lower_at_keyword == "media":
                if rule.content and tinycss2.serialize(rule.prelude).strip().lower() in SHOWN:
                    self._add(tinycss2.serialize(rule.content))
            elif rule.type == "qualified-rule":
                try:
                    selectors = compile_selector_list(rule.prelude)
                except SelectorError:
                    self.ignored.append(tinycss2.serialize(rule.prelude).strip())
                    continue
                for selector in selectors:
                    self._matcher.add_selector(selector, _declarations(rule.content))
            elif rule.type == "at-rule" and rule.lower_at_keyword == "import":
                self.ignored.append("@import")

    def of(self, element: Any) -> dict[str, str]:
        """Name -> value of an element's attributes, overridden by style sheets.

        It is a cssselect2 ``ElementWrapper``.
        """
        if element in self._values:
            return self._values[element]
        own = element.etree_element.attrib
        sources = [match[-1] for match in self._matcher.match(element) if match[2] is None]
        sources.append(_declarations(own.get("style", "")))
        values = {name: value.strip() for name, value in own.items() if name != "style"}
        for important in (False, True):
            for declarations in sources:
                values.update(
                    (name, value) for name, value, weight in declarations if weight == important
                )
        self._values[element] = values
        return values


def _declarations(content) -> list[tuple[str, str, bool]]:
    """Name, value and importance of the declarations of a block."""
    import tinycss2

    parsed = tinycss2.parse_blocks_contents(content, skip_comments=True, skip_whitespace=True)
    return [
        (d.lower_name, tinycss2.serialize(d.value).strip(), d.important)
        for d in parsed
        if d.type == "declaration"
    ]


def length(text: str, whole: float = np.nan) -> float:
    """A length in user units; a percentage is one of ``whole``.

    ValueError for another unit, or if ``whole`` is not known.
    """
    tokens = _tokens(text)
    value = _measure(tokens[0], whole) if len(tokens) == 1 else np.nan
    if not np.isfinite(value):
        raise ValueError(f"length {text!r}")
    return value


def _tokens(text) -> list:
    import tinycss2

    content = (
        tinycss2.parse_component_value_list(text, skip_comments=True)
        if isinstance(text, str)
        else text
    )
    return [part for part in content if part.type != "whitespace" and part != ","]


def is_zero(text: str) -> bool:
    """Whether an opacity or a width is zero."""
    tokens = _tokens(text)
    return (
        len(tokens) == 1
        and tokens[0].type in ("number", "percentage", "dimension")
        and tokens[0].value == 0
    )


def _measure(token, whole) -> float:
    """Pixels of a token; nan for what is not a length."""
    if token.type == "number":
        return token.value
    if token.type == "percentage":
        return token.value / 100 * whole
    return (
        token.value * UNITS.get(token.lower_unit, np.nan) if token.type == "dimension" else np.nan
    )


def _angle(token) -> float:
    """Radians of a token; nan for what is not an angle."""
    if token.type == "number":
        return np.deg2rad(token.value)
    return (
        np.deg2rad(token.value * DEGREES.get(token.lower_unit, np.nan))
        if token.type == "dimension"
        else np.nan
    )


def shift(x: float, y: float) -> Float[np.ndarray, "3 3"]:
    """Translation by x and y."""
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def transform(values: dict[str, str], viewport: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    """Matrix of the property or attribute ``transform`` about ``transform-origin``.

    Percentages are those of the viewport (width, height). ValueError for what is not understood.
    """
    text = values.get("transform", "none")
    matrix = np.eye(3)
    for token in _tokens(text) if text != "none" else []:
        part = _function(token, viewport)
        if part is None or not np.isfinite(part).all():
            raise ValueError(f"transform {text!r}")
        matrix = matrix @ part
    if "transform-origin" in values and text != "none":
        words = (values["transform-origin"].split() + ["50%"])[:2]
        if words[0] in ("top", "bottom") or words[1] in ("left", "right"):
            words.reverse()
        x, y = (
            SIDES[word] * side if word in SIDES else length(word, side)
            for word, side in zip(words, viewport, strict=True)
        )
        if not np.isfinite(x + y):
            raise ValueError(f"transform-origin {values['transform-origin']!r}")
        matrix = shift(x, y) @ matrix @ shift(-x, -y)
    return matrix


def _function(token, viewport):
    """Matrix of one function of a transform; None for what is not one."""
    if token.type != "function":
        return None
    name, arguments = token.lower_name, _tokens(token.arguments)
    number = [
        a.value if a.type == "number" else a.value / 100 if a.type == "percentage" else np.nan
        for a in arguments
    ]
    count = len(arguments)
    if name == "matrix" and count == 6:
        return np.array([number[0::2], number[1::2], [0.0, 0.0, 1.0]])
    if name == "rotate" and count in (1, 3):
        x, y = number[1:] or (0.0, 0.0)
        cos, sin = np.cos(_angle(arguments[0])), np.sin(_angle(arguments[0]))
        return (
            shift(x, y)
            @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
            @ shift(-x, -y)
        )
    axis = {"x": (1, 0), "y": (0, 1)}.get(name[-1]) if count == 1 else None
    if name in ("translate", "translatex", "translatey") and (
        axis or (name == "translate" and count in (1, 2))
    ):
        parts = [
            _measure(a, side)
            for a, side in zip(
                arguments, viewport[::-1] if axis == (0, 1) else viewport, strict=False
            )
        ]
        return shift(*(np.array(axis or (1, 0)) * parts[0] if count == 1 else parts))
    if name in ("scale", "scalex", "scaley") and (axis or (name == "scale" and count in (1, 2))):
        return np.diag(
            [*(np.where(axis, number[0], 1.0) if axis else (number[0], number[-1])), 1.0]
        )
    if name in ("skew", "skewx", "skewy") and (axis or (name == "skew" and count in (1, 2))):
        x, y = np.tan(
            np.array(axis or (1, 0)) * _angle(arguments[0])
            if count == 1
            else [_angle(a) for a in arguments]
        )
        return np.array([[1.0, x, 0.0], [y, 1.0, 0.0], [0.0, 0.0, 1.0]])
    return None


def view_box(text: str) -> list[float]:
    """Left, top, width and height of a viewBox.

    ValueError for others than four numbers, or without an area.
    """
    box = [_measure(token, np.nan) for token in _tokens(text)]
    if len(box) != 4 or not np.isfinite(box).all() or min(box[2:]) <= 0:
        raise ValueError(f"viewBox {text!r}")
    return box


def view_matrix(
    box: Sequence[float], ratio: str, width: float, height: float
) -> Float[np.ndarray, "3 3"]:
    """Matrix that fits a viewBox into a viewport by the preserveAspectRatio ``ratio``."""
    left, top, *size = box
    scale = np.array([width, height]) / size
    words = ratio.split() or ["xMidYMid"]
    if words[0] != "none":
        scale[:] = scale.max() if "slice" in words else scale.min()
    share = [
        {"min": 0.0, "mid": 0.5, "max": 1.0}.get(part.lower(), 0.5)
        for part in (words[0][1:4], words[0][5:8])
    ]
    room = np.array([width, height]) - scale * size
    return shift(*(share * room)) @ np.diag([*scale, 1.0]) @ shift(-left, -top)


def subpaths(
    kind: str, values: dict[str, str], viewport: Sequence[float]
) -> list[Float[np.ndarray, "_ 2"]]:
    """Points of the subpaths of a shape in its user units, of chords within FLATNESS of the size.

    Closed ones end at their first point. ValueError for path data that cannot be read.
    """
    from svgpathtools import parse_path

    text = values.get("d", "") if kind == "path" else _path_of(kind, values, viewport)
    lines, position = [], 0j
    for part in re.findall(r"[mM][^mMzZ]*[zZ]?|[^mMzZ]+[zZ]?", text.strip()):
        start = (
            part if part[0] in "mM" or not lines else f"M{position.real!r},{position.imag!r}{part}"
        )
        try:
            # of arcs without a radius, which are lines
            with warnings.catch_warnings(action="ignore"):
                path = parse_path(start, position) or parse_path(f"{start}h0", position)
        except (ValueError, IndexError, AssertionError, ArithmeticError):
            raise ValueError("path data that cannot be read") from None
        line = np.concatenate([_points(piece, 2) for piece in path] + [[path[-1].end]])
        tolerance = FLATNESS * max(np.ptp(line.real), np.ptp(line.imag))
        line = np.concatenate(
            [_points(piece, _chords(piece, tolerance)) for piece in path] + [[path[-1].end]]
        )
        position = complex(line[-1])
        lines.append(np.stack([line.real, line.imag], axis=1))
    if not all(np.isfinite(line).all() for line in lines):
        raise ValueError("path data that cannot be read")
    return [line for line in lines if np.ptp(line, axis=0).any()]


def _points(part, n) -> np.ndarray:
    """``n`` complex points (n,) at equal parameter steps of a segment, without its end.

    A line, an arc or a Bezier curve.
    """
    t = np.arange(n) / n
    if not hasattr(part, "radius"):
        return np.polyval(part.poly(return_coeffs=True), t) if n > 1 else np.array([part.start])
    angle = np.deg2rad(part.theta + t * part.delta)
    return part.center + part.rot_matrix * (
        part.radius.real * np.cos(angle) + 1j * part.radius.imag * np.sin(angle)
    )


def _chords(part, tolerance) -> int:
    """Number of chords of a line, an arc or a Bezier curve that stay within a tolerance of it."""
    if hasattr(part, "radius"):
        # largest second derivative
        bend = np.deg2rad(part.delta) ** 2 * max(part.radius.real, part.radius.imag)
    else:
        corners = np.array(part.bpoints())
        degree = len(corners) - 1
        bend = degree * (degree - 1) * max(abs(np.diff(corners, 2)), default=0.0)
    return (
        int(np.ceil(np.sqrt(bend / (8 * tolerance)))) or 1
        if tolerance > 0 and np.isfinite(bend)
        else 1
    )


def _path_of(kind, values, viewport) -> str:
    """Path data of a basic shape."""
    if kind in ("polyline", "polygon"):
        return (
            f"M{values.get('points', '')}{'z' * (kind == 'polygon')}"
            if values.get("points")
            else ""
        )
    wholes = {"x": viewport[0], "y": viewport[1], "r": np.hypot(*viewport) / np.sqrt(2)}
    wholes |= {"width": viewport[0], "height": viewport[1]}

    def at(name, default=0.0):
        axis = name if name in wholes else name.strip("cr12")
        return default if values.get(name, "auto") == "auto" else length(values[name], wholes[axis])

    if kind == "line":
        return f"M{at('x1')},{at('y1')}L{at('x2')},{at('y2')}"
    if kind == "rect":
        x, y, width, height = (at(name) for name in ("x", "y", "width", "height"))
        rx, ry = at("rx", at("ry")), at("ry", at("rx"))
        rx, ry = min(max(rx, 0.0), width / 2), min(max(ry, 0.0), height / 2)
        right, low = width - 2 * rx, height - 2 * ry
        if min(width, height) <= 0:
            return ""
        if min(rx, ry) <= 0:
            return f"M{x},{y}h{width}v{height}h{-width}z"
        corner = f"a{rx},{ry} 0 0 1 "
        there = f"h{right}{corner}{rx},{ry}v{low}{corner}{-rx},{ry}"
        back = f"h{-right}{corner}{-rx},{-ry}v{-low}{corner}{rx},{-ry}"
        return f"M{x + rx},{y}{there}{back}z"
    cx, cy = at("cx"), at("cy")
    rx, ry = (at("r"), at("r")) if kind == "circle" else (at("rx", at("ry")), at("ry", at("rx")))
    return (
        f"M{cx + rx},{cy}a{rx},{ry} 0 1 1 {-2 * rx},0a{rx},{ry} 0 1 1 {2 * rx},0z"
        if min(rx, ry) > 0
        else ""
    )
