"""Facts about factors inside compiled programs: those of the host's fronts."""

import jax
import numpy as np
import pytest

import jaxgel
from jaxgel.linalg import elimination_of, factor, is_definite
from jaxgel.mechanics import pair_product

RANDOM = np.random.default_rng(11)


@pytest.fixture(scope="module", params=["held", "periodic"])
def system(request, coarse_model):
    """A problem and node-pair blocks (p, 2, 2) of a positive definite matrix, two kinds.

    Of one with several fronts, and of one whose nodes move together.
    """
    if request.param == "periodic":
        edges = dict.fromkeys(("left", "right", "top", "bottom"), "periodic")
        plate = jaxgel.Plate(8.0, 8.0, [jaxgel.Circle((4.0, 4.0), 1.5)], edges=edges)
        coarse_model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=1.0))
    problem = jaxgel.Problem(coarse_model, jaxgel.Gel(Nv=1e-3, chi=0.1), contact=False).prepared
    pairs = np.asarray(problem.operators.pairs)[: problem.pattern.n_pairs]
    network = problem.network[:, None, None] * np.eye(2)
    return (
        problem,
        pairs,
        network
        + 1e-5 * (pairs[:, 0] == pairs[:, 1])[:, None, None] * np.array([[2.0, 1.0], [1.0, 3.0]]),
    )


def test_a_solution_is_that_of_the_hosts_factor(system):
    problem, _, blocks = system
    elimination, rhs = elimination_of(problem.pattern), RANDOM.normal(size=problem.pattern.size)

    @jax.jit
    def solved(elimination, blocks, rhs):
        factors = elimination.cholesky(blocks)
        return elimination.solve(factors, rhs), is_definite(factors)

    solution, definite = solved(elimination, blocks, rhs)
    expected = factor(problem.pattern, blocks).accurate(rhs)
    assert definite and (problem.pattern.joined is not None or len(elimination.fronts) > 5)
    np.testing.assert_allclose(solution, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    blocks[len(blocks) // 2] -= 1.0  # far from definite
    assert (
        factor(problem.pattern, blocks).negative_pivots > 0
        and not solved(elimination, blocks, rhs)[1]
    )


def test_products_with_pair_blocks_are_those_of_the_matrix(coarse_model):
    problem = jaxgel.Problem(coarse_model, jaxgel.Gel(Nv=1e-3, chi=0.1), contact=False).prepared
    pairs = np.asarray(problem.operators.pairs)[: problem.pattern.n_pairs]
    blocks = RANDOM.normal(size=(len(pairs), 2, 2))
    same = pairs[:, 0] == pairs[:, 1]
    blocks[same] += blocks[same].transpose(0, 2, 1)
    v = RANDOM.normal(size=(problem.model.n_nodes, 2))
    free = problem.free.masters
    v.ravel()[np.setdiff1d(np.arange(v.size), free)] = 0.0
    expected = problem.pattern.matrix(blocks) @ v.ravel()[free]
    np.testing.assert_allclose(
        np.asarray(pair_product(blocks, pairs, v)).ravel()[free], expected, rtol=0, atol=1e-12
    )
