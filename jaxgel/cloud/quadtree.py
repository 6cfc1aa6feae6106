"""Background grid of a cloud: a quadtree refined in narrow ligaments, with 2:1 neighbours.

Squares are the integration cells before they are clipped, their corners the background vertices.
Host NumPy on the reference plate.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import shapely

from .._types import Bool, Float, Int
from .._validation import Inadmissible
from ..geometry import Plate, periods
from .images import symmetries_of, translated

MAX_HALVINGS = 8  # of a background square
# squares of each size are at least two abreast, so that a support spans few sizes
REACH = range(-2, 3)
SAME = 1e-6  # of a side: distance of two strips' centres that are the same
_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


@dataclasses.dataclass(frozen=True, eq=False)
class Background:
    """Squares that cover the plate.

    Those of the ``k``-th halving are numbered row by row, 2^k times as many per side.
    """

    low: Float[np.ndarray, "2"]
    """Lower left corner of the plate, mm."""
    side: Float[np.ndarray, "2"]
    """Sides of a square that was not halved, mm."""
    counts: Int[np.ndarray, "2"]
    """Numbers of such squares along x and y."""
    halved: tuple[Int[np.ndarray, " _"], ...]
    """Per k the numbers, ascending, of the squares of the k-th halving that are halved again."""
    vertices: Float[np.ndarray, "b 2"]
    """Corners of all squares, mm."""
    loops: list[Int[np.ndarray, " _"]]
    """Vertex numbers around each square, anticlockwise, with hanging corners of neighbours.

    Hanging corners are corners of smaller neighbours on its sides. Neighbours across a periodic
    edge count, so that the vertices of opposite edges face each other.
    """
    periodic: Bool[np.ndarray, "2"]
    """Whether the plate is periodic along x and along y."""

    @property
    def facing(self) -> Int[np.ndarray, "m 2"]:
        """Pairs of vertices (m, 2) that face each other on periodic edges, left or bottom first."""
        pairs = [np.zeros((0, 2), dtype=int)]
        for axis in np.flatnonzero(self.periodic):
            along = self.vertices[:, 1 - axis]
            edges = [
                np.flatnonzero(self.vertices[:, axis] == line)
                for line in (self.low[axis], -self.low[axis])
            ]
            pairs.append(np.stack([edge[np.argsort(along[edge])] for edge in edges], axis=1))
        return np.concatenate(pairs)

    def halvings(self, points: Float[np.ndarray, "p 2"]) -> Int[np.ndarray, " p"]:
        """How many times the square around each of ``points`` (p, 2) was halved, (p,)."""
        depth = np.zeros(len(points), dtype=int)
        for k, halved in enumerate(self.halved):
            counts = self.counts * 2**k
            square = ((points - self.low) // (self.side / 2**k)).astype(int)
            square = np.where(self.periodic, square % counts, np.clip(square, 0, counts - 1))
            # a square that does not exist is never halved
            depth += np.isin(square @ [counts[1], 1], halved)
        return depth

    def fewest_halvings(self, points: Float[np.ndarray, "p 2"]) -> Int[np.ndarray, " p"]:
        """The same for the largest square that touches each of ``points`` (p, 2)."""
        return np.min(
            [self.halvings(points + 1e-6 * self.side * (2 * corner - 1)) for corner in _CORNERS],
            axis=0,
        )


def squares(plate: Plate, spacing: float) -> tuple[Int[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Numbers of squares nearly ``spacing`` wide (mm) along x and y, and their sides, mm."""
    size = np.array([plate.width, plate.height])
    counts = np.maximum(1, np.round(size / spacing).astype(int))
    return counts, size / counts


def make_background(
    plate: Plate, spacing: float, refined: Sequence[tuple[np.ndarray, Float[np.ndarray, " _"]]] = ()
) -> Background:
    """``Background`` of squares about ``spacing`` wide (mm), refined to the size of the strips.

    Each is halved until its side is below those of all strips that it touches. If the strips have
    symmetries of the square, the squares have them too: what a strip only touches is halved with
    all its images. Of a periodic plate the images of the strips count, and squares at opposite
    edges are neighbours. ``refined`` are pairs of strips, shapely geometries (m,), and sides (m,),
    mm. Raises ValueError if that takes too many halvings.
    """
    size, periodic, halved = np.array([plate.width, plate.height]), periods(plate) > 0, []
    counts, side = squares(plate, spacing)
    if refined:
        strips, sides = with_images(plate, *map(np.concatenate, zip(*refined, strict=True)))
        halved = _large_squares(strips, sides, -size / 2, side, counts)
    # a square may only be halved if all squares of its size around it exist
    for k in range(len(halved) - 1, 0, -1):
        square = np.stack(np.divmod(halved[k], counts[1] * 2**k), axis=1)
        near = np.concatenate([square + [i, j] for i in REACH for j in REACH])
        near = np.where(periodic, near % (counts * 2**k), near)
        parents = near[((near >= 0) & (near < counts * 2**k)).all(axis=1)] // 2
        halved[k - 1] = np.union1d(halved[k - 1], parents @ [counts[1] * 2 ** (k - 1), 1])
    vertices, loops = _corners(counts, halved, periodic)
    finest = counts * 2 ** len(halved)
    ticks = [
        np.linspace(-length / 2, length / 2, n + 1) for length, n in zip(size, finest, strict=True)
    ]
    vertices = np.stack([ticks[i][vertices[:, i]] for i in range(2)], axis=1)
    return Background(-size / 2, side, counts, tuple(halved), vertices, loops, periodic)


def with_images(
    plate: Plate, strips: np.ndarray, values: Float[np.ndarray, " m"]
) -> tuple[np.ndarray, Float[np.ndarray, " _"]]:
    """The ``strips``, shapely (m,), with their images in a periodic plate, and all values."""
    box, found = (
        shapely.box(-plate.width / 2, -plate.height / 2, plate.width / 2, plate.height / 2),
        [(strips, values)],
    )
    for images in translated(plate, strips):
        met = shapely.intersects(images, box)
        found.append((images[met], values[met]))
    strips, values = map(np.concatenate, zip(*found, strict=True))
    return strips, values


def _large_squares(strips, below, low, side, counts):
    """Per k the squares of the k-th halving that touch a strip whose squares are to be smaller."""
    halved, square = [], np.argwhere(np.ones(counts))
    found = symmetries_of(shapely.get_coordinates(shapely.centroid(strips)), SAME * side.max())
    matrices = [
        m
        for m, _ in found
        if np.array_equal(np.abs(m) @ counts, counts) and np.allclose(np.abs(m) @ side, side)
    ]
    while True:
        size = side / 2 ** len(halved)
        narrow = strips[below <= size.max() * (1 + 1e-9)]
        if len(narrow) == 0:
            return halved
        if len(halved) == MAX_HALVINGS:
            x, y = shapely.get_coordinates(shapely.centroid(narrow[0]))[0]
            raise Inadmissible(
                f"spacing: squares of {side.max():.3g} mm would have to be halved more than "
                f"{MAX_HALVINGS} times, to {below.min():.2g} mm "
                f"near ({x:.3g}, {y:.3g}); use a smaller spacing, fewer nodes on the holes or "
                "across ligaments, or wider ligaments"
            )
        boxes = shapely.box(*(low + square * size).T, *(low + (square + 1) * size).T)
        hit = np.unique(shapely.STRtree(narrow).query(boxes, predicate="intersects")[0])
        square, most = square[hit], counts * 2 ** len(halved) - 1
        # from the middle of the plate, in half squares
        images = [((2 * square - most) @ matrix.T + most) // 2 for matrix in matrices]
        square = np.unique(np.concatenate([square, *images]), axis=0)
        halved.append(square @ [counts[1] * 2 ** len(halved), 1])
        square = (2 * square[:, None] + _CORNERS).reshape(-1, 2)


def _corners(counts, halved, periodic):
    """Vertices (b, 2) of the leaves of the quadtree, in finest steps, and their vertex loops.

    A vertex on a periodic edge has an image on the opposite one.
    """
    rings, square, finest = [], np.argwhere(np.ones(counts)), len(halved)
    for k in range(finest + 1):
        again = (
            np.isin(square @ [counts[1] * 2**k, 1], halved[k])
            if k < finest
            else np.zeros(len(square), dtype=bool)
        )
        rings.append((square[~again][:, None] + _CORNERS) * 2 ** (finest - k))
        square = (2 * square[again][:, None] + _CORNERS).reshape(-1, 2)
    rings = np.concatenate(rings)
    rows = counts[1] * 2**finest + 1
    corners = rings.reshape(-1, 2)
    for axis in np.flatnonzero(periodic):
        last, images = (
            counts[axis] * 2**finest,
            corners[np.isin(corners[:, axis], [0, counts[axis] * 2**finest])],
        )
        images[:, axis] = last - images[:, axis]
        corners = np.concatenate([corners, images])
    keys = np.unique(corners @ [rows, 1])
    middles = (rings + np.roll(rings, -1, axis=1)) // 2
    around = np.stack([rings, middles], axis=2).reshape(-1, 8, 2) @ [rows, 1]
    number = np.minimum(np.searchsorted(keys, around), len(keys) - 1)
    on = keys[number] == around
    # smallest squares have no middles
    on[:, 1::2] &= (np.abs(np.diff(rings[:, :2], axis=1)).sum(axis=(1, 2)) > 1)[:, None]
    return np.stack(np.divmod(keys, rows), axis=1), [
        loop[real] for loop, real in zip(number, on, strict=True)
    ]
