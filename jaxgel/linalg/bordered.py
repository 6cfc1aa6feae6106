"""LU factors of bordered matrices [[K, C], [R, D]]."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from .._types import Float, Int
from .factors import SingularTangent

PIVOTING = 1e-3  # a pivot below this share of its column's largest entry leaves the order of least fill


class Bordered:
    """Factor of [[K, sides], [rows^T, corner]] with the tangent K (f, f), eliminated in ``order`` where pivots allow; SingularTangent."""

    def __init__(
        self,
        order: Int[np.ndarray, " f"],
        matrix: sp.csc_matrix,
        sides: Float[np.ndarray, "f b"],
        rows: Float[np.ndarray, "f b"],
        corner: Float[np.ndarray, "b b"],
    ):
        self.order = order
        self.matrix = sp.block_array([[matrix[order][:, order], sides[order]], [rows[order].T, corner]], format="csc")
        try:
            self.lu = splu(self.matrix, permc_spec="NATURAL", diag_pivot_thresh=PIVOTING, options=dict(Equil=False))
        except RuntimeError as error:
            raise SingularTangent(str(error)) from error

    def solve(self, upper: np.ndarray, lower: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solution (f,) and (b,) for right-hand sides (f,) and (b,), refined twice."""
        rhs = np.concatenate([upper[self.order], lower])
        solution = self.lu.solve(rhs)
        for _ in range(2):
            solution += self.lu.solve(rhs - self.matrix @ solution)
        x = np.empty(len(upper))
        x[self.order] = solution[: len(upper)]
        return x, solution[len(upper) :]
