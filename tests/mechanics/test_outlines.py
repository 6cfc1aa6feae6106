"""Closed loops of cut holes: exact in affine motions and along prescribed edges."""

import functools
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

import jaxgel
from jaxgel.mechanics import crosses, held_dofs, outline_arcs, overlaps

F = np.array([[1.3, 0.1], [-0.2, 1.2]])
SHIFT = np.array([0.3, -0.7])
ROUND_OFF = 1e-10  # of positions of some mm: shape functions reproduce linear fields to 1e-12
CORNER = jaxgel.Circle((2.0, 2.0), 1.0)
TWO_PRONGS = [
    (3.0, -1.2),
    (3.0, 1.2),
    (1.0, 1.2),
    (1.0, 0.5),
    (2.5, 0.5),
    (2.5, -0.5),
    (1.0, -0.5),
    (1.0, -1.2),
]
HOLES = {
    "inside": jaxgel.Circle((0.3, 0.2), 1.0),
    "edge": jaxgel.Circle((2.0, 0.2), 1.0),
    "corner": CORNER,
    "opposite corner": jaxgel.Circle((-1.8, -2.1), 1.0),
    "two corners": jaxgel.Circle((2.0, 0.0), 2.4),
    "three corners": jaxgel.Circle((0.8, 0.8), 3.3),
    "two parts": jaxgel.Polygon(TWO_PRONGS),
}
EDGES = {
    "free": {"right": "free", "top": "free"},
    "roller": "roller",
    "fixed": "fixed",
    "mixed": {"right": "fixed", "top": "free"},
}


@functools.cache
def model_of(hole, edges):
    plate = jaxgel.Plate(4, 4, [HOLES[hole]], edges=EDGES[edges], spacing=0.5, nodes_per_hole=16)
    return jaxgel.discretise(jaxgel.make_cloud(plate))


def states(model, *x):
    return SimpleNamespace(model=model, x=jnp.stack([jnp.asarray(positions) for positions in x]))


def affine(model):
    return np.asarray(model.cloud.nodes) @ F.T + SHIFT


FEW = {"inside", "corner", "two parts"}
EACH = [pytest.param(hole, "free", marks=[pytest.mark.slow] * (hole not in FEW)) for hole in HOLES]


@pytest.mark.thorough
@pytest.mark.parametrize(("hole", "edges"), [*EACH, ("corner", "roller"), ("corner", "mixed")])
def test_every_loop_of_an_affinely_moved_plate_is_the_moved_dry_loop(hole, edges):
    model = model_of(hole, edges)
    moved = states(model, affine(model))
    for loop, dry in zip(
        jaxgel.observables.outlines(moved), jaxgel.observables.dry_outlines(model), strict=True
    ):
        np.testing.assert_allclose(loop[0], dry @ F.T + SHIFT, atol=ROUND_OFF)
    np.testing.assert_allclose(jaxgel.area_reduction(moved), 1 - np.linalg.det(F), atol=ROUND_OFF)
    np.testing.assert_allclose(
        jaxgel.area_reduction_per_hole(moved)[0], 1 - np.linalg.det(F), atol=ROUND_OFF
    )


@pytest.mark.parametrize("hole", ["edge", "corner", "two corners", "three corners", "two parts"])
def test_dry_loops_hold_what_the_hole_takes_of_the_plate(hole):
    """To 2e-3: loop sides are chords of a circle of 16 nodes and 128 vertices."""
    model = model_of(hole, "free")
    outline = jaxgel.geometry.outline_points(
        HOLES[hole], np.union1d(np.arange(2000) / 2000, HOLES[hole].corners)
    )
    taken = shapely.intersection(shapely.Polygon(outline), shapely.box(-2, -2, 2, 2))
    parts = shapely.get_parts(taken)
    loops = [shapely.Polygon(loop) for loop in jaxgel.observables.dry_outlines(model)]
    assert len(loops) == len(parts)
    assert sum(loop.area for loop in loops) == pytest.approx(taken.area, rel=2e-3)
    assert all(loop.is_valid and loop.exterior.is_ccw for loop in loops)


@pytest.mark.parametrize("edges", ["roller", "fixed", "mixed"])
def test_a_corner_follows_the_edges_that_prescribe_its_motion(edges):
    """Held components at the nodes are affine, all others are disturbed, whatever the gel."""
    model = model_of("corner", edges)
    motion = np.diag(np.diag(F)) if edges == "roller" else F
    x = np.asarray(model.cloud.nodes) @ motion.T + SHIFT
    disturbance = 0.05 * np.random.default_rng(7).normal(size=x.shape)
    x = x + np.where(held_dofs(model.lists.topology), 0.0, disturbance)
    (loop,) = jaxgel.observables.outlines(states(model, x))
    np.testing.assert_allclose(loop[0, -1], motion @ [2.0, 2.0] + SHIFT, atol=ROUND_OFF)


def test_area_over_a_free_corner_has_the_slope_of_differences():
    model = model_of("corner", "free")
    x, direction = affine(model), np.random.default_rng(3).normal(size=affine(model).shape)

    def reduction(t):
        return jaxgel.area_reduction(states(model, x + t * direction))[0]

    slope = jax.grad(reduction)(0.0)
    # the area is a polynomial of second degree but for the weights' constants: differences are
    # exact to round-off
    step = 1e-5
    np.testing.assert_allclose(slope, (reduction(step) - reduction(-step)) / (2 * step), rtol=1e-7)


def test_the_position_of_a_corner_is_continuous_where_it_enters_a_hole():
    """The corner moves as the outline's end next to it, to their distance times gradients."""
    small = jaxgel.Plate(
        4,
        4,
        [jaxgel.Circle((2.0, 1.001), 1.0 + 0.0005)],
        edges=EDGES["free"],
        spacing=0.5,
        nodes_per_hole=16,
    )
    model = jaxgel.discretise(jaxgel.make_cloud(small))
    X = np.asarray(model.cloud.nodes)
    x = X + 0.1 * np.stack([np.sin(X[:, 1]), X[:, 0] * X[:, 1]], axis=1)
    (loop,) = jaxgel.observables.outlines(states(model, x))
    dry = np.asarray(jaxgel.observables.dry_outlines(model)[0])
    corner = int(np.argmin(np.linalg.norm(dry - 2.0, axis=1)))
    nearest = np.argmin(np.linalg.norm(np.delete(dry, corner, axis=0) - dry[corner], axis=1))
    end = np.delete(np.asarray(loop[0]), corner, axis=0)[nearest]
    way = np.linalg.norm(np.delete(dry, corner, axis=0)[nearest] - dry[corner])
    assert way < 0.06
    assert np.linalg.norm(loop[0, corner] - end) < 2 * way


def test_aspect_ratio_of_a_quarter_hole_is_that_of_the_moved_quarter():
    """By the principal second moments of the moved dry loop, which shapely triangulates."""
    model = model_of("corner", "free")
    dry = np.asarray(jaxgel.observables.dry_outlines(model)[0]) @ F.T
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(shapely.Polygon(dry)))
    corners, areas = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3], shapely.area(parts)
    centre = areas @ corners.mean(axis=1) / areas.sum()
    # the middles of the sides integrate quadratics exactly
    middles = (corners + np.roll(corners, 1, axis=1)) / 2 - centre
    low, high = np.linalg.eigvalsh(np.einsum("t,tqi,tqj->ij", areas / 3, middles, middles))
    np.testing.assert_allclose(
        jaxgel.observables.aspect_ratio(states(model, affine(model)))[0, 0],
        np.sqrt(high / low),
        rtol=1e-9,
    )


def test_a_notch_whose_edge_bulges_beyond_its_mouth_does_not_cross_itself():
    """The line that closes a hole at a free edge is no surface of the gel."""
    model = model_of("edge", "free")
    X = np.asarray(model.cloud.nodes)
    bulged = X + np.stack(
        [1.3 * np.exp(-((X[:, 0] - 1.0) ** 2 + (X[:, 1] - 0.2) ** 2) / 0.1), np.zeros(len(X))],
        axis=1,
    )
    (loop,), (arc,) = (
        (np.asarray(part[0]) for part in jaxgel.observables.outlines(states(model, bulged))),
        outline_arcs(bulged, model),
    )
    assert not shapely.LinearRing(loop).is_simple
    assert shapely.LineString(np.asarray(arc)).is_simple
    assert not overlaps(bulged, model)


@pytest.mark.slow
def test_two_prongs_of_a_hole_do_not_cross_until_they_meet():
    model = model_of("two parts", "free")
    X = np.asarray(model.cloud.nodes)
    arcs = [np.asarray(arc) for arc in outline_arcs(X, model)]
    none = np.zeros((0, 2, 2))
    assert not crosses(arcs, none)
    assert crosses([arcs[0], arcs[1] + [0.0, 1.2]], none)
