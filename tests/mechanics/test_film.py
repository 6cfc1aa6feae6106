"""Films in plane stress: closed forms, uniform states, tangents, derivatives, refusals."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

import jaxgel
from jaxgel.materials import Gent, VolumeLaw, isotropic_swelling
from jaxgel.observables import history, membrane_stress, thickness_stretch

GEL = jaxgel.Gel(1e-3, 0.1)
MU = [-1.0, -0.1, -0.01]


def potential(J, gel=GEL):
    """d volumetric / dJ of the Flory-Rehner gel, with the network's -Nv ln J, once more."""
    return -np.log1p(1 / (J - 1)) + 1 / J + gel.chi / J**2 - gel.Nv / J


def root(function, low=1 + 1e-13, high=1e4):
    return brentq(function, low, high, xtol=1e-15, rtol=1e-15, maxiter=500)


def film_of(edges):
    """A square film of 2 x 2 mm with 7 x 7 nodes."""
    plate = jaxgel.Plate(2, 2, edges=edges, kinematics="plane stress", gel=GEL, spacing=1 / 3)
    return jaxgel.discretise(jaxgel.make_cloud(plate))


def swollen(edges, mu):
    """Path of a square film of 2 x 2 mm, and its dry nodes from the lower left corner."""
    model = film_of(edges)
    return jaxgel.sweep(jaxgel.Problem(model, GEL), mu), np.asarray(model.cloud.nodes) + 1


@jax.jit
@jax.vmap
def numbers(A, mu):
    """Energy, volume ratio, pressure, stiffness and inverse of a film's law, and derivatives."""
    law = VolumeLaw(GEL, mu, film=True)
    p, slope = law.pressure(A), jax.grad(law.energy)
    return (
        law.energy(A),
        law.volume_ratio(A),
        p,
        slope(A),
        law.stiffness(A),
        jax.grad(slope)(A),
        law.areal_stretch(p),
    )


@pytest.mark.thorough
def test_the_energy_is_the_least_over_the_thickness():
    """By a search over l3, and its derivatives by each other; the areal stretch may be below 1."""
    pairs = [(A, mu) for A in (0.7, 1.0001, 1.3, 3.0) for mu in (-2.0, -0.1)]
    A, mu = np.array(pairs).T

    def energy(u, A, mu):
        J = 1 + np.exp(u)
        mixing = -(J - 1) * np.log1p(1 / (J - 1)) - GEL.chi / J - GEL.Nv * np.log(J)
        return GEL.Nv / 2 * ((J / A) ** 2 - 1) + mixing - mu * (J - 1)

    least = [
        minimize_scalar(
            energy, args=of, bounds=(-25, 6), method="bounded", options=dict(xatol=1e-10)
        ).fun
        for of in pairs
    ]
    expected = np.array(
        [root(lambda J, A=A, mu=mu: potential(J) + GEL.Nv * J / A**2 - mu) for A, mu in pairs]
    )
    found, J, pressure, slope, stiffness, bend, back = map(np.asarray, numbers(A, mu))
    np.testing.assert_allclose(found, least, rtol=1e-12)
    np.testing.assert_allclose(J, expected, rtol=1e-12)
    np.testing.assert_allclose(pressure, -GEL.Nv * expected**2 / A**3, rtol=1e-12)
    np.testing.assert_allclose(pressure, slope, rtol=1e-12)
    np.testing.assert_allclose(stiffness, bend, rtol=1e-11)
    np.testing.assert_allclose(back, A, rtol=1e-12)


def test_every_pressure_has_a_stretch():
    """Newton's method may ask for pressures that no film has."""
    assert np.isfinite(
        VolumeLaw(GEL, -1.0, film=True).areal_stretch(np.array([-10.0, -1e-3, 0.0, 0.1]))
    ).all()


@pytest.mark.slow
def test_a_free_film_swells_as_a_free_gel_in_three_dimensions():
    path, X = swollen(dict(left="roller", bottom="roller", right="free", top="free"), MU)
    stretch = [
        np.cbrt(root(lambda J, mu=mu: potential(J) + GEL.Nv * J ** (-1 / 3) - mu)) for mu in MU
    ]
    np.testing.assert_allclose(isotropic_swelling(np.array(MU), GEL), stretch, rtol=1e-12)
    np.testing.assert_allclose(path.x, -1 + np.array(stretch)[:, None, None] * X, atol=1e-9)
    np.testing.assert_allclose(
        thickness_stretch(path),
        np.broadcast_to(np.array(stretch)[:, None], (3, path.model.n_cells)),
        rtol=1e-9,
    )
    np.testing.assert_allclose(
        jaxgel.volume_ratio(path),
        np.broadcast_to(np.array(stretch)[:, None] ** 3, (3, path.model.n_cells)),
        rtol=1e-9,
    )
    assert np.abs(jaxgel.cauchy_stress(path)).max() < 1e-12
    assert history(path)["status"] == ["converged"] * 3


@pytest.mark.slow
def test_a_strip_held_along_one_axis():
    """l1 = 1, l2 = l3 = l: J = l^2, and no stress across: potential(J) + Nv = mu."""
    path, X = swollen(dict(left="roller", right="roller", bottom="roller", top="free"), MU)
    stretch = np.array([np.sqrt(root(lambda J, mu=mu: potential(J) + GEL.Nv - mu)) for mu in MU])
    np.testing.assert_allclose(
        path.x, -1 + np.stack([np.ones(3), stretch], axis=1)[:, None] * X, atol=1e-9
    )
    sigma_11 = GEL.Nv * (1 - stretch**2) / stretch**2  # Nv (l1^2 - l3^2) / J
    np.testing.assert_allclose(
        np.asarray(jaxgel.cauchy_stress(path))[..., 0],
        np.broadcast_to(sigma_11[:, None], path.x.shape[:2]),
        rtol=1e-8,
    )
    np.testing.assert_allclose(membrane_stress(path), sigma_11, rtol=1e-8)
    assert all("wrinkles out of its plane (-" in text for text in history(path)["status"])


@pytest.mark.slow
def test_a_film_held_along_both_axes_swells_by_eq_59_through_its_thickness():
    path, X = swollen("roller", MU)
    thickness = [root(lambda l3, mu=mu: potential(l3) + GEL.Nv * l3 - mu) for mu in MU]
    np.testing.assert_allclose(path.x, np.broadcast_to(X - 1, path.x.shape), atol=1e-12)
    np.testing.assert_allclose(
        thickness_stretch(path),
        np.broadcast_to(np.array(thickness)[:, None], (3, path.model.n_cells)),
        rtol=1e-9,
    )
    np.testing.assert_allclose(jaxgel.uniaxial_swelling(np.array(MU), GEL), thickness, rtol=1e-12)
    assert np.all(path.negative_pivots == 0)


@pytest.mark.slow
def test_derivatives_are_those_of_the_energy(check_derivatives):
    check_derivatives(film_of({"right": "free", "top": "free"}), GEL)


@pytest.mark.slow
def test_gradients_through_a_sweep_of_a_film_are_those_of_differences(tiny_plate):
    """By Nv, chi and mu at once, of energy, place, thickness and smallest stress.

    Of a film with a hole.
    """
    film_model = jaxgel.discretise(
        jaxgel.make_cloud(dataclasses.replace(tiny_plate, kinematics="plane stress"))
    )

    def read(t):
        path = jaxgel.sweep(
            jaxgel.Problem(film_model, jaxgel.Gel(1e-3 * (1 + 0.3 * t), 0.1 + 0.2 * t)),
            jnp.array([-2.0, -1.0 + 0.5 * t]),
        )
        return (
            path.energy[-1]
            + path.x[-1, 40, 0]
            + jnp.mean(thickness_stretch(path)[-1])
            + 1e3 * membrane_stress(path)[-1]
        )

    h = 1e-5
    assert float(jax.grad(read)(0.1)) == pytest.approx(
        float(read(0.1 + h) - read(0.1 - h)) / (2 * h), rel=1e-6
    )


def test_what_films_cannot_be_is_said_in_one_line():
    model = film_of("roller")
    with pytest.raises(
        ValueError,
        match=(
            r"^kinematics: 'membrane' is not one of plane strain, generalised plane strain, plane "
            r"stress$"
        ),
    ):
        dataclasses.replace(model.cloud.plate, kinematics="membrane")
    with pytest.raises(
        ValueError, match=r"is not accepted in plane stress, it must be neo_hookean$"
    ):
        jaxgel.sweep(jaxgel.Problem(model, dataclasses.replace(GEL, network=Gent(30.0))), MU)


@pytest.mark.slow
def test_a_steeply_graded_film_has_a_smallest_stress():
    """A patch's linear pressure may exceed 0 at points where Nv falls to a hundredth."""
    plate = jaxgel.Plate(
        2, 2, edges={"right": "free", "top": "free"}, kinematics="plane stress", spacing=0.25
    )
    gel = jaxgel.Gel(lambda X: 1e-3 + 0.1 * jnp.exp(-20 * jnp.sum((X - 0.9) ** 2)), 0.1)
    path = jaxgel.sweep(
        jaxgel.Problem(jaxgel.discretise(jaxgel.make_cloud(plate)), gel), [-1.0, -0.1]
    )
    assert np.all(np.isfinite(jaxgel.observables.membrane_stress(path)))
