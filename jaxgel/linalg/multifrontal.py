"""Multifrontal factors of sparse symmetric matrices: nested dissection, dense LAPACK.

A meshless node is coupled to all others within some spacings, so the fronts are large and dense
arithmetic wins: on the paper's samples a factor costs about a third of SuperLU's
(benchmarks/kernels.py). The method is that of Duff and Reid (1983) with the dissection of George
(1973). A front's pivot block is factorised by Cholesky if it is positive definite and by its
eigenvectors if it is not; either way the signs of the pivots give the inertia (Sylvester). There is
no exchange of pivots between fronts: a front that is singular by itself raises, and round-off that
grew shows in the residual of the solution.
"""

import dataclasses
import functools

import numpy as np
import scipy.linalg
from scipy.linalg.blas import dsyrk, dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf, dtrtri

from .._types import Array, Float
from .dissection import Tree


@dataclasses.dataclass(frozen=True, eq=False)
class Fronts:
    """Numbers of a factor, K = sum over fronts of [L; B] S [L; B]^T."""

    tree: Tree
    """Its fronts."""
    numbers: Float[np.ndarray, " fill"]
    """(tree.fill,) all that the corners and sides hold: one piece of memory, given back at once."""
    corners: list[np.ndarray]
    """Per front L (k, k) lower triangular, or the inverse transpose of an indefinite block's L.

    That L is full.
    """
    sides: list[np.ndarray]
    """Per front B (m, k)."""
    signs: list[np.ndarray | None]
    """Per front the signs (k,) S of the pivots; None if all are positive and L is triangular."""

    @property
    def negative_pivots(self) -> int:
        """Number of negative eigenvalues of the matrix."""
        return sum(int(np.sum(signs < 0)) for signs in self.signs if signs is not None)

    @property
    def size(self) -> int:
        """Bytes it fills."""
        return self.numbers.nbytes

    @functools.cached_property
    def _steps(self):
        """Per front its pivots, the unknowns below, L, B and S, for `solve`.

        That is called many times and takes little time.
        """
        numbers = zip(self.tree.fronts, self.corners, self.sides, self.signs, strict=True)
        return [(slice(front.first, front.end), front.below, *own) for front, *own in numbers]

    def solve(
        self, rhs: Float[Array, " f"] | Float[Array, "f r"]
    ) -> Float[np.ndarray, " f"] | Float[np.ndarray, "f r"]:
        """Solution (f,) or (f, r), without refinement."""
        y = np.asarray(rhs, dtype=float)[self.tree.order]
        # one vector: BLAS of level 2, which takes three quarters of the time
        y = y.ravel() if y.size == len(y) else y

        def triangular(L, z, transposed=0):
            if not len(z):  # a front whose nodes are all held
                return z
            return (
                dtrsv(L, z, lower=1, trans=transposed, overwrite_x=1)
                if z.ndim == 1
                else dtrsm(1.0, L, z, lower=1, trans_a=transposed)
            )

        for pivots, below, L, B, signs in self._steps:
            z = y[pivots] = (
                triangular(L, y[pivots]) if signs is None else (signs * (L.T @ y[pivots]).T).T
            )
            y[below] -= B.dot(z)
        for pivots, below, L, B, signs in reversed(self._steps):
            z = B.T.dot(y.take(below, axis=0))
            z = y[pivots] - (z if signs is None else (signs * z.T).T)
            y[pivots] = triangular(L, z, transposed=1) if signs is None else L @ z
        solution = np.empty(y.shape)
        solution[self.tree.order] = y
        return solution.reshape(np.shape(rhs))


def factorise(tree: Tree, values: Float[Array, "..."]) -> Fronts:
    """``Fronts`` of the matrix whose entries are ``values`` (s,), finite.

    LinAlgError if the pivot block of a front is singular. A pivot of round-off passes: next to a
    fold or bifurcation one is that small. `Factor.solve` finds a singular matrix by its residual.
    """
    values, numbers, used = np.ravel(values), np.empty(tree.fill), 0
    corners, sides, signs, updates = [], [], [], {}
    for number, front in enumerate(tree.fronts):
        corner, side, update = _assembled(front, values, updates)
        L, status = dpotrf(corner, lower=1, clean=0)
        if status == 0:
            positive, B = (
                None,
                dtrsm(1.0, L, side, side=1, lower=1, trans_a=1, overwrite_b=1)
                if len(side)
                else side,
            )
            update = (
                dsyrk(-1.0, B, beta=1.0, c=update, lower=1, overwrite_c=1) if len(side) else update
            )
        else:
            positive, L = _signed(corner, front.positive)
            B = side @ L
            update -= (B * positive) @ B.T
        updates[number] = update
        for block, kept in ((L, corners), (B, sides)):
            kept.append(numbers[used : used + block.size].reshape(block.shape, order="F"))
            kept[-1][:] = block
            used += block.size
        signs.append(positive)
    return Fronts(tree, numbers, corners, sides, signs)


def _signed(corner, positive):
    """Signs (k,) S and L (k, k): L S L^T is the inverse of a pivot block.

    The lower triangle of that is given. By Cholesky twice if the first ``positive`` pivots are
    positive and the others negative, otherwise by the eigenvectors.
    """
    if positive < len(corner):
        upper, side = corner[:positive, :positive], corner[positive:, :positive]
        first, failed = dpotrf(upper, lower=1, clean=1) if positive else (upper, 0)
        if not failed:
            B = dtrsm(1.0, first, side, side=1, lower=1, trans_a=1) if positive else side
            second, failed = dpotrf(B @ B.T - corner[positive:, positive:], lower=1, clean=1)
        if not failed:
            signs = np.where(np.arange(len(corner)) < positive, 1.0, -1.0)
            L = np.zeros(corner.shape, order="F")
            L[:positive, :positive], L[positive:, :positive], L[positive:, positive:] = (
                first,
                B,
                second,
            )
            return signs, dtrtri(L, lower=1)[0].T
    pivots, vectors = scipy.linalg.eigh(corner, lower=True, check_finite=False)
    if not np.all(np.abs(pivots) > np.finfo(float).tiny):
        raise np.linalg.LinAlgError("a pivot vanishes")
    return np.sign(pivots), vectors / np.sqrt(np.abs(pivots))


def _assembled(front, values, updates):
    """Pivot block (k, k), block (m, k) below and update (m, m) of a front; lower triangles.

    They are made of matrix entries and its children's updates.
    """
    k, m = front.end - front.first, len(front.below)
    corner, side, update = (np.zeros(shape, order="F") for shape in ((k, k), (m, k), (m, m)))
    for block, (source, place) in ((corner, front.corner), (side, front.side)):
        # a view: the block is contiguous by columns
        block.reshape(-1, order="F")[place] = values[source]
    for child, pivots, rows in front.children:
        below = updates.pop(child)
        blocks = {(0, 0): corner, (1, 0): side, (1, 1): update}
        for (i, j), block in blocks.items():
            part = below[
                pivots * i : len(below) if i else pivots, pivots * j : len(below) if j else pivots
            ]
            for from_column, to_column in rows[j]:
                for from_row, to_row in rows[i]:
                    block[to_row, to_column] += part[from_row, from_column]
    return corner, side, update
