"""Curved sides of cells: an edge along an outline is part of the parabola through three neighbouring fine vertices of the outline.

Points on a parabola are sums of its three vertices with the weights of `parabola`, so that they follow the outline smoothly.
"""

import dataclasses

import numpy as np

from .._types import Float, Int
from .outlines import Outline, loop


@dataclasses.dataclass(frozen=True, eq=False)
class Curves:
    """The fine segments of all outlines, two to a parabola; NumPy arrays."""

    ends: Int[np.ndarray, "s 2"]
    """Vertex numbers of the ends of each segment."""
    vertices: Int[np.ndarray, "s 3"]
    """Vertex numbers of its parabola."""
    start: Float[np.ndarray, " s"]
    """Parameter of its first end on the parabola: 0 or 1/2."""

    def points(self, segment: Int[np.ndarray, " p"], fraction: Float[np.ndarray, " p"]) -> tuple[np.ndarray, np.ndarray]:
        """Vertex numbers (p, 3) and weights (p, 3) of the points at a ``fraction`` of their ``segment``."""
        return self.vertices[segment], parabola(self.start[segment] + fraction / 2)


def curves_of(outlines: tuple[Outline, ...]) -> Curves:
    """``Curves`` of all outlines."""
    lines = [loop(outline) for outline in outlines]
    none = np.zeros((0, 2), int)
    ends = np.concatenate([none, *(np.stack([line[:-1], line[1:]], axis=1) for line in lines)])
    first = [np.arange(len(line) - 1) // 2 * 2 for line in lines]
    vertices = np.concatenate([np.zeros((0, 3), int), *(line[k[:, None] + np.arange(3)] for line, k in zip(lines, first, strict=True))])
    return Curves(ends, vertices, np.concatenate([np.zeros(0), *(np.arange(len(k)) % 2 / 2 for k in first)]))


def parabola(t: Float[np.ndarray, " p"]) -> Float[np.ndarray, "p 3"]:
    """Weights of the three points of a parabola, at the parameters 0, 1/2 and 1, in its point at ``t``."""
    return np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)], axis=-1)
