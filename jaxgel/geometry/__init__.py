"""The dry plate: its holes, its edges and the pieces of hole outlines that lie inside it."""

from .boundary import CONDITIONS, EDGES, held_components
from .checks import check_plate
from .frame import Frame, frame_of
from .hole import Hole, outline_points
from .holes import KINDS, Circle, Ellipse, Fourier, Polygon, Rectangle, Superellipse
from .outline import Arc, arc_parameter, arc_points, arcs, corners_between, equal_arc_length, inside_holes
from .plate import KINEMATICS, Plate, edge_lines, image_offsets, periods, reference_plate
from .symmetries import SYMMETRIES, keeps_edges

__all__ = [
    "CONDITIONS",
    "EDGES",
    "KINDS",
    "KINEMATICS",
    "SYMMETRIES",
    "Arc",
    "Circle",
    "Ellipse",
    "Fourier",
    "Frame",
    "Hole",
    "Plate",
    "Polygon",
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
    "held_components",
    "image_offsets",
    "inside_holes",
    "keeps_edges",
    "outline_points",
    "periods",
    "reference_plate",
]
