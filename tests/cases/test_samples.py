import numpy as np
import pytest
import shapely

from jaxgel.cases import sample, sample_names
from jaxgel.geometry import Ellipse, arcs, check_plate, equal_arc_length, inside_holes
from jaxgel.paper.curves import PRINTED

COUNTS = {name: nodes for name, (nodes, _) in PRINTED.items()} | {"square": 49}
"""Nodes of Deng et al. (2020), Table 1 and section 5.3."""


def grid(ticks):
    return np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)


def n_nodes(plate):
    """Grid points outside the holes, and outline nodes, by the angle where circles are cut."""
    ticks = np.linspace(-plate.width / 2, plate.width / 2, round(plate.width / plate.spacing) + 1)
    on_outlines = (
        len(equal_arc_length(plate, arc, round(plate.nodes_per_hole * (arc.end - arc.start))))
        for arc in arcs(plate)
    )
    return np.sum(~inside_holes(plate, grid(ticks), 1e-9 * plate.spacing)) + sum(on_outlines)


@pytest.mark.parametrize("name", COUNTS)
def test_sample_has_the_papers_nodes(name):
    assert n_nodes(sample(name)) == COUNTS[name]


def test_all_samples_are_sound_plates():
    assert sample_names() == list(COUNTS)
    for name in sample_names():
        plate = sample(name)
        check_plate(plate)
        assert plate.name == name


@pytest.mark.parametrize(
    ("name", "ligament"), [("sample-4", 1.0), ("sample-7", 1.0), ("sample-1", 1.0)]
)
def test_largest_holes_leave_one_millimetre(name, ligament):
    outlines = [
        shapely.Polygon([hole.point(t) for t in np.arange(40) / 40]) for hole in sample(name).holes
    ]
    nearest = min(a.distance(b) for i, a in enumerate(outlines) for b in outlines[:i])
    # the nearest points are among the 40: axis ends and sides
    assert nearest == pytest.approx(ligament, abs=1e-12)


def test_long_axes_lie_along_x_in_the_first_and_third_quadrant():
    for name, semi_axes in (("sample-1", (5, 4)), ("sample-2", (5, 3)), ("sample-3", (4, 2.5))):
        plate = sample(name)
        assert len(plate.holes) == 4
        for hole in plate.holes:
            assert isinstance(hole, Ellipse)
            assert tuple(hole.semi_axes) == semi_axes
            end = np.asarray(hole.point(0.0) - hole.centre)
            along_x = float(hole.centre[0] * hole.centre[1]) > 0
            np.testing.assert_allclose(
                end, (semi_axes[0], 0) if along_x else (0, semi_axes[0]), atol=1e-14
            )


def test_areas_of_circles_and_squares_are_equal():
    for circles, squares in (
        ("sample-4", "sample-7"),
        ("sample-5", "sample-8"),
        ("sample-6", "sample-9"),
    ):
        np.testing.assert_allclose(
            sample(circles).holes[0].area(), sample(squares).holes[0].area(), rtol=1e-14
        )


def test_gels_walls_and_core_points_are_the_papers():
    assert (sample("sample-5").gel.Nv, sample("sample-5").gel.chi) == (1e-3, 1e-4)
    assert (sample("lattice").gel.chi, sample("lattice").core) == (1e-5, (1.0, 1.0))
    assert sample("square").gel.chi == 0.1
    assert dict(sample("square").edges) == {
        "left": "roller",
        "right": "roller",
        "bottom": "roller",
        "top": "free",
    }
    assert set(sample("lattice").edges.values()) == {"roller"}


def test_unknown_sample_is_answered_with_the_nearest_name():
    with pytest.raises(ValueError, match="case: unknown name 'sampel-3'; did you mean 'sample-3'"):
        sample("sampel-3")
