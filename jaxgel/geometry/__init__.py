"""The dry plate: its holes, its edges and the pieces of hole outlines that lie inside it."""

from .boundary import CONDITIONS, EDGES, edge_lines, held_components, image_offsets, periods
from .frame import Frame, frame_of
from .hole import Hole
from .holes import KINDS, Circle, Ellipse, Fourier, Polygon, Rectangle, Superellipse
from .outline import Arc, arc_parameter, arc_point, arc_points, arcs, equal_arc_length, inside_holes, outline_points, stretches
from .plate import KINEMATICS, Plate, check_plate, reference_plate
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
    "arc_point",
    "arc_points",
    "arcs",
    "check_plate",
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
    "stretches",
]
