"""Critical points: where they are, what they are, and how they move with the design."""

import dataclasses
import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.cli import command_line as cli
from jaxgel.continuation import SweepFailed

WINDOW = (-1.2, -1.0)  # one bifurcation of sample 4 on the cloud of these tests


@pytest.fixture(scope="module")
def point(pillars_point):
    return pillars_point


@pytest.mark.smoke
def test_the_symmetric_branch_changes_stability_at_the_critical_mu(point, pillars_model):
    """Located to 1e-6 kT: stable that much below, unstable that much above."""
    path = jaxgel.sweep(
        jaxgel.Problem(pillars_model, pillars_model.cloud.plate.gel),
        [-1.4, point.mu - 1e-6, point.mu + 1e-6],
        branch="symmetric",
        eigenvalues=True,
    )
    assert list(path.negative_pivots) == [0, 0, 1]
    assert path.lowest_eigenvalue[2] == pytest.approx(point.slope * 1e-6, rel=1e-2)


def test_sample_4_buckles_by_turning_its_crosspieces(point):
    """A simple supercritical pitchfork whose mode keeps the rotations and breaks the mirrors."""
    assert (point.kind, point.multiplicity, point.unstable) == ("bifurcation", 1, 0)
    assert point.curvature > 0
    assert point.symmetries["rotation by 90"] == pytest.approx(1, abs=1e-4)
    assert point.symmetries["x -> -x"] == pytest.approx(-1, abs=1e-4)
    assert point.representation == "A2"
    kept = "rotation by 90, rotation by 180, rotation by 270"
    assert point.text.startswith(
        f"simple bifurcation of A2, supercritical; the mode keeps {kept}; breaks x -> -x"
    )


def test_slope_is_the_difference_of_eigenvalues(point, pillars_model):
    path = jaxgel.sweep(
        jaxgel.Problem(pillars_model, pillars_model.cloud.plate.gel),
        [-1.4, point.mu + 1e-3, point.mu + 2e-3],
        branch="symmetric",
        eigenvalues=True,
    )
    difference = np.diff(path.lowest_eigenvalue[1:])[0] / 1e-3
    # the eigenvalues are good to 1e-3, the difference is one-sided
    assert point.slope == pytest.approx(difference, rel=5e-3)


@pytest.fixture(scope="module")
def critical_mu(pillars_model):
    """Critical mu of sample 4 as a function of radius (mm), Nv and chi."""
    cloud = pillars_model.cloud

    def critical_mu(v, moved=True):
        model = (
            jaxgel.discretise(cloud.at(cloud.plate.at([{"radius": v[0]}] * 4)))
            if moved
            else pillars_model
        )
        (point,) = jaxgel.critical_points(jaxgel.Problem(model, jaxgel.Gel(v[1], v[2])), WINDOW)
        assert point.text.startswith("simple bifurcation of A2, supercritical")  # also a traced one
        return point.mu

    return critical_mu


@pytest.mark.thorough
@pytest.mark.parametrize(
    "of",
    [*(pytest.param(of, marks=pytest.mark.slow) for of in (0, 1)), 2],
    ids=["radius", "Nv", "chi"],
)
def test_derivatives_are_differences_of_relocated_points(critical_mu, of):
    """Extrapolated differences, to 1e-5.

    A critical mu carries 3e-11 of round-off, from bulk stiffnesses 1e5 times the network's, which
    asks for a step of 6 % in Nv, its weakest influence; the kinks of the weight functions ask for a
    short one in the radius.
    """
    at, step = np.array([np.sqrt(20.0), 1e-3, 0.05]), (4e-4, 6e-5, 1e-2)[of]
    e = np.eye(3)[of] * step
    located = functools.partial(critical_mu, moved=of == 0)
    slope = jax.grad(located)(jnp.asarray(at))[of]
    # by chi there is nothing to extrapolate: the first difference is good to 5e-10
    shares = (1.0,) if of == 2 else (0.5, 1.0)
    near, *far = ((located(at + s * e) - located(at - s * e)) / (2 * s * step) for s in shares)
    assert float(slope) == pytest.approx((4 * near - far[0]) / 3 if far else near, rel=1e-5)


@pytest.mark.slow
def test_forward_equals_reverse(critical_mu):
    at, direction = jnp.array([np.sqrt(20.0), 1e-3, 0.05]), jnp.array([0.3, 2e-4, 0.1])
    _, forward = jax.jvp(critical_mu, (at,), (direction,))
    reverse = float(jax.grad(critical_mu)(at) @ direction)
    # w comes from a tangent with condition 1e8
    assert float(forward) == pytest.approx(reverse, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("kinematics", ["plane strain", "plane stress"])
def test_derivatives_by_a_field_are_differences_of_relocated_points(kinematics, cloud_of):
    """Extrapolated differences by a symmetric wave of chi over sample 4, and of the film.

    Far from the size 0, where by symmetry the derivative of sample 4 is nearly 0 and its
    differences are round-off; the film is the same plate.
    """
    plate = dataclasses.replace(cloud_of("sample-4").plate, kinematics=kinematics)
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=2 * plate.spacing))
    window = WINDOW if kinematics == "plane strain" else (-1.2, -0.3)

    def located(size):
        def chi(X):
            return 0.05 + size * jnp.prod(jnp.cos(2 * jnp.pi * X / plate.width))

        return jaxgel.critical_points(jaxgel.Problem(model, jaxgel.Gel(1e-3, chi)), window)[0].mu

    _, slope = jax.jvp(located, (0.04,), (1.0,))
    near, far = (
        (located(0.04 + step) - located(0.04 - step)) / (2 * step) for step in (5e-3, 1e-2)
    )
    assert float(slope) == pytest.approx((4 * near - far) / 3, rel=1e-5)


# --- double eigenvalues ---------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "direction",
    [(1.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)],
    ids=["pair stays", "pair splits", "gel"],
)
def test_derivative_of_a_double_onset_is_that_of_the_mean(direction, cloud_of):
    """Sample 7 with its double second onset: all squares grow alike, or chi along x only.

    If all grow alike, or chi does, that keeps the pair; along x only it splits.
    """
    cloud = cloud_of("sample-7")

    def double(growth):
        holes = [{"sides": hole.sides + growth[:2]} for hole in cloud.plate.holes]
        model = jaxgel.discretise(cloud.at(cloud.plate.at(holes)) if direction[0] else cloud)
        gel = (
            dataclasses.replace(cloud.plate.gel, chi=cloud.plate.gel.chi + growth[2])
            if direction[2]
            else cloud.plate.gel
        )
        (point,) = jaxgel.critical_points(jaxgel.Problem(model, gel), (-1.54, -1.50))
        points.append((point.kind, point.multiplicity, jax.lax.stop_gradient(point.eigenvalues)))
        return point.mu

    points, direction = [], np.array(direction)
    at = np.array([0.0, 0.0, 1e-3])
    _, slope = jax.jvp(double, (jnp.asarray(at),), (jnp.asarray(direction),))
    difference = (double(at + 3e-4 * direction) - double(at - 3e-4 * direction)) / 6e-4
    assert float(slope) == pytest.approx(difference, rel=1e-5)  # measured 7e-7 and 5e-7
    assert [point[:2] for point in points] == [("bifurcation", 2)] * 3
    assert np.abs(points[0][2]).max() < 1e-8
    assert (np.diff(points[-1][2])[0] > 1e-5) == (direction[0] != direction[1])


@pytest.mark.thorough
def test_jit_and_second_derivatives_are_refused(pillars_model):
    def critical_mu(chi):
        return jaxgel.critical_points(jaxgel.Problem(pillars_model, jaxgel.Gel(1e-3, chi)), WINDOW)[
            0
        ].mu

    with pytest.raises(ValueError, match=r"^critical_points: is not available inside jit"):
        jax.jit(critical_mu)(1e-4)
    with pytest.raises(ValueError, match=r"^critical_points: has first derivatives only"):
        jax.grad(jax.grad(critical_mu))(1e-4)


@pytest.mark.slow
def test_numbers_beside_the_critical_value_refuse_derivatives(pillars_model, point):
    """Its slope, state and modes are found outside of JAX.

    As constants they would have the derivative 0.
    """

    def problem_of(chi):
        return jaxgel.Problem(pillars_model, jaxgel.Gel(1e-3, chi))

    def numbers(chi):
        (found,) = jaxgel.critical_points(problem_of(chi), WINDOW)
        values = {field.name: getattr(found, field.name) for field in dataclasses.fields(found)} | {
            "mode": found.modes[0]
        }
        return {
            name: value
            for name, value in values.items()
            if isinstance(value, float | np.ndarray | jax.Array)
        }

    _, push = jax.linearize(numbers, 1e-4)
    slopes = push(1.0)
    assert {"slope", "curvature", "x", "mode"} < set(slopes)
    assert {name for name, slope in slopes.items() if not np.isnan(slope).any()} == {"value", "mu"}
    with pytest.raises(
        ValueError, match=r"^critical_points: only the value of a result has derivatives"
    ):
        jax.linear_transpose(lambda chi: push(chi)["slope"], 1.0)(1.0)
    with pytest.raises(ValueError, match=r"^switch_branch: has no derivatives"):
        jax.grad(lambda chi: jaxgel.switch_branch(problem_of(chi), point).energy[-1])(1e-4)


def test_three_ends_are_refused(pillars_model):
    with pytest.raises(
        ValueError, match=r"^mu: \[-2.0, -1.0, 0.0\] is not accepted, it must be two numbers"
    ):
        jaxgel.critical_points(
            jaxgel.Problem(pillars_model, pillars_model.cloud.plate.gel), [-2.0, -1.0, 0.0]
        )


def test_the_command_writes_points_and_modes(tmp_path, capsys, point):
    arguments = [
        "critical",
        "sample-4",
        "--spacing",
        "2.2",
        "--mu-start",
        "-1.2",
        "--mu-end",
        "-1.0",
        "--out",
        str(tmp_path),
    ]
    assert cli.main(arguments) == 0
    assert f"mu = {point.mu:.7f} kT: simple bifurcation" in capsys.readouterr().out
    stored = json.loads((tmp_path / "critical.json").read_text())["points"]
    assert [entry["mu"] for entry in stored] == [pytest.approx(point.mu, abs=1e-9)]
    assert (tmp_path / "modes.png").stat().st_size > 1e4
    assert (tmp_path / "critical.csv").read_text().startswith("mu,kind,multiplicity")
    assert np.load(tmp_path / "critical.npz")["modes_0"].shape == point.modes.shape


@pytest.mark.slow
def test_the_onset_of_a_gel_that_keeps_its_volume_is_found():
    """With a bulk modulus of 4e8 of the network's the last steps do not shrink.

    The eigenvalues have so much round-off.
    """
    holes = [jaxgel.Circle((x, y), 0.8) for x in (-1, 1) for y in (-1, 1)]
    cells = jaxgel.Plate(
        4, 4, holes, edges="periodic", deformation=((1.0, "free"), ("free", "free"))
    )
    model = jaxgel.discretise(jaxgel.make_cloud(cells, spacing=0.25, nodes_per_hole=16))
    softer, stiffer = (
        jaxgel.critical_points(
            jaxgel.Problem(model, jaxgel.Gel(), control=jaxgel.controls.Stretch("x", mu=mu)),
            (1.0, 0.9),
            most=1,
        )
        for mu in (-8.0, -12.0)
    )
    # at -8 the gel has swollen by J - 1 = exp(mu - 1), by half of it along x, and is shortened from
    # there 2e-6 measured; the shift is 6e-5
    assert stiffer[0].value == pytest.approx(softer[0].value / (1 + np.exp(-9) / 2), abs=5e-6)


def test_an_observer_is_told_of_states_and_points(pillars_model, point):
    states, points = [], []
    problem = jaxgel.Problem(pillars_model, pillars_model.cloud.plate.gel)
    observer = jaxgel.Observer(
        accepted=lambda state: states.append(state.value), located=points.append
    )
    found = jaxgel.critical_points(problem, WINDOW, observer=observer)
    assert points == found and found[0].value == point.value and (states[0], states[-1]) == WINDOW


@pytest.mark.parametrize("search", [jaxgel.critical_points, jaxgel.loop])
def test_tolerances_of_newtons_method_are_options(search, pillars_model):
    with pytest.raises(SweepFailed):
        search(
            jaxgel.Problem(pillars_model, pillars_model.cloud.plate.gel),
            WINDOW,
            newton=jaxgel.Newton(max_iterations=1),
        )


def test_a_point_that_is_not_located_is_warned_of(pillars_model, monkeypatch):
    monkeypatch.setattr("jaxgel.bifurcation.search.crossings", lambda *_: [])
    text = (
        r"^critical_points: between mu = -\d.\d+ and -\d.\d+ the negative eigenvalues change from "
        r"0 to 1, and no point was located$"
    )
    with pytest.warns(jaxgel.bifurcation.PointNotLocated, match=text):
        assert (
            jaxgel.critical_points(
                jaxgel.Problem(pillars_model, pillars_model.cloud.plate.gel), (-1.4, -0.9), most=1
            )
            == []
        )
