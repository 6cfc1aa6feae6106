"""Wide steps next to an imperfect bifurcation stay on the branch that the sweep came along."""

import dataclasses

import numpy as np
import pytest

import jaxgel
from jaxgel import Problem
from jaxgel.continuation.follow import Followed, Following, _against_prediction
from jaxgel.continuation.frames import Frames
from jaxgel.mechanics import scatter


@pytest.fixture(scope="module")
def twisted_model():
    """Sample 4 with hole centres turned by a hundredth: it buckles without a bifurcation.

    Turned about the middle; it buckles to one side.
    """
    plate, c, s = jaxgel.sample("sample-4"), np.cos(0.01), np.sin(0.01)
    holes = [
        dataclasses.replace(hole, centre=tuple(np.asarray(hole.centre) @ [[c, -s], [s, c]]))
        for hole in plate.holes
    ]
    return jaxgel.discretise(
        jaxgel.make_cloud(dataclasses.replace(plate, holes=tuple(holes)), spacing=1.1)
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "mu",
    [[-3.0, -2.2, -1.3], np.arange(-1.9125, -1.45, 0.1)],
    ids=["across the unstable branch", "past the stable one that turns the other way"],
)
def test_a_plate_turns_on_in_the_direction_in_which_it_began(mu, twisted_model):
    """Without the last states' direction Newton ends 19 and 10 degrees on the other side."""
    path = jaxgel.sweep(
        jaxgel.Problem(twisted_model, twisted_model.cloud.plate.gel, contact=False), mu
    )
    rotation = np.asarray(jaxgel.core_rotation(path))
    assert path.stop.ok and not path.negative_pivots.any()
    assert rotation[0] > 0 and np.all(np.diff(rotation) > 0)


@pytest.mark.thorough
@pytest.mark.parametrize(("share", "ok"), [(1.0, True), (1e-9, True), (-1e-9, True), (-0.1, False)])
def test_only_a_prediction_that_says_something_refuses_a_step(share, ok, twisted_model):
    """A step along the softest mode, of which ``share`` was predicted."""
    problem = Problem(twisted_model, twisted_model.cloud.plate.gel, contact=False).prepared
    (last,) = Followed(problem, [-1.95], Following(eigenvalues=True))
    step = np.asarray(scatter(last.modes[:, 0], problem.free))
    found, predicted = (
        dataclasses.replace(last, mu=-1.9, x=np.asarray(last.x) + part * step)
        for part in (1.0, share)
    )
    frame = Frames(problem, "off").of(())
    assert _against_prediction(frame, found, predicted.x, last) != ok
