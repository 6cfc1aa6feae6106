"""The discrete equations of Deng et al. (2020), Eqs. (45)-(56), written out, against the derivatives of the total energy.

The state is a converged one of the paper's scheme (J at every Gauss point) on a small plate with a hole. The paper's matrices live in
the freely swollen reference C_mu: coordinates l_mu X, displacements u' = x - l_mu X, weights times J_mu. Gauss points and complex shape
functions are evaluated here, all nodes at once.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss

import jaxgel
from jaxgel.discretisation import shape_functions
from jaxgel.paper import equilibria, scheme_energy, voigt

MU = -1.5


@pytest.fixture(scope="module")
def state(tiny_scheme):
    """Scheme, gel and positions (n, 2) at equilibrium."""
    gel = tiny_scheme.cloud.plate.gel
    states = list(equilibria(tiny_scheme, gel, [-3.0, -2.0, MU]))
    assert len(states) == 3
    return tiny_scheme, gel, jnp.asarray(states[-1].x)


@pytest.fixture(scope="module")
def matrices(state):
    """K_L0, K_L1, K_NL and f_2 of Eqs. (47)-(49) and (51)."""
    model, gel, x = state
    stretch = float(jaxgel.free_swelling(MU, gel))
    phi_1, phi_2, weight = gauss_gradients(model, stretch)
    u = np.asarray(x) - stretch * np.asarray(model.cloud.nodes)
    L = np.stack([phi_1.real @ u, phi_2.real @ u], axis=-1)  # L_ij = du'_i / dX_j
    F = np.eye(2) + L
    G = np.einsum("pki,pkj->pij", F, F)
    S = np.asarray(jax.vmap(lambda G: jaxgel.paper_stress(G, MU, gel))(G))
    D = np.asarray(jax.vmap(lambda G: voigt(jaxgel.paper_tangent(G, MU, gel)))(G))
    B_L0, B_L1, B = strain_matrices(phi_1, phi_2, L)

    def integral(left, middle, right):
        return np.einsum("p,pvi,pvw,pwj->ij", weight, left, middle, right, optimize=True)

    K_L0 = integral(B_L0, D, B_L0)  # Eq. (47)
    K_L1 = integral(B_L0, D, B_L1) + integral(B_L1, D, B_L0) + integral(B_L1, D, B_L1)  # Eq. (48)
    S_hat = np.kron(np.eye(2), np.ones((2, 2))) * np.tile(S, (1, 2, 2))  # Eq. (55): S in both diagonal blocks
    K_NL = integral(B, S_hat, B)  # Eq. (49)
    S_vector = np.stack([S[:, 0, 0], S[:, 1, 1], S[:, 0, 1]], axis=1)  # Eq. (56)
    f_2 = np.einsum("p,pvi,pv->i", weight, B_L0 + B_L1, S_vector)  # Eq. (51)
    return K_L0, K_L1, K_NL, f_2


def gauss_gradients(model, stretch):
    """Complex gradients Phi,1 and Phi,2 (p, n) in C_mu at 4 x 4 Gauss points of 8 x 8 cells, less those in the hole, and weights (p,)."""
    g, w = leggauss(4)
    ticks = (np.arange(8)[:, None] - 3.5 + g / 2).ravel() / 2
    points = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    weight = np.outer(np.tile(w, 8), np.tile(w, 8)).ravel() / 16
    hole = model.cloud.plate.holes[0]
    outside = np.linalg.norm(points - hole.centre, axis=1) > float(hole.radius)
    support = model.dmax * model.cloud.spacing
    phi = functools.partial(
        shape_functions, neighbours=stretch * model.cloud.nodes, support=stretch * support, basis=model.basis, kind="iicvmls"
    )
    gradient = np.asarray(jax.jit(jax.vmap(jax.jacfwd(phi)))(stretch * points[outside]))
    return gradient[:, :, 0], gradient[:, :, 1], stretch**2 * weight[outside]


def strain_matrices(phi_1, phi_2, L):
    """B_L0 (p, 3, 2n), B_L1 (p, 3, 2n) and B (p, 4, 2n) of Eqs. (52)-(54), with the real and imaginary parts as printed."""

    def columns(first, second):
        """Rows (p, n) for u1 and u2 of every node, interleaved: (p, rows, 2n)."""
        return np.stack([np.stack(first, axis=1), np.stack(second, axis=1)], axis=-1).reshape(len(phi_1), len(first), -1)

    r1, i1, r2, i2 = phi_1.real, phi_1.imag, phi_2.real, phi_2.imag
    L11, L12, L21, L22 = (L[:, i, j, None] for i in (0, 1) for j in (0, 1))
    B_L0 = columns([r1, i2, r2 + i1], [-i1, r2, -i2 + r1])
    B_L1 = columns(
        [L11 * r1 + L21 * i1, L12 * r2 + L22 * i2, L11 * r2 + L12 * r1 + L21 * i2 + L22 * i1],
        [-L11 * i1 + L21 * r1, -L12 * i2 + L22 * r2, -L11 * i2 - L12 * i1 + L21 * r2 + L22 * r1],
    )
    B = columns([r1, r2, i1, i2], [-i1, -i2, r1, r2])
    return B_L0, B_L1, B


def test_sum_of_the_papers_matrices_is_the_autodiff_tangent(state, matrices):
    model, gel, x = state
    hessian = jax.jit(jax.hessian(lambda x: scheme_energy(x, model.cells, gel, MU)))(x).reshape((x.size,) * 2)
    K_L0, K_L1, K_NL, _ = matrices
    np.testing.assert_allclose(K_L0 + K_L1 + K_NL, hessian, rtol=0, atol=1e-9 * np.abs(hessian).max())
    for part in (K_L0, K_L1, K_NL):  # each is symmetric, and large enough for the comparison to see it
        np.testing.assert_allclose(part, part.T, atol=1e-12 * np.abs(hessian).max())
        assert np.abs(part).max() > 1e-5 * np.abs(hessian).max()


def test_the_papers_internal_force_is_the_autodiff_residual(state, matrices):
    model, gel, x = state
    force = np.asarray(jax.jit(jax.grad(scheme_energy))(x, model.cells, gel, MU)).ravel()
    f_2 = matrices[3]
    np.testing.assert_allclose(f_2, force, atol=1e-10 * np.abs(force).max())
    free = model.free
    assert np.abs(f_2[free]).max() < 1e-8 * np.abs(f_2).max()  # equilibrium; the rest are the walls' reactions


def test_the_papers_equation_makes_a_newton_step(state, matrices):
    """Eq. (45) from a disturbed state returns to equilibrium with the square of the disturbance."""
    model, gel, x = state
    free = model.free
    K = sum(matrices[:3])[np.ix_(free, free)]
    away = np.zeros(x.size)
    away[free] = 1e-5 * np.random.default_rng(0).normal(size=len(free))
    force = np.asarray(jax.jit(jax.grad(scheme_energy))(x + away.reshape(x.shape), model.cells, gel, MU)).ravel()[free]
    correction = np.linalg.solve(K, -force)
    assert np.linalg.norm(correction + away[free]) < 1e-2 * np.linalg.norm(away)
