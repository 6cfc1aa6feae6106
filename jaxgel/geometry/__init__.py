"""geometry."""

from .boundary import CONDITIONS, EDGES, edge_lines, held_components
from .holes import KINDS, Circle, Ellipse, Fourier, Polygon, Rectangle, Superellipse
from .outline import arc_parameter, arc_point, arc_points, arcs, equal_arc_length, inside_holes, outline_points
from .plate import Plate, check_plate, reference_plate

__all__ = [
    "CONDITIONS",
    "EDGES",
    "KINDS",
    "Circle",
    "Ellipse",
    "Fourier",
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
    "held_components",
    "inside_holes",
    "outline_points",
    "reference_plate",
]
