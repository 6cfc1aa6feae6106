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

KINDS = ("iicvmls", "imls", "icvmls", "mls")
_ORDER = {"linear": 1, "quadratic": 2}


def n_monomials(basis):
    """Number of monomials (int) of the complete real basis: 3 for ``"linear"``, 6 for ``"quadratic"``."""
    return (_order(basis) + 1) * (_order(basis) + 2) // 2


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
        r, r_x = (neighbours - origin) / scale, (x - origin) / scale
        return _interpolating(r, r_x, distance_squared, support, order, kind)
    p = _monomials((neighbours - x) / scale, order, kind)
    return _least_squares(p.T, cubic_spline_weight(_safe_sqrt(distance_squared), support))


def singular_weight(distance, support):
    """The singular weight function of Eq. (37), (rho/d)^2 (1 - d/rho)^2 inside the support and 0 outside; infinite at d = 0."""
    inside = distance < support
    d = jnp.where(inside, distance, 1.0)
    return jnp.where(inside, ((support - d) / d) ** 2, 0.0)


def cubic_spline_weight(distance, support):
    """The cubic spline weight function of the element free Galerkin method: 2/3 at d = 0, 0 from d = ``support`` on, C2."""
    inside = distance < support
    s = jnp.where(inside, distance, 0.0) / jnp.where(support > 0, support, 1.0)
    near = 2 / 3 - 4 * s**2 + 4 * s**3
    return jnp.where(inside, jnp.where(s < 0.5, near, 4 / 3 * (1 - s) ** 3), 0.0)


def _interpolating(r, r_x, distance_squared, support, order, kind):
    """Eq. (36) in a form that is regular at the nodes; ``r`` (n, 2) are the neighbours and ``r_x`` (2,) the point, about the point.

    So ``r_x`` is 0, but its derivative is not: the origin is held. The nearest node k has w_k -> infinity, so only 1/w_k is formed:
    v_k = 1 / (1 + sum w_a / w_k), v_a = w_a v_k / w_k, and w_k b(x_k) = sum v_k w_a (p_k - p_a), where the sums leave k out. The choice
    of k is free: every choice gives the same phi. The other nodes enter only by the moments of their weights, the sums of w_a times the
    monomials up to twice the order: of all that is as long as the list of neighbours only the weights change with the point.
    """
    q, p_x, products = _monomials(r, 2 * order, kind), _monomials(r_x[None], order, kind)[:, 0], _products(order, kind)
    m = len(p_x)
    p = q[:m]
    nearest = jnp.arange(len(r)) == jnp.argmin(jnp.where(distance_squared < support**2, distance_squared, jnp.inf))

    def at_nearest(values):
        return jnp.sum(jnp.where(nearest, values, 0.0), axis=-1)

    w = singular_weight(_safe_sqrt(jnp.where(nearest, 0.0, distance_squared)), jnp.where(nearest, 0.0, support))
    d2_k, p_k = at_nearest(distance_squared), at_nearest(p)
    inverse_w_k = d2_k / (at_nearest(support) - _safe_sqrt(d2_k)) ** 2

    moment_0, moments = jnp.sum(w), q @ w
    v_k = 1 / (1 + inverse_w_k * moment_0)
    shift = -v_k * (p_k + inverse_w_k * moments[:m])  # of Eq. (22): b = p + shift, at the nodes the matrix C of Eq. (33)
    b_x = p_x + shift
    w_k_b_k = v_k * (moment_0 * p_k - moments[:m])
    left, right = jnp.stack([moments[:m], shift, w_k_b_k]), jnp.stack([shift, moments[:m] + moment_0 * shift, p_k + shift])
    moment_matrix = moments[products] + left.conj().T @ right  # A = C^H W C, Eq. (31)
    g = _solve(moment_matrix.T, b_x)
    return jnp.where(nearest, v_k + w_k_b_k.conj() @ g, w * (inverse_w_k * v_k + shift.conj() @ g + g @ p.conj()))


@functools.cache
def _products(order, kind):
    """Numbers (m, m) of the products of two non-constant monomials of a basis, of the conjugate of the first where they are complex."""
    exponents = [(degree - j, j) for degree in range(1, 2 * order + 1) for j in range(degree + 1)]
    basis = [(i, j) for i, j in exponents if i + j <= order]
    first = basis if kind == "imls" else [(j, i) for i, j in basis]
    return np.array([[exponents.index((a + c, b + d)) for c, d in basis] for a, b in first])


def _least_squares(p, w):
    """Moving least squares, phi = p(x)^T A^-1 B; ``p`` (n, m) are the non-constant monomials about the point."""
    p = jnp.concatenate([jnp.ones_like(p[:, :1]), p], axis=1)
    weighted = w[:, None] * p.conj()
    at_x = jnp.zeros_like(p[0]).at[0].set(1.0)
    return weighted @ _solve((weighted.T @ p).T, at_x)


def _monomials(r, degree, kind):
    """The non-constant monomials (m, n) of offsets ``r`` (n, 2): x^i y^j, those of z and its conjugate in Eqs. (18)-(19), or of z alone."""
    u, v = r.T
    if kind in ("iicvmls", "icvmls"):
        u, v = lax.complex(u, v), lax.complex(u, -v)
    if kind == "icvmls":
        return jnp.stack([u**k for k in range(1, degree + 1)])
    rows = last = [u, v]
    for _ in range(degree - 1):
        last = [*(u * row for row in last), v * last[-1]]
        rows = rows + last
    return jnp.stack(rows)


@jax.custom_jvp
def _solve(matrix, rhs):
    """Solution (m,) of a Hermitian positive definite system."""
    return _inverse(matrix) @ rhs


@_solve.defjvp
def _solve_jvp(primals, tangents):
    """A x = b gives A dx = db - dA x: products of the inverse with vectors, where its own derivative is one of matrices."""
    matrix, rhs = primals
    inverse = _inverse(matrix)
    solution = inverse @ rhs
    return solution, inverse @ (tangents[1] - tangents[0] @ solution)


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


def _safe_sqrt(squared):
    """Square root whose derivative at 0 is taken as 0: there the weights depend on d through d^2 only."""
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)


def _order(basis):
    if basis not in _ORDER:
        raise ValueError(f"basis: {basis!r} is not one of {', '.join(_ORDER)}")
    return _ORDER[basis]
