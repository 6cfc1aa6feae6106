"""Sweeps with symmetric states on a part of the plate: the same paths as without."""

import dataclasses

import numpy as np
import pytest

import jaxgel
from jaxgel import Problem
from jaxgel.continuation import lowest_eigenvalue
from jaxgel.continuation.frames import Frames
from jaxgel.equilibrium import with_own_factor
from jaxgel.geometry import Circle, Plate
from jaxgel.mechanics import scatter
from jaxgel.symmetry import characters, representation_of, symmetries_of

GEL = jaxgel.Gel(1e-3, 1e-4)
MU = np.linspace(-4.5, -1.2, 9)


def both(model, values, gel=GEL, loads=None, **keywords):
    return [
        jaxgel.sweep(
            jaxgel.Problem(model, gel, loads=loads),
            values,
            symmetry=symmetry,
            eigenvalues=True,
            **keywords,
        )
        for symmetry in ("off", "auto")
    ]


def assert_same(off, auto, tolerance=1e-10):
    assert len(off) == len(auto) and off.stop == auto.stop
    np.testing.assert_allclose(auto.x, off.x, atol=tolerance)
    np.testing.assert_allclose(auto.energy, off.energy, rtol=1e-12)
    np.testing.assert_array_equal(auto.negative_pivots, off.negative_pivots)
    np.testing.assert_array_equal(auto.switched, off.switched)
    # of many unstable modes the whole plate may have followed others than the lowest
    few = off.negative_pivots < 2
    near = 8e-3 * np.abs(off.lowest_eigenvalue)  # what a sweep's eigenvalues are good to
    np.testing.assert_array_less(auto.lowest_eigenvalue, off.lowest_eigenvalue + near)
    np.testing.assert_array_less((off.lowest_eigenvalue - near)[few], auto.lowest_eigenvalue[few])


@pytest.fixture(scope="module")
def turned(coarse_model):
    """Sample 1, which has the rotations of a square."""
    return coarse_model


@pytest.fixture(scope="module")
def buckling(buckling_model):
    """Sample 4, which has all symmetries of a square and buckles near -1.6."""
    return buckling_model


@pytest.mark.slow
def test_path_with_rotations(turned):
    off, auto = both(turned, MU)
    assert_same(off, auto)
    assert set(auto.symmetry) == {"C4"} and set(off.symmetry) == {"C1"}
    np.testing.assert_allclose(
        auto.pressure, off.pressure, rtol=1e-6, atol=1e-7 * np.abs(off.pressure).max()
    )


@pytest.mark.slow
def test_eigenvalues_to_the_last_digits(turned):
    """`lowest_eigenvalue` is exact, of whole tangents: the states are the same."""
    off, auto = both(turned, MU[:4])
    np.testing.assert_allclose(lowest_eigenvalue(auto), lowest_eigenvalue(off), rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("branch", ["symmetric", "stable"])
def test_path_through_a_bifurcation(buckling, branch):
    """On the symmetric branch all mirrors stay, and what lies below 0 is counted block by block.

    The stable one keeps the rotations.
    """
    off, auto = both(buckling, MU, branch=branch)
    assert_same(off, auto, 1e-9)
    if branch == "symmetric":
        assert off.negative_pivots[-1] > 0 and set(auto.symmetry) == {"D4"}
    else:
        assert auto.symmetry[0] == "D4" and auto.symmetry[-1] == "C4" and auto.switched.sum() == 1


@pytest.mark.slow
def test_load_without_symmetry(buckling):
    loads = np.zeros((buckling.n_nodes, 2))
    loads[:, 0] = 1e-7
    off, auto = both(buckling, MU[:3], loads=loads)
    assert set(auto.symmetry) == {"D1 (y -> -y)"}
    assert_same(off, auto)


@pytest.mark.slow
def test_contact():
    """Sample 7 on an eighth of the plate, with contact by symmetric unknowns.

    Its corners close; the contact of all holes acts.
    """
    plate, steps = jaxgel.sample("sample-7"), []
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    off, auto = both(
        model,
        [-2.0, -1.0, -0.7, -0.55],
        plate.gel,
        branch="symmetric",
        observer=jaxgel.Observer(accepted=steps.append),
    )
    assert_same(off, auto, 1e-7)  # next to contact tangents are stiff, and round-off large
    assert set(auto.symmetry) == {"D4"} and any(state.touches for state in steps)


@pytest.mark.slow
def test_adaptive_steps(turned):
    off, auto = both(turned, jaxgel.Adaptive(-4.5, -2.0))
    np.testing.assert_allclose(auto.mu, off.mu, rtol=1e-12)
    assert_same(off, auto)


@pytest.mark.slow
def test_path_that_goes_on_from_a_state(buckling):
    steps = []
    whole = jaxgel.sweep(
        jaxgel.Problem(buckling, GEL),
        MU,
        observer=jaxgel.Observer(accepted=lambda state: steps.append(state.light)),
    )
    again = jaxgel.sweep(jaxgel.Problem(buckling, GEL), MU[5:], start=steps[4])
    np.testing.assert_allclose(again.x, whole.x[5:], atol=1e-9)
    assert again.symmetry == whole.symmetry[5:]


@pytest.mark.slow
def test_factor_by_blocks_is_that_of_the_whole_tangent(turned):
    """For any right-hand side, and its inertia; a symmetric one excites one block alone."""
    found = []
    for symmetry in ("off", "auto"):
        jaxgel.sweep(
            jaxgel.Problem(turned, GEL, contact=False),
            MU[:2],
            symmetry=symmetry,
            observer=jaxgel.Observer(accepted=found.append),
        )
    whole, blocks = (
        with_own_factor(Problem(turned, GEL, contact=False).prepared, found[1]).factor,
        found[-1].factor,
    )
    rhs = np.random.default_rng(3).normal(size=len(whole.pattern.free))
    np.testing.assert_allclose(
        blocks.accurate(rhs),
        whole.solve(rhs)[0],
        rtol=1e-8,
        atol=1e-9 * np.abs(whole.solve(rhs)[0]).max(),
    )
    assert blocks.negative_pivots == whole.negative_pivots
    assert blocks.size < whole.size
    symmetric = blocks.fields[0][0] @ np.ones(blocks.fields[0][0].shape[1])
    alone = dataclasses.replace(blocks, fields=blocks.fields[:1], factors=blocks.factors[:1])
    np.testing.assert_allclose(alone.accurate(symmetric), blocks.accurate(symmetric), rtol=1e-12)


@pytest.mark.thorough
def test_modes_of_a_block_that_none_was_followed_in_are_found(buckling):
    """From modes of the other blocks alone, the lowest of all is found in a few states."""
    problem = Problem(buckling, GEL, contact=False).prepared
    frame, states = Frames(problem, "auto").of(symmetries_of(problem)), []
    jaxgel.sweep(
        jaxgel.Problem(buckling, GEL, contact=False),
        MU[:1],
        observer=jaxgel.Observer(accepted=states.append),
    )
    state = frame.part(states[0])
    expected, _ = frame.check(state, None)
    symbols = [
        representation_of(characters(field_of(mode, state, problem), buckling))
        for mode in expected.vectors.T
    ]
    others = expected.vectors[:, [symbol != symbols[0] for symbol in symbols]]
    assert others.shape[1] > 0
    found = None
    for _ in range(4):
        found, _ = frame.check(state, others if found is None else found.vectors)
    assert found.eigenvalues[0] == pytest.approx(expected.eigenvalues[0], rel=1e-2)


def field_of(mode, state, problem):
    """A mode (f,) as fields (1, n, 2)."""
    return np.asarray(scatter(mode, problem.free))[None]


@pytest.mark.thorough
@pytest.mark.parametrize("symmetry", [pytest.param("off", marks=pytest.mark.slow), "auto"])
def test_edges_stay_in_their_places(symmetry):
    """To the bit, in a sweep of many given values.

    Extrapolation would let round-off of what all states share grow.
    """
    hole = Circle((0, 0) if symmetry == "auto" else (0.3, 0.2), 1)
    model = jaxgel.discretise(
        jaxgel.make_cloud(Plate(4, 4, [hole], spacing=0.5, nodes_per_hole=16))
    )
    path = jaxgel.sweep(jaxgel.Problem(model, GEL), np.linspace(-4.5, -2.5, 24), symmetry=symmetry)
    nodes = np.asarray(model.cloud.nodes)
    for edge, component in (("left", 0), ("right", 0), ("bottom", 1), ("top", 1)):
        on = model.cloud.topology.edge_nodes[edge]
        np.testing.assert_array_equal(
            np.asarray(path.x)[:, on, component],
            np.broadcast_to(nodes[on, component], (24, len(on))),
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "branch"),
    [
        ("sample-3", "stable"),
        ("sample-9", "stable"),
        ("lattice", "stable"),
        ("sample-4", "symmetric"),
    ],
)
def test_samples(name, branch):
    """States to 1e-10 where they are stable.

    Next to where an unstable one is nearly singular round-off grows more.
    """
    plate = jaxgel.sample(name)
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    off, auto = both(model, np.linspace(-4.9678, -1.2, 13), plate.gel, branch=branch)
    assert_same(off, auto, 1e-10 if branch == "stable" else 1e-8)
    assert auto.symmetry[0] == ("C4" if name < "sample-4" and name.startswith("sample") else "D4")
