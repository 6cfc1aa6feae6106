"""Matrices of the paper's scheme."""

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from .._types import Array, Float
from ..linalg import SingularTangent
from .scheme import Cells


def assembled(matrices: Float[Array, "c A A"], cells: Cells, n_nodes: int) -> sp.csr_array:
    """The sum (N, N), N = 2 ``n_nodes``, of the cells' matrices, A = 2 a."""
    dofs = (
        2 * np.asarray(cells.nodes, dtype=np.int32)[:, :, None] + np.arange(2, dtype=np.int32)
    ).reshape(len(cells.nodes), -1)
    pairs = (
        np.broadcast_to(part, matrices.shape).ravel()
        for part in (dofs[:, :, None], dofs[:, None, :])
    )
    return sp.coo_array(
        (np.asarray(matrices).ravel(), tuple(pairs)), (2 * n_nodes, 2 * n_nodes)
    ).tocsr()


def solved(matrix: sp.csr_array, right: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
    """Solution of a linear system; raises `linalg.SingularTangent`."""
    try:
        return sla.splu(matrix.tocsc()).solve(right)
    except RuntimeError as error:
        raise SingularTangent(str(error)) from error


def negative_eigenvalues(matrix: sp.csr_array) -> int:
    """Number of negative eigenvalues of a symmetric matrix from blocks of its dense LDL^T."""
    blocks = scipy.linalg.ldl(matrix.toarray())[1]
    return int(
        np.sum(scipy.linalg.eigvalsh_tridiagonal(np.diagonal(blocks), np.diagonal(blocks, 1)) < 0)
    )
