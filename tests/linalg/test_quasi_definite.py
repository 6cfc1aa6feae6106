"""Factors of symmetric quasi-definite matrices: both signs of pivots in one front."""

import numpy as np

from jaxgel.linalg import analyse, factor


def test_a_saddle_point_matrix_has_as_many_negative_pivots_as_late_nodes(monkeypatch):
    """[[K, -B^T], [-B, -C]] on a graph along a line: dense solution, inertia of the blocks."""
    monkeypatch.setattr("scipy.linalg.eigh", None)  # Cholesky's method does
    random, n, late = np.random.default_rng(5), 160, 100
    points = random.uniform(size=(n, 2)) * [8.0, 1.0]
    near = np.abs(points[:, None, 0] - points[None, :, 0]) < 0.5
    i, j = np.nonzero(np.triu(near))
    blocks = random.normal(size=(len(i), 2, 2))
    same = i == j
    blocks[same] = (blocks[same] + blocks[same].swapaxes(1, 2)) / 2 + 80 * np.eye(2) * np.where(
        i[same] < late, 1.0, -1.0
    )[:, None, None]
    dense = np.zeros((2 * n, 2 * n))
    for a, b, block in zip(i, j, blocks, strict=True):
        dense[2 * a : 2 * a + 2, 2 * b : 2 * b + 2] = block
        dense[2 * b : 2 * b + 2, 2 * a : 2 * a + 2] = block.T
    made = factor(analyse(np.stack([i, j], axis=1), points, np.arange(2 * n), late=late), blocks)
    rhs = random.normal(size=2 * n)
    assert made.negative_pivots == 2 * (n - late) == int(np.sum(np.linalg.eigvalsh(dense) < 0))
    assert np.abs(made.solve(rhs)[0] - np.linalg.solve(dense, rhs)).max() < 1e-12
