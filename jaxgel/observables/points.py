"""Displacements of material points, and the deformed gel as a mesh of triangles."""

from collections.abc import Sequence

import numpy as np

from .._tracing import is_traced
from .._types import Array, Float, Int
from ..discretisation import Model, make_probe
from ..geometry import inside_holes
from .fields import deformed_vertices
from .states import States, of_path, positions_of

Points = Float[Array, "p 2"] | Sequence[Sequence[float]]


@of_path
def displacement_at(path: States, points: Points) -> Float[Array, "k p 2"]:
    """Displacements (k, p, 2), mm, of material points of the dry gel in every state of a path.

    Arguments:

    - `path`: the path, k states.
    - `points` (p, 2), mm: places of the points in the dry gel, numbers; on edges and outlines, too.

    Returns the displacement by the shape functions, differentiable in all that the path depends on.

    Raises `ValueError` for a point in a hole or outside the plate.

    >>> import jaxgel
    >>> plate = jaxgel.Plate(1, 1, edges={"top": "free"}, spacing=0.25)  # the bottom is at -0.5
    >>> model = jaxgel.discretise(jaxgel.make_cloud(plate))
    >>> path = jaxgel.sweep(jaxgel.Problem(model, jaxgel.Gel(1e-3, 0.1)), [-3.0, -1.0])
    >>> displacement_at(path, [[0.0, 0.5], [0.2, 0.0]])[-1, :, 1].round(3).tolist()
    [0.17, 0.085]
    """
    points = points_in_gel(path.model, points)
    return positions_of(make_probe(path.model, points), path) - points


@of_path
def deformed_mesh(
    path: States, state: int = -1
) -> tuple[Float[np.ndarray, "v 2"], Int[np.ndarray, "t 3"]]:
    """Vertices (v, 2), mm, of the deformed gel in one state, and triangles (t, 3).

    The triangles are numbers of vertices. The triangles are those of the integration cells,
    anticlockwise; NumPy. For instance ``meshio.Mesh(points, {"triangle": triangles})``.
    """
    used, triangles = np.unique(np.asarray(path.model.cloud.triangles), return_inverse=True)
    return np.asarray(deformed_vertices(path[[state]]))[0, used], triangles.reshape(-1, 3)


def points_in_gel(model: Model, points: Points) -> Float[np.ndarray, "p 2"]:
    """The points as numbers; ValueError, one line, for one outside the dry gel."""
    if is_traced(points):
        raise ValueError("points: are traced; give numbers")
    points, plate = np.asarray(points, dtype=float), model.lists.topology.plate
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise ValueError(
            f"points: an array of shape {points.shape}, it must be (p, 2) finite numbers"
        )
    rounding = 1e-9 * model.lists.topology.spacing
    beyond = (np.abs(points) > np.array([plate.width, plate.height]) / 2 + rounding).any(
        axis=1
    ) | inside_holes(plate, points, -rounding)
    if beyond.any():
        x, y = points[np.argmax(beyond)]
        raise ValueError(f"points: ({x:.4g}, {y:.4g}) is not in the dry gel")
    return points
