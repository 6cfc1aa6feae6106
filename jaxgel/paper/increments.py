"""The paper's algorithm: increments u' from the freely swollen plate C_mu, Eqs. (41)-(58).

Deng et al. (2020). At each mu the dry plate swells freely by l_mu, x' = l_mu X, and its rollers are
then brought back, u' = (1 - l_mu) X, while

    (K_L0 + K_L1 + K_NL) du' = f_1 - f_2

is solved until f_1 = f_2. Stress S and tangent D are those of Eqs. (6)-(9), J is taken at every
quadrature point. In C_mu gradients are divided by l_mu and areas multiplied by J_mu = l_mu^2. Index
letters as in ``scheme``.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from .._types import Array, Float, Inexact, Scalar
from ..equilibrium import NEWTON, Stability, State, Status
from ..linalg import SingularTangent
from ..materials import Gel, free_swelling
from .matrices import assembled, negative_eigenvalues, solved
from .scheme import Cells, Scheme, deformation_gradients, scheme_energy, volume_ratios
from .stress import paper_stress, paper_tangent, voigt

MARGIN = 0.2  # share of the least swelling J - 1 that an increment leaves
LEAST_SHARE = 1 / 64  # of an increment, or of the way of the rollers


def incremented(scheme: Scheme, gel: Gel, mu: float, start: Float[Array, "n 2"] | None) -> State:
    """`State` at ``mu`` from nodal values ``start``, or from free swelling if None.

    They are those of another state.
    """
    swollen = float(free_swelling(mu, gel)) * np.asarray(scheme.cloud.nodes)
    if start is None:
        found, matrix = _pushed_back(scheme, gel, mu)
    else:
        found, matrix = _incremented(scheme, gel, mu, np.asarray(start) - swollen, 1.0)
    x = swollen + found.x
    stability = Stability(negative_eigenvalues(matrix)) if found.status.ok else None
    return dataclasses.replace(
        found, x=x, energy=float(scheme_energy(x, scheme.cells, gel, mu)), stability=stability
    )


def _pushed_back(scheme, gel, mu):
    """`_incremented` with rollers moved back from the freely swollen edges, at once or in parts."""
    u, share, part, spent = np.zeros(scheme.cloud.nodes.shape), 0.0, 1.0, 0
    while True:
        found, matrix = _incremented(scheme, gel, mu, u, min(1.0, share + part))
        spent += found.newton_iterations
        if found.status.ok:
            u, share = found.x, min(1.0, share + part)
        else:
            part /= 2
        if share == 1.0 or part < LEAST_SHARE:
            return dataclasses.replace(found, newton_iterations=spent), matrix


def _incremented(scheme, gel, mu, u, share) -> tuple[State, sp.csr_array | None]:
    """`State` whose ``x`` is u' (n, 2), u' = share (1 - l) X on rollers, and last matrix (f, f).

    That is the free-free one. Increments du', Eq. (57), are shortened so that every volume ratio
    stays above 1.
    """
    dry, free, stretch = np.asarray(scheme.cloud.nodes), scheme.free, float(free_swelling(mu, gel))
    held, matrix, iteration, status = np.setdiff1d(np.arange(dry.size), free), None, 0, None
    target, least = share * (1 - stretch) * dry.ravel()[held], _least_swelling(u, stretch, scheme)
    while True:
        matrices, force, network = cell_matrices(jnp.asarray(u), stretch, mu, scheme.cells, gel)
        residual, missing = -np.asarray(force).ravel(), target - u.ravel()[held]
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging iterate ends as a status
            size = float(np.linalg.norm(residual[free]) / float(network))
        met = np.abs(missing).max(initial=0.0) < 1e-14 * np.abs(dry).max()
        if status is None and not (least > 0 and np.isfinite(size)):
            status = Status.NOT_FINITE
        elif status is None and size < NEWTON.tolerance and met and matrix is not None:
            status = Status.CONVERGED
        elif status is None and iteration >= NEWTON.max_iterations:
            status = Status.NOT_CONVERGED
        if status is not None:
            return State(
                float(mu),
                float(mu),
                u,
                np.zeros(0),
                status,
                newton_iterations=iteration,
                residual=size,
            ), matrix
        K, du, part, before = (
            assembled(matrices, scheme.cells, len(u)),
            np.zeros(u.size),
            1.0,
            least,
        )
        matrix, du[held] = K[free][:, free], missing
        try:
            du[free] = solved(matrix, residual[free] - K[free][:, held] @ missing)
        except SingularTangent:
            status = Status.SINGULAR
            continue
        while (
            least := _least_swelling(u + part * du.reshape(u.shape), stretch, scheme)
        ) <= MARGIN * before and part > LEAST_SHARE:
            part /= 2
        u, iteration = u + part * du.reshape(u.shape), iteration + 1


def _least_swelling(u, stretch, scheme):
    """Smallest J - 1 of all Gauss points."""
    return float(jnp.min(volume_ratios(stretch * scheme.cloud.nodes + u, scheme.cells))) - 1


@jax.jit
def cell_matrices(
    u: Float[Array, "n 2"], stretch: Scalar, mu: Scalar, cells: Cells, gel: Gel
) -> tuple[Float[Array, "c A A"], Float[Array, "n 2"], Float[Array, ""]]:
    """Matrices K_L0 + K_L1 + K_NL (c, 2 a, 2 a), f_2 (n, 2), and its network part's norm."""
    phi, weight = cells.dphi / stretch, cells.weight * stretch**2  # in C_mu
    L = deformation_gradients(u, cells) / stretch  # L_ij = du'_i / dX_j
    parts = jax.vmap(jax.vmap(lambda phi, L: _point(phi, L, mu, gel)))(phi, L)
    K, f_2, network = (jnp.einsum("cq,cq...->c...", weight, part) for part in parts)
    force, network = (
        jnp.zeros_like(u).at[cells.nodes].add(part.reshape(*cells.nodes.shape, 2))
        for part in (f_2, network)
    )
    return K, force, jnp.linalg.norm(network)


def _point(phi, L, mu, gel):
    """Integrands at a point: K, Eqs. (47)-(49), f_2, Eq. (51), and its network part.

    K is (2 a, 2 a), the others are (2 a,).
    """
    F = jnp.eye(2) + L
    G = F.T @ F
    S, D = paper_stress(G, mu, gel), voigt(paper_tangent(G, mu, gel))
    B_L0, B_L1, B = strain_matrices(phi, L)
    S_hat = jnp.kron(jnp.eye(2), S)  # Eq. (55)
    K_NL = B.T @ S_hat @ B
    # K_L0 + K_L1, the three products of Eq. (48) included
    K_L = (B_L0 + B_L1).T @ D @ (B_L0 + B_L1)
    S_vector = jnp.stack([S[0, 0], S[1, 1], S[0, 1]])  # Eq. (56)
    return (
        K_L + K_NL,
        (B_L0 + B_L1).T @ S_vector,
        (B_L0 + B_L1).T @ (gel.Nv * jnp.array([1.0, 1.0, 0.0])),
    )


def strain_matrices(
    phi: Inexact[Array, "a 2"], L: Float[Array, "2 2"]
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """B_L0 (3, 2 a), B_L1 (3, 2 a), B (4, 2 a), Eqs. (52)-(54), of gradients (a, 2), L (2, 2).

    Shape function gradients are real or complex.
    """
    r1, r2, i1, i2 = phi[:, 0].real, phi[:, 1].real, phi[:, 0].imag, phi[:, 1].imag

    def rows(first, second):
        return jnp.stack([jnp.stack(first), jnp.stack(second)], axis=-1).reshape(len(first), -1)

    (L11, L12), (L21, L22) = L
    B_L0 = rows([r1, i2, r2 + i1], [-i1, r2, -i2 + r1])
    B_L1 = rows(
        [L11 * r1 + L21 * i1, L12 * r2 + L22 * i2, L11 * r2 + L12 * r1 + L21 * i2 + L22 * i1],
        [-L11 * i1 + L21 * r1, -L12 * i2 + L22 * r2, -L11 * i2 - L12 * i1 + L21 * r2 + L22 * r1],
    )
    return B_L0, B_L1, rows([r1, r2, i1, i2], [-i1, -i2, r1, r2])
