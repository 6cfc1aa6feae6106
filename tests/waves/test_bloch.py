"""Bloch waves against dense algebra, larger cells and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import jaxgel
from jaxgel import Problem
from jaxgel.continuation import lowest_eigenvalue
from jaxgel.mechanics import curvature
from jaxgel.waves import BlochStates

K = np.array([0.7, 0.3])
MU = -3.4


def waves_of(model, gel, mu=MU):
    return BlochStates(
        Problem(model, gel, contact=False).prepared,
        jaxgel.sweep(jaxgel.Problem(model, gel), [mu], symmetry="off")[0],
    )


@pytest.fixture(scope="module")
def waves(cell, gel):
    return waves_of(cell, gel)


def dense(waves, wave_vector):
    layout, entries = waves._entries(np.asarray(wave_vector, float))
    return [layout.matrix(part).toarray() for part in entries]


@pytest.mark.thorough
def test_matrices_are_hermitian_and_those_of_the_opposite_wave_the_conjugates(waves):
    for here, there in zip(dense(waves, K), dense(waves, -K), strict=True):
        assert np.abs(here - here.conj().T).max() < 1e-15
        np.testing.assert_allclose(there, here.conj(), atol=1e-15)
        again = dense(waves, K + [np.pi, -np.pi])[0]  # 2 pi over the side: the same wave
    np.testing.assert_allclose(again, dense(waves, K)[0], atol=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize("mu", [-3.4, -2.9], ids=["stable", "unstable"])
def test_lowest_eigenvalues_and_their_count_are_those_of_dense_matrices(cell, gel, mu):
    waves = BlochStates(
        Problem(cell, gel, contact=False).prepared,
        jaxgel.sweep(jaxgel.Problem(cell, gel), [-3.6, mu], branch="symmetric")[-1],
    )
    for wave_vector in (K, [np.pi / 2, np.pi / 2], [0.02, 0.0], [0.0, 0.0]):
        stiffness, network = dense(waves, wave_vector)
        values = scipy.linalg.eigh(stiffness, network, eigvals_only=True)
        found, fields = waves.lowest(np.array(wave_vector), 3)
        # round-off, large for long waves
        room = 1e-15 * np.linalg.norm(stiffness, 2) / np.linalg.eigvalsh(network)[0]
        np.testing.assert_allclose(found, values[:3], atol=1e-9 + room)
        assert waves.negative(np.array(wave_vector)) == np.sum(values < 0)
        assert fields.shape == (3, cell.n_nodes, 2)


@pytest.mark.thorough
def test_waves_that_are_the_same_in_all_cells_are_those_of_the_sweep(waves, cell, gel):
    path = jaxgel.sweep(jaxgel.Problem(cell, gel), [MU], symmetry="off")
    assert waves.lowest(np.zeros(2))[0][0] == pytest.approx(
        float(lowest_eigenvalue(path)[0]), rel=1e-8
    )


@pytest.mark.thorough
def test_a_larger_cell_has_the_waves_of_its_cells(waves):
    """The matrix of repeated 2 x 2 cells, made of K_R, has one cell's eigenvalues at four k."""
    layout, part = waves.layout, [waves.layout.matrix(part).toarray() for part in waves.stiffness]
    steps, b = np.round(layout.translations / 2).astype(int), layout.size
    whole = np.zeros((2, 2, b, 2, 2, b))
    for (i, j), block in zip(steps, part, strict=True):
        # `matrix` has added the conjugate of the other direction
        upper = np.triu(block) - 0.5 * np.diag(np.diag(block))
        for x in range(2):
            for y in range(2):
                whole[x, y, :, (x + i) % 2, (y + j) % 2] += upper
    whole = whole.reshape(4 * b, 4 * b)
    found = np.linalg.eigvalsh(whole + whole.T)
    four = [
        np.linalg.eigvalsh(dense(waves, np.pi / 2 * np.array(k) + 1e-9)[0])
        for k in ((0, 0), (0, 1), (1, 0), (1, 1))
    ]
    np.testing.assert_allclose(found, np.sort(np.concatenate(four)), atol=1e-7)


def test_a_wave_has_the_curvature_that_its_eigenvalue_says(waves):
    """v* K v of the nodal field in the cell, by products of its real and imaginary part."""
    (value,), (field,) = waves.lowest(K)
    problem, state = waves.problem, waves.state
    at = problem.model, problem.gel, state.mu, problem.loads
    total = sum(
        jax.jit(curvature)(jnp.asarray(state.x), jnp.asarray(v), *at)
        for v in (field.real, field.imag)
    )
    assert float(total) == pytest.approx(value, rel=1e-8)
    phase = np.exp(2j * K)  # of the right and the top edge, 2 mm away
    walls = problem.model.cloud.topology.edge_nodes
    for edge, opposite, factor in (("right", "left", phase[0]), ("top", "bottom", phase[1])):
        np.testing.assert_allclose(field[walls[edge]], factor * field[walls[opposite]], atol=1e-12)


@pytest.mark.slow
def test_plane_waves_of_a_solid_cell_are_those_of_the_acoustic_tensor(gel):
    """C_ijkl k_j k_l / (Nv k.k) has the eigenvalues 1 and the longitudinal one, at any length.

    The former are those of transverse waves.
    """
    stretch, mu, k = 1.3, -0.5, 0.75 * np.pi / 2 * np.array([1.0, 0.4])
    C = jax.hessian(lambda F: jaxgel.free_energy(F, mu, gel))(stretch * jnp.eye(2))
    transverse, longitudinal = np.linalg.eigvalsh(np.einsum("ijkl,j,l->ik", C, k, k)) / (
        gel.Nv * k @ k
    )
    plate = jaxgel.Plate(2, 2, edges="periodic", deformation=((stretch, 0), (0, stretch)))
    values = scipy.linalg.eigh(
        *dense(waves_of(jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.25)), gel, mu), k),
        eigvals_only=True,
    )
    # exact to the round-off of the volumetric stiffness, 859 times as large
    np.testing.assert_allclose(values[:3], transverse, rtol=1e-9)
    # 1.0e-3 is left at this spacing, 2.4e-2 at twice as much
    np.testing.assert_allclose(values[-3:], longitudinal, rtol=2e-3)
