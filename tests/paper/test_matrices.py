"""Discrete equations of Deng et al. (2020), Eqs. (45)-(56), against energy derivatives.

The state is a converged one of the paper's scheme (J at every Gauss point) on a small plate with a
hole. The paper's matrices live in the freely swollen reference C_mu: coordinates l_mu X,
displacements u' = x - l_mu X, weights times J_mu.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.paper import equilibria, scheme_energy
from jaxgel.paper.increments import cell_matrices
from jaxgel.paper.matrices import assembled

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
    """K_L0 + K_L1 + K_NL, Eqs. (47)-(49), and f_2, Eq. (51)."""
    scheme, gel, x = state
    stretch = float(jaxgel.free_swelling(MU, gel))
    K, f_2, _ = cell_matrices(x - stretch * scheme.cloud.nodes, stretch, MU, scheme.cells, gel)
    return assembled(K, scheme.cells, len(x)).toarray(), np.asarray(f_2).ravel()


def test_sum_of_the_papers_matrices_is_the_autodiff_tangent(state, matrices):
    scheme, gel, x = state
    hessian = jax.jit(jax.hessian(lambda x: scheme_energy(x, scheme.cells, gel, MU)))(x).reshape(
        (x.size,) * 2
    )
    np.testing.assert_allclose(matrices[0], hessian, rtol=0, atol=1e-9 * np.abs(hessian).max())


def test_the_papers_internal_force_is_the_autodiff_residual(state, matrices):
    scheme, gel, x = state
    force, f_2 = (
        np.asarray(jax.jit(jax.grad(scheme_energy))(x, scheme.cells, gel, MU)).ravel(),
        matrices[1],
    )
    np.testing.assert_allclose(f_2, force, atol=1e-10 * np.abs(force).max())
    # equilibrium; the rest are the walls' reactions
    assert np.abs(f_2[scheme.free]).max() < 1e-8 * np.abs(f_2).max()


def test_the_papers_equation_makes_a_newton_step(state, matrices):
    """Eq. (45) from a disturbed state returns to equilibrium with the square of the disturbance."""
    scheme, gel, x = state
    free = scheme.free
    away = np.zeros(x.size)
    away[free] = 1e-5 * np.random.default_rng(0).normal(size=len(free))
    force = np.asarray(
        jax.jit(jax.grad(scheme_energy))(x + away.reshape(x.shape), scheme.cells, gel, MU)
    ).ravel()[free]
    correction = np.linalg.solve(matrices[0][np.ix_(free, free)], -force)
    assert np.linalg.norm(correction + away[free]) < 1e-2 * np.linalg.norm(away)
