"""Triangles of the pieces of gel that a partition consists of, the same for a piece and its images.

Host NumPy on the reference plate.
"""

import itertools

import numpy as np
import shapely
from scipy.spatial import cKDTree

from .._types import Float, Int
from .._validation import Inadmissible
from .edges import find_rows


def triangulate(
    vertices: Float[np.ndarray, "v 2"],
    loops: list[list[Int[np.ndarray, " _"]]],
    images: list[Int[np.ndarray, " v"]],
) -> tuple[Int[np.ndarray, "t 3"], Int[np.ndarray, " t"], Int[np.ndarray, "k 2"]]:
    """Triangles (t, 3) of every piece, anticlockwise, pieces (t,) and quadrilaterals (k, 2).

    A piece is a list of ``loops`` of vertex numbers, its outline first; ``images`` say for every
    symmetry where each vertex goes. Rectangles are halved, other pieces have constrained Delaunay
    triangles: those of one piece are taken to all its images.
    """
    plain = np.array([len(loop) == 1 and len(loop[0]) == 4 for loop in loops])
    corners = np.array(
        [loop[0] for loop, four in zip(loops, plain, strict=True) if four], dtype=int
    ).reshape(-1, 4)
    a, b, c, d = (vertices[corners[:, i]] for i in range(4))
    parallelogram = np.abs(a + c - b - d).sum(axis=1) < 1e-9 * np.abs(c - a).sum(axis=1)
    plain[plain] = parallelogram
    triangles, piece = (
        corners[parallelogram][:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3),
        np.repeat(np.flatnonzero(plain), 2),
    )
    pairs = np.arange(len(triangles)).reshape(-1, 2)
    if not plain.all():
        others = np.flatnonzero(~plain)
        found, owner, exchanged = _alike(vertices, [loops[i] for i in others], images)
        pairs = np.concatenate([pairs, len(triangles) + exchanged])
        triangles, piece = (
            np.concatenate([triangles, found]),
            np.concatenate([piece, others[owner]]),
        )
    order = np.argsort(piece, kind="stable")
    triangles, pairs = triangles[order], np.argsort(order)[pairs]
    negative = signed_areas(vertices, triangles) < 0
    triangles[negative] = triangles[negative][:, ::-1]
    return triangles, piece[order], pairs


def _alike(vertices, loops, images):
    """Triangles (t, 3), their pieces (t,) and quadrilaterals (k, 2), alike for images of a piece.

    Quadrilaterals are pairs of triangles.
    """
    source, by, mirrors = np.arange(len(loops)), np.full(len(loops), -1), [[] for _ in loops]
    pieces = {frozenset(np.concatenate(loop).tolist()): piece for piece, loop in enumerate(loops)}
    for own, piece in pieces.items():
        for number, image in enumerate(images if source[piece] == piece else ()):
            # none: round-off may cut a cell in other pieces than its images
            target = pieces.get(frozenset(image[list(own)].tolist()), -1)
            if target == piece:
                mirrors[piece].append(image)
            elif target > piece and source[target] == target:
                source[target], by[target] = piece, number
    first = np.flatnonzero(source == np.arange(len(loops)))
    found, owner = _constrained_delaunay(vertices, [loops[i] for i in first])
    own = {piece: found[owner == k] for k, piece in enumerate(first)}
    quadrilaterals = {piece: _exchanged(own[piece], mirrors[piece]) for piece in first}
    triangles = [own[s] if k < 0 else images[k][own[s]] for s, k in zip(source, by, strict=True)]
    counts = np.array([len(part) for part in triangles])
    pairs = [
        start + quadrilaterals[s]
        for start, s in zip(np.cumsum(counts) - counts, source, strict=True)
    ]
    return (
        np.concatenate(triangles),
        np.repeat(np.arange(len(loops)), counts),
        np.concatenate(pairs),
    )


def _exchanged(triangles, mirrors):
    """Pairs (k, 2) of a piece's triangles (t, 3) whose common edge a mirror image breaks.

    ``mirrors`` are images (v,) of the vertices.
    """
    pairs = set()
    for image in mirrors:
        lone = np.flatnonzero(find_rows(np.sort(triangles), np.sort(image[triangles])) < 0).tolist()
        for one, two in itertools.combinations(lone, 2):
            corners = set(triangles[one]) | set(triangles[two])
            if len(corners) == 4 and corners == set(image[list(corners)]):
                pairs.add((one, two))
    return np.array(sorted(pairs), dtype=int).reshape(-1, 2)


def _constrained_delaunay(vertices, loops):
    """Triangles (t, 3) of the pieces and their pieces (t,)."""
    polygons = [
        shapely.Polygon(vertices[loop[0]], [vertices[hole] for hole in loop[1:]]) for loop in loops
    ]
    try:
        parts, owner = shapely.get_parts(
            shapely.constrained_delaunay_triangles(np.array(polygons)), return_index=True
        )
    except shapely.errors.GEOSException as problem:
        raise Inadmissible(
            f"holes: a cell cut by their outlines has no triangles ({problem}); use less "
            "distorted holes"
        ) from problem
    used = np.unique(np.concatenate([ring for loop in loops for ring in loop]))
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    return used[cKDTree(vertices[used]).query(corners)[1]], owner


def signed_areas(
    vertices: Float[np.ndarray, "v 2"], triangles: Int[np.ndarray, "t 3"]
) -> Float[np.ndarray, " t"]:
    """Areas (t,) of triangles, positive if they run anticlockwise."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return 0.5 * (
        (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    )


def centroids(
    vertices: Float[np.ndarray, "v 2"],
    triangles: Int[np.ndarray, "t 3"],
    areas: Float[np.ndarray, " t"],
    owner: Int[np.ndarray, " t"],
) -> Float[np.ndarray, "c 2"]:
    """Centroids (c, 2) of what every owner has of the triangles with these ``areas``."""
    moments = [
        np.bincount(owner, areas * vertices[triangles][:, :, i].mean(axis=1)) for i in range(2)
    ]
    return np.stack(moments, axis=1) / np.bincount(owner, areas)[:, None]
