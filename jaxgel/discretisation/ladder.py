"""Sizes of arrays that similar plates have in common, so that they share the compiled programs.

The steps are chosen so that plates whose holes differ by a few per cent rarely stand on different
ones: what numbers of a kind their clouds have lies in clusters, between which the steps are. Room
for more nodes, patches and pairs costs memory and little time, as programs stop after the last one;
room for more nodes of a patch costs time.
"""

from .._sizes import rung, step
from .neighbours import NEIGHBOURS

PAIRS = 2**15  # times a power of 2 there is room for pairs of nodes
FEW = 64  # patches for which there is room in any block
ALIKE = 512  # patches up to which there is room for as many in every block of a body
AROUND = 16  # nodes to each cut patch with a linear pressure that there is room for
SHARE = 0.6  # of all patches that there is room for in each block
# nodes of a patch of whole squares: 49 to 53, on finer clouds of large holes 57 to 66
OF_SQUARES = (40, 54, 66, 80, 112, 144)
# quadrature points and contour edges of patches with a linear pressure: whole squares, cut ones
LINEAR = ((16, 8), (112, 40), (192, 64))
CONSTANT = ((64, 24), (112, 40), (192, 64))  # of those with a constant one


def patches_of_blocks(
    counts: list[int], points: list[int], linear: list[bool], nodes: int
) -> list[int]:
    """Room for patches in each block with its numbers of patches, points and nodes of the cloud.

    Given are the patches of each block, the quadrature points of each patch, and the nodes. Cut
    patches with a linear pressure, which have the largest matrices, are few: they lie along the
    outlines.
    """
    alike = min(rung(max(FEW, *counts, round(SHARE * sum(counts))), 1), ALIKE)
    few = min(alike, rung(max(FEW, nodes // AROUND), 1))
    is_cut = [own and most > LINEAR[0][0] for own, most in zip(linear, points, strict=True)]
    return [
        max(rung(count, 1), few if cut else alike)
        for count, cut in zip(counts, is_cut, strict=True)
    ]


def of_patch(points: int, rows: int, neighbours: int, *, linear: bool) -> tuple[int, int, int]:
    """Room for quadrature points, contour edges and nodes of a patch."""
    sizes = LINEAR if linear else CONSTANT
    size = next(
        (size for size in sizes if points <= size[0] and rows <= size[1]),
        (rung(points), rung(rows)),
    )
    return *size, step(neighbours, OF_SQUARES if size == LINEAR[0] else NEIGHBOURS)
