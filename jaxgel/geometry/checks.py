"""Validation of a plate: parameters, outlines, arrangement of holes and regions."""

import numpy as np
import shapely

from .._sizes import at_numbers
from .._validation import Inadmissible
from .frame import TOUCH, Frame, frame_of, sampled_outline
from .hole import Hole, outline_points
from .holes import Polygon, Superellipse
from .outline import outward
from .plate import Plate, edge_lines


def check_plate(plate: Plate) -> Frame:
    """The `Frame` in which a concrete plate is computed.

    ValueError, in one line that names the hole or region, for one that cannot be. That is: values
    that are not finite or not positive, outlines that cross themselves, holes outside the plate,
    with a side along its edge, overlapping or touching each other, swallowing the plate or cutting
    it into parts. The plate's edge may cut holes, and images of the holes of a periodic cell count.
    """
    for name in ("holes", "regions"):
        for k, outline in enumerate(getattr(plate, name)):
            _check_parameters(outline, f"{name}[{k}]")
    frame = frame_of(plate)
    plate = frame.of(plate)
    box = shapely.box(-plate.width / 2, -plate.height / 2, plate.width / 2, plate.height / 2)
    touch = TOUCH * min(plate.width, plate.height)
    apart = f"leave more than {touch:.2g} mm between them"
    holes, regions = (_checked_outlines(plate, name, box, touch) for name in ("holes", "regions"))
    inner = {
        "holes": shapely.intersection(holes, box),
        "regions": shapely.intersection(regions, box),
    }
    for name, shapes in inner.items():
        for i, j in np.argwhere(
            np.triu(shapely.dwithin(shapes[:, None], shapes[None, :], touch), 1)
        ):
            raise Inadmissible(f"{name}[{i}], {name}[{j}]: they overlap or touch; {apart}")
    rest = shapely.get_parts(shapely.difference(box, shapely.union_all(inner["holes"])))
    if len(rest) != 1:
        raise Inadmissible(
            f"holes: they cut the plate into {len(rest)} parts; leave one connected piece"
        )
    lines = [shapely.intersection(shapely.boundary(shapes), box) for shapes in (regions, holes)]
    for i, j in np.argwhere(shapely.dwithin(lines[0][:, None], lines[1][None, :], touch)):
        raise Inadmissible(f"regions[{i}], holes[{j}]: their outlines cross or touch; {apart}")
    for i, j in np.argwhere(shapely.contains(holes[:, None], inner["regions"][None, :])):
        raise Inadmissible(
            f"regions[{j}]: it lies in holes[{i}]; to fill a hole give its outline as a region "
            "instead"
        )
    return frame


def _check_parameters(hole: Hole, name: str) -> None:
    for parameter, value in hole.theta.items():
        value = np.asarray(value)
        if not np.isfinite(value).all():
            raise Inadmissible(f"{name}.{parameter}: {value.tolist()} is not finite; give numbers")
        if parameter in hole.positive and not (value > 0).all():
            raise Inadmissible(
                f"{name}.{parameter}: {value.tolist()} is not positive; give values above 0"
            )
    if isinstance(hole, Superellipse) and not 1 < hole.exponent <= 100:
        raise Inadmissible(f"{name}.exponent: {hole.exponent} is not in (1, 100]")
    if isinstance(hole, Polygon):
        sides = np.linalg.norm(hole.vertices - np.roll(hole.vertices, -1, axis=0), axis=1)
        if len(sides) < 3 or not (sides > 0).all():
            raise Inadmissible(
                f"{name}.vertices: {np.asarray(hole.vertices).tolist()} are not at least 3, each "
                "different from the next"
            )


def _checked_outlines(plate, name, box, touch):
    """Polygons of the ``holes`` or ``regions``, also outside the plate.

    ValueError for one that has no part or all of the plate.
    """
    found = np.empty(len(getattr(plate, name)), dtype=object)
    for k, outline in enumerate(getattr(plate, name)):
        where = f"{name}[{k}]"
        shape = found[k] = shapely.Polygon(sampled_outline(outline))
        if not shape.is_valid or not shape.exterior.is_ccw:
            raise Inadmissible(
                f"{where}: its outline crosses itself or runs clockwise; give a simple "
                "anticlockwise outline"
            )
        if shape.intersection(box).area <= touch**2:
            raise Inadmissible(
                f"{where}: it lies outside the plate, |x| <= {plate.width / 2:g}, |y| <= "
                f"{plate.height / 2:g}; move it in"
            )
        if shape.contains(box):
            raise Inadmissible(
                f"{where}: it covers the whole plate of {plate.width:g} x {plate.height:g} mm; "
                "make it smaller"
            )
        _check_edges(plate, outline, shape, where, touch)
    return found


def _check_edges(plate, hole, shape, where, touch):
    """Refuse a straight side on the plate's edge, and a polygon that touches an edge.

    If a hole moves, it is not defined whether the edge cuts a side that lies on it. A polygon may
    cross an edge.
    """
    corners = (
        at_numbers(outline_points, hole, np.asarray(hole.corners))
        if hole.corners
        else np.zeros((0, 2))
    )
    on_edge = np.abs(outward(plate, corners)) < touch
    for side in np.flatnonzero((on_edge & np.roll(on_edge, -1, axis=0)).any(axis=1)):
        middle = (corners[side] + corners[(side + 1) % len(corners)]) / 2
        if outward(plate, middle[None]).max() < touch:
            raise Inadmissible(
                f"{where}: its side {side} lies along the plate's edge; move it across the edge "
                "or away from it"
            )
    points = shapely.get_coordinates(shape)
    half, beyond = np.array([plate.width, plate.height]) / 2, outward(plate, points)
    for column, (edge, (axis, _)) in enumerate(edge_lines(plate).items()):
        beside = np.abs(points[:, 1 - axis]) < half[1 - axis] + touch
        if (
            plate.edges[edge] != "periodic"
            and abs(np.max(beyond[beside, column], initial=-np.inf)) < touch
        ):
            raise Inadmissible(
                f"{where}: it touches the {edge} edge; move it in by more than {touch:.2g} mm, or "
                "across the edge"
            )
