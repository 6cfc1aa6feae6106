"""Stability of an equilibrium: the lowest eigenvalues of its tangent.

Eigenvalues are those of K v = lambda N v with the stiffness N of the dry gel's network alone, Nv
times the Laplacian: lambda is the stiffness against the mode v in units of the network's,
dimensionless and nearly independent of the cloud. A free network has 1, a neutral state 0. Modes
have v . N v = 1.
"""

import functools

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from .._types import Float
from ..equilibrium import Stability, State, with_own_factor
from ..linalg import (
    Factorised,
    columnwise,
    inverse_iteration,
    lowest_of_factor,
    network_matrix,
    rayleigh_ritz,
)
from ..mechanics import Problem, gather

# modes whose eigenvalues are made accurate if all may be unstable: both of a double eigenvalue
TRACKED = 2
# of the lowest eigenvalue, relative; up to 8e-3 is seen after large steps of mu and next to a
# crease
ACCURACY = 1e-3
IDLE = 0.1  # part of the accuracy below which a correction is not worth its cost
ITERATIONS = 40


class StabilityAnalysis:
    """Eigenvalues of the tangents of states of one problem."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    @functools.cached_property
    def stiffness(self) -> sp.csr_matrix:
        """N (f, f) of the free degrees of freedom: Nv times the vector Laplacian, kT/v."""
        return network_matrix(self.problem.without_pairs.pattern, self.problem.network)

    def check(
        self, state: State, start: Float[np.ndarray, "f m"] | None = None
    ) -> tuple[Stability, State]:
        """`Stability` of a converged state, and the state with a factor of its own tangent.

        It has the lowest eigenvalues. Davidson's iteration, from modes ``start`` (f, m) of a nearby
        state. Raises `linalg.SingularTangent`.
        """
        state = with_own_factor(self.problem, state)
        return stability_of_factor(state.factor, self.stiffness, start), state


def stability_of_factor(
    factor: Factorised, stiffness: sp.csr_matrix, start: Float[np.ndarray, "f m"] | None = None
) -> Stability:
    """`Stability` of a tangent with its lowest eigenvalues, by its own ``factor``.

    ``start`` are modes (f, m) of one nearby.
    """
    if start is not None:
        m = min(factor.negative_pivots + 1, TRACKED)
        # the lowest ones are far from those that an inverse iteration finds first
        if factor.negative_pivots >= TRACKED:
            start, _ = inverse_iteration(factor, stiffness, start)
        found = _from_modes(factor, stiffness, start, m)
        if int(np.sum(found.eigenvalues < 0)) == min(found.negative, m):
            return found  # otherwise an unstable mode is none of those that were followed
    followed, _ = inverse_iteration(factor, stiffness, lowest_of_factor(factor, stiffness))
    return _from_modes(factor, stiffness, followed, TRACKED)


def _from_modes(factor, stiffness, start, m):
    """`Stability` from the vectors ``start`` (f, w), the lowest ``m`` eigenvalues accurate."""
    followed, weights = inverse_iteration(factor, stiffness, start)
    eigenvalues, vectors = _davidson(factor, stiffness, followed[:, :m], weights[:, :m])
    return Stability(
        factor.negative_pivots, eigenvalues, np.concatenate([vectors, followed[:, m:]], axis=1)
    )


def _davidson(factor, stiffness, vectors, weights):
    """The lowest eigenvalues (m,) of a tangent K and their vectors (f, m).

    Corrections are d = K^-1 r of the eigen-residual r = K v - lambda N v, so that K d is r.
    """
    images = factor.product(vectors)
    eigenvalues, turn = scipy.linalg.eigh(
        vectors.T @ images, vectors.T @ weights, check_finite=False
    )
    for _ in range(ITERATIONS):
        vectors, weights, images = vectors @ turn, weights @ turn, images @ turn
        residual = images - weights * eigenvalues
        d = factor.apply(residual)
        if 0 <= residual[:, 0] @ d[:, 0] <= IDLE * ACCURACY * eigenvalues[0]:
            return eigenvalues, vectors
        weighted = columnwise(stiffness.dot, d)
        share = vectors.T @ weighted
        d, weighted = d - vectors @ share, weighted - weights @ share
        image = residual - images @ share
        better, turn = rayleigh_ritz(eigenvalues, images, d, image, weighted)
        # parts of the first may cancel if the factor is indefinite
        gains = residual[:, 0] @ d[:, 0], better[0] - eigenvalues[0]
        last = np.abs(gains).max() <= IDLE * ACCURACY * min(abs(eigenvalues[0]), abs(better[0]))
        eigenvalues = better
        vectors, weights, images = (
            np.concatenate(pair, axis=1)
            for pair in ((vectors, d), (weights, weighted), (images, image))
        )
        if last:
            break
    return eigenvalues, vectors @ turn


def oriented(vectors: Float[np.ndarray, "f m"], problem: Problem) -> Float[np.ndarray, "f m"]:
    """Modes whose sign gives a positive product with a fixed asymmetric field on every cloud."""
    plate = problem.model.cloud.plate
    x, y = (np.asarray(problem.model.cloud.nodes) / [plate.width, plate.height]).T
    field = np.asarray(
        gather(
            np.stack([np.sin(5.1 * y + 2.3 * x + 0.4), np.sin(3.7 * x - 1.9 * y - 0.9)], axis=1),
            problem.free,
        )
    )
    return vectors * np.where(field @ vectors < 0, -1.0, 1.0)
