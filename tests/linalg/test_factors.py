"""Sparse symmetric systems in a small model's pattern, against dense linear algebra."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from jaxgel import Gel, Gent, Problem
from jaxgel.linalg import Bordered, FactorCache, SingularTangent, analyse, factor
from jaxgel.mechanics import free_dofs, node_pairs


@pytest.fixture(scope="module")
def lists(tiny_model):
    return tiny_model.lists


@pytest.fixture(scope="module")
def pattern(lists):
    """Of the free degrees of freedom; an own one, so that it remembers only what is done here."""
    return analyse(*arguments(lists))


def arguments(lists):
    return (
        node_pairs(lists)[0],
        lists.topology.partition.vertices[lists.topology.node_vertices],
        free_dofs(lists.topology).masters,
    )


def random_pairs(pattern, seed, shift=0.0):
    """Blocks (p, 2, 2) of a random symmetric matrix, indefinite unless shifted."""
    random = np.random.default_rng(seed)
    blocks = random.normal(size=(pattern.n_pairs, 2, 2))
    return symmetric(pattern, blocks) + shift * diagonal(pattern)


def symmetric(pattern, blocks):
    on_diagonal = diagonal(pattern).any(axis=(1, 2))
    return np.where(on_diagonal[:, None, None], blocks + blocks.transpose(0, 2, 1), blocks)


def diagonal(pattern):
    """Blocks of the unit matrix: the pairs (i, i)."""
    blocks = np.zeros((pattern.n_pairs, 2, 2))
    blocks[pattern.source[pattern.structure.indices == columns(pattern)] // 4] = np.eye(2)
    return blocks


def columns(pattern):
    """Column (nnz,) of each stored matrix entry."""
    return np.repeat(np.arange(len(pattern.free)), np.diff(pattern.structure.indptr))


def dense(pattern, pairs):
    """The matrix (f, f) in the order of the free degrees of freedom."""
    return pattern.matrix(pairs).toarray()


def test_pattern_puts_every_block_in_its_place(lists, pattern):
    pairs, n = node_pairs(lists)[0], len(lists.topology.node_vertices)
    blocks = random_pairs(pattern, 0)
    full = np.zeros((2 * n, 2 * n))
    for (i, j), block in zip(pairs, blocks, strict=True):
        full[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = block
        full[2 * j : 2 * j + 2, 2 * i : 2 * i + 2] = block.T
    np.testing.assert_array_equal(dense(pattern, blocks), full[np.ix_(pattern.free, pattern.free)])
    np.testing.assert_array_equal(dense(pattern, diagonal(pattern)), np.eye(len(pattern.free)))


def test_pairs_are_the_nodes_that_share_a_cell(lists):
    pairs = {tuple(pair) for pair in node_pairs(lists)[0]}
    expected = set()
    for nodes, support in zip(lists.nodes, lists.support, strict=True):
        real = nodes[support > 0]
        expected |= {(i, j) for i in real for j in real if i <= j}
    assert pairs == expected


@pytest.mark.parametrize("seed", range(30))
def test_inertia_and_solution_of_random_symmetric_matrices(seed, pattern):
    """From indefinite (no shift) to nearly definite ones.

    Without pivoting the refinement repairs the growth of round-off.
    """
    blocks = random_pairs(pattern, seed, shift=float(seed % 10) * 2)
    K = dense(pattern, blocks)
    made = factor(pattern, blocks)
    assert made.negative_pivots == np.sum(np.linalg.eigvalsh(K) < 0)
    rhs = np.random.default_rng(100 + seed).normal(size=len(K))
    solution, error = made.solve(rhs)
    assert error < 1e-8
    assert np.linalg.norm(K @ solution - rhs) < 1e-11 * np.linalg.norm(K, 2) * np.linalg.norm(
        solution
    )


def test_several_right_hand_sides_at_once(pattern):
    made = factor(pattern, random_pairs(pattern, 1, shift=30.0))
    rhs = np.random.default_rng(2).normal(size=(len(pattern.free), 3))
    together, _ = made.solve(rhs)
    np.testing.assert_allclose(
        together, np.stack([made.solve(b)[0] for b in rhs.T], axis=1), atol=1e-14
    )


def test_zero_right_hand_side_has_the_zero_solution(pattern):
    solution, error = factor(pattern, random_pairs(pattern, 3, shift=30.0)).solve(
        np.zeros(len(pattern.free))
    )
    assert error == 0.0
    assert np.all(solution == 0)


def at(number):
    """Positions by which a factor is remembered."""
    return np.full((2, 2), float(number))


def test_remembered_factors_fill_bounded_memory(pattern):
    blocks = random_pairs(pattern, 15, shift=30.0)
    size = factor(pattern, blocks).size
    cache, none = FactorCache(3.5 * size), FactorCache(0)
    for seed in range(6):
        made = factor(pattern, blocks + 1e-4 * random_pairs(pattern, seed))
        cache.add(made, pattern, (at(seed), Gel(1e-3, 0.2)))
        none.add(made, pattern, (at(seed), Gel(1e-3, 0.2)))
    assert [kept[2][0][0, 0] for kept in cache.contents()] == [3, 4, 5]
    assert [kept[2][0][0, 0] for kept in none.contents()] == [5]  # the latest stays, however large
    assert cache.find(pattern, (at(5), Gel(1e-3, 0.2))) is made
    gels = Gel(1e-3, 0.3), Gel(1e-3, 0.2, network=Gent(30.0))
    others = (object(), (at(5), Gel(1e-3, 0.2))), (pattern, (at(2), Gel(1e-3, 0.2)))
    others += tuple((pattern, (at(5), gel)) for gel in gels)
    assert all(cache.find(*other) is None for other in others)


def no_stiffness_along_one_component(pattern):
    blocks = random_pairs(pattern, 11, shift=30.0)
    touched = np.zeros(4 * pattern.n_pairs, dtype=bool)
    touched[pattern.source[(pattern.structure.indices == 7) | (columns(pattern) == 7)]] = True
    return np.where(touched.reshape(blocks.shape), 0.0, blocks)


def rank_one(pattern):
    """All entries equal: after one pivot nothing is left but round-off."""
    return np.ones((pattern.n_pairs, 2, 2))


@pytest.mark.parametrize(
    "make",
    [no_stiffness_along_one_component, lambda pattern: np.zeros((pattern.n_pairs, 2, 2)), rank_one],
)
def test_singular_matrices_are_detected(make, pattern):
    rhs = np.random.default_rng(12).normal(size=len(pattern.free))
    with pytest.raises(SingularTangent):
        factor(pattern, make(pattern)).solve(rhs)


@pytest.mark.parametrize("unit", [1e-120, 1 / 3, 1e120])
def test_a_singular_matrix_is_singular_in_every_unit(unit, pattern):
    """Pivots of round-off have the unit of the matrix."""
    rhs, blocks = np.random.default_rng(12).normal(size=len(pattern.free)), unit * rank_one(pattern)
    with pytest.raises(SingularTangent):
        factor(pattern, blocks).solve(rhs)


def test_a_bordered_matrix_is_solved(pattern):
    """Further rows and columns, which differ, about a tangent."""
    blocks, random = random_pairs(pattern, 50, 0.0), np.random.default_rng(51)
    rhs, lower = random.normal(size=len(pattern.free)), random.normal(size=1)
    side, row = random.normal(size=(2, len(rhs), 1))
    wider = np.block([[dense(pattern, blocks), side], [row.T, np.zeros((1, 1))]])
    found = np.concatenate(
        Bordered.of(factor(pattern, blocks), side, row, np.zeros((1, 1))).solve(rhs, lower)
    )
    wanted = np.linalg.solve(wider, np.append(rhs, lower))
    np.testing.assert_allclose(found, wanted, atol=1e-9 * np.abs(wanted).max())


def test_floating_plate_is_singular_or_answers_with_a_huge_translation(tiny_model):
    """The Laplacian of all nodes has translations in its kernel; a last pivot may be 1e-16."""
    pairs, points, _ = arguments(tiny_model.lists)
    every = analyse(pairs, points, np.arange(2 * tiny_model.n_nodes))
    laplacian = Problem(tiny_model, Gel(Nv=1.0)).network[:, None, None] * np.eye(2)
    try:
        solution, _ = factor(every, laplacian).solve(np.ones(2 * tiny_model.n_nodes))
    except SingularTangent:
        return
    assert np.abs(solution).min() > 1e12
    np.testing.assert_allclose(
        solution.reshape(-1, 2), np.broadcast_to(solution[:2], (tiny_model.n_nodes, 2)), rtol=1e-3
    )


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_matrices_that_are_not_finite_are_refused(value, pattern):
    blocks = random_pairs(pattern, 13, shift=30.0) + np.where(diagonal(pattern) > 0, value, 0.0)
    with pytest.raises(SingularTangent, match="the tangent is not finite"):
        factor(pattern, blocks)


def test_blas_threads_are_left_as_they_were(pattern):
    before = [pool["num_threads"] for pool in threadpool_info()]
    factor(pattern, random_pairs(pattern, 14, shift=30.0)).solve(np.ones(len(pattern.free)))
    assert [pool["num_threads"] for pool in threadpool_info()] == before
