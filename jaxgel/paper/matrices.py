"""Dense matrices of the paper's scheme."""

import numpy as np
import scipy.linalg

from .._types import Array, Float
from ..linalg import SingularTangent
from .scheme import Cells

CHUNK = 256  # cells whose matrices are added up together


def assembled(matrices: Float[Array, "c A A"], cells: Cells, n_nodes: int) -> Float[np.ndarray, "N N"]:
    """The sum (N, N), N = 2 ``n_nodes``, of the cells' matrices, A = 2 a."""
    size = 2 * n_nodes
    total = np.zeros(size * size)
    dofs = (2 * np.asarray(cells.nodes)[:, :, None] + np.arange(2)).reshape(len(cells.nodes), -1)
    for k in range(0, len(dofs), CHUNK):
        part = dofs[k : k + CHUNK]
        indices = (part[:, :, None] * size + part[:, None, :]).ravel()
        total += np.bincount(indices, np.asarray(matrices[k : k + CHUNK]).ravel(), minlength=size * size)
    return total.reshape(size, size)


def solved(matrix: Float[np.ndarray, "f f"], right: Float[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
    """Solution of a linear system; raises `linalg.SingularTangent`."""
    try:
        return np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError as error:
        raise SingularTangent(str(error)) from error


def negative_eigenvalues(matrix: Float[np.ndarray, "f f"]) -> int:
    """Number of negative eigenvalues of a symmetric matrix, from the blocks of its LDL^T."""
    blocks = scipy.linalg.ldl(matrix)[1]
    return int(np.sum(scipy.linalg.eigvalsh_tridiagonal(np.diagonal(blocks), np.diagonal(blocks, 1)) < 0))
