"""Edges of triangles: look-up by vertex numbers, and contours. Host NumPy."""

import numpy as np

from .._types import Int


def find_rows(
    rows: Int[np.ndarray, "r k"], wanted: Int[np.ndarray, "w k"]
) -> Int[np.ndarray, " w"]:
    """Which of the different ``rows``, numbers >= 0, each ``wanted`` one is; -1 for none."""
    size = np.concatenate([rows, wanted]).max(axis=0) + 1
    key, wanted_key = (np.ravel_multi_index(tuple(part.T), tuple(size)) for part in (rows, wanted))
    order = np.argsort(key)
    at = order[np.minimum(np.searchsorted(key, wanted_key, sorter=order), len(key) - 1)]
    return np.where(key[at] == wanted_key, at, -1)


def opposite_edges(
    edges: Int[np.ndarray, "e 2"], owner: Int[np.ndarray, " e"] | int = 0
) -> Int[np.ndarray, " e"]:
    """The reverse of each of the directed ``edges`` with the same ``owner``; -1 for none."""
    first, last = edges.T
    owner = np.broadcast_to(owner, first.shape)
    return find_rows(np.stack([owner, first, last], axis=1), np.stack([owner, last, first], axis=1))


def contour_edges(
    triangles: Int[np.ndarray, "t 3"], owner: Int[np.ndarray, " t"]
) -> tuple[np.ndarray, np.ndarray]:
    """Directed contour edges (e, 2) of all owners of triangles, gel on the left; owners (e,)."""
    edges, owners = (
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]),
        np.tile(owner, 3),
    )
    outer = opposite_edges(edges, owners) < 0
    order = np.argsort(owners[outer], kind="stable")
    return edges[outer][order], owners[outer][order]


def boundary_edges(triangles: Int[np.ndarray, "t 3"]) -> Int[np.ndarray, "e 2"]:
    """Edges that belong to one triangle only, in ascending order."""
    edges, _ = contour_edges(triangles, np.zeros(len(triangles), dtype=int))
    return np.unique(np.sort(edges, axis=1), axis=0)
