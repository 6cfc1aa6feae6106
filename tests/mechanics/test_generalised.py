"""Generalised plane strain: closed forms, the full Hessian of positions and axial stretch, derivatives, symmetry, refusals."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxgel
from jaxgel.linalg import bordered_product, host_border
from jaxgel.materials import ArrudaBoyce, Gent, free_swelling, isotropic_swelling
from jaxgel.mechanics import (
    border,
    curvature,
    energy_at,
    factorised_tangent,
    gather,
    linearise,
    mu_force,
    prepare,
    residual,
    scatter,
    state_pressure,
    tangent,
    tangent_product,
    total_energy,
    with_free_values,
)
from jaxgel.observables import axial_stretch, free_stretch, history, thickness_stretch

GEL = jaxgel.Gel(1e-3, 0.1)
MU = [-1.0, -0.1, -0.01]
CORNER = dict(left="roller", bottom="roller", right="free", top="free")


def potential(J, gel=GEL):
    """d volumetric / dJ of the Flory-Rehner gel, with the network's -Nv ln J, written out once more."""
    return -np.log1p(1 / (J - 1)) + 1 / J + gel.chi / J**2 - gel.Nv / J


def root(function, low=1 + 1e-13, high=1e4):
    return brentq(function, low, high, xtol=1e-15, rtol=1e-15, maxiter=500)


def swollen(edges, axial, kinematics="generalised plane strain"):
    """Path of a square plate of 2 x 2 mm, 81 nodes and more, and its dry nodes from the lower left corner."""
    plate = jaxgel.Plate(2, 2, edges=edges, kinematics=kinematics, axial_stretch=axial, gel=GEL)
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.25))
    return jaxgel.sweep(model, GEL, mu=MU), np.asarray(model.cloud.nodes) + 1


@pytest.fixture(scope="module")
def model_at(tiny_plate):
    """Function of an axial stretch that gives the tiny plate's model, 79 nodes."""
    made = {}

    def at(axial):
        if axial not in made:
            plate = dataclasses.replace(tiny_plate, kinematics="generalised plane strain", axial_stretch=axial, gel=GEL)
            made[axial] = jaxgel.discretise(jaxgel.make_cloud(plate))
        return made[axial]

    return at


def test_a_free_block_swells_as_a_free_gel_in_three_dimensions():
    path, X = swollen(CORNER, "free")
    stretch = np.array([np.cbrt(root(lambda J, mu=mu: potential(J) + GEL.Nv * J ** (-1 / 3) - mu)) for mu in MU])
    np.testing.assert_allclose(path.x, -1 + stretch[:, None, None] * X, atol=1e-9)
    np.testing.assert_allclose(axial_stretch(path), stretch, rtol=1e-9)
    np.testing.assert_allclose(free_stretch(path), stretch, rtol=1e-12)
    np.testing.assert_allclose(jaxgel.volume_ratio(path), np.broadcast_to(stretch[:, None] ** 3, (3, path.model.n_cells)), rtol=1e-9)
    np.testing.assert_allclose(thickness_stretch(path), np.broadcast_to(stretch[:, None], (3, path.model.n_cells)), rtol=1e-9)
    assert np.abs(jaxgel.cauchy_stress(path)).max() < 1e-12
    assert history(path)["status"] == ["converged"] * 3
    assert np.all(path.negative_pivots == 0)


def test_a_block_held_along_one_axis():
    """l1 = 1, l2 = l3 = l: J = l^2, and no stress across: potential(J) + Nv = mu."""
    path, X = swollen(CORNER | dict(right="roller"), "free")
    stretch = np.array([np.sqrt(root(lambda J, mu=mu: potential(J) + GEL.Nv - mu)) for mu in MU])
    np.testing.assert_allclose(path.x, -1 + np.stack([np.ones(3), stretch], axis=1)[:, None] * X, atol=1e-9)
    np.testing.assert_allclose(axial_stretch(path), stretch, rtol=1e-9)
    sigma_11 = GEL.Nv * (1 - stretch**2) / stretch**2  # Nv (l1^2 - l3^2) / J
    np.testing.assert_allclose(
        np.asarray(jaxgel.cauchy_stress(path))[..., 0], np.broadcast_to(sigma_11[:, None], path.x.shape[:2]), rtol=1e-8
    )


def test_a_block_held_along_both_axes_swells_by_eq_59_through_its_thickness():
    path, X = swollen("roller", "free")
    thickness = [root(lambda l3, mu=mu: potential(l3) + GEL.Nv * l3 - mu) for mu in MU]
    np.testing.assert_allclose(path.x, np.broadcast_to(X - 1, path.x.shape), atol=1e-12)
    np.testing.assert_allclose(axial_stretch(path), thickness, rtol=1e-9)


def test_held_at_one_it_is_plane_strain():
    held, plane = swollen(CORNER, 1.0)[0], swollen(CORNER, None, "plane strain")[0]
    np.testing.assert_allclose(held.x, plane.x, rtol=1e-13)
    np.testing.assert_allclose(held.energy, plane.energy, rtol=1e-13)
    np.testing.assert_allclose(held.lowest_eigenvalue, plane.lowest_eigenvalue, rtol=1e-9)


def test_a_block_held_at_another_stretch():
    """l1 = l2 = l, no stress across: Nv + l3 (potential(l3 l^2) - mu) = 0."""
    path, X = swollen(CORNER, 1.2)
    stretch = np.array([np.sqrt(root(lambda J, mu=mu: GEL.Nv + 1.2 * (potential(J) - mu)) / 1.2) for mu in MU])
    assert stretch[0] < 1  # the areal stretch may be below 1
    np.testing.assert_allclose(path.x, -1 + stretch[:, None, None] * X, atol=1e-9)
    np.testing.assert_allclose(free_stretch(path), stretch, rtol=1e-12)
    np.testing.assert_allclose(axial_stretch(path), 1.2)
    assert np.abs(jaxgel.cauchy_stress(path)).max() < 1e-12


@pytest.mark.parametrize("network", [Gent(30.0), ArrudaBoyce(8.0)])
def test_other_networks_swell_freely_as_their_energy_says(network):
    """By differences of W(l, l, l), written with I = 3 l^2; and in plane with a held stretch."""
    gel = dataclasses.replace(GEL, network=network)

    def slope(energy, at, h=1e-6):
        return (energy(at + h) - energy(at - h)) / (2 * h)

    def energy(plane, axial, mu):
        volume = plane**2 * axial
        return float(network(plane * jnp.eye(2), gel, axial) + gel.volumetric(volume, gel) - mu * (volume - 1))

    for mu in (-1.0, -0.1):
        stretch = root(lambda s, mu=mu: slope(lambda s: energy(s, s, mu), s), 1.01, 1.9)
        assert float(isotropic_swelling(mu, gel)) == pytest.approx(stretch, rel=1e-6)
        plane = root(lambda s, mu=mu: slope(lambda s: energy(s, 0.9, mu), s), 1.07, 1.9)
        assert float(free_swelling(mu, gel, 0.9)) == pytest.approx(plane, rel=1e-6)


def _rough(model, gel, mu=-1.0):
    """A rough state: problem, positions, pressures, linearisation and a vector."""
    random, nodes, problem = np.random.default_rng(2), np.asarray(model.cloud.nodes), prepare(model, gel)
    x = jnp.asarray(1.1 * nodes + 0.02 * random.normal(size=nodes.shape))
    p = state_pressure(x, model, gel, mu)
    return problem, x, p, linearise(problem, x, p, mu), jnp.asarray(random.normal(size=len(problem.free)))


@pytest.mark.parametrize(
    ("network", "axial"),
    [
        (GEL.network, None),
        (GEL.network, 1.15),
        *(pytest.param(of, at, marks=pytest.mark.slow) for of in (Gent(30.0), ArrudaBoyce(8.0)) for at in (None, 1.15)),
    ],
)
def test_tangent_residual_and_products_are_derivatives_of_the_energy(model_at, network, axial):
    """At a rough state: the assembled tangent, its product, the force of mu, and the curvature, by differentiating the total energy."""
    model, gel, mu = model_at(axial), dataclasses.replace(GEL, network=network), -1.0
    problem, x, p, now, v = _rough(model, gel)
    field = scatter(v, x.shape, problem.free)

    def force(x, mu):
        return residual(x, model, problem.gel, mu, problem.loads)

    exact = gather(jax.jvp(lambda x: force(x, mu), (x,), (field,))[1], problem.free)
    np.testing.assert_allclose(gather(-now.rhs, problem.free), gather(force(x, mu), problem.free), atol=1e-13)
    assembled = bordered_product(problem.pattern.matrix(tangent(problem, x, p, now)), host_border(border(problem, now)), np.asarray(v))
    for product in (tangent_product(problem, x, p, now, v), assembled):
        assert np.linalg.norm(product - exact) < 1e-11 * np.linalg.norm(exact)
    by_mu = gather(jax.jvp(lambda mu: force(x, mu), (mu,), (1.0,))[1], problem.free)
    assert np.linalg.norm(mu_force(problem, x, mu) - by_mu) < 1e-11 * np.linalg.norm(by_mu)
    assert float(jax.jit(curvature)(x, field, model, gel, mu, problem.loads)) == pytest.approx(float(v @ exact), rel=1e-11)

    def energy(h):
        return float(energy_at(x + h * field, model, problem.gel, mu, problem.loads))

    assert (energy(1e-5) - energy(-1e-5)) / 2e-5 == pytest.approx(float(jnp.sum(force(x, mu) * field)), rel=1e-6)


@pytest.mark.parametrize("stretched", [0.0, 0.25])
def test_solutions_and_negative_pivots_are_those_of_the_full_hessian(model_at, stretched):
    """The Hessian of the held plate's energy in positions and axial stretch together, dense, at rough states."""
    model, mu = model_at(None), -1.0
    problem, x, _, _, v = _rough(model, GEL)
    x = (1 - stretched) * x + stretched * 1.6 * model.cloud.nodes
    p = state_pressure(x, model, GEL, mu)
    now = linearise(problem, x, p, mu)
    at = jnp.append(gather(x, problem.free), now.axial.stretch)

    def energy(z):
        positions = with_free_values(z[:-1], x, problem.free)
        return total_energy(positions, model.at_axial_stretch(z[-1]), problem.gel, mu, problem.loads)

    assert abs(float(jax.grad(energy)(at)[-1])) < 1e-9 * float(now.axial.stiffness)
    hessian = np.asarray(jax.hessian(energy)(at))
    made = factorised_tangent(problem, x, p, now)
    assert made.negative_pivots == int(np.sum(np.linalg.eigvalsh(hessian) < 0))
    exact = np.linalg.solve(hessian, np.append(v, 0.0))[:-1]
    assert np.linalg.norm(made.solve(np.asarray(v))[0] - exact) < 1e-8 * np.linalg.norm(exact)


def _rates(function, slope, steps):
    """Taylor rates of a function about 0 with the given slope."""
    left = [abs(float(function(h)) - float(function(0.0)) - h * float(slope)) for h in steps]
    return np.log2(np.array(left[:-1]) / left[1:])


@pytest.mark.slow
def test_derivatives_by_hole_and_gel_with_a_free_stretch(model_at):
    """Reverse and forward, by the hole's place and size, Nv, chi and mu at once: of energy, stretch, areas and a pressure."""
    cloud = model_at(None).cloud

    def read(t):
        plate = cloud.plate.at([dict(radius=1.1 + 0.1 * t, centre=jnp.array([0.1 + 0.1 * t, -0.2]))])
        gel, mu = jaxgel.Gel(1e-3 * (1 + t), 0.1 + t), jnp.array([-2.0, -1.0 + t])
        path = jaxgel.sweep(jaxgel.discretise(cloud.at(plate)), gel, mu=mu)
        return 10 * axial_stretch(path)[-1] + jaxgel.area_reduction(path)[-1] + path.energy[-1] + 100 * path.pressure[-1, 3]

    slope = jax.grad(read)(0.0)
    assert float(jax.jvp(read, (0.0,), (1.0,))[1]) == pytest.approx(float(slope), rel=1e-9)
    assert np.all(_rates(read, slope, (2e-2, 1e-2, 5e-3)) > 1.95)


@pytest.mark.slow
def test_derivatives_by_a_held_stretch(model_at):
    """First ones by Taylor rates, the second by a difference of first ones."""
    model = model_at(1.05)

    def read(t):
        path = jaxgel.sweep(model.at_axial_stretch(1.05 + t), GEL, mu=[-2.0, -1.0])
        return jaxgel.area_reduction(path)[-1] + path.energy[-1] + axial_stretch(path)[-1] + 100 * path.pressure[-1, 3]

    slope = jax.grad(read)
    assert np.all(_rates(read, slope(0.0), (2e-2, 1e-2, 5e-3)) > 1.95)
    second = float(jax.jvp(slope, (0.0,), (1.0,))[1])
    assert second == pytest.approx(float(slope(1e-4) - slope(-1e-4)) / 2e-4, rel=1e-5)


@pytest.mark.slow
def test_the_energy_of_a_free_stretch_is_least_among_the_held_ones(model_at):
    """The free state is an equilibrium of the plate held at its stretch, and there the energy is stationary in it."""
    path = jaxgel.sweep(model_at(None), GEL, mu=[-2.0])
    stretch = float(axial_stretch(path)[0])
    held = [jaxgel.sweep(model_at(None).at_axial_stretch(stretch + h), GEL, mu=[-2.0]) for h in (0.0, -1e-3, 1e-3)]
    np.testing.assert_allclose(held[0].x, path.x, atol=1e-10)
    assert float(held[0].energy[0]) == pytest.approx(float(path.energy[0]), rel=1e-12)
    below, above = (float(one.energy[0] - held[0].energy[0]) for one in held[1:])
    assert below > 0 and above > 0
    assert abs(above - below) < 0.2 * (above + below)  # of third order in the step


@pytest.mark.slow
def test_onset_and_branch_of_a_symmetric_plate_with_a_free_stretch(cloud_of):
    """Sample 4: the located onset parts stable from unstable states, moves with chi as differences say, and the stable branch turns."""
    plate = dataclasses.replace(cloud_of("sample-4").plate, kinematics="generalised plane strain")
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=2 * plate.spacing))

    def located(chi):
        return jaxgel.critical_points(model, jaxgel.Gel(1e-3, chi), mu=(-1.0, -0.7), most=1)[0].mu

    gel, mu = jaxgel.Gel(1e-3, 0.05), located(0.05)
    path = jaxgel.sweep(model, gel, mu=[-2.2, mu - 1e-6, mu + 1e-6], branch="symmetric")
    assert list(path.negative_pivots) == [0, 0, 1]
    assert float(jax.jvp(located, (0.05,), (1.0,))[1]) == pytest.approx((located(0.055) - located(0.045)) / 0.01, rel=1e-6)
    path = jaxgel.sweep(model, gel, mu=[-2.2, mu - 0.1, mu + 0.1])
    assert (path.symmetry[1], path.symmetry[2]) == ("D4", "C4")
    whole = jaxgel.sweep(model, gel, mu=[-2.2, mu - 0.1], symmetry="off")
    np.testing.assert_allclose(whole.x, path.x[:2], atol=1e-10)
    np.testing.assert_allclose(whole.lowest_eigenvalue, path.lowest_eigenvalue[:2], rtol=1e-2)


def own_network(F, gel):
    return gel.Nv / 2 * (jnp.sum(F**2) - 2)


def test_what_is_not_possible_is_said_in_one_line(tiny_plate, model_at):
    held = dict(kinematics="generalised plane strain")
    for wrong in (0.0, -1.0, np.nan, "held", [1.0]):
        with pytest.raises(ValueError, match=r"^axial_stretch: [^\n]* is not accepted, it must be a finite number > 0 or 'free'$"):
            dataclasses.replace(tiny_plate, **held, axial_stretch=wrong)
    for kinematics in ("plane strain", "plane stress"):
        with pytest.raises(ValueError, match=r"^axial_stretch: 1\.1 is not accepted in plane str[^\n]*$"):
            dataclasses.replace(tiny_plate, kinematics=kinematics, axial_stretch=1.1)
    with pytest.raises(ValueError, match=r"is not accepted in generalised plane strain, it must be neo_hookean, Gent or ArrudaBoyce$"):
        jaxgel.sweep(model_at(None), dataclasses.replace(GEL, network=own_network), mu=MU)
    with pytest.raises(ValueError, match=r"leave no room to swell in"):
        swollen("roller", 0.9)
    cell = jaxgel.Plate(2, 2, [jaxgel.Circle((0, 0), 0.5)], edges="periodic", spacing=0.5, nodes_per_hole=8, **held)
    with pytest.raises(ValueError, match=r"^axial_stretch: 'free' is not accepted by lattice_onset, it must be a number$"):
        jaxgel.lattice_onset(jaxgel.discretise(jaxgel.make_cloud(cell)), GEL, mu=(-2.0, -1.0))
