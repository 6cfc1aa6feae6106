"""A plate with its holes and edges."""

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import numpy as np
import shapely

from .._types import Array
from .._validation import did_you_mean, one_of
from .boundary import checked_deformation, checked_displacement, checked_edges, edge_lines
from .hole import Hole, pytree
from .holes import check_parameters
from .outline import _outward, _traced, outline_points

KINEMATICS = ("plane strain", "plane stress")
TOUCH = 1e-5  # gaps below this fraction of the plate's shorter side count as contact


@pytree(
    meta=(
        *("width", "height", "edges", "deformation", "displacement", "kinematics", "name"),
        *("spacing", "nodes_per_hole", "cells", "core", "gel", "unit", "reference"),
    )
)
@dataclasses.dataclass(frozen=True, eq=False)
class Plate:
    """A rectangular dry plate with holes; a JAX pytree whose leaves are the hole parameters.

    Raises ValueError for an unusable size, edge or hole; ``check_plate`` checks how the holes lie.
    """

    width: float
    """Length along x, mm."""
    height: float
    """Length along y, mm."""
    holes: Sequence[Hole] = ()
    """The holes; kept as a tuple."""
    _: dataclasses.KW_ONLY
    edges: Mapping[str, str] | str = "roller"
    """A condition for all edges, or edge -> condition; edges left out are rollers. "roller" holds the displacement normal to the edge,
    "fixed" both components, "free" none; opposite edges that are "periodic" move alike but for ``deformation``."""
    deformation: Sequence[Sequence[float]] = ((1.0, 0.0), (0.0, 1.0))
    """Macroscopic deformation gradient (2, 2), rows first: what held edges and the two sides of a periodic cell follow."""
    displacement: Mapping[str, Sequence[float]] = dataclasses.field(default_factory=dict)
    """Roller or fixed edge -> its displacement (2,), mm, on top of ``deformation``; 0 for edges left out and along rollers."""
    kinematics: str = "plane strain"
    """"plane strain", thickness held, or "plane stress", a thin film whose thickness swells freely."""
    name: str = "plate"
    """What tables and files call it."""
    spacing: float | None = None
    """Default distance of background nodes, mm; None for 1/40 of the shorter side."""
    nodes_per_hole: int = 40
    """Default number of nodes on the outline of each whole hole."""
    cells: int | None = None
    """Default number of background cells per side for the paper's quadrature."""
    core: Sequence[float] = (0.0, 0.0)
    """Point whose rotation is the plate's core rotation, mm."""
    gel: object = None
    """Default ``materials.Gel`` with concrete numbers, or None."""
    unit: str = "mm"
    """What a length of 1 stands for in figures and tables; swelling itself knows no length, so read every mm of this package as this."""
    reference: "Plate | None" = None  # pyright: ignore[reportGeneralTypeIssues]
    """The concrete plate that this one was moved from by ``at``; None for a plate that was not moved."""

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            if not (np.ndim(value) == 0 and np.isfinite(value) and value > 0):
                raise ValueError(f"{name}: {value!r} is not a positive length in mm")
            object.__setattr__(self, name, float(value))
        one_of("kinematics", self.kinematics, KINEMATICS)
        object.__setattr__(self, "edges", checked_edges(self.edges))
        object.__setattr__(self, "deformation", checked_deformation(self.deformation, self.edges))
        object.__setattr__(self, "displacement", checked_displacement(self.displacement, self.edges))
        object.__setattr__(self, "core", tuple(float(c) for c in self.core))
        object.__setattr__(self, "holes", (self.holes,) if isinstance(self.holes, Hole) else tuple(self.holes))
        for k, hole in enumerate(self.holes):
            if not isinstance(hole, Hole):
                raise ValueError(f"holes[{k}]: {hole!r} is not a hole such as Circle(centre=(0, 0), radius=1)")

    @property
    def moved(self) -> bool:
        """Whether ``deformation`` or ``displacement`` moves an edge."""
        return self.deformation != ((1.0, 0.0), (0.0, 1.0)) or any(map(any, self.displacement.values()))

    @property
    def theta(self) -> tuple[dict[str, Array], ...]:
        """Parameters of all holes: a tuple of dicts, name -> array; a pytree, the argument of ``at``."""
        return tuple(hole.theta for hole in self.holes)  # pyright: ignore[reportGeneralTypeIssues]

    def at(self, theta: Sequence[Mapping[str, object]]) -> "Plate":
        """The plate with new hole parameters, which may be traced.

        ``theta`` has one dict per hole, name -> value; what is left out stays as it is. The result's ``reference`` is the plate
        that was first moved. Raises ValueError for a wrong number of holes, an unknown name or a value of another shape.
        """
        if len(theta) != len(self.holes):
            raise ValueError(f"theta: {len(theta)} entries for {len(self.holes)} holes; give one dict of parameters per hole")
        holes = tuple(_hole_at(hole, new, f"theta[{k}]") for k, (hole, new) in enumerate(zip(self.holes, theta, strict=True)))  # pyright: ignore[reportGeneralTypeIssues]
        reference = self if self.reference is None and not _traced(self) else self.reference
        return dataclasses.replace(self, holes=holes, reference=reference)


def reference_plate(plate: Plate) -> Plate:
    """The concrete plate from which ``plate`` takes its topology: its ``reference``, itself, or its values under differentiation.

    Raises ValueError when no values exist, that is under ``jax.jit`` or ``jax.vmap`` of a plate made from traced parameters.
    """
    reference = plate if plate.reference is None else plate.reference
    if _traced(reference):
        reference = jax.tree.map(jax.lax.stop_gradient, reference)  # leaves JAX's differentiation, not jit
    if _traced(reference):
        raise ValueError("plate: its hole parameters have no values inside jit; make a concrete plate outside and move it by plate.at")
    return reference


def check_plate(plate: Plate) -> None:
    """Raise ValueError, in one line that names the hole, for parameters or an arrangement of holes that make no plate.

    That is: values that are not finite or not positive, outlines that cross themselves, holes outside the plate, with a side along
    its edge, overlapping or touching each other, swallowing the plate or cutting it into parts. The plate's edge may cut holes.
    """
    for k, hole in enumerate(plate.holes):
        check_parameters(hole, f"holes[{k}]")
    box = shapely.box(-plate.width / 2, -plate.height / 2, plate.width / 2, plate.height / 2)
    touch = TOUCH * min(plate.width, plate.height)
    inner = []
    for k, hole in enumerate(plate.holes):
        shape = shapely.Polygon(np.asarray(outline_points(hole, np.union1d(np.arange(1440) / 1440, hole.corners))))
        if not shape.is_valid or not shape.exterior.is_ccw:
            raise ValueError(f"holes[{k}]: its outline crosses itself or runs clockwise; give a simple anticlockwise outline")
        if shape.intersection(box).area <= touch**2:
            raise ValueError(f"holes[{k}]: it lies outside the plate, |x| <= {plate.width / 2:g}, |y| <= {plate.height / 2:g}; move it in")
        if shape.contains(box):
            raise ValueError(f"holes[{k}]: it covers the whole plate of {plate.width:g} x {plate.height:g} mm; make it smaller")
        _check_sides_along_edges(plate, hole, f"holes[{k}]", touch)
        if plate.moved and any(shape.contains(shapely.Point(corner)) for corner in shapely.get_coordinates(box)):
            raise ValueError(f"holes[{k}]: it takes a corner of a plate whose edges move; choose the plate so that its corners are gel")
        for edge, (axis, coordinate) in edge_lines(plate).items():
            if plate.edges[edge] == "periodic" and np.max(np.sign(coordinate) * shapely.get_coordinates(shape)[:, axis]) > abs(coordinate):
                raise ValueError(f"holes[{k}]: the periodic edge {edge} cuts it; choose the cell so that its holes lie inside")
        inner.append(shape.intersection(box))
    inner = np.array(inner, dtype=object)
    for i, j in np.argwhere(np.triu(shapely.dwithin(inner[:, None], inner[None, :], touch), 1)):
        raise ValueError(f"holes[{i}], holes[{j}]: they overlap or touch; leave more than {touch:.2g} mm between them")
    rest = shapely.get_parts(shapely.difference(box, shapely.union_all(inner)))
    if len(rest) != 1:
        raise ValueError(f"holes: they cut the plate into {len(rest)} parts; leave one connected piece")


def _hole_at(hole, new, where):
    """The hole with the parameters of the dict ``new`` in place of its own."""
    theta = hole.theta
    for name, value in new.items():
        if name not in theta:
            raise ValueError(f"{where}: unknown parameter {name!r} of {type(hole).__name__}; {did_you_mean(name, theta)}")
        if np.shape(value) != theta[name].shape:
            raise ValueError(f"{where}: {name} has shape {np.shape(value)}, but the hole's own has {theta[name].shape}")
    return dataclasses.replace(hole, **new)


def _check_sides_along_edges(plate, hole, where, touch):
    """Refuse a straight side on the plate's edge: whether the edge cuts it is not defined once the hole moves."""
    if not hole.corners:
        return
    corners = np.asarray(outline_points(hole, np.asarray(hole.corners)))
    on_edge = np.abs(_outward(plate, corners)) < touch
    for side in np.flatnonzero((on_edge & np.roll(on_edge, -1, axis=0)).any(axis=1)):
        middle = (corners[side] + corners[(side + 1) % len(corners)]) / 2
        if _outward(plate, middle[None]).max() < touch:
            raise ValueError(f"{where}: its side {side} lies along the plate's edge; move it across the edge or away from it")
