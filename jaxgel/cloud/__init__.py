"""The node cloud of a plate and its integration cells, which follow the holes."""

from .._deprecated import old_names
from .cells import SLIVER, partition
from .checks import refuse_ligament
from .clearance import CLEARANCE
from .cloud import Cloud, make_cloud, place
from .edges import boundary_edges, find_rows, opposite_edges
from .ligaments import find_ligaments, shortest_lines
from .morph import thin_plate_matrix
from .outlines import OUTLINE_SEGMENTS, Outline, loop, sample_lines
from .quadrature import EDGE_POINTS, Quadrature
from .quadtree import make_background
from .topology import GRADING, Topology, assemble
from .triangles import centroids, signed_areas

__all__ = [
    "CLEARANCE",
    "EDGE_POINTS",
    "GRADING",
    "OUTLINE_SEGMENTS",
    "SLIVER",
    "Cloud",
    "Outline",
    "Quadrature",
    "Topology",
    "assemble",
    "boundary_edges",
    "centroids",
    "find_ligaments",
    "find_rows",
    "loop",
    "make_background",
    "make_cloud",
    "opposite_edges",
    "partition",
    "place",
    "refuse_ligament",
    "sample_lines",
    "shortest_lines",
    "signed_areas",
    "thin_plate_matrix",
]

__getattr__ = old_names(__name__)
