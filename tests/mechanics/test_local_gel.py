"""Gels with fields: exact states, constant fields, derivatives, refusals.

Derivatives are by fields and by holes under them.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.geometry import inside_holes
from jaxgel.materials import Gent, uniaxial_swelling
from jaxgel.mechanics import (
    condensed_rhs,
    energy_at,
    linearise,
    localised,
    mean_stiffness,
    state_pressure,
    tangent,
)

MU = [-3.0, -1.5, -1.0]
EXTENT = (-2.0, 2.0, -2.0, 2.0)
SHARES = np.random.default_rng(5).uniform(0.5, 2.0, (5, 4))


def pixels(shares):
    return jaxgel.PixelField(1e-3 * shares, EXTENT)


def constant(gel):
    return dataclasses.replace(gel, Nv=pixels(np.ones((5, 4))), chi=lambda X: 1e-4 + 0 * X[0])


@pytest.mark.thorough
def test_energy_forces_and_tangent_with_a_constant_field_are_those_of_the_plain_gel(tiny_model):
    x = np.asarray(tiny_model.cloud.nodes)
    x, found = 1.3 * x + 0.02 * np.random.default_rng(1).normal(size=x.shape), []
    for gel in (jaxgel.Gel(1e-3, 1e-4), constant(jaxgel.Gel(1e-3, 1e-4))):
        problem = jaxgel.Problem(tiny_model, gel, contact=False).prepared
        p = state_pressure(x, tiny_model, problem.gel, -1.0)
        now = linearise(problem, x, p, -1.0)
        energy = energy_at(x, tiny_model, problem.gel, -1.0, problem.loads)
        found.append((energy, p, condensed_rhs(problem, now, now), tangent(problem, x, p, now)))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-13 * np.abs(one).max())


@pytest.mark.slow
@pytest.mark.parametrize("network", [None, Gent(60.0)], ids=["neo-Hookean", "Gent"])
def test_a_constant_field_is_the_plain_gel(network, tiny_model):
    """States, energies, eigenvalues, stresses and surfaces."""
    own = {} if network is None else {"network": network}
    gel = jaxgel.Gel(1e-3, 1e-4, **own)
    plain, field = (
        jaxgel.sweep(jaxgel.Problem(tiny_model, one, contact=False), MU, eigenvalues=True)
        for one in (gel, constant(gel))
    )
    for name in ("x", "pressure", "energy"):
        np.testing.assert_allclose(
            getattr(field, name), getattr(plain, name), rtol=1e-12, atol=1e-13
        )
    # that of an iteration: 4e-12 and 1.6e-11 found on two machines
    np.testing.assert_allclose(field.lowest_eigenvalue, plain.lowest_eigenvalue, rtol=1e-10)
    for read in (jaxgel.cauchy_stress, jaxgel.surface_ratio, jaxgel.volume_ratio):
        np.testing.assert_allclose(read(field), read(plain), rtol=1e-11, atol=1e-13)


@pytest.mark.slow
def test_a_film_on_a_laterally_rigid_base_is_as_high_as_its_layers():
    """Every layer swells by Eq. (59) at its own Nv and chi: the height is an integral.

    Third order at least under refinement.
    """

    def gel_at(y):
        return jaxgel.Gel(1e-3 * (1.5 + jnp.sin(1.3 * y + 0.3)), 0.2 + 0.1 * jnp.cos(y))

    plate, mu = jaxgel.sample("square"), [-2.0, -1.0]
    gel, half = jaxgel.Gel(lambda X: gel_at(X[1]).Nv, lambda X: gel_at(X[1]).chi), plate.height / 2
    points, weights = np.polynomial.legendre.leggauss(20)
    layers = jax.vmap(lambda y: uniaxial_swelling(jnp.array(mu), gel_at(half * y)))(points)
    errors = []
    for across in (6, 12, 24):
        model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=plate.height / across))
        path = jaxgel.sweep(jaxgel.Problem(model, gel), mu)
        top = np.isclose(np.asarray(model.cloud.nodes)[:, 1], half)
        errors.append(
            np.abs(
                (np.asarray(path.x)[:, top, 1].mean(axis=1) + half) / (half * weights @ layers) - 1
            ).max()
        )
    assert errors[0] < 3e-5  # 2.6e-5 found
    assert errors[1] < 2e-7  # 1.3e-7
    assert errors[2] < 3e-8  # 2.0e-8
    assert errors[2] < errors[0] / 2**6


@pytest.mark.slow
def test_gradients_by_pixels_are_those_of_differences(tiny_model):
    """Of the energy, a displacement and the lowest eigenvalue, by all pixels at once."""
    direction = {"Nv": SHARES[::-1] - 1.0, "chi": SHARES - 1.0}

    @jax.jit
    def gel(t):
        values = 1e-3 * (SHARES + t["Nv"])
        return jaxgel.Gel(
            jaxgel.PixelField(values, EXTENT),
            jaxgel.PixelField(0.2 + 0.1 * (SHARES - 1.0 + t["chi"]), EXTENT),
        )

    def read(t):
        path = jaxgel.sweep(jaxgel.Problem(tiny_model, gel(t), contact=False), MU[:2])
        return path.energy[-1] + path.x[-1, 40, 0] + jnp.sum(path.pressure)

    at, h = {name: np.zeros(SHARES.shape) for name in direction}, 1e-4
    gradient = jax.grad(read)(at)
    slope = sum(np.vdot(gradient[name], direction[name]) for name in at)
    ahead, behind = (read({name: s * h * direction[name] for name in at}) for s in (1, -1))
    assert slope == pytest.approx(float((ahead - behind) / (2 * h)), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("moves", [False, True], ids=["stays", "moves"])
def test_gradients_by_a_hole_under_a_field_are_those_of_differences(moves, tiny_plate):
    """The field stays on the plate while the hole moves, or moves with the material."""
    field = pixels(SHARES)
    gel = jaxgel.Gel(jaxgel.WithHoles(field) if moves else field, 1e-4)
    cloud = jaxgel.make_cloud(tiny_plate)

    def read(shift):
        plate = tiny_plate.at([{"centre": jnp.array([0.1, -0.2]) + shift * jnp.array([0.6, 0.8])}])
        path = jaxgel.sweep(jaxgel.Problem(jaxgel.discretise(cloud.at(plate)), gel), MU[:2])
        return path.energy[-1] + path.x[-1, 40, 0]

    h = 1e-5
    slope = jax.grad(read)(0.01)
    assert slope == pytest.approx(float(read(0.01 + h) - read(0.01 - h)) / (2 * h), rel=1e-6)


def test_what_a_field_cannot_be_is_said_in_one_line(tiny_model):
    with pytest.raises(
        ValueError,
        match=(
            r"^Nv: -0\.\d+ at \(-0\.\d+, .*\) mm is not accepted, "
            r"it must be a finite number > 0$"
        ),
    ):
        jaxgel.sweep(
            jaxgel.Problem(tiny_model, jaxgel.Gel(lambda X: jnp.where(X[0] > -1.0, X[0], 1.0))), MU
        )
    with pytest.raises(
        ValueError, match=r"^chi: nan at .* mm is not accepted, it must be a finite number < 2$"
    ):
        jaxgel.sweep(jaxgel.Problem(tiny_model, jaxgel.Gel(chi=lambda X: jnp.log(X[0]))), MU)
    with pytest.raises(
        ValueError,
        match=(
            r"^Nv: the field gives an array of shape \(2,\), it must give one number for a "
            r"position"
        ),
    ):
        jaxgel.sweep(jaxgel.Problem(tiny_model, jaxgel.Gel(lambda X: X)), MU)


def test_a_gel_on_a_model_fits_no_other_one(tiny_model, square_model):
    gel = localised(tiny_model, jaxgel.Gel(pixels(SHARES)))
    assert localised(tiny_model, gel) is gel
    with pytest.raises(
        ValueError,
        match=r"^gel: has the values of its fields on another model; give the fields themselves$",
    ):
        jaxgel.sweep(jaxgel.Problem(square_model, gel), MU)


def test_the_mean_of_a_linear_field_is_its_value_at_the_centroid(square_model):
    """At the centre of the square it is 2e-3."""
    gel = localised(square_model, jaxgel.Gel(lambda X: 2e-3 + 1e-3 * X[0] - 5e-4 * X[1]))
    assert float(mean_stiffness(gel, square_model)) == pytest.approx(2e-3, rel=1e-9)


def quadratic(X):
    return 1e-3 * (2.0 + 0.3 * X[..., 0] - 0.2 * X[..., 0] * X[..., 1] + 0.1 * X[..., 1] ** 2)


def nodal(model, function=quadratic):
    return jaxgel.NodalField(function(np.asarray(model.cloud.nodes)), model)


@pytest.mark.slow
def test_a_nodal_field_reproduces_nodal_values_and_quadratics(tiny_plate, tiny_model):
    """At the nodes, at every point of the gel, one point alone, and on another cloud.

    To round-off.
    """
    field, rough = nodal(tiny_model), nodal(tiny_model, lambda X: np.sin(9 * X[:, 0] + 5 * X[:, 1]))
    np.testing.assert_allclose(rough.at(tiny_model.cloud.nodes), rough.values, atol=1e-12)
    points = np.random.default_rng(3).uniform(-2, 2, (200, 2))
    points = points[~inside_holes(tiny_plate, points)]
    np.testing.assert_allclose(field.at(points), quadratic(points), rtol=1e-11)
    assert float(jax.jit(field.__call__)(points[0])) == pytest.approx(
        quadratic(points[0]), rel=1e-11
    )
    fewer = jaxgel.discretise(jaxgel.make_cloud(tiny_plate, nodes_per_hole=11))
    for model in (tiny_model, fewer):
        found, exact = (
            localised(model, jaxgel.Gel(own)).Nv for own in (field, jaxgel.WithHoles(quadratic))
        )
        for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(exact), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-11)


@pytest.mark.thorough
def test_a_nodal_field_says_where_it_has_no_value_and_what_it_takes(tiny_model, tilted_cloud):
    field = nodal(tiny_model)
    assert np.isnan(field.at(np.array([[5.0, 0.0], [2.8, 2.8], [1.0, 3.1]]))).all()
    with pytest.raises(
        ValueError,
        match=r"^Nv: nan at \(-?\d.*\) mm is not accepted, it must be a finite number > 0$",
    ):
        jaxgel.sweep(jaxgel.Problem(jaxgel.discretise(tilted_cloud), jaxgel.Gel(field)), MU)
    with pytest.raises(
        ValueError,
        match=r"^values: an array of shape \(3,\), it must have one number for each of 79 nodes$",
    ):
        jaxgel.NodalField(np.ones(3), tiny_model)


def test_values_at_all_points_are_linear_in_nodal_values(tiny_model):
    start, direction = np.random.default_rng(7).uniform(1e-3, 2e-3, (2, tiny_model.n_nodes))

    @jax.jit
    def everywhere(values):
        return jax.tree.leaves(
            localised(tiny_model, jaxgel.Gel(jaxgel.NodalField(values, tiny_model))).Nv
        )

    for slope, value in zip(
        jax.jvp(everywhere, (start,), (direction,))[1], everywhere(direction), strict=True
    ):
        np.testing.assert_allclose(slope, value, rtol=1e-12)


@pytest.mark.slow
def test_a_sweep_is_differentiable_by_nodal_values(tiny_model):
    """Taylor: the remainder after the gradient falls with the square of the step."""
    start, direction = (
        nodal(tiny_model),
        1e-3 * np.random.default_rng(7).uniform(-1, 1, tiny_model.n_nodes),
    )

    def read(values):
        path = jaxgel.sweep(
            jaxgel.Problem(tiny_model, jaxgel.Gel(jaxgel.NodalField(values, tiny_model), 0.1)),
            MU[:2],
        )
        return path.energy[-1] + path.x[-1, 40, 0]

    value, gradient = jax.value_and_grad(read)(start.values)
    steps = 0.05 / 2.0 ** np.arange(3)
    remainders = [
        abs(float(read(start.values + h * direction) - value - h * (gradient @ direction)))
        for h in steps
    ]
    assert np.log2(np.divide(remainders[:-1], remainders[1:])).min() >= 1.95


@pytest.mark.parametrize("traced", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_nodal_field_moves_with_its_nodes(traced, tiny_plate):
    """Values at all points stay as a hole moves, also where jit traces it.

    Then the derivative by the hole is that of differences.
    """
    cloud = jaxgel.make_cloud(tiny_plate)
    field = nodal(jaxgel.discretise(cloud))

    def moved(shift):
        plate = tiny_plate.at([{"centre": jnp.array([0.1, -0.2]) + shift * jnp.array([0.6, 0.8])}])
        return jaxgel.discretise(cloud.at(plate))

    before, after = (
        localised(moved(0.0), jaxgel.Gel(field)),
        (jax.jit if traced else lambda f: f)(
            lambda shift: localised(moved(shift), jaxgel.Gel(field))
        )(0.05),
    )
    for one, same in zip(jax.tree.leaves(before.Nv), jax.tree.leaves(after.Nv), strict=True):
        np.testing.assert_allclose(one, same, rtol=1e-12)
    if not traced:
        return

    def read(shift):
        path = jaxgel.sweep(jaxgel.Problem(moved(shift), jaxgel.Gel(field, 0.1)), MU[:2])
        return path.energy[-1] + path.x[-1, 40, 0]

    h = 1e-5
    assert jax.grad(read)(0.01) == pytest.approx(
        float(read(0.01 + h) - read(0.01 - h)) / (2 * h), rel=1e-6
    )


def test_a_picture_that_does_not_cover_the_plate_is_refused(square_model):
    """Beyond its edge a picture has no value; on the edge it has that of its outermost pixels."""
    width = square_model.cloud.plate.width
    whole = jaxgel.PixelField(np.full((2, 2), 1e-3), (-width / 2, width / 2, -width / 2, width / 2))
    assert float(whole(jnp.array([width / 2, -width / 2]))) == 1e-3
    small = jaxgel.PixelField(np.full((2, 2), 1e-3), (-width / 4, width / 4, -width / 2, width / 2))
    with pytest.raises(ValueError, match=r"^Nv: nan at \("):
        localised(square_model, jaxgel.Gel(small, 0.1))
