"""Loops of a beam that snaps through under a transverse load, and of reversible plates.

These come back the way they went.
"""

import dataclasses
import json

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxgel
from jaxgel import Problem
from jaxgel.continuation import StabilityAnalysis
from jaxgel.controls import Driven, Load, Setting
from jaxgel.design import barrier_height, fold_up, loop_width, onset
from jaxgel.equilibrium import StateNotFound
from jaxgel.io import write_loop
from jaxgel.mechanics import restrict
from jaxgel.plotting import plot_loop

pytestmark = pytest.mark.thorough

MU = -1.4  # kT: the beam has buckled, and its limits of stability are folds; it buckles at -1.72
STEEP = -0.6  # it loses its stability to a mode that turns its middle, before the fold
AT = 0.02  # of the load, inside the loop


class Beam:
    """A gel of 10 x 1 mm between two walls, with a force across its middle; 63 nodes.

    It is free above and below.
    """

    def __init__(self):
        plate = jaxgel.Plate(
            10,
            1,
            [],
            edges={"left": "fixed", "right": "fixed", "top": "free", "bottom": "free"},
            spacing=0.5,
        )
        self.model = jaxgel.discretise(jaxgel.make_cloud(plate))
        nodes = np.asarray(self.model.cloud.nodes)
        middle = np.abs(nodes[:, 0]) < 1e-9
        self.loads = np.stack([np.zeros(len(nodes)), middle / middle.sum() * 1e-3], axis=1)
        self.middle = int(np.flatnonzero(np.abs(nodes).max(axis=1) < 1e-9)[0])
        self.gel = jaxgel.Gel(Nv=1e-2, chi=0.1)

    def control(self, mu=MU):
        """By the force."""
        return Load(self.loads, mu=mu, scale=0.1)

    def problem(self, gel=None, mu=MU):
        """The beam under the force."""
        return Problem(self.model, self.gel if gel is None else gel, control=self.control(mu))

    def loop(self, gel=None, mu=MU, values=(-0.5, 0.5), **options):
        """Up and down."""
        return jaxgel.loop(self.problem(gel, mu), values, **options)

    def height(self, state):
        """Of the middle above its dry place, mm."""
        return float(state.x[self.middle, 1])


@pytest.fixture(scope="module")
def beam():
    return Beam()


@pytest.fixture(scope="module")
def loop(beam):
    return beam.loop()


@pytest.mark.slow
def test_a_beam_snaps_at_two_folds_that_mirror_each_other(beam, loop):
    """Both are located to 1e-9 of the control's scale."""
    assert (loop.fold_up.kind, loop.fold_down.kind) == ("fold", "fold")
    assert loop.fold_up.value == pytest.approx(-loop.fold_down.value, abs=1e-9)
    assert loop.width == pytest.approx(2 * loop.fold_up.value, abs=1e-9)
    jumps = [way.switched[way.switched > 0].tolist() for way in (loop.up, loop.down)]
    assert jumps == [[jaxgel.Change.RELAXATION]] * 2
    assert not loop.up.negative_pivots.any() and not loop.down.negative_pivots.any()
    # one eigenvalue is 0, whose sign is round-off
    assert loop.critical.negative_pivots.tolist() == [-1, -1]
    heights = [beam.height(path[k]) for path in (loop.up, loop.down) for k in (0, -1)]
    assert np.sign(heights).tolist() == [-1, 1, 1, -1]
    assert str(loop) == (
        "Loop over load = -0.5 ... 0.5 ... -0.5: width 0.199341, jumps up load = 0.0996703 "
        "(fold), down load = -0.0996703 (fold); "
        f"unstable branch of {len(loop.unstable)} states, joined; converged"
    )


def test_the_unstable_branch_joins_both_folds(beam, loop):
    """Its states have one negative eigenvalue and lie between those of the folds.

    In the middle the beam is straight.
    """
    assert loop.joined and set(loop.unstable.negative_pivots.tolist()) == {1}
    values, heights = (
        loop.unstable.value,
        [beam.height(loop.unstable[k]) for k in range(len(loop.unstable))],
    )
    assert np.all(np.diff(values) < 0) and np.all(np.diff(heights) > 0)
    assert loop.fold_down.value < values[-1] < values[0] < loop.fold_up.value
    straight = np.interp(0.0, -values, heights)
    assert straight == pytest.approx(0.0, abs=1e-2)  # read off a chord


def test_states_on_either_side_are_distinct_inside_the_loop_only(beam, loop):
    up, down = loop.states_at(AT)
    assert (
        beam.height(up) < 0 < beam.height(down) and up.negative_pivots == down.negative_pivots == 0
    )
    mirrored, _ = loop.states_at(-AT)
    assert beam.height(mirrored) == pytest.approx(-beam.height(down), rel=1e-9)
    for outside in (-0.3, 0.3):
        np.testing.assert_allclose(*(state.x for state in loop.states_at(outside)), atol=1e-9)
    with pytest.raises(
        ValueError, match=r"^load: 0.6 is outside of the loop, which goes from -0.5 to 0.5$"
    ):
        loop.states_at(0.6)


def relocated(beam, v):
    """Folds and width of the beam with Nv, chi and mu."""
    found = beam.loop(jaxgel.Gel(v[0], v[1]), v[2], (-0.3, 0.3), unstable=False)
    return jnp.array([found.fold_up.value, found.fold_down.value, found.width])


def extrapolated(function, at, direction, step):
    """Derivative of a function by differences of two steps."""
    at, e = np.asarray(at), np.asarray(direction)
    near, far = (
        (np.asarray(function(at + s * e)) - np.asarray(function(at - s * e))) / (2 * s)
        for s in (step / 2, step)
    )
    return (4 * near - far) / 3


@pytest.mark.slow
def test_derivatives_of_folds_and_width_are_differences_of_relocated_ones(beam):
    """Along one direction of Nv, chi and mu, forwards and in reverse."""
    at, e = np.array([1e-2, 0.1, MU]), np.array([2e-2, 1.0, -0.7])
    _, slope = jax.jvp(lambda v: relocated(beam, v), (jnp.asarray(at),), (jnp.asarray(e),))
    np.testing.assert_allclose(
        slope, extrapolated(lambda v: relocated(beam, v), at, e, 1e-3), rtol=1e-5
    )
    reverse = jax.grad(lambda v: relocated(beam, v)[2])(jnp.asarray(at)) @ e
    # the same sum in another order
    assert float(slope[2]) == pytest.approx(float(reverse), rel=1e-9)


@pytest.mark.slow
def test_the_derivative_of_a_fold_by_the_load_itself_is_exact(beam):
    """With all forces twice as large the folds lie at half the load."""

    def located(size):
        found = jaxgel.loop(
            Problem(beam.model, beam.gel, control=Load(size * beam.loads, mu=MU, scale=0.1)),
            (-0.2, 0.2),
            unstable=False,
        )
        return jnp.stack([found.fold_up.value, found.fold_down.value])

    values, slopes = jax.jvp(located, (1.0,), (1.0,))
    np.testing.assert_allclose(slopes, -values, rtol=1e-8)


@pytest.mark.slow
def test_states_of_a_loop_refuse_derivatives(beam, loop):
    def energies(chi):
        found = beam.loop(jaxgel.Gel(1e-2, chi), values=(-0.2, 0.2), unstable=False)
        return found.up.energy[-1], found.states_at(0.0)[0].energy

    _, push = jax.linearize(energies, 0.1)
    for part, message in enumerate(
        (
            "loop: only the value of a jump of a result has",
            "states_at: only the value of a jump of the loop",
        )
    ):
        with pytest.raises(ValueError, match=f"^{message}"):
            jax.linear_transpose(lambda dot, part=part: push(dot)[part], 1.0)(1.0)
    with pytest.raises(ValueError, match=r"^barrier: only the height of a result has derivatives"):
        jax.grad(lambda v: jaxgel.barrier(beam.problem(), v, loop)[0].saddle.energy)(AT)


# --- barriers -------------------------------------------------------------------------------------


def test_the_barrier_is_that_of_one_saddle_by_arc_length_and_by_deflation(beam, loop):
    """The saddle has exactly one negative eigenvalue; without a load both sides are as high."""
    by_loop = jaxgel.barrier(beam.problem(), AT, loop)
    by_states = jaxgel.barrier(beam.problem(), AT, loop.states_at(AT))
    for one, other in zip(by_loop, by_states, strict=True):
        assert (
            one.saddle.negative_pivots == other.saddle.negative_pivots == 1
            and one.state.negative_pivots == 0
        )
        # energies of 1e-2 that differ by 4e-5
        assert one.height == pytest.approx(other.height, rel=1e-8)
    difference = by_loop[0].height - by_loop[1].height
    assert difference == pytest.approx(by_loop[1].state.energy - by_loop[0].state.energy, rel=1e-9)
    first, second = jaxgel.barrier(beam.problem(), 0.0, loop)
    assert first.height == pytest.approx(second.height, rel=1e-8) and first.height > 0


def barriers(beam, states, v):
    """Both heights at Nv, chi, mu and load."""
    return jnp.stack(
        [
            one.height
            for one in jaxgel.barrier(beam.problem(jaxgel.Gel(v[0], v[1]), v[2]), v[3], states)
        ]
    )


@pytest.mark.slow
def test_derivatives_of_a_barrier_are_differences(beam, loop):
    """Along a direction of Nv, chi, mu and the load, forwards and in reverse."""
    at, states, e = (
        np.array([1e-2, 0.1, MU, AT]),
        loop.states_at(AT),
        np.array([2e-2, 1.0, -0.7, 0.5]),
    )
    _, slope = jax.jvp(lambda v: barriers(beam, states, v), (jnp.asarray(at),), (jnp.asarray(e),))
    np.testing.assert_allclose(
        slope, extrapolated(lambda v: barriers(beam, states, v), at, e, 1e-3), rtol=1e-6
    )
    reverse = jax.jacrev(lambda v: barriers(beam, states, v))(jnp.asarray(at)) @ e
    np.testing.assert_allclose(slope, reverse, rtol=1e-9)  # the same sum in another order


def test_a_barrier_has_first_derivatives_only(beam, loop):
    states = loop.states_at(AT)

    def slope(v):
        return jax.jvp(lambda v: barriers(beam, states, v), (v,), (jnp.eye(4)[3],))[1]

    with pytest.raises(ValueError, match=r"^barrier: has first derivatives only"):
        jax.jvp(slope, (jnp.array([1e-2, 0.1, MU, AT]),), (jnp.eye(4)[3],))


def pushed_and_stretched(value, gel, mu, rate, loads):
    """A force across the gel while its walls move apart."""
    return Setting(
        mu, gel, deformation=jnp.diag(jnp.array([1.0 + rate * value, 1.0])), loads=value * loads
    )


@pytest.mark.slow
def test_a_control_may_move_the_edges_and_a_design_the_hole(beam):
    """Derivatives of barriers of a beam with a hole, by several parameters at once.

    By its semi-axis, the rate at which the walls move, and the control.
    """
    plate = dataclasses.replace(
        beam.model.cloud.plate, holes=(jaxgel.Ellipse((1.5, 0.05), (0.3, 0.2)),), nodes_per_hole=8
    )
    cloud = jaxgel.make_cloud(plate)
    middle = np.abs(np.asarray(cloud.nodes)[:, 0]) < 0.3
    loads = np.stack([np.zeros(len(middle)), middle / middle.sum() * 1e-3], axis=1)

    def control(rate):
        return Driven(pushed_and_stretched, (MU, rate, jnp.asarray(loads)), scale=0.1)

    states = jaxgel.loop(
        Problem(jaxgel.discretise(cloud), beam.gel, control=control(0.05), contact=False),
        (-0.4, 0.4),
        unstable=False,
    ).states_at(AT)

    def heights_at(v):
        model = jaxgel.discretise(cloud.at(plate.at([{"semi_axes": jnp.array([v[0], 0.2])}])))
        heights = [
            one.height
            for one in jaxgel.barrier(
                Problem(model, beam.gel, control=control(v[1]), contact=False), v[2], states
            )
        ]
        return jnp.stack(heights)

    at, e = np.array([0.3, 0.05, AT]), np.array([0.2, 1.0, 1.0])
    slopes = np.asarray(jax.jacrev(heights_at)(jnp.asarray(at)))
    difference = extrapolated(heights_at, at, e, 1e-3)
    # of the least of three terms
    np.testing.assert_array_less(
        np.abs(slopes @ e - difference), 1e-5 * np.abs(slopes * e).min(axis=1)
    )


@pytest.mark.slow
def test_a_saddle_off_the_unstable_branch_is_found(beam):
    """The steep beam loses its stability at a subcritical bifurcation.

    Deflation finds a straight state with two negative eigenvalues first, from which the saddle is
    reached along the second mode.
    """
    loop = beam.loop(mu=STEEP, values=(-2.0, 2.0))
    assert [point.kind for point in (loop.fold_up, loop.fold_down)] == ["bifurcation"] * 2
    assert loop.fold_up.subcritical and loop.fold_down.subcritical and loop.joined
    assert loop.fold_up.value == pytest.approx(-loop.fold_down.value, abs=1e-8)
    assert set(loop.unstable.negative_pivots.tolist()) == {1}
    heights = [
        jaxgel.barrier(beam.problem(mu=STEEP), AT, between)[0].height
        for between in (loop, loop.states_at(AT))
    ]
    assert heights[0] == pytest.approx(heights[1], rel=1e-8)


def test_one_state_twice_has_no_barrier(beam, loop):
    with pytest.raises(ArithmeticError, match=r"^barrier: both states are the same at load = 0.4$"):
        jaxgel.barrier(beam.problem(), 0.4, loop)


def test_a_saddle_needs_exactly_one_negative_eigenvalue(beam, loop, monkeypatch):
    """Where deflation finds nothing, and on the unstable branch as if it had two."""
    monkeypatch.setattr("jaxgel.bifurcation.barriers.find_states_by_deflation", lambda *_, **__: [])
    with pytest.raises(
        ArithmeticError,
        match=(
            r"^barrier: no equilibrium with exactly one negative eigenvalue was found at load = "
            r"0.02$"
        ),
    ):
        jaxgel.barrier(beam.problem(), AT, loop.states_at(AT))


# --- what is made of a loop -----------------------------------------------------------------------


def test_a_figure_shows_both_ways_and_the_branch_between_them(beam, loop):
    """The dashed line joins the dots; an arrow leads from each to the other branch."""
    ax = plot_loop(loop, lambda path: path.x[:, beam.middle, 1], label="height (mm)")
    lines = {line.get_label(): line.get_xydata() for line in ax.lines}
    dots = ax.lines[-1].get_xydata()
    np.testing.assert_allclose(dots[:, 0], [loop.fold_up.value, loop.fold_down.value])
    np.testing.assert_allclose(lines["unstable"][[0, -1]], dots)
    for way, dot, arrow in zip(("up", "down"), dots, ax.texts, strict=True):
        assert dot in lines[way] and np.isnan(lines[way][:, 1]).sum() == 1
        assert arrow.xy[0] == dot[0] and np.sign(arrow.xy[1]) == -np.sign(dot[1])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("load factor", "height (mm)")
    plt.close(ax.figure)


@pytest.mark.slow
def test_files_hold_the_jumps_and_all_states(loop, tmp_path):
    write_loop(loop, tmp_path, {"a": 1})
    record = json.loads((tmp_path / "loop.json").read_text())
    assert (record["control"], record["width"], record["joined"]) == ("load", loop.width, True)
    assert (
        record["fold_up"] == record["jumps_up"][0]
        and record["fold_up"]["value"] == loop.fold_up.value
    )
    header, *rows = [line.split(",") for line in (tmp_path / "loop.csv").read_text().splitlines()]
    assert header[:3] == ["way", "load", "mu"]
    assert [way for way, *_ in rows].count("unstable") == len(loop.unstable) and len(rows) == sum(
        map(len, (loop.up, loop.down, loop.unstable))
    )


@pytest.mark.slow
def test_switches_are_objectives_of_a_path(beam, loop):
    """Of a path that comes nowhere near the switch; a gel that does not switch has no fold."""
    path, of = jaxgel.sweep(Problem(beam.model, beam.gel), [-3.0]), ((-0.2, 0.2), beam.control())
    assert loop_width(*of)(path) == pytest.approx(loop.width, abs=1e-9)
    assert barrier_height(AT, *of)(path) == pytest.approx(
        jaxgel.barrier(beam.problem(), AT, loop)[0].height, rel=1e-8
    )
    tame = (-0.2, 0.2), beam.control(-3.0)
    with pytest.raises(StateNotFound, match="it has no fold_up"):
        fold_up(*tame)(path)
    with pytest.raises(StateNotFound):
        barrier_height(AT, *tame)(path)
    assert loop_width(*tame)(path) == 0


def test_an_onset_is_an_objective_of_a_path(beam):
    path = jaxgel.sweep(Problem(beam.model, beam.gel), [-3.0])
    (point,) = jaxgel.critical_points(Problem(beam.model, beam.gel), (-3.0, -1.5), most=1)
    assert onset((-3.0, -1.5))(path) == point.value
    with pytest.raises(StateNotFound, match="it has no onset"):
        onset((-3.0, -2.5))(path)


@pytest.mark.slow
def test_an_objective_has_the_gradient_of_the_loop(beam):
    def width(chi):
        path = jaxgel.sweep(Problem(beam.model, jaxgel.Gel(1e-2, chi)), [-3.0])
        return loop_width((-0.2, 0.2), beam.control())(path)

    # that of the differences above
    assert float(jax.grad(width)(0.1)) == pytest.approx(-0.949083, rel=1e-5)


# --- without a loop -------------------------------------------------------------------------------


@pytest.mark.slow
def test_up_and_down_are_the_same_branch_where_there_is_no_fold(beam):
    """Far below its buckling the beam only bends: states at the same loads to 1e-9 mm."""
    loop = beam.loop(mu=-3.0)
    assert (loop.fold_up, loop.fold_down, loop.width, loop.unstable) == (None, None, 0.0, None)
    assert loop.text == "no loop: up and down the same branch, width 0"
    for value in (-0.3, 0.1, 0.45):
        np.testing.assert_allclose(*(state.x for state in loop.states_at(value)), atol=1e-9)


@pytest.mark.slow
def test_a_buckled_plate_comes_back_through_its_bifurcation(buckling_model, buckling_point):
    """Sample 4: the way down repeats the way up and is straight below the critical mu."""
    mu = [-2.2, -1.7, -1.55, -1.45]
    path = jaxgel.sweep(Problem(buckling_model, buckling_model.cloud.plate.gel), [*mu, *mu[-2::-1]])
    assert mu[1] < buckling_point.value < mu[2]
    rotation = np.asarray(jaxgel.core_rotation(path))
    np.testing.assert_allclose(rotation, rotation[::-1], atol=1e-9)
    assert np.abs(rotation[:2]).max() < 1e-9 < 5 < np.abs(rotation[2])


@pytest.mark.slow
def test_a_supercritical_bifurcation_is_no_jump(buckling_model):
    loop = jaxgel.loop(Problem(buckling_model, buckling_model.cloud.plate.gel), (-2.2, -1.45))
    assert loop.width == 0.0 and loop.fold_up is None and loop.up.switched.any()


@pytest.mark.slow
def test_with_an_imperfection_the_departure_grows_by_its_cube_root(buckling_model, buckling_point):
    """At the critical mu, along the mode: 0.332 to 0.328 for loads of 1e-3 to 1.6e-2 spacings."""
    gel, sizes, departures = (
        buckling_model.cloud.plate.gel,
        [1e-3, 4e-3, 1.6e-2],
        {"up": [], "down": []},
    )
    analysis = StabilityAnalysis(Problem(buckling_model, gel, contact=False).prepared)
    free = analysis.problem.free
    weighted, critical = (
        analysis.stiffness @ restrict(buckling_point.modes[0], free),
        float(buckling_point.value),
    )
    for size in sizes:
        loads = jaxgel.imperfection(
            Problem(buckling_model, gel, contact=False), buckling_point, size
        )
        path = jaxgel.sweep(
            Problem(buckling_model, gel, loads=loads, contact=False),
            [-2.2, -1.85, -1.7, critical, -1.5, -1.55, critical],
        )
        assert not path.negative_pivots.any() and not path.switched.any()
        for way, k in (("up", 3), ("down", 6)):
            departures[way].append(
                abs(weighted @ restrict(np.asarray(path.x[k]) - buckling_point.x, free))
            )
    np.testing.assert_allclose(departures["up"], departures["down"], rtol=1e-7)
    for departure in departures.values():
        exponents = np.diff(np.log(departure)) / np.diff(np.log(sizes))
        np.testing.assert_allclose(exponents, 1 / 3, atol=0.05)


def pushed(value, gel, loads, push):
    """The force across the beam and a push besides it."""
    return Setting(mu=STEEP, gel=gel, loads=value * loads + push)


@pytest.mark.slow
def test_the_fold_of_an_imperfect_subcritical_bifurcation_moves_by_the_two_thirds_power(beam):
    """The push turns the middle, as the mode does, with forces of 1.6 to 25.6 % of the load's unit.

    Of folds at sizes with the ratio 4 the distances grow by 4^p whatever the perfect value, which
    is 1.31670. p = 0.654 measured, and 0.664 and 0.658 with it. A loop finds the same folds, and
    not the bifurcation next to them, from steps as long as the distance to zero.
    """
    nodes, values = np.asarray(beam.model.cloud.nodes), [-2.0, -1.0, 0.0, 0.5, 0.7, 0.8]
    turning = np.stack([0 * nodes[:, 0], np.sin(2 * np.pi * nodes[:, 0] / 10)], axis=1)
    turning *= 1e-3 / np.abs(turning).sum()
    found = []
    for size in (0.016, 0.064, 0.256):
        control = Driven(pushed, (beam.loads, size * turning), scale=0.1)
        path = jaxgel.sweep(Problem(beam.model, beam.gel, control=control), values)
        branch = jaxgel.continue_branch(path, max_step=0.5, max_states=25)
        assert not path.negative_pivots.any() and branch.negative_pivots[-1] == 1
        (fold,) = jaxgel.folds(branch)
        found.append(float(fold.value))
        loop = jaxgel.loop(
            Problem(beam.model, beam.gel, control=control), (-2.0, 2.0), unstable=False
        )
        assert [point.kind for point in (loop.fold_up, loop.fold_down)] == ["fold"] * 2
        # turned by half a turn they are one
        np.testing.assert_allclose(
            [loop.fold_up.value, -loop.fold_down.value], found[-1], atol=1e-8
        )
    near, far = -np.diff(found)
    assert np.log(far / near) / np.log(4) == pytest.approx(2 / 3, abs=0.05)


def test_ends_that_are_no_ends_are_refused(beam, refused):
    refused(
        lambda values: beam.loop(values=values),
        [
            (
                (0.1, 0.1),
                r"load: 0.1 is followed by 0.1, the values must differ from one to the next",
            ),
            ([-0.5], r"load: \[-0.5\] is not accepted, it must be two numbers \(first, last\)"),
            (
                (-0.5, 0.1, 0.5),
                r"load: \(-0.5, 0.1, 0.5\) is not accepted, it must be two numbers \(first, last\)",
            ),
        ],
        whole=True,
    )


def test_a_loop_that_cannot_go_on_says_why(beam):
    """After three states of both ways together."""
    loop = beam.loop(max_steps=3)
    assert loop.down is None and loop.width is None
    assert (
        loop.stop_text.startswith("stopped after load = ") and "raise max_steps" in loop.stop_text
    )
    with pytest.raises(ValueError, match=r"^load: the loop has no way down, stopped after"):
        loop.states_at(0.0)
