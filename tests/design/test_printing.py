"""Fields as design parameters: filter, modes, mean over the gel, many parameters."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse as sp

import jaxgel
from jaxgel.design import (
    METHODS,
    MOST_DENSE,
    OF_GEL,
    DesignField,
    DesignProblem,
    bound,
    filtered,
    optimise,
    search,
)
from jaxgel.mechanics import localised, mean_stiffness

SIZE, PIXELS, RADIUS = (6.0, 3.5), (7, 12), 1.3  # mm, rows and columns, mm
RANDOM = np.random.default_rng(3)


@pytest.fixture(scope="module")
def matrix():
    """The filter as a matrix, by one picture for every pixel."""
    n = PIXELS[0] * PIXELS[1]
    return np.stack(
        [
            np.asarray(filtered(jnp.asarray(one.reshape(PIXELS)), SIZE, RADIUS)).ravel()
            for one in np.eye(n)
        ],
        axis=1,
    )


def test_the_filter_takes_means(matrix):
    """Its matrix is symmetric, positive, with row sums of 1: constants, bounds and mean stay."""
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-15)
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, atol=1e-12)
    assert matrix.min() > 0
    np.testing.assert_allclose(filtered(jnp.full(PIXELS, 2e-3), SIZE, RADIUS), 2e-3, rtol=1e-12)
    picture = RANDOM.choice([0.0, 1.0], size=PIXELS)
    smooth = np.asarray(filtered(picture, SIZE, RADIUS))
    assert smooth.min() > 0 and smooth.max() < 1 and np.std(smooth) < 0.5 * np.std(picture)
    np.testing.assert_allclose(smooth.mean(), picture.mean(), rtol=1e-13)
    np.testing.assert_array_equal(filtered(picture, SIZE, 0.0), picture)


def test_the_filter_solves_the_equation_of_helmholtz(matrix):
    """Beside the sparse matrix of f - l^2 (f_xx + f_yy), no flux, l = radius / (2 sqrt 3)."""
    laplacian = []
    for count, length in zip(PIXELS, SIZE[::-1], strict=True):
        difference = sp.diags([-1.0, 1.0], [0, 1], shape=(count - 1, count)) * (count / length)
        laplacian.append(difference.T @ difference)
    operator = sp.identity(matrix.shape[0]) + RADIUS**2 / 12 * (
        sp.kron(laplacian[0], sp.identity(PIXELS[1]))
        + sp.kron(sp.identity(PIXELS[0]), laplacian[1])
    )
    np.testing.assert_allclose(operator @ matrix, np.eye(matrix.shape[0]), atol=1e-12)


def test_modes_are_cosines_within_the_bounds():
    field = DesignField((20, 30), (3.0, 2.0), lower=1e-3, upper=3e-3, modes=(2, 3))
    np.testing.assert_allclose(field.values(field.constant(1.4e-3)), 1.4e-3, rtol=1e-12)
    one = field.constant(2e-3)
    one[1, 2] = 0.5
    # from the left and from the top, over the plate's size
    x, y = (np.arange(30) + 0.5) / 30, (np.arange(20) + 0.5) / 20
    wave = 0.5 * np.cos(np.pi * y)[:, None] * np.cos(2 * np.pi * x)
    np.testing.assert_allclose(field.values(one), 1e-3 + 2e-3 / (1 + np.exp(-wave)), rtol=1e-12)
    wild = np.asarray(field.values(100 * RANDOM.normal(size=(2, 3))))
    assert wild.min() >= 1e-3 and wild.max() <= 3e-3
    at = jnp.array([-1.5 + 3 * x[4], 1.0 - 2 * y[3]])  # the centre of a pixel, mm
    # a mean with its neighbours
    assert float(field.field(one)(at)) == pytest.approx(float(field.values(one)[3, 4]), rel=1e-2)


def test_a_smooth_picture_has_no_kinks_and_keeps_its_bounds():
    """Its slope is continuous at centres and edges of pixels; a straight ramp stays one."""
    picture = jaxgel.PixelField(
        RANDOM.uniform(1.0, 2.0, (4, 4)), (-2.0, 2.0, -2.0, 2.0), smooth=True
    )
    slope = jax.jit(jax.vmap(jax.grad(picture)))
    values = jax.jit(jax.vmap(picture))(RANDOM.uniform(-2.0, 2.0, (500, 2)))
    corners = np.stack(np.meshgrid(*2 * [np.arange(-2.0, 2.1, 0.5)]), axis=-1).reshape(-1, 2)
    # the slope's own change
    np.testing.assert_allclose(slope(corners - 1e-9), slope(corners + 1e-9), atol=1e-7)
    assert (
        values.min() >= picture.values.min() - 1e-15
        and values.max() <= picture.values.max() + 1e-15
    )
    ramp = jaxgel.PixelField(np.tile(np.arange(6.0), (2, 1)), (0.0, 6.0, 0.0, 2.0), smooth=True)
    # pixel 0 has its centre at 0.5
    assert float(ramp(jnp.array([2.3, 0.4]))) == pytest.approx(1.8, abs=1e-14)


def test_the_mean_is_that_over_the_gel(tiny_plate):
    """Holes are left out: little remains of a field of 1 in the hole and 0 in the gel.

    The pixels that both share are an exception.
    """
    cloud, mean = jaxgel.make_cloud(tiny_plate), OF_GEL["Nv_mean"]
    assert float(mean(cloud, jaxgel.Gel(Nv=2e-3))[0]) == 2e-3
    constant = DesignField((40, 40), (4.0, 4.0))
    assert float(
        mean(cloud, jaxgel.Gel(Nv=constant.field(jnp.full((40, 40), 2e-3))))[0]
    ) == pytest.approx(2e-3, rel=1e-12)
    # by the centroids of plate and circle
    slope = mean(cloud, jaxgel.Gel(Nv=lambda X: X[0] + 2.0))[0]
    area = np.pi * 1.1**2
    # the outline has 12 nodes
    np.testing.assert_allclose(slope, (16 * 2.0 - area * (0.1 + 2.0)) / (16 - area), rtol=2e-3)
    gel = jaxgel.Gel(Nv=lambda X: 1e-3 * (1 + X[0] ** 2))
    model = jaxgel.discretise(cloud)
    # of patches
    np.testing.assert_allclose(
        mean(cloud, gel)[0], mean_stiffness(localised(model, gel), model), rtol=1e-2
    )


def test_the_gradient_of_the_mean_follows_the_hole(tiny_plate):
    cloud, pixels = (
        jaxgel.make_cloud(tiny_plate),
        1e-3 * (1 + np.linspace(0, 1, 400).reshape(20, 20)),
    )

    def mean(centre, with_holes):
        field = DesignField((20, 20), (4.0, 4.0), with_holes=with_holes).field(pixels)
        return OF_GEL["Nv_mean"](
            cloud.at(tiny_plate.at([{"centre": centre}])), jaxgel.Gel(Nv=field)
        )[0]

    # mm; quadrature points may lie where two pixels meet
    at, step = jnp.array([0.1, -0.2]), jnp.array([3e-6, 4e-6])
    for with_holes in (False, True):
        slope = jax.grad(mean)(at, with_holes) @ step
        difference = (mean(at + step, with_holes) - mean(at - step, with_holes)) / 2
        # round-off of a mean of 1e-3 over its change of 1e-9
        np.testing.assert_allclose(slope, difference, rtol=1e-5)


@pytest.fixture(scope="module")
def many():
    """A problem of 1600 pixels: least at a wave that its mean constraint forbids."""
    # a quadrature point to each pixel
    plate = jaxgel.Plate(4, 4, edges={"top": "free"}, spacing=0.2)
    field = DesignField((40, 40), (4.0, 4.0))
    wave = 2e-3 + 1e-3 * np.sin(np.arange(40) / 5)
    return wave, DesignProblem(
        start={"Nv": np.full((40, 40), 1e-3)},
        bounds={"Nv": (5e-4, 4e-3)},
        plate=lambda _: plate,
        gel=lambda p: jaxgel.Gel(Nv=field.field(p["Nv"])),
        mu=[-3.0, -2.0],
        objective=lambda pixels: 1e6 * jnp.mean((pixels - wave) ** 2),
        constraints=(bound("Nv_mean", below=1.8e-3),),
    )


@pytest.mark.slow
@pytest.mark.parametrize("method", ["lbfgs", pytest.param("mma", marks=pytest.mark.slow)])
def test_methods_take_thousands_of_pixels_and_keep_the_mean(method, many, monkeypatch, tmp_path):
    """The point of a plane nearest to the wave, along the gradient of the mean."""
    wave, problem = many
    cloud = problem.make_cloud(problem.plate(problem.start))
    share = np.asarray(
        jax.grad(lambda pixels: OF_GEL["Nv_mean"](cloud, problem.gel({"Nv": pixels}))[0])(
            problem.start["Nv"]
        )
    )
    nearest = wave - share * (np.sum(share * wave) - 1.8e-3) / np.sum(share**2)

    def formula(self, vector):
        values, pullback = jax.vjp(
            lambda v: self.problem.objective(self.problem.parameters(v)["Nv"])[None],
            jnp.asarray(vector),
        )
        return values, lambda weights: pullback(weights), {}

    monkeypatch.setattr(search.Search, "_forward", formula)
    design = optimise(problem, method=method, evaluations=80, tolerance=1e-6, folder=tmp_path)
    assert design.feasible
    # the margin of the augmented Lagrangian
    np.testing.assert_allclose(design.constraints["Nv_mean <= 0.0018"], 0.0, atol=4e-6)
    np.testing.assert_allclose(design.parameters["Nv"], nearest, atol=2e-5)
    assert (tmp_path / "design.json").stat().st_size < 20e6


def test_dense_methods_are_refused_for_many_parameters(many):
    with pytest.raises(
        ValueError,
        match=(
            rf"^method: 'slsqp' takes at most {MOST_DENSE} parameters, not 1600; use 'mma', "
            r"'lbfgs' or"
        ),
    ):
        optimise(many[1])
    assert METHODS[0] == "slsqp"


@pytest.mark.slow
def test_a_film_is_verified():
    plate = jaxgel.Plate(
        2, 2, edges={"right": "free", "top": "free"}, kinematics="plane stress", spacing=0.5
    )
    problem = jaxgel.DesignProblem(
        start={"Nv": 1e-2},
        bounds={"Nv": (1e-3, 1e-1)},
        plate=lambda _: plate,
        gel=lambda p: jaxgel.Gel(p["Nv"], 0.1),
        mu=[-1.0, -0.5],
        objective=jaxgel.value_at(lambda path: path.energy, -0.5),
    )
    found, _ = jaxgel.verify(problem, problem.start, spacing=0.5)
    assert found["valid"] and np.isfinite(found["value"])
