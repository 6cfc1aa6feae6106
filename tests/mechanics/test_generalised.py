"""Generalised plane strain: closed forms, the axial force, the tangent, derivatives, refusals."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxgel
from jaxgel.materials import ArrudaBoyce, Gent, free_swelling, isotropic_swelling
from jaxgel.observables import free_stretch, history, thickness_stretch

GEL = jaxgel.Gel(1e-3, 0.1)
MU = [-1.0, -0.1, -0.01]
CORNER = dict(left="roller", bottom="roller", right="free", top="free")


def potential(J, gel=GEL):
    """d volumetric / dJ of the Flory-Rehner gel, with the network's -Nv ln J, once more."""
    return -np.log1p(1 / (J - 1)) + 1 / J + gel.chi / J**2 - gel.Nv / J


def root(function, low=1 + 1e-13, high=1e4):
    return brentq(function, low, high, xtol=1e-15, rtol=1e-15, maxiter=500)


def swollen(edges, axial, kinematics="generalised plane strain", **options):
    """Path of a plate of 2 x 2 mm, 7 x 7 nodes, and dry nodes from the lower left corner."""
    plate = jaxgel.Plate(2, 2, edges=edges, kinematics=kinematics, axial_stretch=axial, gel=GEL)
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=1 / 3))
    return jaxgel.sweep(jaxgel.Problem(model, GEL), MU, **options), np.asarray(
        model.cloud.nodes
    ) + 1


@pytest.fixture(scope="module")
def block():
    """Path of a block held at the axial stretch 1.2, and dry nodes from the lower left."""
    return swollen(CORNER, 1.2)


@pytest.mark.slow
def test_held_at_one_it_is_plane_strain():
    cases = {"generalised plane strain": 1.0, "plane strain": None}
    held, plane = (
        swollen(CORNER, axial, kinematics, eigenvalues=True)[0]
        for kinematics, axial in cases.items()
    )
    np.testing.assert_allclose(held.x, plane.x, rtol=1e-13)
    np.testing.assert_allclose(held.energy, plane.energy, rtol=1e-13)
    np.testing.assert_allclose(held.lowest_eigenvalue, plane.lowest_eigenvalue, rtol=1e-9)


@pytest.mark.slow
def test_a_block_held_at_another_stretch(block):
    """l1 = l2 = l, no stress across: Nv + l3 (potential(l3 l^2) - mu) = 0."""
    path, X = block
    stretch = np.array(
        [np.sqrt(root(lambda J, mu=mu: GEL.Nv + 1.2 * (potential(J) - mu)) / 1.2) for mu in MU]
    )
    assert stretch[0] < 1  # the areal stretch may be below 1
    np.testing.assert_allclose(path.x, -1 + stretch[:, None, None] * X, atol=1e-9)
    np.testing.assert_allclose(free_stretch(path), stretch, rtol=1e-12)
    J = np.broadcast_to(1.2 * stretch[:, None] ** 2, (3, path.model.n_cells))
    np.testing.assert_allclose(jaxgel.volume_ratio(path), J, rtol=1e-9)
    np.testing.assert_allclose(thickness_stretch(path), np.full(J.shape, 1.2))
    assert np.abs(jaxgel.cauchy_stress(path)).max() < 1e-12
    assert history(path)["status"] == ["converged"] * 3


@pytest.mark.slow
def test_the_derivative_of_the_energy_by_the_stretch_is_the_axial_force(block):
    """Nv l3 + l^2 (potential(l3 l^2) - mu) on 4 mm^2; 0 at the free-swelling stretch."""
    model, mu = block[0].model, MU[-1]

    @jax.grad
    def force(axial):
        return jaxgel.sweep(jaxgel.Problem(model.at_axial_stretch(axial), GEL), MU).energy[-1]

    area = root(lambda A: GEL.Nv + 1.2 * (potential(1.2 * A) - mu))
    assert float(force(1.2)) == pytest.approx(
        4 * (1.2 * GEL.Nv + area * (potential(1.2 * area) - mu)), rel=1e-9
    )
    free = np.cbrt(root(lambda J: potential(J) + GEL.Nv * J ** (-1 / 3) - mu))
    assert abs(float(force(free))) < 1e-9 * 4 * GEL.Nv


@pytest.mark.thorough
@pytest.mark.parametrize("network", [Gent(30.0), ArrudaBoyce(8.0)])
def test_other_networks_swell_freely_as_their_energy_says(network):
    """By differences of W(l, l, l), written with I = 3 l^2; and in plane with a held stretch."""
    gel = dataclasses.replace(GEL, network=network)

    def slope(energy, at, h=1e-6):
        return float(energy(at + h) - energy(at - h)) / (2 * h)

    @jax.jit
    def energy(plane, axial, mu):
        volume = plane**2 * axial
        return (
            network(plane * jnp.eye(2), gel, axial)
            + gel.volumetric(volume, gel)
            - mu * (volume - 1)
        )

    for mu in (-1.0, -0.1):
        stretch = root(lambda s, mu=mu: slope(lambda s: energy(s, s, mu), s), 1.01, 1.9)
        assert float(isotropic_swelling(mu, gel)) == pytest.approx(stretch, rel=1e-6)
        plane = root(lambda s, mu=mu: slope(lambda s: energy(s, 0.9, mu), s), 1.07, 1.9)
        assert float(free_swelling(mu, gel, 0.9)) == pytest.approx(plane, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "network",
    [
        GEL.network,
        *(pytest.param(of, marks=pytest.mark.slow) for of in (Gent(30.0), ArrudaBoyce(8.0))),
    ],
)
def test_derivatives_are_those_of_the_energy(block, network, check_derivatives):
    check_derivatives(block[0].model, dataclasses.replace(GEL, network=network))


def _rates(function, slope, steps):
    """Taylor rates of a function about 0 with the given slope."""
    left = [abs(float(function(h)) - float(function(0.0)) - h * float(slope)) for h in steps]
    return np.log2(np.array(left[:-1]) / left[1:])


@pytest.mark.slow
def test_derivatives_by_the_stretch(tiny_plate):
    """First ones by Taylor rates, the second by a difference of first ones.

    Of a plate with a hole.
    """
    held = dataclasses.replace(
        tiny_plate, kinematics="generalised plane strain", axial_stretch=1.15
    )
    model = jaxgel.discretise(jaxgel.make_cloud(held))

    def read(t):
        path = jaxgel.sweep(jaxgel.Problem(model.at_axial_stretch(1.05 + t), GEL), [-2.0, -1.0])
        return jaxgel.area_reduction(path)[-1] + path.energy[-1] + 100 * path.pressure[-1, 3]

    slope = jax.grad(read)
    assert np.all(_rates(read, slope(0.0), (2e-2, 1e-2, 5e-3)) > 1.95)
    second = float(jax.jvp(slope, (0.0,), (1.0,))[1])
    assert second == pytest.approx(float(slope(1e-4) - slope(-1e-4)) / 2e-4, rel=1e-5)


def own_network(F, gel):
    return gel.Nv / 2 * (jnp.sum(F**2) - 2)


@pytest.mark.thorough
def test_what_is_not_possible_is_said_in_one_line(tiny_plate, block):
    held = dict(kinematics="generalised plane strain")
    for wrong in (0.0, -1.0, np.nan, "free", [1.0]):
        with pytest.raises(
            ValueError,
            match=r"^axial_stretch: [^\n]* is not accepted, it must be a finite number > 0$",
        ):
            dataclasses.replace(tiny_plate, **held, axial_stretch=wrong)
    with pytest.raises(
        ValueError,
        match=(
            r"^axial_stretch: is missing; generalised plane strain takes a finite number > 0, 1 "
            r"for [^\n]*$"
        ),
    ):
        dataclasses.replace(tiny_plate, **held)
    for kinematics in ("plane strain", "plane stress"):
        with pytest.raises(
            ValueError, match=r"^axial_stretch: 1\.1 is not accepted in plane str[^\n]*$"
        ):
            dataclasses.replace(tiny_plate, kinematics=kinematics, axial_stretch=1.1)
    with pytest.raises(
        ValueError,
        match=(
            r"is not accepted in generalised plane strain, it must be neo_hookean, Gent or "
            r"ArrudaBoyce$"
        ),
    ):
        jaxgel.sweep(
            jaxgel.Problem(block[0].model, dataclasses.replace(GEL, network=own_network)), MU
        )
    with pytest.raises(ValueError, match=r"leave no room to swell in"):
        swollen("roller", 0.9)
