"""Sweeps in mu: given and chosen steps, continuation, ends, and no second compilation."""

import contextlib
import dataclasses
import weakref

import jax
import numpy as np
import pytest

import jaxgel
from jaxgel import Problem
from jaxgel.continuation import SweepFailed
from jaxgel.continuation.predictor import predict
from jaxgel.equilibrium import State, Status
from jaxgel.linalg import factors as linear_solve
from jaxgel.linalg import multifrontal
from jaxgel.materials import Gel, Gent, limits_of_stability, neo_hookean


@pytest.fixture(scope="module")
def given(tiny_model):
    """Ten given steps and what was called on the way."""
    seen = []
    path = jaxgel.sweep(
        jaxgel.Problem(tiny_model, tiny_model.cloud.plate.gel),
        np.linspace(-4.9678, -0.9678, 10),
        observer=jaxgel.Observer(accepted=seen.append),
    )
    return path, seen


@pytest.mark.thorough
def test_given_steps_are_all_there_in_order(given, tiny_model):
    path, seen = given
    np.testing.assert_array_equal(path.mu, np.linspace(-4.9678, -0.9678, 10))
    assert path.x.shape == (10, tiny_model.n_nodes, 2)
    assert path.pressure.shape[0] == len(path) == 10
    assert path.ok.all() and not path.switched.any()
    assert set(path.derivative) == {Status.NOT_EXAMINED}
    assert path.stop.ok
    assert path.residual.max() < 1e-10
    assert np.all(path.newton_iterations >= 1)
    assert np.all(path.negative_pivots == 0)
    assert np.all(np.diff(path.energy) < 0)  # dE/dmu = -(J - 1) V
    assert [step.mu for step in seen] == list(path.mu)
    np.testing.assert_array_equal(np.stack([step.x for step in seen]), path.x)


def test_slices_and_arrays_of_numbers_are_paths_of_these_states(given):
    path, _ = given
    for chosen in (
        slice(-3, None),
        slice(None, None, 4),
        [0, 7],
        np.array([9, 2]),
        path.mu > -2.0,
        np.zeros(10, dtype=bool),
    ):
        part, numbers = (
            path[chosen],
            np.arange(10)[
                chosen
                if isinstance(chosen, slice)
                else np.asarray(chosen, dtype=None if len(chosen) else int)
            ],
        )
        assert isinstance(part, jaxgel.Path)
        np.testing.assert_array_equal(part.mu, path.mu[numbers])
        np.testing.assert_array_equal(part.x, path.x[numbers])
        np.testing.assert_array_equal(part.status, path.status[numbers])
        assert len(part.symmetry) == len(numbers)
    assert path[-1].mu == path[np.int64(9)].mu == path.mu[9]
    with pytest.raises(IndexError, match=r"^path: has no state 10; it has 10"):
        path[10]


@pytest.mark.slow
def test_the_derivative_of_a_sweep_is_that_of_its_network_after_a_sweep_with_another():
    """Held edges without holes: equal positions and pressures for all networks, other tangents."""
    plate = jaxgel.Plate(1.0, 1.0, [], edges="fixed", deformation=((1.3, 0.0), (0.0, 1.3)))
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.25))
    force, row = (
        np.zeros((model.n_nodes, 2)),
        np.argmin(np.sum(np.asarray(model.cloud.nodes) ** 2, axis=1)),
    )
    force[row, 1] = 1e-3

    def deflection(network):
        gel = Gel(0.1, 0.1, network=network)

        def of(load):
            return jaxgel.sweep(jaxgel.Problem(model, gel, loads=load * force), [-1.0]).x[0, row, 1]

        return jax.vjp(of, 0.0)[1]

    (alone,) = deflection(neo_hookean)(1.0)
    first, second = deflection(neo_hookean), deflection(Gent(3.0))
    np.testing.assert_allclose(first(1.0)[0], alone, rtol=1e-9)
    assert second(1.0)[0] < 0.9 * alone  # the other network is stiffer


@pytest.mark.slow
def test_a_part_of_a_path_has_the_derivatives_of_the_whole(tiny_model):
    def reduction(chi, part):
        path = jaxgel.sweep(jaxgel.Problem(tiny_model, Gel(1e-3, chi)), [-3.0, -2.0])
        return jaxgel.area_reduction(path[part])[0]

    whole = jax.grad(
        lambda chi: jaxgel.area_reduction(
            jaxgel.sweep(jaxgel.Problem(tiny_model, Gel(1e-3, chi)), [-3.0, -2.0])
        )[1]
    )(0.1)
    assert whole != 0
    for part in (slice(-1, None), [1], np.array([False, True])):
        assert float(jax.grad(reduction)(0.1, part)) == pytest.approx(float(whole), rel=1e-12)


def test_what_a_notebook_shows_is_one_line_of_sizes(given, tiny_model):
    path, _ = given
    plate = tiny_model.cloud.plate
    assert repr(plate) == "Plate 'plate': 4 x 4 mm, 1 hole, plane strain"
    assert repr(tiny_model.cloud) == f"Cloud of 79 nodes, 0.5 mm apart, of {plate!r}"
    assert repr(tiny_model) == (
        "Model of 79 nodes, quadratic, "
        f"{sum(len(block.patches) for block in tiny_model.blocks)} patches"
    )
    assert (
        repr(Problem(tiny_model, path.gel, contact=False).prepared)
        == f"Problem along mu of a {tiny_model!r}"
    )
    assert repr(path[0]) == "State of 79 nodes, mu = -4.9678 kT, stable: converged"
    assert repr(path[:0]) == "Path of no states of 79 nodes"


def test_energy_falls_with_mu_by_the_solvent_taken_up(given, tiny_model):
    """dE/dmu = -sum V (J - 1) at equilibrium, by central differences about middle states."""
    middle = jaxgel.sweep(
        jaxgel.Problem(tiny_model, tiny_model.cloud.plate.gel), [-2.0 - 1e-3, -2.0, -2.0 + 1e-3]
    )
    slope = (middle.energy[2] - middle.energy[0]) / 2e-3
    volumes = jaxgel.observables.cell_volumes(tiny_model)
    uptake = float(np.sum(np.asarray(volumes) * (np.asarray(jaxgel.volume_ratio(middle))[1] - 1)))
    assert slope == pytest.approx(-uptake, rel=1e-5)  # truncation step^2


def test_given_and_chosen_steps_end_in_the_same_state(given, tiny_model):
    path, _ = given
    chosen = jaxgel.sweep(
        jaxgel.Problem(tiny_model, tiny_model.cloud.plate.gel), jaxgel.Adaptive(-4.9678, -0.9678)
    )
    assert chosen.stop.ok
    assert (chosen.mu[0], chosen.mu[-1]) == (-4.9678, -0.9678)
    assert np.all(np.diff(chosen.mu) > 0)
    np.testing.assert_allclose(chosen.x[-1], path.x[-1], atol=1e-8)


@pytest.mark.slow
def test_a_single_value_and_a_single_huge_step_are_reached(given, tiny_model):
    """Directly, or by way of intermediate states that are not kept."""
    path, _ = given
    gel = tiny_model.cloud.plate.gel
    one = jaxgel.sweep(jaxgel.Problem(tiny_model, gel), [-0.9678])
    np.testing.assert_allclose(one.x[-1], path.x[-1], atol=1e-8)
    cut = jaxgel.sweep(jaxgel.Problem(tiny_model, gel), [-4.9678, -0.2])
    assert list(cut.mu) == [-4.9678, -0.2]
    assert cut.stop.ok


def test_sweep_continued_from_a_step_equals_the_uninterrupted_one(given, tiny_model):
    path, seen = given
    rest = jaxgel.sweep(
        jaxgel.Problem(tiny_model, tiny_model.cloud.plate.gel), path.mu[6:], start=seen[5]
    )
    np.testing.assert_array_equal(rest.mu, path.mu[6:])
    np.testing.assert_allclose(rest.x, path.x[6:], atol=1e-9)


def test_a_sweep_must_leave_its_start(given, tiny_model):
    path, seen = given
    for mu in ([path.mu[5], path.mu[6]], jaxgel.Adaptive(path.mu[4], path.mu[5])):
        with pytest.raises(
            ValueError, match=r"^mu: \S+ is the value of the start, the sweep must leave it"
        ):
            jaxgel.sweep(jaxgel.Problem(tiny_model, tiny_model.cloud.plate.gel), mu, start=seen[5])


def test_twenty_steps_trace_and_compile_nothing_after_the_third(tiny_model):
    """The third step is the first with a full history for the predictor."""
    seen, guard = [], contextlib.ExitStack()

    def watch(step):
        seen.append(step)
        if len(seen) == 3:
            guard.enter_context(jax.no_tracing())
        if len(seen) == 20:
            guard.close()

    with guard:
        jaxgel.sweep(
            jaxgel.Problem(tiny_model, tiny_model.cloud.plate.gel),
            np.linspace(-4.8, -1.0, 20),
            observer=jaxgel.Observer(accepted=watch),
        )
    assert len(seen) == 20


def test_another_gel_of_the_same_kind_compiles_nothing_new(given, tiny_model):
    with jax.no_tracing():
        assert jaxgel.sweep(jaxgel.Problem(tiny_model, Gel(Nv=2e-3, chi=0.3)), [-3.0, -2.0]).stop.ok


def test_interruption_passes_through_with_all_finished_steps_delivered(tiny_model):
    seen = []

    def interrupt(step):
        seen.append(step)
        if len(seen) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        jaxgel.sweep(
            jaxgel.Problem(tiny_model, tiny_model.cloud.plate.gel),
            np.linspace(-4.9678, -0.9678, 10),
            observer=jaxgel.Observer(accepted=interrupt),
        )
    assert [step.status for step in seen] == [Status.CONVERGED] * 3


# --- how sweeps end -------------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize(
    "mu",
    [pytest.param([-2.0, -1.0, 0.0, 0.5], marks=pytest.mark.slow), jaxgel.Adaptive(-2.0, 0.5)],
    ids=["given", "chosen"],
)
def test_sweep_into_a_swelling_jump_stops_at_the_fold_and_says_so(mu, square_model):
    """With chi = 1.5 no state connected with the dry one exists above the fold.

    The gel would jump to a hundredfold volume.
    """
    gel = Gel(Nv=1e-3, chi=1.5)
    # of free swelling, 0.2351; uniaxially a little higher
    fold = float(limits_of_stability(gel, swelling="plane strain").control[0])
    path = jaxgel.sweep(jaxgel.Problem(square_model, gel), mu)
    assert path.stop is Status.STEP_TOO_SMALL
    assert path.stop_text == f"stopped after mu = {path.mu[-1]:.6g}: {Status.STEP_TOO_SMALL.text}"
    assert np.all(np.isfinite(path.x))
    assert path.mu[-1] < fold + 2e-3
    assert path.mu[-1] == (0.0 if isinstance(mu, list) else pytest.approx(fold, abs=2e-3))


@pytest.mark.slow
def test_sweep_without_a_first_state_fails_with_the_reason(square_model):
    with pytest.raises(SweepFailed, match=r"^sweep: no equilibrium at mu = 0.6: Newton "):
        jaxgel.sweep(jaxgel.Problem(square_model, Gel(Nv=1e-3, chi=1.5)), [0.6, 0.7])


def test_number_of_chosen_steps_is_limited(tiny_model):
    path = jaxgel.sweep(
        jaxgel.Problem(tiny_model, tiny_model.cloud.plate.gel),
        jaxgel.Adaptive(-4.9678, -0.9678, max_steps=2),
    )
    assert path.stop is Status.TOO_MANY_STEPS
    assert len(path) == 2


def test_unusable_mu_is_refused(tiny_model, refused):
    refused(
        lambda mu: jaxgel.sweep(jaxgel.Problem(tiny_model, tiny_model.cloud.plate.gel), mu),
        [
            (
                [-1.0, np.nan],
                r"mu: \[-1.0, nan\] is not accepted, it must be a list of finite numbers",
            ),
            ([np.inf], r"mu: \[inf\] is not accepted"),
            ([], r"mu: \[\] is not accepted"),
            ([[-1.0, -0.5]], r"mu: \[\[-1.0, -0.5\]\] is not accepted"),
            (
                [-1.0, -0.5, -0.5],
                r"mu: -0.5 is followed by -0.5, the values must differ from one to the next",
            ),
            ((-1.0, -1.0), r"mu: -1 is followed by -1, the values must differ"),
        ],
        start=True,
    )


def test_a_tuple_means_the_same_states_as_a_list(tiny_model):
    problem = jaxgel.Problem(tiny_model, Gel(1e-3, 0.1))
    lists = [
        jaxgel.sweep(problem, values).value.tolist()
        for values in ((-3.0, -2.0), [-3.0, -2.0], np.array([-3.0, -2.0]))
    ]
    assert lists == [[-3.0, -2.0]] * 3
    for wrong in ((-3.0, "x"), (-3.0, None)):
        with pytest.raises(ValueError, match=r"^Adaptive: the ends must be concrete numbers"):
            jaxgel.Adaptive(*wrong)


@pytest.mark.slow
def test_a_path_is_a_pytree_with_the_same_fields_where_it_is_differentiated(tiny_model):
    """Leaves are arrays; how it ended and the symmetries are part of the structure."""

    def path(chi):
        return jaxgel.sweep(jaxgel.Problem(tiny_model, Gel(1e-3, chi)), [-3.0, -2.0])

    eager, differentiated = path(0.1), jax.jvp(path, (0.1,), (1.0,))[0]
    for name in (field.name for field in dataclasses.fields(eager) if field.name != "problem"):
        one, other = getattr(eager, name), getattr(differentiated, name)
        assert type(one) is type(other) or (np.shape(one), np.dtype(one.dtype)) == (
            np.shape(other),
            np.dtype(other.dtype),
        ), name
    assert differentiated.stop is Status.CONVERGED and differentiated.symmetry == eager.symmetry
    # the eigenvalues are looked at for the derivatives alone
    np.testing.assert_array_equal(differentiated.status, eager.status)
    assert set(np.asarray(differentiated.derivative)) == {Status.CONVERGED}
    again = jax.tree.map(lambda leaf: leaf, eager)
    np.testing.assert_array_equal(again.x, eager.x)


@pytest.mark.slow
def test_an_observer_is_told_of_iterations_and_of_states_refused_and_accepted(square_model):
    told = {"accepted": [], "refused": [], "iteration": []}
    observer = jaxgel.Observer(
        **{name: (lambda state, name=name: told[name].append(state.value)) for name in told}
    )
    path = jaxgel.sweep(
        jaxgel.Problem(square_model, Gel(1e-3, 1.5)), jaxgel.Adaptive(-2.0, 0.5), observer=observer
    )
    assert told["accepted"] == path.value.tolist()
    assert told["refused"] and min(told["refused"]) > path.value[0]
    assert len(told["iteration"]) > len(path) + len(told["refused"])


def test_tolerances_of_newtons_method_are_options(tiny_model):
    problem = jaxgel.Problem(tiny_model, Gel(1e-3, 0.1))
    exact, rough = (
        jaxgel.sweep(problem, [-2.0]),
        jaxgel.sweep(
            problem, [-2.0], newton=jaxgel.Newton(tolerance=1e-3, constraint_tolerance=1e-3)
        ),
    )
    assert exact.residual[0] < 1e-10 < rough.residual[0] < 1e-3
    assert rough.newton_iterations[0] < exact.newton_iterations[0]
    with pytest.raises(SweepFailed):
        jaxgel.sweep(problem, [-2.0], newton=jaxgel.Newton(max_iterations=1))


@pytest.mark.slow
def test_a_sweep_to_a_value_without_a_state_ends_after_a_bounded_number_of_steps():
    """At the dry size there is no room for solvent; every halved step on the way there succeeds."""
    model, tried = jaxgel.discretise(jaxgel.make_cloud(jaxgel.Plate(2, 2, spacing=0.5))), []
    problem = jaxgel.Problem(model, Gel(1e-3, 0.1), control=jaxgel.Stretch("both"))
    path = jaxgel.sweep(
        problem,
        [1.1, 1.0],
        observer=jaxgel.Observer(refused=lambda state: tried.append(state.value)),
    )
    assert (
        path.stop is Status.STEP_TOO_SMALL and path.value.tolist() == [1.1] and len(tried) < 24
    )  # 18: 17 halvings to 1e-5 of the way, and the first


@pytest.mark.parametrize(
    ("gel", "name"),
    [(Gel(Nv=0.0), "Nv"), (Gel(Nv=np.nan), "Nv"), (Gel(chi=2.0), "chi"), (Gel(chi=np.nan), "chi")],
)
def test_unusable_gel_is_refused(gel, name, tiny_model):
    with pytest.raises(ValueError, match=f"^{name}: "):
        jaxgel.sweep(jaxgel.Problem(tiny_model, gel), [-2.0])


def test_unknown_branch_is_refused(tiny_model):
    with pytest.raises(ValueError, match=r"^branch: 'buckled' is not one of stable, symmetric"):
        jaxgel.sweep(
            jaxgel.Problem(tiny_model, tiny_model.cloud.plate.gel), [-2.0], branch="buckled"
        )


def states(values, at):
    """Steps at given mu of one node whose position and one pressure are ``values`` (k,)."""
    rest = dict(status=jaxgel.Status.CONVERGED, newton_iterations=1, residual=0.0, energy=0.0)
    return [
        State(value=mu, mu=mu, x=np.full((1, 2), v), pressure=np.full(1, -v), **rest)
        for mu, v in zip(at, values, strict=True)
    ]


def test_prediction_is_exact_on_a_polynomial_and_cautious_after_a_turn(tiny_model):
    problem, at = (
        Problem(tiny_model, tiny_model.cloud.plate.gel, contact=False).prepared,
        np.array([-3.0, -2.8, -2.5, -2.3, -2.2]),
    )
    x, pressure = predict(problem, -2.0, states(at**4 - at, at))
    np.testing.assert_allclose(x, 18.0, rtol=1e-11)
    np.testing.assert_allclose(pressure, -18.0, rtol=1e-11)
    # constant, until it turned: so the last state is best
    x, _ = predict(problem, -2.0, states([1.0, 1.0, 1.0, 1.0, 1.5], at))
    np.testing.assert_allclose(x, 1.5)


def test_a_first_state_predicts_the_second_to_second_order(tiny_model):
    model = tiny_model
    problem, steps, misses = (
        Problem(model, model.cloud.plate.gel, contact=False).prepared,
        0.2 * 0.5 ** np.arange(3),
        [],
    )
    for step in steps:
        seen = []
        jaxgel.sweep(
            jaxgel.Problem(model, model.cloud.plate.gel),
            [-3.0, -3.0 + step],
            observer=jaxgel.Observer(accepted=seen.append),
        )
        x, pressure = predict(problem, seen[1].mu, seen[:1])
        misses.append([np.abs(x - seen[1].x).max(), np.abs(pressure - seen[1].pressure).max()])
    np.testing.assert_allclose(np.log2(np.divide(misses[:-1], misses[1:])), 2, atol=0.15)


@pytest.mark.thorough
def test_one_factor_is_in_memory_at_a_time(coarse_model, monkeypatch):
    """At 3e5 nodes each fills gigabytes.

    The modes at the end of so long a step need one of their own. Blocks are small.
    """
    made, alive = weakref.WeakSet(), []

    def factorise(*args):
        alive.append(len(made))
        fronts = multifrontal.factorise(*args)
        made.add(fronts)
        return fronts

    monkeypatch.setattr(linear_solve, "factorise", factorise)
    jaxgel.sweep(
        jaxgel.Problem(coarse_model, coarse_model.cloud.plate.gel), [-4.9678, -3.5], symmetry="off"
    )
    assert len(alive) > 3 and not any(alive)
