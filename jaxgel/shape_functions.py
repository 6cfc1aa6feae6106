"""Shape functions at one point: interpolating complex-variable MLS, its real twin, and the two methods they are compared with.

One call maps a point and its neighbours to the neighbours' shape function values; ``jax.vmap`` makes the many points and
``jax.jacfwd`` the gradients. Index letters: ``a`` neighbour, ``m n`` basis monomial. A neighbour whose support does not reach the
point (in particular padding with support 0) gets the value 0.

Sources: Deng et al. (2020), Eqs. (17)-(37), for the interpolating complex form; Lancaster & Salkauskas (1981) for the
interpolating MLS; Belytschko, Lu & Gu (1994) for the MLS; Bai et al. (2012) for the improved complex variable MLS.
"""

import jax
import jax.numpy as jnp
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
    offset = neighbours - x
    real = kind in ("imls", "mls")
    p = _real_monomials(offset / scale, order) if real else _complex_monomials(offset / scale, order, conjugates=kind == "iicvmls")
    distance_squared = jnp.sum(offset**2, axis=1)
    if kind in ("iicvmls", "imls"):
        return _interpolating(p, distance_squared, support)
    return _least_squares(p, cubic_spline_weight(_safe_sqrt(distance_squared), support))


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


def _interpolating(p, distance_squared, support):
    """Eq. (36) in a form that is regular at the nodes; ``p`` (n, m) are the non-constant monomials about the point.

    With the origin at the point, p(x) = 0 and b(x) = -v^T p, b(x_a) = p_a + b(x). The nearest node k has w_k -> infinity, so only
    1/w_k is formed: v_k = 1 / (1 + sum' w_a / w_k), v_a = w_a v_k / w_k, and w_k b(x_k) = sum' v_k w_a (p_k - p_a), where the
    sums leave k out. The choice of k is free: every choice gives the same phi.
    """
    inside = distance_squared < support**2
    nearest = jnp.arange(p.shape[0]) == jnp.argmin(jnp.where(inside, distance_squared, jnp.inf))
    w = singular_weight(_safe_sqrt(jnp.where(nearest, 0.0, distance_squared)), jnp.where(nearest, 0.0, support))
    d2_k = jnp.sum(jnp.where(nearest, distance_squared, 0.0))
    inverse_w_k = d2_k / (jnp.sum(jnp.where(nearest, support, 0.0)) - _safe_sqrt(d2_k)) ** 2

    v_k = 1 / (1 + inverse_w_k * jnp.sum(w))
    v = jnp.where(nearest, v_k, inverse_w_k * v_k * w)  # Eq. (23)
    b_x = -v @ p
    b = p + b_x  # Eq. (22) at the nodes: the matrix C of Eq. (33)
    p_k = jnp.sum(jnp.where(nearest[:, None], p, 0.0), axis=0)
    w_k_b_k = v_k * (w @ (p_k - p))
    weighted = jnp.where(nearest[:, None], w_k_b_k, w[:, None] * b).conj()  # B = C^H W, Eq. (32), transposed
    moment_matrix = weighted.T @ b  # A = C^H W C, Eq. (31)
    return v + weighted @ _solve(moment_matrix.T, b_x)


def _least_squares(p, w):
    """Moving least squares, phi = p(x)^T A^-1 B; ``p`` (n, m) are the non-constant monomials about the point."""
    p = jnp.concatenate([jnp.ones_like(p[:, :1]), p], axis=1)
    weighted = w[:, None] * p.conj()
    at_x = jnp.zeros_like(p[0]).at[0].set(1.0)
    return weighted @ _solve((weighted.T @ p).T, at_x)


def _real_monomials(r, order):
    """(x, y) or (x, y, x^2, xy, y^2) for the offsets ``r`` (n, 2)."""
    x, y = r[:, 0], r[:, 1]
    return jnp.stack([x, y] if order == 1 else [x, y, x * x, x * y, y * y], axis=1)


def _complex_monomials(r, order, *, conjugates):
    """The non-constant monomials of Eqs. (18)-(19), or those without conjugates."""
    z = lax.complex(r[:, 0], r[:, 1])
    if not conjugates:
        return jnp.stack([z] if order == 1 else [z, z * z], axis=1)
    c = z.conj()
    return jnp.stack([z, c] if order == 1 else [z, c, z * z, c * c, z * c], axis=1)


@jax.custom_jvp
def _solve(matrix, rhs):
    """Solution (m,) of a Hermitian positive definite system with m <= 6, written out so that many systems run side by side."""
    m = rhs.shape[0]
    a = [[matrix[i, j] for j in range(m)] + [rhs[i]] for i in range(m)]
    for k in range(m):
        for i in range(k + 1, m):
            factor = a[i][k] / a[k][k]
            for j in range(k + 1, m + 1):
                a[i][j] = a[i][j] - factor * a[k][j]
    solution = []
    for i in reversed(range(m)):
        known = sum(a[i][j] * s for j, s in zip(range(m - 1, i, -1), solution, strict=True))
        solution.append((a[i][m] - known) / a[i][i])
    return jnp.stack(solution[::-1])


@_solve.defjvp
def _solve_jvp(primals, tangents):
    """A x = b gives A dx = db - dA x: a second solve instead of the derivative of the elimination."""
    matrix, rhs = primals
    solution = _solve(matrix, rhs)
    return solution, _solve(matrix, tangents[1] - tangents[0] @ solution)


def _safe_sqrt(squared):
    """Square root whose derivative at 0 is taken as 0: there the weights depend on d through d^2 only."""
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)


def _order(basis):
    if basis not in _ORDER:
        raise ValueError(f"basis: {basis!r} is not one of {', '.join(_ORDER)}")
    return _ORDER[basis]
