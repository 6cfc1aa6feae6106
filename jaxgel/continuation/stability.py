"""Stability of an equilibrium: the lowest eigenvalues of its tangent, and the way from an unstable state to the stable branch.

Eigenvalues are those of K v = lambda N v with the stiffness N of the dry gel's network alone, Nv times the Laplacian: lambda is the
stiffness against the mode v in units of the network's, without dimension and next to independent of the cloud. A free network has 1, a
neutral state 0. Modes have v . N v = 1.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

from ..equilibrium import Status, acting, linearised, solve, solve_pinned, with_own_factor
from ..linalg import columnwise_products, inverse_iteration, lowest_of_factor, network_matrix, rayleigh_ritz
from ..materials import neo_hookean
from ..mechanics import contact_force, network_energy, picked, reduced, spread, volume_product

TRACKED = 2  # modes whose eigenvalues are made accurate where all may be unstable: both of a double eigenvalue
ACCURACY = 1e-3  # of the lowest eigenvalue, relative; up to 8e-3 is seen next to a crease, where a local mode falls fast
NEAR = 0.1  # largest relative difference of d . K d for a mode's correction d between a state and the factor that its solution left
IDLE = 0.1  # part of the accuracy below which a correction is not worth its making
ITERATIONS = 40
NEARBY_ITERATIONS = 4  # with the factor of another tangent, before the state's own is factorised
FIRST_AMPLITUDE = 0.02  # of the spacing: largest displacement of the first pinned state
GROWTH = 1.5  # of the amplitude from one pinned state to the next
MAX_PINNED = 24  # pinned states before the search for another branch gives up
MAX_SWITCHES = 6  # branches tried one after the other until one is stable


@dataclasses.dataclass(frozen=True, eq=False)
class Modes:
    """The lowest eigenvalues of a tangent, m of them."""

    eigenvalues: np.ndarray
    """(m,) ascending, dimensionless; the first is as accurate as asked for."""
    vectors: np.ndarray
    """(f, m) modes on the free degrees of freedom, 1 / sqrt(kT/v), of either sign; see ``oriented``."""
    negative: int
    """Number of negative eigenvalues of the tangent, tracked or not."""


def network_stiffness(problem):
    """Sparse matrix N (f, f) of the free degrees of freedom: Nv times the Laplacian in each direction, kT/v."""
    pattern = (problem.apart or problem).pattern  # without contact
    return network_matrix(pattern, float(problem.gel.Nv) * np.asarray(problem.fixed.laplacian))


def lowest_modes(problem, stiffness, state, mu, start=None, *, accuracy=ACCURACY):
    """``Modes`` of an ``Equilibrium`` at ``mu``, and that state with a factor of its own tangent.

    ``stiffness`` is ``network_stiffness(problem)``; ``start`` (f, m) are modes of a nearby state. Davidson's iteration.
    """
    state = with_own_factor(problem, mu, state)
    if start is not None:
        modes = _modes_from(start, problem, stiffness, state, mu, accuracy)
        if int(np.sum(modes.eigenvalues < 0)) == min(modes.negative, TRACKED):
            return modes, state  # otherwise an unstable mode is none of those that were followed
    return _modes_from(lowest_of_factor(state.factor, stiffness), problem, stiffness, state, mu, accuracy), state


def _modes_from(start, problem, stiffness, state, mu, accuracy):
    """``Modes`` of a state by its own factor, from the vectors ``start`` (f, m)."""
    followed, _ = inverse_iteration(state.factor, stiffness, start)
    followed, weights = inverse_iteration(state.factor, stiffness, followed)  # they were unknown, or have changed much
    lowest = followed[:, :TRACKED], weights[:, :TRACKED]
    eigenvalues, vectors, _ = _davidson(acting(problem, state), stiffness, state, mu, *lowest, accuracy, own=True)
    return Modes(eigenvalues, np.concatenate([vectors, followed[:, TRACKED:]], axis=1), state.factor.negative_pivots)


def nearby_modes(problem, stiffness, state, mu, start, *, accuracy=ACCURACY):
    """``Modes`` by the factor of a nearby tangent that the solution of a state left, from those ``start`` (f, m) of a nearby state.

    It will do as long as they converge and fewer than all are unstable, by its pivots and by their eigenvalues alike, which are Rayleigh
    quotients of the state's own tangent. Where it will not, or without ``start``, None; and in either case modes from which
    `lowest_modes` is to start, or None.
    """
    pivots = getattr(state.factor, "negative_pivots", -1)
    if start is None or not 0 <= pivots < TRACKED:
        return None, start
    followed, weights = inverse_iteration(state.factor, stiffness, start)
    m = pivots + 1
    lowest = followed[:, :m], weights[:, :m]
    eigenvalues, vectors, converged = _davidson(acting(problem, state), stiffness, state, mu, *lowest, accuracy, own=False)
    vectors, seen = np.concatenate([vectors, followed[:, m:]], axis=1), int(np.sum(eigenvalues < 0))
    if seen < pivots:
        return None, None
    return (Modes(eigenvalues, vectors, pivots), vectors) if converged and seen == pivots else (None, followed)


def _davidson(problem, stiffness, state, mu, vectors, weights, accuracy, own):
    """The lowest eigenvalues (m,) of the state's tangent K, their vectors (f, m), and whether the iterations were enough.

    Corrections d = K_f^-1 r of the imbalance r = K v - lambda N v come from the state's factor K_f. Where that is its ``own`` K d is r;
    where it is not r is wrong by the distance of K_f from K, at most ``NEAR`` of what the last correction gains.
    """
    images = tangent_products(problem, state, mu, vectors, weights)
    eigenvalues, turn = scipy.linalg.eigh(vectors.T @ images, vectors.T @ weights, check_finite=False)
    for _ in range(ITERATIONS if own else NEARBY_ITERATIONS):
        vectors, weights, images = vectors @ turn, weights @ turn, images @ turn
        imbalance = images - weights * eigenvalues
        d = state.factor.apply(imbalance)
        if 0 <= imbalance[:, 0] @ d[:, 0] <= IDLE * accuracy * eigenvalues[0]:
            return eigenvalues, vectors, True
        weighted = columnwise_products(stiffness, d)
        share = vectors.T @ weighted
        d, weighted = d - vectors @ share, weighted - weights @ share
        product, small = imbalance - images @ share, accuracy / NEAR
        better, turn = rayleigh_ritz(eigenvalues, images, d, product, weighted)
        gains = imbalance[:, 0] @ d[:, 0], better[0] - eigenvalues[0]  # parts of the first may cancel where the factor is indefinite
        last = np.abs(gains).max() <= small * min(abs(eigenvalues[0]), abs(better[0]))
        if not (last or own):
            product = tangent_products(problem, state, mu, d, weighted)
            better, turn = rayleigh_ritz(eigenvalues, images, d, product, weighted)
        eigenvalues = better
        vectors, weights, images = (np.concatenate(pair, axis=1) for pair in ((vectors, d), (weights, weighted), (images, product)))
        if last:
            break
    return eigenvalues, vectors @ turn, last


def tangent_products(problem, state, mu, vectors, weights):
    """Products (f, m) of the state's own tangent, the Hessian of the total energy, with ``vectors`` (f, m).

    ``weights`` (f, m) are the products of ``network_stiffness``, which is all of a neo-Hookean network's share. Without it and contact the
    products cost less than a derivative of the residual, as the volume's share is at hand in the state's linearisation.
    """
    basis = state.linearisation
    if basis is None:
        everything = problem.model, problem.gel, jnp.asarray(mu, dtype=float), problem.loads, problem.fixed, problem.free
        basis = linearised(state.x, state.pressure, *everything)[0]
    share = _products(vectors, state.x, state.pressure, basis, problem.model, problem.gel, problem.fixed, problem.free)
    return np.asarray(share) + (weights if problem.gel.network is neo_hookean else 0.0)


@jax.jit
def _products(vectors, x, p, basis, model, gel, fixed, free):
    """``tangent_products`` less the share of a neo-Hookean network."""

    def force(x):
        network = jax.grad(network_energy)(x, model, gel) if gel.network is not neo_hookean else 0.0
        return network + (contact_force(x, model) if model.contact is not None else 0.0)

    def one(v):
        v = spread(v, x.shape, free)
        product = volume_product(v, p, basis, model, fixed)
        if gel.network is not neo_hookean or model.contact is not None:
            product += jax.jvp(force, (x,), (v,))[1]
        return reduced(product, free)

    return jax.lax.map(one, vectors.T).T  # one after the other, as each fills the cache


def oriented(vectors, problem):
    """The modes (f, m) with the sign that makes their product with a fixed field without symmetry positive, on every cloud."""
    plate = problem.model.cloud.plate
    x, y = (np.asarray(problem.model.cloud.nodes) / [plate.width, plate.height]).T
    field = picked(np.stack([np.sin(5.1 * y + 2.3 * x + 0.4), np.sin(3.7 * x - 1.9 * y - 0.9)], axis=1), problem.free)
    return vectors * np.where(field @ vectors < 0, -1.0, 1.0)


def stable_state(problem, mu, state, modes, *, sign=1):
    """``Equilibrium`` without negative eigenvalues at ``mu`` and its ``Modes``, reached from an unstable state; None if none is found.

    Along ``sign`` times the mode of the lowest eigenvalue the state is pinned at growing amplitudes. The force that holds it points
    outwards at first; where it changes sign lies an equilibrium of another branch, and Newton's method without the pin finds it.
    """
    stiffness = network_stiffness(problem)
    for _ in range(MAX_SWITCHES):
        mode = sign * oriented(modes.vectors[:, :1], problem)[:, 0]
        against = np.asarray(reduced(problem.loads, problem.free)) @ mode < 0  # loads that push choose the side
        found = _across(problem, mu, state.x, state.pressure, -mode if against else mode)
        if found is None:
            return None
        modes, state = lowest_modes(problem, stiffness, found, mu)
        if modes.negative == 0:
            return state, modes
    return None


def _across(problem, mu, x, pressure, mode):
    """The next ``Equilibrium`` along ``mode`` (f,), with a factor of its own tangent, or None."""
    mode = mode / np.linalg.norm(mode)
    start, free = jnp.asarray(x), problem.free
    amplitude, force_before = FIRST_AMPLITUDE * problem.model.cloud.spacing / np.abs(mode).max(), None
    x = start + amplitude * spread(mode, start.shape, free)
    for _ in range(MAX_PINNED):
        pinned, force = solve_pinned(problem, mu, x, pressure, mode, start, amplitude)
        if not pinned.status.ok:
            return None
        if force_before is not None and np.sign(force) != np.sign(force_before):
            found = solve(problem, mu, pinned.x, pinned.pressure, fresh=True)
            moved = float(jnp.linalg.norm(found.x - start))
            return found if found.status is Status.CONVERGED and moved > 0.5 * amplitude / GROWTH else None
        x = pinned.x + (GROWTH - 1) * (pinned.x - start)
        pressure, amplitude, force_before = pinned.pressure, GROWTH * amplitude, force
    return None
