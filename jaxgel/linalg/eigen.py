"""Eigenvalues of a factorised tangent over the network's stiffness: Lanczos, Rayleigh-Ritz.

Shift-invert Lanczos.
"""

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from .._types import Array, Float
from .blocks import Diagonal
from .factors import Factor, columnwise
from .pattern import Pattern

FOLLOWED = 4  # modes that are carried along a sweep, any of which may become the lowest
SAME = 1e-8  # part of a vector that is left beside the others if they are next to dependent
FIRST_ITERATIONS = 4  # inverse iterations for modes of which nothing is known
MOST_NEGATIVE = 30  # negative eigenvalues among which the lowest is looked for if nothing is known


Factorised = Factor | Diagonal


def network_matrix(pattern: Pattern, laplacian: Float[Array, " p"]) -> sp.csr_matrix:
    """``network_stiffness`` from its entries (p,) by node pairs."""
    matrix = sp.csr_matrix(pattern.matrix(np.asarray(laplacian)[:, None, None] * np.eye(2)))
    matrix.eliminate_zeros()
    return matrix.copy()  # half of the entries were zero, but not given back


def lowest_mode(
    factor: Factorised, stiffness: sp.csr_matrix
) -> tuple[float, Float[np.ndarray, " f"]]:
    """Lowest eigenvalue of the factorised tangent and mode (f,), by shift-invert Lanczos."""
    negative = min(factor.negative_pivots, MOST_NEGATIVE)
    values, modes = nearest_modes(
        factor, stiffness, max(negative, 1), which="SA" if negative else "LM"
    )
    return values[0], modes[:, 0]


def inverse_iteration(
    factor: Factorised, stiffness: sp.csr_matrix, start: Float[np.ndarray, "f m"]
) -> tuple[Float[np.ndarray, "f m"], Float[np.ndarray, "f m"]]:
    """Ascending Ritz vectors (f, m) of the tangent by inverse iteration of ``start``, and N times.

    The start is (f, m), the tangent factorised.
    """
    before = columnwise(stiffness.dot, start)
    # next to a singular tangent all vectors turn into one direction
    vectors, r = np.linalg.qr(factor.apply(before))
    weights, sizes = columnwise(stiffness.dot, vectors), np.abs(np.diagonal(r))
    if sizes.min() > SAME * sizes.max():
        images = scipy.linalg.solve_triangular(r, before.T, trans="T", check_finite=False).T
    else:
        images = factor.product(vectors)
    _, turn = scipy.linalg.eigh(vectors.T @ images, vectors.T @ weights, check_finite=False)
    return vectors @ turn, weights @ turn


def _without_symmetry(f, factor=1):
    """A fixed vector (f,), or vectors (f, m) for factors (m,), without any symmetry."""
    return np.sin(1.0 + np.multiply.outer(np.arange(f) ** 1.5, factor))


def lowest_of_factor(factor: Factorised, stiffness: sp.csr_matrix) -> Float[np.ndarray, "f m"]:
    """Modes (f, FOLLOWED) of the lowest eigenvalues: the negative ones, or those next to zero."""
    negative = min(factor.negative_pivots, MOST_NEGATIVE)
    if negative == 0:
        vectors = _without_symmetry(stiffness.shape[0], np.arange(1, FOLLOWED + 1))
        for _ in range(FIRST_ITERATIONS):
            vectors = np.linalg.qr(factor.apply(stiffness @ vectors))[0]
        return vectors
    # of 1 / eigenvalue: the negative ones
    below = nearest_modes(factor, stiffness, negative, which="SA")[1]
    missing = max(FOLLOWED - negative, 0)
    above = [nearest_modes(factor, stiffness, missing, which="LA")[1]] if missing else []
    return np.concatenate([below, *above], axis=1)[:, :FOLLOWED]


def nearest_modes(
    factor: Factorised,
    stiffness: sp.csr_matrix,
    count: int,
    before: Float[np.ndarray, "f m"] | None = None,
    *,
    which: str = "LM",
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "f m"]]:
    """The ``count`` eigenvalues nearest zero, ascending, and modes (f, count), by Lanczos.

    The method is shift-invert Lanczos. ``which`` "SA" takes the negative ones, "LA" the positive
    ones. With the modes ``before`` (f, count) of a nearby tangent they keep their signs.
    """
    inverse = sla.LinearOperator(stiffness.shape, matvec=factor.apply, dtype=float)
    start = _without_symmetry(stiffness.shape[0]) if before is None else before.sum(axis=1)
    values, modes = sla.eigsh(
        factor.matrix, count, stiffness, 0.0, which=which, OPinv=inverse, v0=start
    )
    if before is not None:
        modes = modes * np.where(np.sum(modes * (stiffness @ before), axis=0) < 0, -1.0, 1.0)
    rank = np.argsort(values)
    return values[rank], modes[:, rank]


def rayleigh_ritz(
    eigenvalues: Float[np.ndarray, " m"],
    images: Float[np.ndarray, "f m"],
    d: Float[np.ndarray, "f m"],
    product: Float[np.ndarray, "f m"],
    weighted: Float[np.ndarray, "f m"],
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "r m"]]:
    """Lowest eigenvalues (m,) and coefficients (2 m, m) of Ritz vectors and corrections ``d``.

    There are m Ritz vectors; the corrections (f, m) are orthogonal to them. ``images`` and
    ``product`` (f, m) are K times the two, ``weighted`` (f, m) is N d.
    """
    m, coupling, corner, gram = len(eigenvalues), images.T @ d, d.T @ product, d.T @ weighted
    scale = 1 / np.sqrt(np.diagonal(gram) + np.finfo(float).tiny)
    both = np.block(
        [
            [np.diag(eigenvalues), coupling * scale],
            [(coupling * scale).T, 0.5 * (corner + corner.T) * np.outer(scale, scale)],
        ]
    )
    # two corrections may be the same but for round-off
    gram = np.outer(scale, scale) * gram + 1e-9 * np.eye(m)
    values, coefficients = scipy.linalg.eigh(
        both, scipy.linalg.block_diag(np.eye(m), gram), check_finite=False
    )
    coefficients[m:] *= scale[:, None]
    return values[:m], coefficients[:, :m]
