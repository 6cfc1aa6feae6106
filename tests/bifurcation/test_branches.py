"""Branches of a bifurcation by switching, continuation, deflation, vanishing imperfections."""

import numpy as np
import pytest

import jaxgel
from jaxgel import Problem
from jaxgel.equilibrium import accepted, solve

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def point(buckling_point):
    return buckling_point


@pytest.fixture(scope="module")
def gel(buckling_model):
    return buckling_model.cloud.plate.gel


@pytest.fixture(scope="module")
def buckled(buckling_model, gel, point):
    """Both sides of the pitchfork, to mu = -1.3."""
    return [
        jaxgel.switch_branch(
            jaxgel.Problem(buckling_model, gel, contact=False), point, sign=sign, end=-1.3
        )
        for sign in (1, -1)
    ]


def test_both_sides_are_mirror_images(buckled):
    up, down = buckled
    np.testing.assert_allclose(up.mu, down.mu, atol=1e-6)
    np.testing.assert_allclose(
        jaxgel.core_rotation(up), -np.asarray(jaxgel.core_rotation(down)), atol=1e-4
    )
    assert abs(float(jaxgel.core_rotation(up)[-1])) > 15


def test_buckled_states_are_stable_and_cost_less_energy(buckled, buckling_model, gel):
    for path in buckled:
        assert path.stop.ok and path.mu[-1] == -1.3
        symmetric = jaxgel.sweep(
            jaxgel.Problem(buckling_model, gel), list(path.mu), branch="symmetric"
        )
        assert np.all(path.negative_pivots == 0)
        assert np.all(path.energy < symmetric.energy)


def test_the_branch_opens_with_the_curvature_of_the_critical_point(buckled, point, buckling_model):
    """mu - mu_c = curvature a^2 / 2 with the amplitude a in the network's norm.

    The next term is of order a^4.
    """
    from jaxgel.continuation import StabilityAnalysis

    problem = Problem(buckling_model, buckling_model.cloud.plate.gel, contact=False).prepared
    free = problem.pattern.free
    weighted = StabilityAnalysis(problem).stiffness @ point.modes[0].ravel()[free]
    amplitude = (buckled[0].x[:2] - point.x).reshape(2, -1)[:, free] @ weighted
    np.testing.assert_allclose(
        buckled[0].mu[:2] - point.mu, point.curvature * amplitude**2 / 2, rtol=0.02
    )


def test_the_stable_sweep_is_on_the_switched_branch(buckled, buckling_model, gel):
    """At the last mu of the switched branch, on one of its two sides."""
    path = jaxgel.sweep(jaxgel.Problem(buckling_model, gel, contact=False), [-2.2, -1.8, -1.3])
    assert list(path.switched) == [False, False, True]
    assert path.energy[-1] == pytest.approx(buckled[0].energy[-1], rel=1e-9)
    assert min(np.abs(path.x[-1] - side.x[-1]).max() for side in buckled) < 1e-6


def test_deflation_finds_both_sides_from_next_to_the_symmetric_state(
    buckling_model, gel, buckled, point
):
    symmetric = jaxgel.sweep(
        jaxgel.Problem(buckling_model, gel), [-2.2, -1.3], branch="symmetric"
    ).x[-1]
    push = 0.1 * point.modes[0] / np.abs(point.modes[0]).max()
    found = jaxgel.find_states_by_deflation(
        jaxgel.Problem(buckling_model, gel, contact=False),
        -1.3,
        known=[symmetric],
        starts=[symmetric + push, symmetric - push],
    )
    assert len(found) == 2
    for side in buckled:
        assert min(np.abs(np.asarray(state.x) - side.x[-1]).max() for state in found) < 1e-6


@pytest.mark.slow
def test_imperfect_gels_approach_the_switched_branch(buckled, buckling_model, gel, point):
    """Past the bifurcation the distance is proportional to the imperfection.

    Its sign chooses the side.
    """
    mu = [-2.2, -1.8, -1.7, -1.6, -1.45, -1.3]
    rotation = np.array([float(jaxgel.core_rotation(side)[-1]) for side in buckled])
    distance = []
    for size in (1e-2, 1e-3, -1e-3):
        path = jaxgel.sweep(
            jaxgel.Problem(
                buckling_model,
                gel,
                loads=jaxgel.imperfection(
                    jaxgel.Problem(buckling_model, gel, contact=False), point, size
                ),
            ),
            mu,
        )
        distance.append(float(jaxgel.core_rotation(path)[-1]) - rotation[0 if size > 0 else 1])
        # it buckles without a bifurcation
        assert not np.any(path.switched) and np.all(path.negative_pivots == 0)
    assert abs(distance[0]) < 2
    # -0.128 and -1.188: the second order of the larger size is 8 %
    assert distance[1] == pytest.approx(0.1 * distance[0], rel=0.1)
    assert distance[2] == pytest.approx(-distance[1], rel=1e-2)


@pytest.mark.slow
def test_continuation_turns_at_the_fold_of_an_imperfect_bifurcation(
    buckled, buckling_model, gel, point
):
    """The side against the imperfection has no dry state: followed back it ends in a fold.

    There it becomes unstable.
    """
    loads = jaxgel.imperfection(jaxgel.Problem(buckling_model, gel, contact=False), point, -1e-3)
    problem, start = Problem(buckling_model, gel, loads=loads, contact=False).prepared, buckled[0]
    found = [
        solve(problem, start.mu[k], start.x[k], start.pressure[k], own_factor=True)
        for k in (-1, -2)
    ]
    found = [accepted(problem, state, None) for state in found if state.status.ok]
    path = jaxgel.continue_branch(
        jaxgel.Path.from_states(problem, found), max_step=0.15, max_states=14
    )
    turn = int(np.argmin(path.mu))
    assert 0 < turn < len(path) - 1
    assert path.mu[turn] > point.mu
    assert np.all(path.negative_pivots[:turn] == 0) and np.all(
        path.negative_pivots[turn + 2 :] >= 1
    )
    (fold,) = jaxgel.folds(path)
    assert fold.kind == "fold" and abs(fold.eigenvalues[0]) < 1e-6 and fold.mu < path.mu.min()


def test_what_cannot_be_continued_is_refused(buckled, point):
    import dataclasses

    with pytest.raises(ValueError, match=r"^point: the fold at mu = "):
        jaxgel.switch_branch(
            jaxgel.Problem(buckled[0].model, buckled[0].gel, contact=False),
            dataclasses.replace(point, kind="fold"),
        )
    one = jaxgel.sweep(jaxgel.Problem(buckled[0].model, buckled[0].gel), [-3.0])
    with pytest.raises(ValueError, match=r"^path: 1 states do not give a direction"):
        jaxgel.continue_branch(one)
