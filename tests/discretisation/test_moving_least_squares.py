"""Shape functions at single points of random clouds: 7 x 7 jittered grid points.

Of spacing 1, support 3.5. The function of ``jaxgel.paper`` has the kinds of the package, and those
with which it is compared.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgel.discretisation import n_monomials, shape_functions_and_gradients, singular_weight
from jaxgel.paper import KINDS, cubic_spline_weight, shape_functions

SUPPORT = 3.5
each_basis = pytest.mark.parametrize("basis", ["linear", "quadratic"])
each_kind = pytest.mark.parametrize("kind", KINDS)
interpolating = pytest.mark.parametrize("kind", ["iicvmls", "imls"])


def clouds(n, seed):
    """Nodes (n, 49, 2) of n jittered grids and a point (n, 2) in the middle square of each."""
    random = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(7.0), np.arange(7.0)), axis=-1).reshape(-1, 2)
    return grid + random.uniform(-0.35, 0.35, (n, 49, 2)), random.uniform(2, 4, (n, 2))


def value_and_gradient(x, nodes, support, *, basis, kind):
    """Values (p, n) and gradients (p, n, 2) at ``x`` (p, 2) with nodes (p, n, 2), supports.

    p <= 200 points, each with its own nodes, and supports () or (n,).
    """
    fill = np.arange(200) % len(x)  # one shape for all tests: compiled once per basis and kind
    phi, gradient = two_hundred(
        x[fill], nodes[fill], np.broadcast_to(support, nodes.shape[1]), basis=basis, kind=kind
    )
    return np.asarray(phi[: len(x)]), np.asarray(gradient[: len(x)])


@functools.partial(jax.jit, static_argnames=("basis", "kind"))
def two_hundred(x, nodes, support, *, basis, kind):
    def one(x, nodes):
        def phi(x):
            value = shape_functions(x, nodes, support, basis=basis, kind=kind)
            return value, value

        gradient, value = jax.jacfwd(phi, has_aux=True)(x)
        return value, gradient

    return jax.vmap(one)(x, nodes)


def monomials(x, basis):
    """The basis (..., m) at points ``x`` (..., 2) and its gradient (..., m, 2)."""
    one, zero = np.ones_like(x[..., 0]), np.zeros_like(x[..., 0])
    x, y = x[..., 0], x[..., 1]
    p = [one, x, y, x * x, x * y, y * y]
    dp = [(zero, zero), (one, zero), (zero, one), (2 * x, zero), (y, x), (zero, 2 * y)]
    m = n_monomials(basis)
    return np.stack(p[:m], axis=-1), np.stack([np.stack(d, axis=-1) for d in dp[:m]], axis=-2)


def at_nodes(cloud):
    """Every node of the cloud (n, 2) as a point, with all nodes as neighbours."""
    return cloud, np.broadcast_to(cloud, (len(cloud), *cloud.shape))


@each_basis
@interpolating
def test_values_at_nodes_are_exactly_kronecker_deltas(basis, kind):
    x, nodes = at_nodes(clouds(1, 1)[0][0])
    phi, _ = value_and_gradient(x, nodes, SUPPORT, basis=basis, kind=kind)
    np.testing.assert_array_equal(phi, np.eye(49))  # exact: at a node v = delta and b(x) = 0


@each_basis
@interpolating
def test_gradients_at_nodes_match_differences_of_values(basis, kind):
    x, nodes = at_nodes(clouds(1, 2)[0][0])
    step = 1e-5
    _, gradient = value_and_gradient(x, nodes, SUPPORT, basis=basis, kind=kind)
    assert np.all(np.isfinite(gradient))
    for i in range(2):
        ahead, behind = (
            value_and_gradient(
                x + sign * step * np.eye(2)[i], nodes, SUPPORT, basis=basis, kind=kind
            )[0]
            for sign in (1, -1)
        )
        # phi has a term |x - x_a|^3 at the nodes: truncation about step^2 = 1e-10; round-off
        # 1e-15 / step = 1e-10
        np.testing.assert_allclose(gradient[:, :, i], (ahead - behind) / (2 * step), atol=3e-9)


@each_basis
@each_kind
def test_gradients_match_differences_of_values(basis, kind):
    nodes, x = clouds(50, 3)
    step = 1e-5
    gradient = value_and_gradient(x, nodes, SUPPORT, basis=basis, kind=kind)[1]
    for i in range(2):
        ahead, behind = (
            value_and_gradient(
                x + sign * step * np.eye(2)[i], nodes, SUPPORT, basis=basis, kind=kind
            )[0]
            for sign in (1, -1)
        )
        np.testing.assert_allclose(gradient[:, :, i], (ahead - behind) / (2 * step), atol=3e-9)


@each_basis
@pytest.mark.parametrize("kind", ["iicvmls", "imls", "mls"])
def test_200_random_clouds_reproduce_the_basis(basis, kind):
    nodes, x = clouds(200, 4)
    phi, gradient = value_and_gradient(x, nodes, SUPPORT, basis=basis, kind=kind)
    # monomials about the point, so that errors are relative to the size of the support
    about = nodes - x[:, None]
    p, _ = monomials(about, basis)
    p_x, dp_x = monomials(np.zeros_like(x), basis)
    np.testing.assert_allclose(np.einsum("pa,pam->pm", phi, p), p_x, atol=1e-12)
    np.testing.assert_allclose(np.einsum("pai,pam->pmi", gradient, p), dp_x, atol=1e-10)


@each_basis
@interpolating
def test_linear_fields_are_exact_between_and_next_to_nodes(basis, kind):
    nodes, x = clouds(200, 5)
    # to the node nearest to the middle
    distance = np.repeat([1e-12, 1e-8, 1e-4, 1e-1], 50)[:, None]
    x = nodes[:, 24] + distance * np.array([0.6, 0.8])
    phi, gradient = value_and_gradient(x, nodes, SUPPORT, basis=basis, kind=kind)
    slope = np.array([0.3, -1.7])
    field = 2.0 + nodes @ slope
    np.testing.assert_allclose(np.sum(phi * field, axis=1), 2.0 + x @ slope, atol=1e-10)
    np.testing.assert_allclose(
        np.einsum("pai,pa->pi", gradient, field), np.broadcast_to(slope, (200, 2)), atol=1e-10
    )


@each_basis
def test_complex_form_is_real_and_equals_its_real_twin(basis):
    nodes, x = clouds(200, 6)
    phi, gradient = value_and_gradient(x, nodes, SUPPORT, basis=basis, kind="iicvmls")
    twin, twin_gradient = value_and_gradient(x, nodes, SUPPORT, basis=basis, kind="imls")
    assert np.abs(phi.imag).max() < 1e-12
    np.testing.assert_allclose(phi.real, twin, atol=1e-12)
    np.testing.assert_allclose(gradient, twin_gradient, atol=1e-10)


@each_basis
def test_complex_form_is_equation_36_as_printed(basis):
    """Eqs. (18)-(37) of Deng et al. (2020) word by word; valid away from the nodes."""
    nodes, points = clouds(20, 7)
    phi, _ = value_and_gradient(points, nodes, SUPPORT, basis=basis, kind="iicvmls")
    for x, cloud, mine in zip(points, nodes, np.asarray(phi), strict=True):
        z, z_a = complex(*x), cloud[:, 0] + 1j * cloud[:, 1]
        distance = abs(z - z_a)
        w = np.where(
            distance <= SUPPORT, (SUPPORT / distance) ** 2 * (1 - distance / SUPPORT) ** 2, 0.0
        )
        v = w / w.sum()

        def p(z):
            terms = (
                [z, np.conj(z)]
                if basis == "linear"
                else [z, np.conj(z), z**2, np.conj(z) ** 2, z * np.conj(z)]
            )
            return np.stack(terms, axis=-1)

        mean = v @ p(z_a)
        b, C = p(z) - mean, p(z_a) - mean
        A, B = C.conj().T @ np.diag(w) @ C, C.conj().T @ np.diag(w)
        # the paper's monomials are about the origin: the moment matrix has a condition number near
        # 1e8
        np.testing.assert_allclose(mine, v + b @ np.linalg.solve(A, B), atol=1e-9)


@each_basis
@pytest.mark.parametrize(
    ("kind", "weight"), [("imls", singular_weight), ("mls", cubic_spline_weight)]
)
def test_values_are_those_of_a_weighted_least_squares_fit(basis, kind, weight):
    """The fitted polynomial at the point.

    The interpolating form is the fit with the singular weight (Lancaster & Salkauskas 1981).
    """
    nodes, points = clouds(20, 8)
    phi, _ = value_and_gradient(points, nodes, SUPPORT, basis=basis, kind=kind)
    for x, cloud, mine in zip(points, nodes, phi, strict=True):
        root = np.sqrt(np.asarray(weight(np.sum((cloud - x) ** 2, axis=1), SUPPORT)))
        p, _ = monomials(cloud - x, basis)
        fit, *_ = np.linalg.lstsq(root[:, None] * p, np.diag(root), rcond=None)
        np.testing.assert_allclose(mine, fit[0], atol=1e-12)


@each_basis
def test_icvmls_reproduces_powers_of_z_but_not_their_conjugates(basis):
    nodes, x = clouds(200, 9)
    phi, gradient = value_and_gradient(x, nodes, SUPPORT, basis=basis, kind="icvmls")
    z = (nodes - x[:, None]) @ np.array([1.0, 1.0j])  # about the point
    for power in range(2 if basis == "linear" else 3):
        np.testing.assert_allclose(np.sum(phi * z**power, axis=1), float(power == 0), atol=1e-12)
        by_x, by_y = np.einsum("pai,pa->ip", gradient, z**power)
        np.testing.assert_allclose(by_x, float(power == 1), atol=1e-10)
        np.testing.assert_allclose(by_y, 1j * float(power == 1), atol=1e-10)
    # the incomplete basis: what the paper's complete one cures
    assert np.abs(np.sum(phi * z.conj(), axis=1)).max() > 0.01


@each_basis
@pytest.mark.parametrize("kind", ["icvmls", "mls"])
def test_kinds_of_comparison_do_not_interpolate(basis, kind):
    x, nodes = at_nodes(clouds(1, 10)[0][0])
    phi, gradient = value_and_gradient(x, nodes, SUPPORT, basis=basis, kind=kind)
    assert np.all(np.isfinite(gradient))  # the weight is smooth at d = 0
    assert phi[24, 24].real < 0.7  # the middle node, where an interpolating kind has 1


@pytest.mark.parametrize(
    ("basis", "kind"),
    [
        ("quadratic", "imls"),
        ("linear", "iicvmls"),
        *(pytest.param("linear", kind, marks=pytest.mark.slow) for kind in ("icvmls", "mls")),
    ],
)
def test_padding_and_nodes_out_of_reach_change_nothing(basis, kind):
    nodes, x = clouds(50, 11)
    phi, gradient = value_and_gradient(x, nodes, SUPPORT, basis=basis, kind=kind)
    padded = np.concatenate(
        [nodes, np.repeat(nodes[:, :1], 5, axis=1), np.repeat(x[:, None] + 3.6, 3, axis=1)], axis=1
    )
    support = np.concatenate([np.full(49, SUPPORT), np.zeros(5), np.full(3, SUPPORT)])
    longer, longer_gradient = value_and_gradient(x, padded, support, basis=basis, kind=kind)
    assert np.all(longer[:, 49:] == 0)
    assert np.all(longer_gradient[:, 49:] == 0)
    # sums in another order, multiplied by the condition of the moment matrix
    np.testing.assert_allclose(longer[:, :49], phi, atol=1e-13)
    np.testing.assert_allclose(longer_gradient[:, :49], gradient, atol=1e-12)


@pytest.mark.parametrize(("basis", "kind"), [("quadratic", "imls"), ("linear", "iicvmls")])
def test_padding_with_a_copy_of_the_node_at_the_point_is_harmless(basis, kind):
    nodes = clouds(1, 12)[0]
    padded = np.concatenate([nodes, np.repeat(nodes[:, 24:25], 8, axis=1)], axis=1)
    phi, gradient = value_and_gradient(
        nodes[:, 24], padded, np.append(np.full(49, SUPPORT), np.zeros(8)), basis=basis, kind=kind
    )
    np.testing.assert_array_equal(phi[0], np.eye(57)[24])
    assert np.all(np.isfinite(gradient))


@pytest.mark.slow
@pytest.mark.parametrize(("basis", "kind"), [("linear", "iicvmls"), ("quadratic", "imls")])
def test_compiled_and_uncompiled_values_agree(basis, kind):
    nodes, x = clouds(1, 13)
    phi, gradient = value_and_gradient(x, nodes, SUPPORT, basis=basis, kind=kind)
    function = functools.partial(
        shape_functions, neighbours=jnp.asarray(nodes[0]), support=SUPPORT, basis=basis, kind=kind
    )
    with jax.disable_jit():
        np.testing.assert_allclose(phi[0], function(jnp.asarray(x[0])), atol=1e-14)
        derivative = jax.jvp(function, (jnp.asarray(x[0]),), (jnp.array([0.6, 0.8]),))[1]
        np.testing.assert_allclose(gradient[0] @ np.array([0.6, 0.8]), derivative, atol=1e-12)


@pytest.mark.smoke
@pytest.mark.parametrize(
    "n", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in (7, 1000, 16385)), 32769]
)
def test_many_points_get_the_values_of_single_points(n):
    """Some jaxlib releases sum more than 16,384 mapped products wrongly (jax issue 39103)."""
    nodes = np.stack(np.meshgrid(np.arange(3.0), np.arange(3.0)), axis=-1).reshape(-1, 2)
    x = np.random.default_rng(14).uniform(0, 2, (n, 2))
    one = functools.partial(
        shape_functions, neighbours=nodes, support=4.0, basis="linear", kind="imls"
    )
    phi = jax.jit(jax.vmap(one))(x)
    np.testing.assert_allclose(phi, jax.jit(lambda x: jax.lax.map(one, x))(x), atol=1e-13)
    np.testing.assert_allclose(phi @ nodes, x, atol=1e-12)


@pytest.mark.smoke
@each_basis
@pytest.mark.parametrize("level", [0, 3])
@pytest.mark.parametrize("n", [1, pytest.param(2, marks=pytest.mark.slow), 50])
def test_a_batch_of_any_size_at_any_optimisation_level_gives_the_fit_of_numpy(n, level, basis):
    """Distances computed twice, each rounded in its way, once left points without nearest node."""
    nodes = np.stack(np.meshgrid(np.arange(3.0), np.arange(3.0)), axis=-1).reshape(-1, 2)
    between, support = np.random.default_rng(14).uniform(0, 2, (50, 2)), 4.0
    function = jax.vmap(
        functools.partial(
            shape_functions, neighbours=nodes, support=support, basis=basis, kind="imls"
        )
    )
    program = (
        jax.jit(function)
        .lower(between[:n])
        .compile(compiler_options={"xla_backend_optimization_level": level})
    )

    def phi(points):  # filled up to whole batches
        return np.concatenate(
            [program(points[np.arange(i, i + n) % len(points)]) for i in range(0, len(points), n)]
        )[: len(points)]

    distance = np.linalg.norm(between[:, None] - nodes, axis=2)
    p, q = monomials(nodes, basis)[0], monomials(between, basis)[0]
    weighted = p.T[None] * ((support / distance - 1) ** 2)[:, None]
    fit = np.linalg.solve(weighted @ p, weighted).transpose(0, 2, 1) @ q[:, :, None]
    values = phi(between)
    # the plain fit is ill-conditioned next to a node: weights up to 1e4
    np.testing.assert_allclose(values, fit[:, :, 0], atol=1e-9)
    np.testing.assert_allclose(values @ p, q, atol=1e-13)  # sum 1 and the basis, to round-off
    np.testing.assert_array_equal(phi(nodes), np.eye(9))  # exact, see above


@each_basis
@interpolating
def test_values_are_local_and_independent_of_unit_place_and_direction(basis, kind):
    nodes, x = clouds(50, 15)
    support = np.random.default_rng(15).uniform(3.0, 4.0, 49)  # each node its own
    phi, gradient = value_and_gradient(x, nodes, support, basis=basis, kind=kind)
    assert np.all(phi[np.linalg.norm(nodes - x[:, None], axis=2) >= support] == 0)
    c, s = np.cos(0.7), np.sin(0.7)
    turn, shift, scale = np.array([[c, -s], [s, c]]), np.array([4.0, -9.0]), 1e-3
    moved = value_and_gradient(
        scale * (x @ turn.T + shift),
        scale * (nodes @ turn.T + shift),
        scale * support,
        basis=basis,
        kind=kind,
    )
    # the shift by 10 costs a digit of the distances
    np.testing.assert_allclose(moved[0], phi, atol=1e-12)
    np.testing.assert_allclose(scale * moved[1], gradient @ turn.T, atol=1e-10)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("basis", "kind"),
    [("quadratic", "imls"), pytest.param("linear", "iicvmls", marks=pytest.mark.slow)],
)
def test_values_and_gradients_are_those_of_automatic_differentiation(basis, kind):
    """Their derivatives by point and neighbours, too, in the nodes, forwards and backwards."""
    nodes, x = clouds(6, 18)
    x[:2] = nodes[:2, 24]
    random = np.random.default_rng(18)
    x_dot, nodes_dot = random.normal(size=x.shape), random.normal(size=nodes.shape)
    written_out = functools.partial(
        shape_functions_and_gradients, support=SUPPORT, basis=basis, kind=kind
    )

    def differentiated(x, nodes):
        return jax.jvp(
            lambda x: shape_functions(x, nodes, SUPPORT, basis=basis, kind=kind),
            (x,),
            (jnp.ones(2),),
        )

    def along(x, nodes):
        phi, gradient = written_out(x, nodes)
        return phi, gradient @ jnp.ones(2)

    @jax.jit
    @jax.vmap
    def both(x, nodes, x_dot, nodes_dot):
        found, wanted = (
            jax.jvp(function, (x, nodes), (x_dot, nodes_dot))
            for function in (along, differentiated)
        )
        slopes = [
            jax.grad(lambda *at, f=f: jnp.sum(jnp.abs(f(*at)[1]) ** 2), (0, 1))(x, nodes)
            for f in (along, differentiated)
        ]
        return (found, slopes[0]), (wanted, slopes[1])

    for found, wanted in zip(*map(jax.tree.leaves, both(x, nodes, x_dot, nodes_dot)), strict=True):
        # round-off of the moment matrix
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.slow
def test_second_derivatives_are_differences_of_first_ones_by_every_route():
    """By the neighbours: no route may hold what the others differentiate."""
    nodes, x = clouds(1, 19)
    nodes, x, step = jnp.asarray(nodes[0]), jnp.asarray(x[0]), 1e-5
    direction, weights = (
        jnp.asarray(np.random.default_rng(19).normal(size=shape)) for shape in ((49, 2), 49)
    )

    def reading(nodes):
        return weights @ shape_functions(x, nodes, SUPPORT, kind="imls")

    def linearised(nodes):
        return jax.vmap(jax.linearize(reading, nodes)[1])(jnp.eye(98).reshape(98, 49, 2)).reshape(
            49, 2
        )

    @jax.jit
    def slopes(nodes):
        return jax.grad(reading)(nodes)

    difference = (slopes(nodes + step * direction) - slopes(nodes - step * direction)) / (2 * step)
    routes = {
        "forwards over backwards": lambda: jax.jvp(jax.grad(reading), (nodes,), (direction,))[1],
        "backwards over backwards": lambda: jax.grad(
            lambda nodes: jnp.sum(jax.grad(reading)(nodes) * direction)
        )(nodes),
        "backwards over forwards": lambda: jax.grad(
            lambda nodes: jax.jvp(reading, (nodes,), (direction,))[1]
        )(nodes),
        "forwards over linearised": lambda: jax.jvp(linearised, (nodes,), (direction,))[1],
    }
    for name, route in routes.items():
        # truncation of the differences, step^2
        np.testing.assert_allclose(
            jax.jit(route)(), difference, rtol=0, atol=1e-8 * np.abs(difference).max(), err_msg=name
        )


def test_values_are_continuous_where_the_nearest_node_changes():
    nodes, _ = clouds(1, 16)
    middle, normal = nodes[0, [23, 24]].mean(axis=0), nodes[0, 24] - nodes[0, 23]
    x = middle + np.array([[-1e-13], [0.0], [1e-13]]) * normal
    phi, gradient = value_and_gradient(
        x, np.repeat(nodes, 3, axis=0), SUPPORT, basis="quadratic", kind="imls"
    )
    np.testing.assert_allclose(phi, np.broadcast_to(phi[1], phi.shape), atol=1e-12)
    np.testing.assert_allclose(gradient, np.broadcast_to(gradient[1], gradient.shape), atol=1e-11)


def test_too_few_neighbours_give_nan_and_never_a_wrong_number():
    corner = np.array([[0.0, 0.0], [1.0, 0.0]])
    linear = jax.jit(functools.partial(shape_functions, support=2.0, basis="linear", kind="imls"))
    assert np.all(np.isnan(linear(np.array([0.4, 0.3]), corner)))


@each_basis
@interpolating
def test_nodes_that_do_not_determine_a_polynomial_give_nan(basis, kind):
    """The moment matrix is singular, but its last pivots are round-off instead of 0."""
    random = np.random.default_rng(21)
    angle, x = random.uniform(0, 2 * np.pi, (1000, 9)), random.uniform(-0.5, 0.5, (1000, 2))
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    line = np.stack([np.cos(0.7) * np.sin(angle), np.sin(0.7) * np.sin(angle) + 0.3], axis=-1)
    few = np.concatenate(
        [
            random.uniform(-1, 1, (1000, n_monomials(basis) - 1, 2)),
            np.zeros((1000, 10 - n_monomials(basis), 2)),
        ],
        axis=1,
    )
    support = np.where(np.arange(9) < n_monomials(basis) - 1, 3.5, 0.0)
    function = functools.partial(shape_functions, basis=basis, kind=kind)
    compiled = jax.jit(jax.vmap(function, in_axes=(0, 0, None)))
    for nodes, reach in (
        (line, np.full(9, 3.5)),
        (few, support),
        *([(circle, np.full(9, 3.5))] if basis == "quadratic" else []),
    ):
        assert np.all(np.isnan(compiled(x, nodes, reach)).any(axis=1))


def test_unknown_options_are_refused():
    x, nodes = jnp.zeros(2), jnp.asarray(clouds(1, 17)[0][0])
    with pytest.raises(ValueError, match="basis: 'cubic' is not one of linear, quadratic"):
        shape_functions(x, nodes, SUPPORT, basis="cubic")
    with pytest.raises(ValueError, match="kind: 'rbf' is not one of iicvmls, imls, icvmls, mls"):
        shape_functions(x, nodes, SUPPORT, kind="rbf")
    assert (n_monomials("linear"), n_monomials("quadratic")) == (3, 6)
