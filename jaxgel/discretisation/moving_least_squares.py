"""Shape functions at one point: interpolating complex-variable MLS, and its real twin.

One call maps a point and its neighbours to the neighbours' shape function values, or to values and
gradients; ``jax.vmap`` makes the many points. Index letters: ``a`` neighbour, ``m n`` basis
monomial. A neighbour whose support does not reach the point (in particular padding with support 0)
gets the value 0.

Sources: Deng et al. (2020), Eqs. (17)-(37), for the interpolating complex form; Lancaster &
Salkauskas (1981) for the interpolating MLS.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero

from .._types import Array, Float, Inexact, Scalar
from .._validation import one_of
from .weights import safe_sqrt, singular_slope, singular_weight

KINDS = ("iicvmls", "imls")
BASES = ("linear", "quadratic")
# pivot over its diagonal entry: of 18,000 singular moment matrices three left more than 1e-11, none
# 1e-10; clouds have 1e-6 or more
_VANISHING = 1e-9


def n_monomials(basis: str) -> int:
    """Number of monomials of the complete real basis: 3 for ``"linear"``, 6 for ``"quadratic"``."""
    return len(_exponents(_order(basis)))


def shape_functions(
    x: Float[Array, "2"],
    neighbours: Float[Array, "a 2"],
    support: Float[Array, " a"] | Scalar,
    *,
    basis: str = "quadratic",
    kind: str = "iicvmls",
) -> Inexact[Array, " a"]:
    """Shape function values (n,) of the neighbours of one point; dimensionless.

    Arguments:

    - `x` (2,): the point.
    - `neighbours` (n, 2): positions of the nodes, in the unit of length of `x`.
    - `support` () or (n,): radius of each node's weight function, in the same unit.
    - `basis`: "quadratic" or "linear".
    - `kind`: "iicvmls", Eq. (36) with the complete complex basis, Eqs. (18)-(19), of complex dtype
      with an imaginary part of round-off; or "imls", the same functions from the real basis that
      spans the same space, which is faster.

    Returns functions with phi_a(x_b) = delta_ab, whose values and gradients are finite at the
    nodes. They are NaN at a point with fewer neighbours than monomials, for which the moment matrix
    is singular; `discretise` refuses such a cloud.

    Raises `ValueError` for an unknown basis or kind, and for unusable shapes.

    Sources: Deng et al. (2020), Eqs. (17)-(37); Lancaster & Salkauskas (1981).

    >>> nodes = jnp.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    >>> phi = jax.jit(shape_functions, static_argnames=("basis", "kind"))
    >>> phi(nodes[1], nodes, 2.0, basis="linear", kind="imls").round(12)
    Array([0., 1., 0., 0.], dtype=float64)
    """
    order, support = _checked(neighbours, support, basis, kind)
    fit = _fit(x, neighbours, support, order, kind)
    y = _coefficients(fit.w, fit.p, fit.inverse_w_k, fit.p_x, _factor(fit, order, kind))
    return fit.nearest * y[0] + fit.w * _polynomial(y, fit.p, fit.inverse_w_k)


def shape_functions_and_gradients(
    x: Float[Array, "2"],
    neighbours: Float[Array, "a 2"],
    support: Float[Array, " a"] | Scalar,
    *,
    basis: str = "quadratic",
    kind: str = "iicvmls",
) -> tuple[Inexact[Array, " a"], Inexact[Array, "a 2"]]:
    """Values (n,) of `shape_functions`, and gradients (n, 2) by ``x``, over the unit of length.

    The gradients are those of automatic differentiation, written out: all of them share one
    solution y, each costs one more, and what depends on the neighbours alone is not differentiated.

    >>> nodes = jnp.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    >>> phi = jax.jit(shape_functions_and_gradients, static_argnames=("basis", "kind"))
    >>> _, gradients = phi(nodes.mean(axis=0), nodes, 2.0, basis="linear", kind="imls")
    >>> (gradients.T @ nodes).round(12)
    Array([[1., 0.],
           [0., 1.]], dtype=float64)
    """
    order, support = _checked(neighbours, support, basis, kind)
    fit = _fit(x, neighbours, support, order, kind)
    nearest, w, p, inverse_w_k, p_x, along = fit
    factor = _factor(fit, order, kind)
    y = _coefficients(w, p, inverse_w_k, p_x, factor)
    polynomial, gradients = _polynomial(y, p, inverse_w_k), []
    for w_dot, inverse_w_k_dot, p_x_dot in along:
        # of the polynomial, whose other coefficients change by those in y_dot
        constant = inverse_w_k_dot * y[0]
        y_dot = _coefficients(
            w, p, inverse_w_k, p_x_dot - p @ (w_dot * polynomial + w * constant), factor
        )
        gradients.append(
            nearest * y_dot[0]
            + w_dot * polynomial
            + w * (_polynomial(y_dot, p, inverse_w_k) + constant)
        )
    return nearest * y[0] + w * polynomial, jnp.stack(gradients, axis=1)


def _checked(neighbours, support, basis, kind):
    """Order of the basis, and the supports (n,)."""
    order = _order(basis)
    one_of("kind", kind, KINDS)
    return order, jnp.broadcast_to(
        jnp.asarray(support, dtype=neighbours.dtype), neighbours.shape[:1]
    )


class _Fit(NamedTuple):
    """A point and its neighbours, with monomials about the nearest node k; ``p_k`` is (1, 0, ...).

    Eq. (36) is phi_a = w_a p_a^H g with the coefficients g for which the basis is reproduced, sum_a
    phi_a p_a = p(x): eliminating the constant from these equations leaves the b, C and A of Eqs.
    (22) and (31)-(33). At node k the weight w_k is infinite, but this node enters the first
    equation only, so its value phi_k = w_k g_0 takes the place of g_0 as an unknown, and 1 / w_k,
    which is regular, that of w_k. The choice of k is free: every choice gives the same phi.
    """

    nearest: Inexact[Array, " n"]  # 1 for the nearest node, 0 for the others
    w: Inexact[Array, " n"]  # weights of the other nodes; 0 for the nearest
    p: Inexact[Array, "m n"]  # monomials at the nodes
    inverse_w_k: Inexact[Array, ""]  # inverse weight of the nearest node
    p_x: Inexact[Array, " m"]  # monomials at the point
    # derivatives of the weights, the inverse weight and p_x by the two coordinates of the point
    along: list[tuple]


def _fit(x, neighbours, support, order, kind):
    # axis by axis: what lies in pairs is not vectorised
    nodes, point = (neighbours[:, 0], neighbours[:, 1]), (x[0], x[1])
    away = [at - node for at, node in zip(point, nodes, strict=True)]
    distance_squared = away[0] ** 2 + away[1] ** 2
    nearest = _nearest(lax.stop_gradient(distance_squared), support)
    x_k, rho_k = [nearest @ node for node in nodes], nearest @ support
    away_k = [at - node for at, node in zip(point, x_k, strict=True)]
    d2_k = away_k[0] ** 2 + away_k[1] ** 2
    reach = rho_k - safe_sqrt(d2_k)

    # phi does not depend on the scale of the basis, so neither does its derivative
    per_length = 1 / lax.stop_gradient(jnp.max(support))
    p = monomials(
        *_coordinates(*((node - k) * per_length for node, k in zip(nodes, x_k, strict=True)), kind),
        order,
    )

    def basis(*away):
        return monomials(*_coordinates(*(a * per_length for a in away), kind), order)

    others = jnp.where(nearest > 0, 0.0, support)
    slope, slope_k = singular_slope(distance_squared, others), 2 * rho_k / reach**3
    along = [
        (
            slope * away[axis],
            slope_k * away_k[axis],
            jax.jvp(basis, away_k, [1.0 * (axis == i) for i in range(2)])[1],
        )
        for axis in range(2)
    ]
    return _Fit(
        nearest,
        singular_weight(distance_squared, others),
        p,
        d2_k / reach**2,
        basis(*away_k),
        along,
    )


def _nearest(distance_squared, support):
    """Indicator (n,) of the node of largest weight, the first one of least d / rho.

    Found by its index: a comparison with the least ratio may meet ratios that the compiler has
    computed once more and rounded otherwise.
    """
    reaching = support > 0
    ratio = jnp.where(reaching, distance_squared / jnp.where(reaching, support, 1.0) ** 2, jnp.inf)
    return jnp.where(jnp.arange(len(support)) == jnp.argmin(ratio), 1.0, 0.0)


def _polynomial(y, p, inverse_w_k):
    """Values (n,) of the polynomial p^H g with the unknowns ``y`` (m,)."""
    return y.at[0].multiply(inverse_w_k) @ p.conj()


def _reproduced(w, p, inverse_w_k, y):
    """What the shape functions with the unknowns ``y`` reproduce: sum_a phi_a p_a (m,)."""
    return (p @ (w * _polynomial(y, p, inverse_w_k))).at[0].add(y[0])


def _factor(fit, order, kind):
    """Factors of the moment system: first row and column, v_k of Eq. (23), inverse of A, Eq. (31).

    The row and column are those of the moment matrix.
    """
    _, w, p, inverse_w_k, *_ = fit
    # of the basis times 1, u^order, v^order
    moments = jnp.concatenate([p @ (w * p[of]) for of in (0, len(p) - 1 - order, len(p) - 1)])
    M = moments[_products(order, kind)]
    v_k = 1 / (1 + inverse_w_k * M[0, 0])
    return (
        M[0, 1:],
        M[1:, 0],
        v_k,
        definite_inverse(M[1:, 1:] - inverse_w_k * v_k * M[1:, :1] * M[0, 1:]),
    )


@jax.custom_jvp
def _coefficients(w, p, inverse_w_k, rhs, factor):  # noqa: ARG001
    """The unknowns y (m,) with which ``rhs`` (m,) is reproduced."""
    row, column, v_k, inverse = factor
    g = inverse @ (rhs[1:] - inverse_w_k * v_k * rhs[0] * column)
    return jnp.append(v_k * (rhs[0] - row @ g), g)


@functools.partial(_coefficients.defjvp, symbolic_zeros=True)
def _coefficients_jvp(primals, tangents):
    """T y = b gives T dy = db - dT y without a derivative of the matrix.

    dT y is the change of what the same y reproduce.
    """
    *system, rhs, factor = primals
    y = _coefficients(*primals)
    moving = [i for i, tangent in enumerate(tangents[:3]) if not isinstance(tangent, SymbolicZero)]
    change = 0.0 if isinstance(tangents[3], SymbolicZero) else tangents[3]
    if moving:

        def reproduced(*some):
            known = dict(zip(moving, some, strict=True))
            return _reproduced(*(known.get(i, value) for i, value in enumerate(system)), y)

        change -= jax.jvp(reproduced, [system[i] for i in moving], [tangents[i] for i in moving])[1]
    return y, _coefficients(*system, jnp.broadcast_to(change, rhs.shape), factor)


def _coordinates(x, y, kind):
    """Factors of the monomials of offsets: x and y, or z and its conjugate, Eqs. (18)-(19)."""
    return (lax.complex(x, y), lax.complex(x, -y)) if kind == "iicvmls" else (x, y)


def _exponents(degree):
    return [(total - j, j) for total in range(degree + 1) for j in range(total + 1)]


def monomials(
    u: Inexact[Array, "..."], v: Inexact[Array, "..."], degree: int
) -> Inexact[Array, "m ..."]:
    """The monomials (m, ...) u^i v^j up to a degree: 1, u, v, u^2, u v, v^2, ..."""
    rows = last = [jnp.ones_like(u)]
    for _ in range(degree):
        last = [*(u * row for row in last), v * last[-1]]
        rows = rows + last
    return jnp.stack(rows)


@functools.cache
def _products(order, kind):
    """Numbers (m, m) of the moments that are products of two monomials.

    They are moments of 1, u^order and v^order times the basis. The second of the two is conjugated
    if they are complex.
    """
    basis = _exponents(order)
    known = [(i + a, j + b) for a, b in ((0, 0), (order, 0), (0, order)) for i, j in basis]
    second = basis if kind == "imls" else [(j, i) for i, j in basis]
    return np.array([[known.index((i + a, j + b)) for a, b in second] for i, j in basis])


@jax.custom_jvp
def definite_inverse(matrix: Inexact[Array, "m m"]) -> Inexact[Array, "m m"]:
    """Inverse (m, m) of a Hermitian positive definite matrix by in-place elimination.

    It has few operations for many matrices. NaN for a singular one, whose last pivots are round-off
    of the diagonal, rarely exactly 0.
    """
    number, least = np.arange(len(matrix)), _VANISHING * jnp.diagonal(matrix).real
    for k in number:
        own = number == k
        pivot = jnp.where(matrix[k, k].real > least[k], matrix[k, k], jnp.nan)
        row, column = jnp.where(own, 1.0, matrix[k]) / pivot, jnp.where(own, 0.0, matrix[:, k])
        matrix = jnp.where(own[:, None], row, jnp.where(own, 0.0, matrix) - column[:, None] * row)
    return matrix


@definite_inverse.defjvp
def _definite_inverse_jvp(primals, tangents):
    inverse = definite_inverse(primals[0])
    return inverse, -inverse @ tangents[0] @ inverse


def _order(basis):
    """Degree of the monomials of a basis."""
    one_of("basis", basis, BASES)
    return BASES.index(basis) + 1
