"""Stability of an equilibrium: the lowest eigenvalues of its tangent.

Eigenvalues are those of K v = lambda N v with the stiffness N of the dry gel's network alone, Nv times the Laplacian: lambda is the
stiffness against the mode v in units of the network's, dimensionless and nearly independent of the cloud. A free network has 1, a
neutral state 0. Modes have v . N v = 1.
"""

import functools
from collections.abc import Callable

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from .._types import Float
from ..equilibrium import Stability, State, acting_problem, with_own_factor
from ..linalg import Factorised, columnwise, inverse_iteration, lowest_of_factor, network_matrix, rayleigh_ritz
from ..mechanics import Problem, gather, linearise, tangent_product

TRACKED = 2  # modes whose eigenvalues are made accurate where all may be unstable: both of a double eigenvalue
ACCURACY = 1e-3  # of the lowest eigenvalue, relative; up to 8e-3 is seen after large steps of mu and next to a crease
NEAR = 0.1  # largest relative difference of d . K d for a mode's correction d between a state and the factor that its solution left
IDLE = 0.1  # part of the accuracy below which a correction is not worth its cost
ITERATIONS = 40
NEARBY_ITERATIONS = 4  # with the factor of another tangent, before the state's own is factorised


class StabilityAnalysis:
    """Eigenvalues of the tangents of states of one problem."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    @functools.cached_property
    def stiffness(self) -> sp.csr_matrix:
        """N (f, f) of the free degrees of freedom: Nv times the Laplacian in each direction, kT/v."""
        free = self.problem.without_contact
        return network_matrix(free.pattern, np.asarray(free.operators.network))

    def check(self, state: State, start: Float[np.ndarray, "f m"] | None = None) -> tuple[Stability, State]:
        """`Stability` of a converged state, and the state with the factor that was used; ``start`` are modes of a nearby state."""
        stability, start = self.by_nearby_factor(state, start)
        return (stability, state) if stability is not None else self.by_own_factor(state, start)

    def by_own_factor(self, state: State, start: Float[np.ndarray, "f m"] | None = None) -> tuple[Stability, State]:
        """`Stability` of a converged state, and that state with a factor of its own tangent. Davidson's iteration."""
        state = with_own_factor(self.problem, state)
        return stability_of_factor(state.factor, self.stiffness, self.product(state), start), state

    def by_nearby_factor(
        self, state: State, start: Float[np.ndarray, "f m"] | None
    ) -> tuple[Stability | None, Float[np.ndarray, "f m"] | None]:
        """`Stability` by the factor of a nearby tangent that the solution of a state left, from modes ``start`` (f, m) of a nearby state.

        The factor serves as long as the modes converge and fewer than all are unstable, by its pivots and by their eigenvalues alike, which
        are Rayleigh quotients of the state's own tangent. Where it does not, or without ``start``, None; and in either case modes from
        which `by_own_factor` is to start, or None.
        """
        pivots = getattr(state.factor, "negative_pivots", -1)
        if start is None or not 0 <= pivots < TRACKED:
            return None, start
        followed, weights = inverse_iteration(state.factor, self.stiffness, start)
        m = pivots + 1
        lowest = followed[:, :m], weights[:, :m]
        eigenvalues, vectors, converged = _davidson(state.factor, self.stiffness, self.product(state), *lowest, own=False)
        vectors, seen = np.concatenate([vectors, followed[:, m:]], axis=1), int(np.sum(eigenvalues < 0))
        if seen < pivots:
            return None, None
        return (Stability(eigenvalues, vectors, pivots), vectors) if converged and seen == pivots else (None, followed)

    def product(self, state: State) -> Callable[[Float[np.ndarray, "f m"]], Float[np.ndarray, "f m"]]:
        """Function that multiplies vectors (f, m) with the tangent of a state."""
        problem = acting_problem(self.problem, state)
        at = problem, state.x, state.pressure
        now = state.linearisation if state.linearisation is not None else linearise(*at, state.mu)
        return lambda vectors: np.stack([tangent_product(*at, now, v) for v in vectors.T], axis=1)


def stability_of_factor(
    factor: Factorised,
    stiffness: sp.csr_matrix,
    product: Callable[[Float[np.ndarray, "f m"]], Float[np.ndarray, "f m"]],
    start: Float[np.ndarray, "f m"] | None = None,
) -> Stability:
    """`Stability` of a tangent by its own ``factor`` and its ``product`` with vectors; ``start`` are modes (f, m) of one nearby."""
    if start is not None:
        m = min(factor.negative_pivots + 1, TRACKED)
        if factor.negative_pivots >= TRACKED:  # the lowest ones are far from those that an inverse iteration finds first
            start, _ = inverse_iteration(factor, stiffness, start)
        found = _from_modes(factor, stiffness, product, start, m)
        if int(np.sum(found.eigenvalues < 0)) == min(found.negative, m):
            return found  # otherwise an unstable mode is none of those that were followed
    followed, _ = inverse_iteration(factor, stiffness, lowest_of_factor(factor, stiffness))
    return _from_modes(factor, stiffness, product, followed, TRACKED)


def _from_modes(factor, stiffness, product, start, m):
    """`Stability` from the vectors ``start`` (f, w), of which the lowest ``m`` eigenvalues are made accurate."""
    followed, weights = inverse_iteration(factor, stiffness, start)
    eigenvalues, vectors, _ = _davidson(factor, stiffness, product, followed[:, :m], weights[:, :m], own=True)
    return Stability(eigenvalues, np.concatenate([vectors, followed[:, m:]], axis=1), factor.negative_pivots)


def _davidson(factor, stiffness, product, vectors, weights, own):
    """The lowest eigenvalues (m,) of a tangent K, their vectors (f, m), and whether the iterations were enough.

    Corrections d = K_f^-1 r of the eigen-residual r = K v - lambda N v come from the factor of K_f. Where that is the tangent's ``own`` K d
    is r; where it is not, r is wrong by the distance of K_f from K, at most ``NEAR`` of what the last correction gains.
    """
    images = product(vectors)
    eigenvalues, turn = scipy.linalg.eigh(vectors.T @ images, vectors.T @ weights, check_finite=False)
    for _ in range(ITERATIONS if own else NEARBY_ITERATIONS):
        vectors, weights, images = vectors @ turn, weights @ turn, images @ turn
        residual = images - weights * eigenvalues
        d = factor.apply(residual)
        if 0 <= residual[:, 0] @ d[:, 0] <= IDLE * ACCURACY * eigenvalues[0]:
            return eigenvalues, vectors, True
        weighted = columnwise(stiffness.dot, d)
        share = vectors.T @ weighted
        d, weighted = d - vectors @ share, weighted - weights @ share
        image, small = residual - images @ share, IDLE * ACCURACY if own else ACCURACY / NEAR
        better, turn = rayleigh_ritz(eigenvalues, images, d, image, weighted)
        gains = residual[:, 0] @ d[:, 0], better[0] - eigenvalues[0]  # parts of the first may cancel where the factor is indefinite
        last = np.abs(gains).max() <= small * min(abs(eigenvalues[0]), abs(better[0]))
        if not (last or own):
            image = product(d)
            better, turn = rayleigh_ritz(eigenvalues, images, d, image, weighted)
        eigenvalues = better
        vectors, weights, images = (np.concatenate(pair, axis=1) for pair in ((vectors, d), (weights, weighted), (images, image)))
        if last:
            break
    return eigenvalues, vectors @ turn, last


def oriented(vectors: Float[np.ndarray, "f m"], problem: Problem) -> Float[np.ndarray, "f m"]:
    """Modes with the sign that makes their product with a fixed field without symmetry positive, on every cloud."""
    plate = problem.model.cloud.plate
    x, y = (np.asarray(problem.model.cloud.nodes) / [plate.width, plate.height]).T
    field = np.asarray(gather(np.stack([np.sin(5.1 * y + 2.3 * x + 0.4), np.sin(3.7 * x - 1.9 * y - 0.9)], axis=1), problem.free))
    return vectors * np.where(field @ vectors < 0, -1.0, 1.0)
