"""Fields of a state on the triangles of its cloud, for figures and files."""

import numpy as np
import scipy.sparse

from .._types import Float
from .._validation import one_of
from ..continuation import Path
from .fields import deformed_vertices, volume_ratio
from .solvent import solvent_potential
from .states import of_path

FIELDS = {
    "J": "volume ratio $J$",
    "stretch": "largest principal stretch",
    "mu": r"chemical potential $\mu$ ($kT$)",
}
"""Fields that figures fill the gel with, and their labels."""


@of_path
def field_values(path: Path, field: str) -> Float[np.ndarray, "k t"]:
    """Values (k, t) of a field of ``FIELDS`` on triangles, constant in cells.

    ValueError for another name. "J" is `observables.volume_ratio`, "mu"
    `observables.solvent_potential`; "stretch" follows from the deformation gradient between the
    vertices, averaged over the dry volume of a cell.
    """
    return field_on_triangles(path, np.asarray(deformed_vertices(path)), field)


@of_path
def field_on_triangles(
    path: Path, vertices: Float[np.ndarray, "k v 2"], field: str
) -> Float[np.ndarray, "k t"]:
    """Values (k, t) of a field, with the deformed vertices (k, v, 2) at hand."""
    one_of("field", field, FIELDS)
    triangles, cells = (
        np.asarray(path.model.cloud.triangles),
        np.asarray(path.model.cloud.cell_of_triangle),
    )
    if field in ("J", "mu"):
        return np.asarray(volume_ratio(path) if field == "J" else solvent_potential(path))[:, cells]
    dry = _edges(np.asarray(path.model.cloud.vertices)[triangles])
    F = _edges(vertices[:, triangles]) @ np.linalg.inv(dry)
    volume = np.linalg.det(dry)
    average = scipy.sparse.csr_array(
        (volume, (cells, np.arange(len(cells)))), shape=(cells.max() + 1, len(cells))
    )
    average = average / average.sum(axis=1)[:, None]
    F = np.stack([(average @ state.reshape(-1, 4)).reshape(-1, 2, 2) for state in F])
    return np.linalg.svd(F, compute_uv=False)[..., 0][:, cells]


def _edges(corners: Float[np.ndarray, "*b 3 2"]) -> Float[np.ndarray, "*b 2 2"]:
    """Two edge vectors as columns (..., 2, 2) of triangles (..., 3, 2)."""
    return np.stack(
        [corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]], axis=-1
    )
