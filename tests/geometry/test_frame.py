"""The frame of a periodic cell: which rectangle of the lattice is computed."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

import jaxgel
from jaxgel.geometry import arcs, check_plate, frame_of, image_offsets, outline_points, periods
from jaxgel.io import dry_gel

STRIP = {"left": "periodic", "right": "periodic", "bottom": "fixed", "top": "free"}
HOLES = [jaxgel.Ellipse((0.1, -0.2), (0.6, 0.4), 0.5), jaxgel.Circle((-0.85, 0.75), 0.15)]
ROUND_OFF = 1e-12  # mm, of lengths of a few mm


def shifted(holes, by):
    return [hole.translated(np.array(by)) for hole in holes]


def test_a_cell_whose_edges_lie_in_the_middle_of_a_widest_gap_keeps_its_frame():
    rows = [jaxgel.Circle((x, y), 0.6) for x in (-1, 1) for y in (-1, 1)]
    for plate in (
        jaxgel.Plate(4, 4, rows, edges="periodic"),  # the gaps between the holes are as wide
        jaxgel.Plate(2, 2, [jaxgel.Circle((0, 0), 0.7)], edges="periodic"),
        jaxgel.Plate(2, 2, edges="periodic"),
        jaxgel.Plate(4, 4, [jaxgel.Circle((0.3, 2), 1.1)]),
        jaxgel.Plate(2, 2, [jaxgel.Circle((0, 0.3), 0.6)], edges=STRIP),
    ):
        assert frame_of(plate).of(plate) is plate


@pytest.mark.parametrize("by", [(0.25, 0.125), (1.0, 1.0), (-7.3, 0.9)])
def test_the_frame_moves_with_the_lattice(by):
    """Holes and core have equal coordinates in it wherever the lattice lies.

    There is one widest gap along either axis.
    """
    plate, moved = (
        jaxgel.Plate(2, 2, holes, edges="periodic", core=core)
        for holes, core in (
            (HOLES, (-0.6, 0.1)),
            (shifted(HOLES, by), np.add((-0.6, 0.1), by).tolist()),
        )
    )
    one, other = (frame_of(cell).of(cell) for cell in (plate, moved))
    for hole, image in zip(one.holes, other.holes, strict=True):
        np.testing.assert_allclose(hole.centre, image.centre, rtol=0, atol=ROUND_OFF)
    np.testing.assert_allclose(one.core, other.core, rtol=0, atol=ROUND_OFF)
    without = frame_of(moved).of(jaxgel.Plate(2, 2, moved.holes, edges="periodic"))
    assert without.core is None  # the middle of the frame, a point of the lattice as well
    # the plate itself stays as given
    np.testing.assert_array_equal(moved.holes[0].centre, HOLES[0].centre + np.array(by))


def test_coordinates_in_the_frame_and_on_the_plate_are_those_of_one_point_of_the_lattice():
    rng = np.random.default_rng(3)
    plate = jaxgel.Plate(2, 3, [jaxgel.Circle((0.8, 1.4), 0.5)], edges="periodic")
    frame, points = frame_of(plate), rng.uniform(-0.99, 0.99, (50, 2)) * [1.0, 1.5]
    np.testing.assert_allclose(
        frame.to_given(frame.from_given(points)), points, rtol=0, atol=ROUND_OFF
    )
    inside = (
        np.abs(
            np.linalg.norm(
                frame.from_given(points) - np.array(frame.of(plate).holes[0].centre), axis=1
            )
        )
        < 0.5
    )
    apart = points - np.array([0.8, 1.4])
    nearest = np.linalg.norm(apart - np.round(apart / [2, 3]) * [2, 3], axis=1)
    np.testing.assert_array_equal(inside, nearest < 0.5)
    np.testing.assert_allclose(
        jax.jit(frame.to_given)(jnp.asarray(points)), frame.to_given(points), rtol=0, atol=ROUND_OFF
    )


@pytest.mark.parametrize("edges", ["periodic", STRIP])
def test_no_periodic_edge_of_the_frame_crosses_a_hole(edges):
    rng, big = np.random.default_rng(0), jaxgel.Circle((0.0, 0.0), 0.45)
    for _ in range(10):
        by = rng.uniform(-1, 1, 2) * [1.0, 0.2]
        plate = jaxgel.Plate(2, 2, shifted([big, jaxgel.Circle((0.3, 0.65), 0.1)], by), edges=edges)
        check_plate(plate)
        framed = frame_of(plate).of(plate)
        crossed = {
            edge
            for arc in arcs(framed)
            for edge in (arc.start_edge, arc.end_edge)
            if edge is not None
        }
        assert not {edge for edge in crossed if plate.edges[edge] == "periodic"}
        if edges is STRIP:
            assert [float(hole.centre[1]) for hole in framed.holes] == [
                float(hole.centre[1]) for hole in plate.holes
            ]


def test_a_lattice_without_a_straight_line_between_its_holes_is_refused_with_what_to_do():
    staggered = [jaxgel.Circle((0, 0), 0.6), jaxgel.Circle((1, 1), 0.6)]
    message = (
        r"^edges: left and right are periodic, but every line along y crosses a hole or region "
        r".*, or use roller edges along mirror lines"
    )
    with pytest.raises(ValueError, match=message):
        check_plate(jaxgel.Plate(2, 2, staggered, edges="periodic"))
    check_plate(
        jaxgel.Plate(
            2, 2, [jaxgel.Circle(hole.centre, 0.45) for hole in staggered], edges="periodic"
        )
    )
    with pytest.raises(ValueError, match=r"^holes\[0\], holes\[1\]: they overlap or touch"):
        check_plate(
            jaxgel.Plate(
                2,
                2,
                [jaxgel.Circle((-0.9, 0), 0.3), jaxgel.Circle((0.9, 0), 0.3)],
                edges="periodic",
            )
        )


def test_a_layer_keeps_its_place_and_its_frame():
    layer, hole = jaxgel.Rectangle((0, -0.6), (3, 0.5)), jaxgel.Circle((0.2, 0.3), 0.4)
    plate = jaxgel.Plate(2, 2, [hole], regions=[layer], edges=STRIP)
    assert frame_of(plate).of(plate) is plate
    across = jaxgel.Plate(
        2, 2, [hole.translated(np.array([0.6, 0.0]))], regions=[layer], edges=STRIP
    )
    with pytest.raises(
        ValueError,
        match=(
            r"^edges: left and right are periodic and cross a hole or region, but regions\[0\] is "
            r"a layer"
        ),
    ):
        check_plate(across)


def test_a_region_across_a_periodic_edge_lies_inside_the_frame():
    plate = jaxgel.Plate(2, 2, regions=[jaxgel.Circle((0.9, 1.0), 0.4)], edges="periodic")
    check_plate(plate)
    np.testing.assert_allclose(
        frame_of(plate).of(plate).regions[0].centre, 0.0, rtol=0, atol=ROUND_OFF
    )


def test_periods_and_translations_are_those_of_the_periodic_edges():
    assert periods(jaxgel.Plate(2, 3, edges=STRIP)).tolist() == [2.0, 0.0]
    assert sorted(image_offsets(jaxgel.Plate(2, 3, edges=STRIP)).tolist()) == [
        [-2.0, 0.0],
        [0.0, 0.0],
        [2.0, 0.0],
    ]
    assert len(image_offsets(jaxgel.Plate(2, 3, edges="periodic"))) == 9
    assert image_offsets(jaxgel.Plate(2, 3)).tolist() == [[0.0, 0.0]]


def test_the_drawn_area_of_a_crossing_hole_is_that_of_the_hole():
    plate = jaxgel.Plate(2, 2, [jaxgel.Circle((0.9, 1.0), 0.5)], edges="periodic")
    # the polygon of the circle
    assert dry_gel(plate).area == pytest.approx(4 - 0.25 * np.pi, abs=1e-4)
    moved = plate.at([{"centre": (0.2, 0.7)}])
    assert dry_gel(moved).area == pytest.approx(4 - 0.25 * np.pi, abs=1e-4)


def test_a_kind_of_hole_without_a_place_says_so():
    class Nowhere(jaxgel.Circle):
        shapes: ClassVar = {"radius": ()}

    with pytest.raises(
        ValueError,
        match=r"^Nowhere: has no parameter 'centre' or 'vertices'; define translated\(by\) for it$",
    ):
        Nowhere((0, 0), 1.0).translated(np.zeros(2))
    square = jaxgel.Polygon([(0, 0), (1, 0), (1, 1), (0, 1)]).translated(np.array([1.0, 2.0]))
    np.testing.assert_array_equal(
        outline_points(square, np.arange(4) / 4), [(1, 2), (2, 2), (2, 3), (1, 3)]
    )
    assert shapely.Polygon(square.vertices).area == 1.0
