"""Fronts: the tree covers every unknown once; the factor is dense algebra's."""

import numpy as np
import pytest
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from jaxgel.linalg import dissect, factorise
from jaxgel.mechanics import free_dofs, node_pairs


@pytest.fixture(scope="module")
def system(coarse_model):
    """Pairs, unknowns, points and tree of 321 nodes with holes: several levels of fronts."""
    topology = coarse_model.lists.topology
    points, free = topology.partition.vertices[topology.node_vertices], free_dofs(topology).masters
    unknowns = np.full(2 * len(points), -1)
    unknowns[free] = np.arange(len(free))
    pairs = node_pairs(coarse_model.lists)[0]
    return pairs, unknowns.reshape(-1, 2), points, dissect(pairs, unknowns.reshape(-1, 2), points)


def values(system, seed, shift):
    """Blocks (p, 2, 2) of a random symmetric matrix that decays, plus ``shift`` on the diagonal.

    Its entries fall with distance.
    """
    pairs, _, points, _ = system
    far = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    blocks = (
        np.random.default_rng(seed).normal(size=(len(pairs), 2, 2)) * np.exp(-far)[:, None, None]
    )
    same = pairs[:, 0] == pairs[:, 1]
    blocks[same] = blocks[same] + blocks[same].transpose(0, 2, 1) + shift * np.eye(2)
    return blocks


def dense(system, blocks):
    pairs, unknowns, _, tree = system
    K = np.zeros((len(tree.order),) * 2)
    for i, j in np.ndindex(2, 2):
        row, column = unknowns[pairs[:, 0], i], unknowns[pairs[:, 1], j]
        kept = (row >= 0) & (column >= 0)
        K[row[kept], column[kept]] = K[column[kept], row[kept]] = blocks[kept, i, j]
    return K


def test_every_unknown_is_the_pivot_of_one_front(system):
    _, unknowns, _, tree = system
    assert len(tree.fronts) > 5
    assert sorted(tree.order) == list(range(np.sum(unknowns >= 0)))
    assert [front.first for front in tree.fronts] == [0, *(front.end for front in tree.fronts[:-1])]
    children = [child for front in tree.fronts for child, _, _ in front.children]
    # each has one parent, after it; the last is the root
    assert sorted(children) == list(range(len(tree.fronts) - 1))
    assert all(
        child < number for number, front in enumerate(tree.fronts) for child, _, _ in front.children
    )
    assert tree.fronts[-1].below.size == 0


@pytest.mark.parametrize(
    "shift",
    [
        pytest.param(0.0, marks=pytest.mark.slow),
        2.0,
        pytest.param(5.0, marks=pytest.mark.slow),
        20.0,
    ],
)
def test_solutions_and_inertia_are_those_of_the_dense_matrix(shift, system):
    """From half of the eigenvalues negative to none."""
    blocks = values(system, 3, shift)
    K = dense(system, blocks)
    made = factorise(system[-1], blocks)
    eigenvalues = np.linalg.eigvalsh(K)
    assert made.negative_pivots == np.sum(eigenvalues < 0)
    rhs = np.random.default_rng(4).normal(size=(len(K), 2))
    solution = made.solve(rhs)
    # pivots stay within their front, so round-off may grow: 1e-9 of |K| |x| leaves four digits to
    # the backward error that is asked for
    assert np.linalg.norm(K @ solution - rhs) < (1e-14 if shift == 20 else 1e-9) * np.abs(
        eigenvalues
    ).max() * np.linalg.norm(solution)
    np.testing.assert_array_equal(made.solve(rhs[:, 0]), made.solve(rhs[:, :1])[:, 0])


@pytest.mark.parametrize("columns", [None, 2])
def test_a_front_may_have_no_unknowns(columns, system):
    """Where the nodes of a cut are all held, as along a wall."""
    pairs, unknowns, points, tree = system
    held = tree.order[tree.fronts[-1].first :]
    rest = np.where(np.isin(unknowns, held), -1, unknowns)
    rest[rest >= 0] = np.argsort(np.argsort(rest[rest >= 0]))
    without = pairs, rest, points, dissect(pairs, rest, points)
    assert any(front.first == front.end for front in without[-1].fronts)
    blocks = values(without, 3, 20.0)
    K, rhs = (
        dense(without, blocks),
        np.ones(np.sum(rest >= 0) if columns is None else (np.sum(rest >= 0), columns)),
    )
    np.testing.assert_allclose(K @ factorise(without[-1], blocks).solve(rhs), rhs, atol=1e-12)


def test_both_kinds_of_pivot_blocks_are_met(system):
    signs = factorise(system[-1], values(system, 3, 6.0)).signs
    assert any(s is None for s in signs) and any(s is not None for s in signs)
    assert all(s is None for s in factorise(system[-1], values(system, 3, 20.0)).signs)


def test_factor_fills_less_than_that_of_a_minimum_degree_order(system):
    """SuperLU's, both triangles of which it keeps."""
    blocks = values(system, 3, 20.0)
    other = splu(
        csc_matrix(dense(system, blocks)),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options=dict(SymmetricMode=True),
    )
    assert factorise(system[-1], blocks).size < 8 * other.nnz


def test_singular_front_raises(system):
    with pytest.raises(np.linalg.LinAlgError, match="a pivot vanishes"):
        factorise(system[-1], np.zeros_like(values(system, 0, 0.0)))
