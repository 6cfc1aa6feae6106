"""Shape functions at one point: interpolating complex-variable MLS, its real twin, and the two methods they are compared with.

One call maps a point and its neighbours to the neighbours' shape function values; ``jax.vmap`` makes the many points and
``jax.jacfwd`` the gradients. Index letters: ``a`` neighbour, ``m n`` basis monomial. A neighbour whose support does not reach the
point (in particular padding with support 0) gets the value 0.

Sources: Deng et al. (2020), Eqs. (17)-(37), for the interpolating complex form; Lancaster & Salkauskas (1981) for the
interpolating MLS; Belytschko, Lu & Gu (1994) for the MLS; Bai et al. (2012) for the improved complex variable MLS.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero

KINDS = ("iicvmls", "imls", "icvmls", "mls")
_ORDER = {"linear": 1, "quadratic": 2}


def n_monomials(basis):
    """Number of monomials (int) of the complete real basis: 3 for ``"linear"``, 6 for ``"quadratic"``."""
    return _number(_order(basis))


def shape_functions(x, neighbours, support, *, basis="quadratic", kind="iicvmls"):
    """Shape function values (n,) at the point ``x`` (2,) of the nodes ``neighbours`` (n, 2); dimensionless.

    ``support`` () or (n,) is the radius of each node's weight function, in the unit of length of ``x``. ``kind``:

    - ``"iicvmls"``: Eq. (36) with the complete complex basis, Eqs. (18)-(19); complex dtype, the imaginary part is round-off;
    - ``"imls"``: the same functions from the real basis that spans the same space; the fast path;
    - ``"icvmls"``: not interpolating, basis (1, z) or (1, z, z^2); complex, acting on u1 + i u2;
    - ``"mls"``: not interpolating, real basis.

    The interpolating kinds satisfy phi_a(x_b) = delta_ab; value and gradient are finite at the nodes. A point with fewer
    neighbours than monomials has a singular moment matrix and gives NaN: ``discretise`` refuses such a cloud.

    >>> nodes = jnp.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    >>> shape_functions(nodes[1], nodes, 2.0, basis="linear", kind="imls").round(12)
    Array([0., 1., 0., 0.], dtype=float64)
    """
    order = _order(basis)
    if kind not in KINDS:
        raise ValueError(f"kind: {kind!r} is not one of {', '.join(KINDS)}")
    support = jnp.broadcast_to(jnp.asarray(support, dtype=neighbours.dtype), neighbours.shape[:1])
    scale = lax.stop_gradient(jnp.max(support))  # phi does not depend on the scale of the basis, so neither does its derivative
    distance_squared = jnp.sum((neighbours - x) ** 2, axis=1)
    if kind in ("iicvmls", "imls"):
        origin = lax.stop_gradient(x)  # nor does it depend on the origin of the basis
        return _interpolating((neighbours - origin) / scale, (x - origin) / scale, distance_squared, support, order, kind)
    return _least_squares((neighbours - x) / scale, cubic_spline_weight(distance_squared, support), order, kind)


def singular_weight(distance_squared, support):
    """The singular weight function of Eq. (37), (rho/d)^2 (1 - d/rho)^2 inside the support and 0 outside, of d^2; infinite at d = 0."""
    inside = distance_squared < support**2
    inverse_distance = _inverse_root(jnp.where(inside, distance_squared, 1.0))
    return jnp.where(inside, (support * inverse_distance - 1) ** 2, 0.0)


def cubic_spline_weight(distance_squared, support):
    """The cubic spline weight of the element free Galerkin method, of d^2: 2/3 at d = 0, 0 from d = ``support`` on, C2."""
    inside = distance_squared < support**2
    s = _safe_sqrt(jnp.where(inside, distance_squared, 0.0)) / jnp.where(support > 0, support, 1.0)
    near = 2 / 3 - 4 * s**2 + 4 * s**3
    return jnp.where(inside, jnp.where(s < 0.5, near, 4 / 3 * (1 - s) ** 3), 0.0)


def _interpolating(r, r_x, distance_squared, support, order, kind):
    """Eq. (36) in a form that is regular at the nodes; ``r`` (n, 2) are the neighbours and ``r_x`` (2,) the point, about the point.

    So ``r_x`` is 0, but its derivative is not: the origin is held. The nearest node k has w_k -> infinity, so only 1/w_k is formed:
    v_k = 1 / (1 + sum w_a / w_k), v_a = w_a v_k / w_k, and w_k b(x_k) = sum v_k w_a (p_k - p_a), where the sums leave k out. The choice
    of k is free: every choice gives the same phi. The other nodes enter only by the moments of their weights, the sums of w_a times the
    monomials up to twice the order, and phi is their weights times one polynomial: of all that is as long as the list of neighbours
    only the weights change with the point.
    """
    u, v = _coordinates(r, kind)
    q, n = _monomials(u, v, 2 * order), _number(order)
    nearest = jnp.arange(len(r)) == jnp.argmin(jnp.where(distance_squared < support**2, distance_squared, jnp.inf))

    def at_nearest(values):
        return jnp.sum(jnp.where(nearest, values, 0.0))

    w = singular_weight(jnp.where(nearest, 1.0, distance_squared), jnp.where(nearest, 0.0, support))
    d2_k, rho_k = at_nearest(distance_squared), at_nearest(support)
    inverse_w_k = d2_k / (rho_k - _safe_sqrt(d2_k)) ** 2
    p_k, p_x = _monomials(at_nearest(u), at_nearest(v), order)[1:], _monomials(*_coordinates(r_x, kind), order)[1:]

    moments = _moments(w, u, v, q)
    moment_0, moments_p = moments[0], moments[1:n]
    v_k = 1 / (1 + inverse_w_k * moment_0)
    shift = -v_k * (p_k + inverse_w_k * moments_p)  # of Eq. (22): b = p + shift, at the nodes the matrix C of Eq. (33)
    w_k_b_k = v_k * (moment_0 * p_k - moments_p)
    pairs = (moments_p, shift), (shift, moments_p + moment_0 * shift), (w_k_b_k, p_k + shift)
    moment_matrix = _products(order, kind) @ moments + sum(a.conj()[:, None] * b for a, b in pairs)  # A = C^H W C, Eq. (31)
    g = _solve(moment_matrix.T, p_x + shift)
    coefficients = jnp.append(inverse_w_k * v_k + shift @ g.conj(), g.conj())
    return jnp.where(nearest, v_k + w_k_b_k.conj() @ g, w * _polynomial(coefficients, u, v, q[:n]).conj())


def _least_squares(r, w, order, kind):
    """Moving least squares, phi = p(x)^T A^-1 B; ``r`` (n, 2) are the neighbours about the point."""
    u, v = _coordinates(r, kind)
    p = (jnp.stack([u**k for k in range(order + 1)]) if kind == "icvmls" else _monomials(u, v, order)).T
    weighted = w[:, None] * p.conj()
    at_x = jnp.zeros_like(p[0]).at[0].set(1.0)
    return weighted @ _solve((weighted.T @ p).T, at_x)


# --- polynomials: u and v are x and y, or z and its conjugate -------------------------------------------------------------------


def _coordinates(r, kind):
    """What the monomials of offsets ``r`` (..., 2) are made of: x and y, or z and its conjugate, Eqs. (18)-(19)."""
    x, y = r[..., 0], r[..., 1]
    return (lax.complex(x, y), lax.complex(x, -y)) if kind in ("iicvmls", "icvmls") else (x, y)


def _exponents(degree):
    return [(total - j, j) for total in range(degree + 1) for j in range(total + 1)]


def _number(degree):
    """Number of monomials up to a degree."""
    return (degree + 1) * (degree + 2) // 2


def _monomials(u, v, degree):
    """The monomials (m, ...) u^i v^j up to a degree: 1, u, v, u^2, u v, v^2, ..."""
    rows = last = [jnp.ones_like(u)]
    for _ in range(degree):
        last = [*(u * row for row in last), v * last[-1]]
        rows = rows + last
    return jnp.stack(rows)


@functools.cache
def _derivative(number, axis):
    """Matrix D (m, m) with dq/du = D q for the first ``number`` monomials q, or with dq/dv = D q for ``axis`` 1."""
    exponents = _exponents(number)[:number]
    matrix = np.zeros((number, number))
    for row, (i, j) in enumerate(exponents):
        if (i, j)[axis]:
            matrix[row, exponents.index((i - (axis == 0), j - (axis == 1)))] = (i, j)[axis]
    return matrix


@functools.cache
def _products(order, kind):
    """Matrices (m, m, q) that pick the products of two non-constant monomials of a basis, of the conjugate of the first where complex."""
    exponents, basis = _exponents(2 * order), _exponents(order)[1:]
    first = basis if kind == "imls" else [(j, i) for i, j in basis]
    return np.array([[[(a + c, b + d) == e for e in exponents] for c, d in basis] for a, b in first], dtype=float)


@jax.custom_jvp
def _moments(weights, u, v, q):  # noqa: ARG001
    """Sums (m,) of ``weights`` (n,) times the monomials ``q`` (m, n) of ``u`` and ``v`` (n,); tangents of ``q`` are those of u and v."""
    return q @ weights


@functools.partial(_moments.defjvp, symbolic_zeros=True)
def _moments_jvp(primals, tangents):
    """Derivatives of monomials are monomials, so those of moments are moments of other weights."""
    weights, u, v, q = primals
    weights_dot, *along = tangents[:3]
    parts = [] if _is_zero(weights_dot) else [_moments(weights_dot, u, v, q)]
    parts += [_derivative(len(q), k) @ _moments(weights * t, u, v, q) for k, t in enumerate(along) if not _is_zero(t)]
    found = _moments(weights, u, v, q)
    return found, sum(parts, start=jnp.zeros_like(found))


@jax.custom_jvp
def _polynomial(coefficients, u, v, q):  # noqa: ARG001
    """Values (n,) of the polynomial with ``coefficients`` (m,) of the monomials ``q`` (m, n) of ``u`` and ``v`` (n,), as `_moments`."""
    return coefficients @ q


@functools.partial(_polynomial.defjvp, symbolic_zeros=True)
def _polynomial_jvp(primals, tangents):
    """Derivatives of a polynomial are polynomials in the same monomials."""
    coefficients, u, v, q = primals
    coefficients_dot, *along = tangents[:3]
    parts = [] if _is_zero(coefficients_dot) else [_polynomial(coefficients_dot, u, v, q)]
    parts += [t * _polynomial(coefficients @ _derivative(len(q), k), u, v, q) for k, t in enumerate(along) if not _is_zero(t)]
    found = _polynomial(coefficients, u, v, q)
    return found, sum(parts, start=jnp.zeros_like(found))


def _is_zero(tangent):
    return isinstance(tangent, SymbolicZero)


# --- small systems and roots ---------------------------------------------------------------------------------------------------


def _solve(matrix, rhs):
    """Solution (m,) of a Hermitian positive definite system."""
    return _solution(matrix, rhs, _inverse(matrix))


@jax.custom_jvp
def _solution(matrix, rhs, inverse):  # noqa: ARG001
    """Solution (m,) with the ``inverse`` of the ``matrix``, whose own derivative is not needed."""
    return inverse @ rhs


@_solution.defjvp
def _solution_jvp(primals, tangents):
    """A x = b gives A dx = db - dA x: products of the inverse with vectors, where its own derivative is one of matrices."""
    matrix, _, inverse = primals
    solution = _solution(*primals)
    return solution, _solution(matrix, tangents[1] - tangents[0] @ solution, inverse)


@jax.custom_jvp
def _inverse(matrix):
    """Inverse (m, m) of a Hermitian positive definite matrix, by elimination in place: few operations for many matrices."""
    number = np.arange(len(matrix))
    for k in number:
        own = number == k
        row, column = jnp.where(own, 1.0, matrix[k]) / matrix[k, k], jnp.where(own, 0.0, matrix[:, k])
        matrix = jnp.where(own[:, None], row, jnp.where(own, 0.0, matrix) - column[:, None] * row)
    return matrix


@_inverse.defjvp
def _inverse_jvp(primals, tangents):
    inverse = _inverse(primals[0])
    return inverse, -inverse @ tangents[0] @ inverse


@jax.custom_jvp
def _inverse_root(squared):
    return 1 / jnp.sqrt(squared)


@_inverse_root.defjvp
def _inverse_root_jvp(primals, tangents):
    """Products only: JAX's own rule divides once more for each derivative."""
    inverse = _inverse_root(primals[0])
    return inverse, -0.5 * inverse**3 * tangents[0]


def _safe_sqrt(squared):
    """Square root whose derivative at 0 is taken as 0: there the weights depend on d through d^2 only."""
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)


def _order(basis):
    if basis not in _ORDER:
        raise ValueError(f"basis: {basis!r} is not one of {', '.join(_ORDER)}")
    return _ORDER[basis]
