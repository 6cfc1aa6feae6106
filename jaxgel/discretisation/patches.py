"""Patches: cells with one pressure field, linear over 2 x 2 squares, else constant.

Single squares, along outlines and in narrow ligaments, follow what varies there over one square;
blocks leave out the pressures that a quadratic displacement cannot meet. A block counts if it has
two whole squares and more, outside narrow ligaments: a linear pressure across two squares of one
makes it too stiff.
"""

import numpy as np
import scipy.sparse as sp
import shapely

from .._memo import once_per_owner
from .._types import Bool, Int
from ..cloud import Topology, centroids, opposite_edges, signed_areas

# least whole squares of a block with a linear pressure, which is larger than these: two alone do
# not vary twice across
SQUARES = 2
# squares across a ligament up to which it has single ones: as a block of two the lattice's buckle 9
# % late
LIGAMENT = 2.0
ROUND_OFF = 1e-9  # of areas, relative


@once_per_owner
def patches(topology: Topology) -> tuple[Int[np.ndarray, " c"], Bool[np.ndarray, " p"]]:
    """The patch (c,) of every cell, and whether each patch (p,) has a linear pressure."""
    part = topology.partition
    areas = signed_areas(part.vertices, part.triangles)
    area, centre = (
        np.bincount(part.cell_of_triangle, areas),
        centroids(part.vertices, part.triangles, areas, part.cell_of_triangle),
    )
    block, square, complete = _blocks_of_squares(topology, centre)
    block = _connected_parts(topology, block)
    whole, size = (
        np.bincount(block, of) for of in (area > square * (1 - ROUND_OFF), area / square)
    )
    linear = (
        (whole >= SQUARES) & (size > SQUARES * (1 + ROUND_OFF)) & (np.bincount(block, complete) > 0)
    )
    linear &= np.bincount(block, _in_narrow_ligament(topology, centre)) == 0
    alone = len(linear) + np.arange(topology.partition.n_cells)
    patch = np.unique(np.where(linear[block], block, alone), return_inverse=True)[1]
    is_linear = np.zeros(patch.max() + 1, dtype=bool)
    is_linear[patch] = linear[block]
    return patch, is_linear


def _blocks_of_squares(topology, centre):
    """The 2 x 2 block (c,) of each cell, its square's area (c,), mm^2, and whether it is whole.

    A whole block lies on the plate; its squares are equal. Blocks begin at the middle of the plate:
    no block lies across a ligament there. Of an odd number of squares the middle one is alone.
    """
    background = topology.background
    depth = background.halvings(centre)[:, None]
    counts = background.counts * 2**depth
    square = np.clip(
        (centre - background.low) // (background.side / 2.0**depth), 0, counts - 1
    ).astype(int)
    from_middle = 2 * square + 1 - counts  # in half squares
    # 0 for the middle one, or the two next to the middle
    rank, odd = np.abs(from_middle) // 2, counts % 2
    number = (rank + 2 - odd) // 2
    block = np.concatenate([depth, np.sign(from_middle) * number], axis=1)
    complete = ((number > 0) & (2 * number - 1 + odd <= (counts - 1) // 2)).all(axis=1)
    return (
        np.unique(block, axis=0, return_inverse=True)[1].ravel(),
        background.side.prod() / 4.0 ** depth[:, 0],
        complete,
    )


def _connected_parts(topology, block):
    """Connected part (c,) of its block that each cell belongs to: a hole may divide a block."""
    part = topology.partition
    edges, owner = part.contour_edges
    at, region = opposite_edges(edges), part.region_of_cell[owner]
    inside = (at >= 0) & (block[owner] == block[owner[at]]) & (region == region[at])
    pairs = owner[inside], owner[at[inside]]
    graph = sp.coo_array((np.ones(len(pairs[0])), pairs), (len(block), len(block)))
    return sp.csgraph.connected_components(graph, directed=False)[1]


def _in_narrow_ligament(topology, centre):
    """Whether (c,) the square around each cell touches a ligament of few squares.

    Such a ligament is at most ``LIGAMENT`` squares wide.
    """
    (strips, widths), background = topology.ligaments, topology.background
    side = background.side / 2.0 ** background.halvings(centre)[:, None]
    low = background.low + (centre - background.low) // side * side
    cell, strip = shapely.STRtree(strips).query(
        shapely.box(*low.T, *(low + side).T), predicate="intersects"
    )
    narrow = widths[strip] <= LIGAMENT * side.max(axis=1)[cell] * (1 + ROUND_OFF)
    return np.bincount(cell[narrow], minlength=len(centre)) > 0
