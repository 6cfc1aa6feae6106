"""Critical points: where they are, what they are, and how they move with the design."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel import cli

WINDOW = (-1.8, -1.5)  # one bifurcation of sample 4 on the cloud of these tests


@pytest.fixture(scope="module")
def point(buckling_model):
    (found,) = jaxgel.critical_points(buckling_model, buckling_model.cloud.plate.gel, mu=WINDOW)
    return found


def test_the_symmetric_branch_changes_stability_at_the_critical_mu(point, buckling_model):
    """Located to 1e-6 kT: stable that much below, unstable that much above."""
    path = jaxgel.sweep(buckling_model, buckling_model.cloud.plate.gel, mu=[-2.2, point.mu - 1e-6, point.mu + 1e-6], branch="symmetric")
    assert list(path.negative_pivots) == [0, 0, 1]
    assert path.lowest_eigenvalue[2] == pytest.approx(point.slope * 1e-6, rel=1e-2)


def test_sample_4_buckles_by_turning_its_crosspieces(point):
    """A simple supercritical pitchfork whose mode keeps the rotations and breaks the mirrors."""
    assert (point.kind, point.multiplicity, point.unstable) == ("bifurcation", 1, 0)
    assert point.curvature > 0
    assert point.symmetries["rotation by 90"] == pytest.approx(1, abs=1e-4)
    assert point.symmetries["x -> -x"] == pytest.approx(-1, abs=1e-4)
    assert point.text.startswith("simple bifurcation, supercritical; the mode keeps rotation by 90, rotation by 180; breaks x -> -x")


def test_slope_is_the_difference_of_eigenvalues(point, buckling_model):
    path = jaxgel.sweep(buckling_model, buckling_model.cloud.plate.gel, mu=[-2.2, point.mu + 1e-3, point.mu + 2e-3], branch="symmetric")
    difference = np.diff(path.lowest_eigenvalue[1:])[0] / 1e-3
    assert point.slope == pytest.approx(difference, rel=5e-3)  # the eigenvalues are good to 1e-3, the difference is one-sided


@pytest.fixture(scope="module")
def critical_mu(buckling_model):
    """Critical mu of sample 4 as a function of radius (mm), Nv and chi."""
    cloud = buckling_model.cloud

    def critical_mu(v):
        model = jaxgel.discretise(cloud.at(cloud.plate.at([{"radius": v[0]}] * 4)))
        return jaxgel.critical_points(model, jaxgel.Gel(v[1], v[2]), mu=WINDOW)[0].mu

    return critical_mu


def test_derivatives_are_differences_of_relocated_points(critical_mu):
    """Extrapolated differences, to 1e-5. A critical mu carries 3e-11 of round-off, from bulk stiffnesses 1e5 times the network's, which
    asks for a step of 6 % in Nv, its weakest influence; the kinks of the weight functions ask for a short one in the radius."""
    at, steps = np.array([np.sqrt(20.0), 1e-3, 0.05]), np.array([4e-4, 6e-5, 1e-2])
    gradient = np.asarray(jax.grad(critical_mu)(jnp.asarray(at)))
    for k, step in enumerate(steps):
        e = np.eye(3)[k] * step
        near, far = ((critical_mu(at + s * e) - critical_mu(at - s * e)) / (2 * s * step) for s in (0.5, 1.0))
        assert gradient[k] == pytest.approx((4 * near - far) / 3, rel=1e-5)


def test_forward_equals_reverse(critical_mu):
    at, direction = jnp.array([np.sqrt(20.0), 1e-3, 0.05]), jnp.array([0.3, 2e-4, 0.1])
    _, forward = jax.jvp(critical_mu, (at,), (direction,))
    reverse = float(jax.grad(critical_mu)(at) @ direction)
    assert float(forward) == pytest.approx(reverse, rel=1e-8)  # w comes from a tangent with condition 1e8


def test_jit_and_second_derivatives_are_refused(buckling_model):
    def critical_mu(chi):
        return jaxgel.critical_points(buckling_model, jaxgel.Gel(1e-3, chi), mu=WINDOW)[0].mu

    with pytest.raises(ValueError, match=r"^critical_points: is not available inside jit"):
        jax.jit(critical_mu)(1e-4)


def test_a_list_of_mu_is_refused(buckling_model):
    with pytest.raises(ValueError, match=r"^mu: \[-2.0, -1.0\] is not accepted, it must be a tuple"):
        jaxgel.critical_points(buckling_model, buckling_model.cloud.plate.gel, mu=[-2.0, -1.0])


def test_the_command_writes_points_and_modes(tmp_path, capsys, point):
    arguments = ["critical", "sample-4", "--spacing", "1.1", "--mu-start", "-1.8", "--mu-end", "-1.5", "--out", str(tmp_path)]
    assert cli.main(arguments) == 0
    assert f"mu = {point.mu:.7f}: simple bifurcation" in capsys.readouterr().out
    stored = json.loads((tmp_path / "critical.json").read_text())["points"]
    assert [entry["mu"] for entry in stored] == [pytest.approx(point.mu, abs=1e-9)]
    assert (tmp_path / "modes.png").stat().st_size > 1e4
    assert (tmp_path / "critical.csv").read_text().startswith("mu,kind,multiplicity")
    assert np.load(tmp_path / "critical.npz")["modes_0"].shape == point.modes.shape
