"""The node cloud of a plate and its integration cells, which follow the holes."""

from .cells import SLIVER, boundary_edges, partition
from .checks import narrow_ligament
from .clearance import CLEARANCE
from .cloud import Cloud, make_cloud, place
from .ligaments import find_ligaments
from .morph import thin_plate_matrix
from .outlines import OUTLINE_SEGMENTS, Outline, loop
from .quadrature import EDGE_POINTS
from .quadtree import make_background
from .topology import GRADING, Topology, assemble

__all__ = [
    "CLEARANCE",
    "EDGE_POINTS",
    "GRADING",
    "OUTLINE_SEGMENTS",
    "SLIVER",
    "Cloud",
    "Outline",
    "Topology",
    "assemble",
    "boundary_edges",
    "find_ligaments",
    "loop",
    "make_background",
    "make_cloud",
    "narrow_ligament",
    "partition",
    "place",
    "thin_plate_matrix",
]
