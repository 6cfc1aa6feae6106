"""The dry plate: its holes, its edges and the pieces of hole outlines that lie inside it."""

from .._deprecated import old_names
from .boundary import CONDITIONS, EDGES, FRAME_EDGES, held_components
from .checks import check_plate
from .frame import Frame, frame_of
from .hole import Hole, outline_points, pytree
from .holes import KINDS, Circle, Ellipse, Fourier, Polygon, Rectangle, Superellipse
from .obstacles import (
    OBSTACLES,
    Disc,
    HalfPlane,
    Obstacle,
    Polyline,
    Primitives,
    gap,
    primitives_of,
)
from .outline import (
    Arc,
    arc_parameter,
    arc_points,
    arcs,
    corners_between,
    equal_arc_length,
    inside_holes,
)
from .plate import KINEMATICS, Plate, edge_lines, image_offsets, periods, reference_plate
from .symmetries import SYMMETRIES, keeps_edges

__all__ = [
    "CONDITIONS",
    "EDGES",
    "FRAME_EDGES",
    "KINDS",
    "KINEMATICS",
    "OBSTACLES",
    "SYMMETRIES",
    "Arc",
    "Circle",
    "Disc",
    "Ellipse",
    "Fourier",
    "Frame",
    "HalfPlane",
    "Hole",
    "Obstacle",
    "Plate",
    "Polygon",
    "Polyline",
    "Primitives",
    "Rectangle",
    "Superellipse",
    "arc_parameter",
    "arc_points",
    "arcs",
    "check_plate",
    "corners_between",
    "edge_lines",
    "equal_arc_length",
    "frame_of",
    "gap",
    "held_components",
    "image_offsets",
    "inside_holes",
    "keeps_edges",
    "outline_points",
    "periods",
    "primitives_of",
    "pytree",
    "reference_plate",
]

__getattr__ = old_names(__name__)
