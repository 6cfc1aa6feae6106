"""Transient swelling: films with known uptake, balances, limits, and what is refused."""

import re

import jax
import numpy as np
import pytest

import jaxgel
from jaxgel.equilibrium import UNOBSERVED
from jaxgel.linalg import SingularTangent
from jaxgel.materials import layer_diffusivity, layer_stretch
from jaxgel.mechanics import all_volumes, carried, solvent_of, volume_ratios
from jaxgel.observables import events, solvent_flux
from jaxgel.transient import run as transient_run
from jaxgel.transient.march import GAMMA, jump_share

GOOD = jaxgel.Gel(1e-3, 0.1)
TIMES = [1e-3, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0]
# chemical potentials before and after, and the uptake at TIMES over that at the end, of a film of
# thickness 1 that is held sideways, sealed below and wetted above: finite volumes along the
# thickness, 3,200 graded cells (drying 1,200), all digits converged
FILMS = {
    "small jump": (
        GOOD,
        -0.5,
        -0.4999,
        [0.01797, 0.05683, 0.09844, 0.17972, 0.31129, 0.56622, 0.87604],
    ),
    "swelling": (GOOD, -1.0, -0.1, [0.01013, 0.03204, 0.05549, 0.10131, 0.17548, 0.31880, 0.52152]),
    "from the dry state": (
        jaxgel.Gel(1e-3, 1e-4),
        -4.9678,
        -0.9178,
        [0.02793, 0.08833, 0.15300, 0.27933, 0.48236, 0.80008, 0.98145],
    ),
    "drying": (GOOD, -0.1, -1.0, [0.01528, 0.04832, 0.08369, 0.15280, 0.26466, 0.48320, 0.83323]),
}


AXIAL = {"kinematics": "generalised plane strain", "axial_stretch": 1.3}


def film(spacing, width=None, edges=("top",), **options):
    """A film of thickness 1 with free ``edges``, by default the upper one."""
    plate = jaxgel.Plate(
        width or 8 * spacing,
        1.0,
        edges=dict.fromkeys(edges, "free") | options.pop("held", {}),
        **options,
    )
    return jaxgel.discretise(jaxgel.make_cloud(plate, spacing=spacing))


@pytest.fixture(scope="module")
def coarse():
    """A film of four squares."""
    return film(0.25)


def volumes(model):
    """Dry volumes of the groups that carry solvent, mm^2."""
    return np.where(np.asarray(model.carries), np.asarray(all_volumes(model)), 0.0)


def contents(path):
    """Solvent and network in the plate, mm^2, at each state."""
    return np.array(
        [volumes(path.model) @ np.asarray(volume_ratios(x, path.model)) for x in path.x]
    )


def uptake(problem, start, bath, times):
    """Path, and the uptake at its states over that in equilibrium."""
    path = jaxgel.swell(problem, bath, times, start=start)
    end = contents(jaxgel.sweep(problem, [bath]))[0]
    amounts = contents(path)
    return path, (amounts - amounts[0]) / (end - amounts[0])


SLOW_FILMS = [pytest.param(name, 0.1, marks=pytest.mark.slow) for name in ("swelling", "drying")]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "spacing"), [("swelling", 0.25), *SLOW_FILMS])
def test_the_uptake_of_a_film_is_that_of_finite_volumes(name, spacing):
    """While the layer is thinner than a square, and from 0.1 on.

    In a film that dries it is as thick as one to two of ten squares.
    """
    gel, start, bath, expected = FILMS[name]
    times = sorted(
        {
            *jaxgel.TimeSteps(3.0, first=1e-5 if spacing < 0.2 else 1e-4, per_decade=5).values(
                0.1, 1.0
            ),
            *TIMES,
        }
    )
    path, share = uptake(jaxgel.Problem(film(spacing), gel, contact=False), start, bath, times)
    errors = np.interp(TIMES, path.t, share) / expected - 1
    assert path.stop.ok and not path.negative_pivots.any()
    assert np.abs(errors[:3]).max() < 0.1  # -0.9 to -0.5 without the term of thin layers at 1e-3
    assert np.abs(errors[3:]).max() < 0.05  # of ten squares, drying 4.7 %, the other 0.3 %
    # of ten squares 0.5 %, a fifth of it by five steps to a decade
    assert np.abs(errors[5:]).max() < 0.01
    imbalance = np.diff(contents(path)) - np.diff(path.supplied[:, 0])
    solvent = contents(path)[1:] - volumes(path.model).sum()
    # of each step; of each unknown of mu Newton's method leaves 1e-12
    assert np.abs(imbalance / solvent).max() < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("name", FILMS)
def test_the_uptake_converges_with_the_spacing(name):
    """At a quarter of the spacing errors are smaller: 0.05 to 0.14 % from 0.1 on.

    Those from 0.03 on, of a boundary layer, are small.
    """
    gel, start, bath, expected = FILMS[name]
    errors = []
    for spacing in (0.1, 0.025):
        times = sorted({*jaxgel.TimeSteps(3.0, first=1e-6).values(spacing, 1.0), *TIMES})
        path, share = uptake(jaxgel.Problem(film(spacing), gel, contact=False), start, bath, times)
        errors.append(np.abs(np.interp(TIMES, path.t, share) / expected - 1))
    assert errors[1][2:].max() < 0.005 and errors[1][0] < 0.1
    assert errors[1][3:].max() < min(errors[0][3:].max(), 2e-3)


@pytest.mark.slow
def test_a_hole_whose_outline_cuts_the_cells_takes_up_what_a_half_space_does():
    hole = jaxgel.Ellipse((0.1, -0.05), (1.25, 1.0), 0.3)
    model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.Plate(4.0, 4.0, [hole], spacing=0.4)))
    gel, start, end, shares = FILMS["from the dry state"]
    times = np.array([1e-5, 1e-4, 4e-4, 1e-3, 4e-3])
    path = jaxgel.swell(jaxgel.Problem(model, gel, contact=False), end, times, start=start)
    # of the film, whose stretch goes from 1.00257 to 1.21203
    law = shares[0] * (1.21203 - 1.00257) * np.sqrt(times / TIMES[0])
    angles = np.linspace(0.0, 2 * np.pi, 2001)
    outline = np.stack([1.25 * np.cos(angles), np.sin(angles)], axis=1)
    length = np.linalg.norm(np.diff(outline, axis=0), axis=1).sum()
    # around a hole of radius R sqrt(pi D t) / (4 R) more than over a plane (Carslaw & Jaeger,
    # Conduction of heat in solids, 1959, section 13.5)
    D_m = np.pi / TIMES[0] * (shares[0] / 2) ** 2
    length = length + 2 * np.pi * np.sqrt(np.pi * D_m * times) / 4
    over = np.asarray(jaxgel.uptake(path))[1:] / (law * length)
    # within 1.1 %; 8 % less at the end with mu of the bath at the nodes of the outline alone, and
    # 20 % at the beginning by a first step that leaves a fifth out
    assert (np.abs(over - 1) < 0.015).all()


@pytest.mark.slow
def test_four_holes_take_up_what_cubic_finite_elements_do():
    """Sample 1 in a bath a little wetter than its gel: as linear diffusion between its holes.

    Mean volume ratio less that at the start, of 1,271 triangles (NGSolve, ``Swelling`` of
    benchmarks/ngsolve_swelling.py, 0.4 mm along the outlines, four steps to a decade).
    """
    times, expected = [0.05, 0.1, 0.2, 0.5, 1.0], [0.5386, 0.7544, 1.0705, 1.6918, 2.3448]  # 1e-5
    model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.sample("sample-1")))
    growing = jaxgel.TimeSteps(1.0, first=1e-3, per_decade=3).values(0.55, 1.0)
    steps = sorted({*growing.tolist(), *times})
    path = jaxgel.swell(jaxgel.Problem(model, GOOD, contact=False), -0.4999, steps, start=-0.5)
    share = (contents(path) - contents(path)[0]) / volumes(model).sum()
    errors = np.interp(times, path.t, share) / (1e-5 * np.array(expected)) - 1
    # -10 to -8 % up to 0.5 with mu of the bath at the nodes of the outlines alone
    assert (errors > -0.04).all() and (errors < 0.03).all()


@pytest.mark.thorough
@pytest.mark.parametrize(
    "axial", [pytest.param(None, marks=pytest.mark.slow), AXIAL["axial_stretch"]]
)
def test_a_small_jump_is_linear_diffusion(axial):
    """U = 1 - sum 8 / ((2j + 1)^2 pi^2) exp(-(2j + 1)^2 pi^2 D_eff t / 4).

    Also at a given axial stretch; time counts times D alone.
    """
    problem, odd = (
        jaxgel.Problem(film(0.125, **({} if axial is None else AXIAL)), GOOD, contact=False),
        2 * np.arange(200) + 1,
    )
    times = np.array(
        sorted({*jaxgel.TimeSteps(8.0, first=1e-4, per_decade=5).values(0.1, 1.0), 1.0, 3.0})
    )
    path, share = uptake(problem, -0.5, -0.499, times)
    D = float(
        jax.jit(
            lambda: layer_diffusivity(layer_stretch(-0.5, 1.0, GOOD, axial), 1.0, GOOD, axial, 1.0)
        )()
    )
    series = [
        1 - np.sum(8 / (odd * np.pi) ** 2 * np.exp(-((odd * np.pi) ** 2) * D * t / 4))
        for t in (1.0, 3.0)
    ]
    assert np.interp([1.0, 3.0], path.t, share) == pytest.approx(series, rel=5e-3)
    # of a jump of 1e-3
    assert jaxgel.uptake_fraction(path, jaxgel.sweep(problem, [-0.499])) == pytest.approx(
        share, rel=1e-6
    )
    faster = jaxgel.swell(problem, -0.499, times[:5] / 7, start=-0.5, D=7.0)
    assert np.abs(faster.x - path.x[:6]).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(
    "axial", [pytest.param(None, marks=pytest.mark.slow), AXIAL["axial_stretch"]]
)
def test_two_baths_drive_a_steady_flow_and_the_flux_is_the_inflow(axial):
    """Held sideways: flow from above to below through every cell, mu is neither's there."""
    options = {"held": {"left": "fixed"}} | ({} if axial is None else AXIAL)
    model = film(0.125, edges=("top", "bottom"), **options)
    path = jaxgel.swell(
        jaxgel.Problem(model, GOOD, contact=False),
        {"top": -0.5, "bottom": -0.6},
        [0.3, 3.0, 30.0, 100.0, 200.0, 300.0],
        start=-0.6,
        D=2.0,
    )
    through = np.asarray(solvent_flux(path)).mean(axis=1)[-1]
    rates = np.diff(path.supplied[-2:], axis=0)[0] / 100
    # at rest to 2e-7
    assert through[1] < 0 and -through[1] * model.cloud.plate.width == pytest.approx(
        rates[0], rel=1e-5
    )
    assert rates[0] > 0 and rates.sum() == pytest.approx(0.0, abs=1e-9 * rates[0])
    assert -0.6 < path.potential[-1][np.asarray(model.carries)].mean() < -0.5


@pytest.mark.slow
def test_a_plate_swells_to_the_equilibrium_of_its_bath():
    """Also with a network of finite chains, a printed field, a load and a sealed edge.

    What comes in is kept, the way there is another.
    """
    plate = jaxgel.Plate(
        1.4, 1.0, [jaxgel.Ellipse((0.02, 0.0), (0.3, 0.2), 0.2)], edges={"top": "free"}
    )
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.25, nodes_per_hole=8))
    gel = jaxgel.Gel(lambda X: 2e-3 + 5e-4 * X[0], 0.1, network=jaxgel.Gent(20.0))
    problem = jaxgel.Problem(
        model, gel, loads=jaxgel.load_vector(model, traction={"top": (0.0, 2e-4)}), contact=False
    )
    equilibrium = jaxgel.sweep(problem, [-0.9, -0.3])
    path = jaxgel.swell(problem, {0: -0.3}, [0.01, 1.0, 1e3, 1e5, 1e7], start=equilibrium[0])
    assert path.stop.ok and np.ptp(path.potential[-1][np.asarray(model.carries)]) < 1e-9
    assert np.abs(path.x[-1] - equilibrium.x[1]).max() < 1e-7
    assert (contents(path) - contents(path)[0])[:4] == pytest.approx(
        path.supplied[:4, 0], abs=1e-10
    )
    assert (
        path[2:].t.tolist() == path.t[2:].tolist()
        and path[2].potential.tolist() == path.potential[2].tolist()
    )
    on = jaxgel.swell(problem, {0: -0.3}, path.t[3:] - path.t[2], start=path[2])
    assert np.abs(on.x[-1] - path.x[-1]).max() < 1e-7  # from the state of another run


@pytest.mark.slow
def test_long_after_equilibrium_steps_still_end(coarse):
    """There round-off of mu times a stage's length exceeds the balance's tolerance."""
    problem = jaxgel.Problem(coarse, GOOD, contact=False)
    path = jaxgel.swell(problem, -0.5, [1.0, 1e3, 1e6, 1e9, 1e12], start=-1.0)
    assert path.stop.ok and path.newton_iterations.max() < 40
    assert np.abs(path.x[-1] - jaxgel.sweep(problem, [-0.5]).x[0]).max() < 1e-9


def lowest_ratio(problem, times):
    """Path from the dry state, and the least of J - 1 on it over that at its start."""
    path = jaxgel.swell(problem, -0.9678, times, start=-4.9678)
    J = np.stack([np.asarray(volume_ratios(x, path.model)) for x in path.x])[
        :, np.asarray(path.model.carries)
    ]
    return path, (J.min() - 1) / (J[0].min() - 1)


@pytest.mark.thorough
def test_thin_layers_leave_the_other_side_of_a_patch_as_it_is(coarse):
    """J - 1 falls by less than 3 %; by 9 % if all of the flow works on the slopes of mu."""
    path, lowest = lowest_ratio(
        jaxgel.Problem(coarse, jaxgel.Gel(1e-3, 1e-4), contact=False), [1e-4, 1e-3, 1e-2]
    )
    assert path.stop.ok and path.newton_iterations.max() <= 14 and lowest > 0.95


@pytest.mark.slow
def test_thin_layers_at_a_tilted_hole_leave_a_dry_gel_as_it_is():
    """J never falls to that of the polymer, and no step is cut.

    A cut costs hundreds of corrections.
    """
    plate = jaxgel.Plate(4.4, 4.4, holes=[jaxgel.Ellipse((-0.2, 0.05), (1.0, 1.0), 0.2)])
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.4))
    problem = jaxgel.Problem(model, jaxgel.Gel(1e-3, 1e-4), contact=False)
    path, lowest = lowest_ratio(problem, [1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2])
    assert path.stop.ok and path.newton_iterations.max() <= 14 and lowest > 0.3


@pytest.mark.thorough
def test_what_mu_moves_has_its_slope_in_layers_of_any_steepness(coarse):
    """Work between places of mu from -4 to -0.03 kT: Flory and Rehner's, to round-off."""
    model, gel, solvent = (
        coarse,
        jaxgel.Problem(coarse, GOOD, contact=False).gel,
        solvent_of(coarse, ("top",)),
    )
    mu = np.random.default_rng(0).uniform(
        -4.0, -0.03, len(model.carries) + len(solvent.wetting.node_parts)
    )
    pressure = np.full(len(model.carries), 0.01)

    def first_works(values):
        found = carried(pressure, values, model, gel, solvent)
        return [work[0] for work in found.work], [slope[0] for slope in found.slopes]

    _, slopes = jax.jit(first_works)(mu)
    for rates, slope, block in zip(
        jax.jit(jax.jacfwd(first_works))(mu)[0], slopes, solvent.blocks, strict=True
    ):
        places, own = np.unique(block.places[0], return_index=True)
        # of the work at the places of the first patch
        rates = np.asarray(rates)[np.ix_(own, places)]
        rates = rates - rates[:1]  # but for a constant
        expected = np.diag(np.asarray(slope)[own])
        np.testing.assert_allclose(rates, expected - expected[:1], atol=1e-13)


def beam(branch, observer=UNOBSERVED, *, bath=-0.5, start=-1.0):
    """Path of a beam between walls that swells from both sides and buckles, or stays.

    It keeps its symmetry when that becomes unstable.
    """
    model = film(0.25, width=4.0, edges=("top", "bottom"), held={"left": "fixed", "right": "fixed"})
    return jaxgel.swell(
        jaxgel.Problem(model, GOOD, contact=False),
        bath,
        [0.5, 2.0, 8.0],
        start=start,
        branch=branch,
        observer=observer,
    )


@pytest.mark.slow
def test_a_state_that_loses_stability_ends_the_path():
    """Or, by the ``branch``, the run goes on: events have times, derivatives are flagged."""
    refused, iterates = [], []
    path = beam(
        "stable",
        jaxgel.Observer(
            refused=refused.append, iteration=lambda state: iterates.append(state.value)
        ),
    )
    assert [(state.value, state.status.name) for state in refused][-1] == (2.0, "LOST_STABILITY")
    assert len(iterates) > path.newton_iterations.sum() and max(iterates) == 2.0
    assert path.t.tolist() == [0.0, 0.5] and not path.negative_pivots.any()
    assert (
        path.stop.name == "LOST_STABILITY"
        and "stopped after t = 0.5: at t = 2 the state is unstable" in path.stop_text
    )
    path = beam("symmetric", start=path)
    assert path.stop.ok and path.negative_pivots.tolist() == [0, 0, 1, 1]
    assert [int(status) for status in path.derivative] == [0, 0, 13, 13]
    nothing = np.ones(len(path))
    (event,) = events(
        {"t": path.t, "negative_pivots": path.negative_pivots}
        | dict.fromkeys(("surface_ratio", "surface_stability", "min_gap"), nothing)
    )
    assert (
        event["event"] == "bifurcation" and "from 0 to 1 between t = 0.5 and 2" in event["text"]
    ), event


@pytest.mark.thorough
def test_a_singular_tangent_ends_the_path(coarse, monkeypatch):
    """Whether its state is stable is not known.

    Here the tangent of the second state counts as singular.
    """
    pivots, factorised = [], transient_run.factorised_tangent

    def singular(*args):
        pivots.append(None)
        if len(pivots) == 2:
            raise SingularTangent("zero pivot")
        return factorised(*args)

    monkeypatch.setattr(transient_run, "factorised_tangent", singular)
    path = jaxgel.swell(
        jaxgel.Problem(coarse, GOOD, contact=False), -0.4999, [0.1, 0.2], start=-0.5
    )
    assert (
        path.t.tolist() == [0.0]
        and path.stop is jaxgel.Status.SINGULAR
        and "the tangent is singular" in path.stop_text
    )


@pytest.mark.slow
def test_a_derivative_beyond_a_loss_of_stability_is_warned_of():
    """With the times from which on."""
    with pytest.warns(
        jaxgel.IllPosedDerivative,
        match="swell: ill-posed derivative at t = 2, 8: the state is unstable",
    ):
        jax.jvp(lambda bath: beam("symmetric", bath=bath).x[-1], (-0.5,), (1.0,))


@pytest.mark.slow
def test_a_hole_that_closes_ends_the_path():
    """There is no contact in time; the states before are kept.

    A run that stops for this reason is in ``tests/cli/test_time_runs.py``.
    """
    slit = jaxgel.Plate(1.2, 1.2, [jaxgel.Ellipse((0.0, 0.0), (0.4, 0.05))])
    model = jaxgel.discretise(jaxgel.make_cloud(slit, spacing=0.3, nodes_per_hole=12))
    path = jaxgel.swell(
        jaxgel.Problem(model, GOOD, contact=False), -1.0, [1e-3, 1e-2, 0.1, 1.0], start=-4.0
    )
    assert (
        path.stop is jaxgel.Status.SELF_CONTACT
        and 1 < len(path) < 5
        and path.ok.all()
        and "touch or overlap" in path.stop_text
    )


@pytest.mark.thorough
def test_loads_alone_move_no_solvent_at_once(coarse):
    """At the least times the gel deforms and every group keeps its volume ratio."""
    loads = jaxgel.load_vector(coarse, traction={"top": (0.0, 1e-4)})
    free = jaxgel.Problem(coarse, GOOD, contact=False)
    before = jaxgel.sweep(free, [-0.5])[0]
    path = jaxgel.swell(
        jaxgel.Problem(coarse, GOOD, loads=loads, contact=False), -0.5, [1e-13], start=before
    )
    carries = np.asarray(coarse.carries)
    J = [np.asarray(volume_ratios(x, coarse))[carries] for x in path.x]
    assert (
        np.abs(J[1] - J[0]).max() < 1e-10
        and np.abs(path.potential[1] - path.potential[0])[carries].max() > 1e-5
    )


@pytest.mark.thorough
def test_times_that_differ_by_round_off_are_one_step_and_none(coarse):
    """The second state is the first; the steps after it are as without it."""
    problem, close = jaxgel.Problem(coarse, GOOD, contact=False), 0.01 * (1 + 4e-16)
    path = jaxgel.swell(problem, -0.3, [0.001, 0.01, close, 0.03], start=-0.5)
    without = jaxgel.swell(problem, -0.3, [0.001, 0.01, 0.03], start=-0.5)
    assert path.stop.ok and close > 0.01 and np.abs(path.x[[1, 2, 4]] - without.x[1:]).max() < 1e-10


def test_a_gel_in_the_bath_of_its_equilibrium_rests(coarse):
    """No solvent moves."""
    path = jaxgel.swell(jaxgel.Problem(coarse, GOOD, contact=False), -0.5, [0.1, 1.0], start=-0.5)
    assert np.abs(path.x - path.x[0]).max() < 1e-10 and np.abs(path.supplied).max() < 1e-11


@pytest.mark.thorough
def test_steps_in_time_are_of_second_order(coarse):
    """A ramp, whose end is a step: differences of 4, 8 and 16 steps fall by more than 2^1.8."""
    problem = jaxgel.Problem(coarse, GOOD, contact=False)
    bath = jaxgel.Bath([-1.0, -0.4], times=[0.0, 0.4])
    ends = [
        contents(jaxgel.swell(problem, bath, np.linspace(0, 0.8, 2 * n + 1)[1:], start=-1.0))[-1]
        for n in (2, 4, 8)
    ]
    assert (ends[0] - ends[1]) / (ends[1] - ends[2]) > 2**1.8


def test_a_bath_is_linear_between_its_times_and_ages():
    """The mean of 1 / sqrt(t) over its changes: of a jump, of a ramp, and of both."""
    jump, ramp = jaxgel.Bath(-0.1), jaxgel.Bath([-1.0, -0.5, -0.5], times=[0.0, 1.0, 5.0])
    assert jump.at(3.0) == -0.1 and jump.kinks == () and jump.inverse_root_age(4.0, -1.0) == 0.5
    assert ramp.at(0.5) == -0.75 and ramp.kinks == (1.0, 5.0)
    assert (
        jump.inverse_root_age(4.0, -1.0, rising=True) == 0.5
        and jump.inverse_root_age(4.0, 0.0, rising=True) == 0.0
    )
    assert ramp.inverse_root_age(1.0, -1.0) == pytest.approx(2.0)
    assert ramp.inverse_root_age(4.0, -1.0) == pytest.approx(2 * (2 - np.sqrt(3)))
    assert (
        ramp.inverse_root_age(1.0, -1.5) == pytest.approx((1 + 2) / 2)
        and jump.inverse_root_age(1.0, -0.1) == 0.0
    )


def test_stages_sum_up_what_enters_after_a_jump():
    """The integral of 1 / sqrt(t), from time 0 and later."""
    begin, end = np.array([0.0, 0.1, 3.0]), np.array([0.1, 0.4, 3.001])
    stages = np.stack([begin + GAMMA * (end - begin), end])
    rates = jaxgel.Bath(-0.1).inverse_root_age(stages, -1.0, share=jump_share(begin, end))
    total = (end - begin) * ([1 - GAMMA, GAMMA] @ rates)
    assert total == pytest.approx(2 * (np.sqrt(end) - np.sqrt(begin)), rel=1e-14)
    assert jump_share(0.0, 2.0) == pytest.approx(1.2504, abs=1e-4)
    assert np.isfinite(jax.grad(lambda end: jump_share(0.0, end))(2.0))


def test_what_time_does_not_cover_is_refused_in_one_line(coarse):
    """Each message names the field."""
    problem, sealed = (
        jaxgel.Problem(coarse, GOOD, contact=False),
        jaxgel.Plate(1.0, 1.0, edges={"top": "free"}, kinematics="plane stress"),
    )
    cell = jaxgel.Plate(1.0, 1.0, [jaxgel.Circle((0.0, 0.0), 0.2)], edges="periodic")
    poor = jaxgel.Gel(1e-3, 0.9)
    models = {
        plate: jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.25)) for plate in (sealed, cell)
    }
    cases = {
        "contact": (jaxgel.Problem(models[cell], GOOD), -0.5, [1.0]),
        "control": (
            jaxgel.Problem(coarse, GOOD, control=jaxgel.controls.chi(mu=-1.0), contact=False),
            -0.5,
            [1.0],
        ),
        "kinematics": (jaxgel.Problem(models[sealed], GOOD, contact=False), -0.5, [1.0]),
        "edges": (jaxgel.Problem(models[cell], GOOD, contact=False), -0.5, [1.0]),
        "gel": (jaxgel.Problem(coarse, poor, contact=False), -0.5, [1.0]),
        "bath: there is no 'topp'": (problem, {"topp": -0.5}, [1.0]),
        "bath: there is no 3": (problem, {3: -0.5}, [1.0]),
        "bath: nothing is wetted": (problem, {"top": None}, [1.0]),
        "bath.times": (problem, jaxgel.Bath, [1.0]),
        "times: 0 is": (problem, -0.5, [0.0, 1.0]),
        "times: 2 is followed by 1": (problem, -0.5, [2.0, 1.0]),
    }
    for field, (one, bath, times) in cases.items():
        with pytest.raises(ValueError, match=f"^{field.split(':')[0]}") as error:
            jaxgel.swell(
                one,
                jaxgel.Bath([-1.0, -0.5], times=[1.0, 0.5]) if bath is jaxgel.Bath else bath,
                times,
                start=-0.6,
            )
        assert str(error.value).startswith(field) and "\n" not in str(error.value)
    rested = jaxgel.swell(problem, -0.5, [1.0], start=-0.5)
    with pytest.raises(ValueError, match=r"^lowest_eigenvalue: is of states of equilibrium"):
        jaxgel.continuation.lowest_eigenvalue(rested)
    with pytest.raises(ValueError, match=r"^D: 0"):
        jaxgel.swell(problem, -0.5, [1.0], start=-0.6, D=0.0)


def test_a_wetted_part_of_one_node_is_refused(monkeypatch):
    """Clouds have at least two on every piece of the boundary, as at a cut-off edge."""
    model = film(0.25)
    nodes = jaxgel.mechanics.wetted_parts(model.lists)["top"]
    monkeypatch.setattr("jaxgel.mechanics.solvent.wetted_parts", lambda lists: {"top": nodes[:1]})
    with pytest.raises(
        ValueError,
        match=(
            r"^bath: 'top' has one node alone, what is wetted needs two at least; use a smaller "
            r"spacing$"
        ),
    ):
        solvent_of(model, ("top",))


@pytest.mark.thorough
def test_a_path_that_was_interrupted_goes_on_to_the_same_bits(coarse):
    """After its first state, and before and after a kink of the bath between two of its times."""
    problem, bath, times = (
        jaxgel.Problem(coarse, GOOD, contact=False),
        jaxgel.Bath([-1.0, -0.4], times=[0.0, 0.04]),
        [0.01, 0.03, 0.1, 0.3],
    )
    path = jaxgel.swell(problem, bath, times, start=-1.0, unit="h")
    for kept in (1, 3, 4):
        on = jaxgel.swell(path.problem, bath, times, start=path[:kept], unit="h")
        assert path.control.unit == on.control.unit == "h" and len(on) == 5
        for name in (
            "x",
            "pressure",
            "potential",
            "supplied",
            "value",
            "mu",
            "newton_iterations",
            "residual",
            "energy",
            "negative_pivots",
        ):
            np.testing.assert_array_equal(
                getattr(on, name), getattr(path, name), err_msg=f"{name} after {kept} states"
            )
    with pytest.raises(ValueError, match=r"^start: the path is not one of swell with these times"):
        jaxgel.swell(problem, bath, [0.02, 0.03], start=path[:3])


def test_a_step_ends_at_its_time_whatever_round_off_says(coarse):
    """Of these times a + (b - a) is below b; a further step would have no length."""
    a, b = next((a, 4.7 * a) for a in np.geomspace(1e-5, 1e-4, 50) if a + (4.7 * a - a) < 4.7 * a)
    path = jaxgel.swell(
        jaxgel.Problem(coarse, GOOD, contact=False), -0.5, [a, b, 3 * b], start=-0.6
    )
    assert path.stop.ok and path.t.tolist() == [0.0, a, b, 3 * b]


def test_a_step_at_which_newton_fails_is_cut(coarse):
    """With six corrections at most the step to 0.1 fails, and so does its half.

    Quarters succeed, then a step of a half, and the state is that of a run with these times.
    """
    problem = jaxgel.Problem(coarse, GOOD, contact=False)
    start = jaxgel.sweep(problem, [-1.0])[0]
    few = jaxgel.swell(
        problem, -0.1, [0.1], start=start, newton=jaxgel.equilibrium.Newton(max_iterations=6)
    )
    whole, parts = (
        jaxgel.swell(problem, -0.1, times, start=start) for times in ([0.1], [0.025, 0.075, 0.1])
    )
    assert (
        few.stop.ok
        and few.t.tolist() == [0.0, 0.1]
        and few.newton_iterations[1] > parts.newton_iterations.sum()
    )
    # Newton's tolerance; one step for three
    assert np.abs(few.x[1] - parts.x[3]).max() < 1e-9 < 1e-5 < np.abs(few.x[1] - whole.x[1]).max()


@pytest.mark.parametrize(
    ("newton", "missed"),
    [
        (
            jaxgel.equilibrium.Newton(tolerance=1e-30, max_iterations=6),
            r"residual of the forces \S+, tolerance 1e-30",
        ),
        (
            jaxgel.equilibrium.Newton(constraint_tolerance=1e-30, max_iterations=6),
            r"error of the volume ratios \S+, tolerance 1e-30",
        ),
    ],
    ids=["forces", "volume ratios"],
)
def test_a_step_that_fails_after_all_cuts_says_when_it_began_and_what_failed(
    newton, missed, coarse, monkeypatch
):
    """What is within its tolerance is not named."""
    monkeypatch.setattr("jaxgel.transient.march.MAX_HALVINGS", 2)
    problem = jaxgel.Problem(coarse, GOOD, contact=False)
    path = jaxgel.swell(problem, -0.5, [0.01, 0.1], start=-0.6)
    path = jaxgel.swell(problem, -0.5, [0.01, 0.1], start=path[:2], newton=newton)
    assert path.stop is jaxgel.Status.NOT_CONVERGED and path.t.tolist() == [0.0, 0.01]
    began, text = (
        "stopped after t = 0.01: the last step, from t = 0.01, failed",
        "Newton did not converge[^;]*;[^;]*",
    )
    assert re.fullmatch(f"{began}: {text}; {missed}", path.stop_text)


def test_a_failed_step_may_begin_between_two_times(coarse, monkeypatch):
    """At a kink of the bath, before which the gel rests and no correction is needed.

    Then neither forces nor solvent are in balance.
    """
    monkeypatch.setattr("jaxgel.transient.march.MAX_HALVINGS", 2)
    problem, bath = (
        jaxgel.Problem(coarse, GOOD, contact=False),
        jaxgel.Bath([-0.6, -0.6, -0.3], times=[0.0, 0.5, 0.6]),
    )
    start, newton = jaxgel.sweep(problem, [-0.6])[0], jaxgel.equilibrium.Newton(max_iterations=1)
    path = jaxgel.swell(problem, bath, [1.0], start=start, newton=newton)
    assert path.stop_text.startswith("stopped after t = 0: the last step, from t = 0.5, failed: ")
    assert all(
        text in path.stop_text
        for text in ("residual of the forces", "balance of the solvent", "tolerance 1e-12")
    )


def test_steps_between_two_times_are_finite_in_number(coarse, monkeypatch):
    """With Newton's method that never ends the path ends, and says so.

    The observer is told of each step.
    """
    monkeypatch.setattr("jaxgel.transient.march.MAX_STEPS", 5)
    problem = jaxgel.Problem(coarse, GOOD, contact=False)
    start, refused = jaxgel.sweep(problem, [-0.6])[0], []
    observer = jaxgel.Observer(refused=refused.append)
    path = jaxgel.swell(
        problem, -0.5, [1.0], start=start, newton=jaxgel.Newton(max_iterations=1), observer=observer
    )
    assert [state.status for state in refused] == 5 * [jaxgel.Status.NOT_CONVERGED]
    assert (
        path.stop is jaxgel.Status.NOT_CONVERGED
        and path.t.tolist() == [0.0]
        and "solvent" in path.stop_text
    )
