"""A plate with its holes and edges."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import jax
import numpy as np

from .._deprecated import OldAttribute
from .._tracing import is_traced
from .._types import Array, Float, Scalar
from .._validation import Inadmissible, did_you_mean, one_of
from .boundary import FRAME_EDGES, FREE, checked_deformation, checked_displacement, checked_edges
from .hole import Hole, checked_parameter, pytree
from .obstacles import Obstacle, checked_obstacles

KINEMATICS = ("plane strain", "generalised plane strain", "plane stress")


@pytree(
    meta=(
        *("width", "height", "edges", "deformation", "displacement", "kinematics", "name"),
        *("spacing", "nodes_per_hole", "core", "gel", "unit", "reference"),
    )
)
@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Plate:
    """A rectangular dry plate with holes, obstacles and regions; the user makes it, or `sample`.

    A JAX pytree: its leaves are the parameters of holes, obstacles and regions and an axial
    stretch. Raises `ValueError` for an unusable size, edge or hole; `check_plate` checks how the
    holes lie.
    """

    width: float
    """Length along x, mm."""
    height: float
    """Length along y, mm."""
    holes: Sequence[Hole] = ()
    """The holes; kept as a tuple."""
    _: dataclasses.KW_ONLY
    obstacles: Sequence[Obstacle] = ()
    """Rigid bodies that the gel's surfaces meet without friction; kept as a tuple."""
    regions: Sequence[Hole] = ()
    """Outlines of regions with a material of their own, see ``materials.Composite``; a tuple."""
    edges: Mapping[str, str] | str = "roller"
    """A condition for all edges, or edge -> condition.

    Edges left out are rollers. "roller" holds the displacement normal to the edge, "fixed" both
    components, "free" none; opposite edges that are "periodic" move alike but for ``deformation``.
    """
    deformation: Sequence[Sequence[float | str]] | str = ((1.0, 0.0), (0.0, 1.0))
    """Macroscopic deformation gradient F (2, 2), rows first, of held edges and periodic sides.

    A component of a periodic cell may be "free": it is an unknown, and no mean stress acts along
    it. A free shear is F12 = F21. "free" alone frees all components; the cell does not turn.
    """
    displacement: Mapping[str, Sequence[float]] = dataclasses.field(default_factory=dict)
    """Roller or fixed edge -> displacement (2,), mm, on top of ``deformation``; default 0.

    0 along rollers.
    """
    kinematics: str = "plane strain"
    """"plane strain", "generalised plane strain" or "plane stress".

    Thickness held, one stretch of the whole thickness, or a thin film whose thickness swells
    freely.
    """
    axial_stretch: Scalar | None = None
    """Stretch of the thickness in generalised plane strain: a number > 0, may be traced.

    It is needed there; 1 is plane strain.
    """
    name: str = "plate"
    """Name in tables and files."""
    spacing: float | None = None
    """Default distance of background nodes, mm; None for 1/40 of the shorter side."""
    nodes_per_hole: int = 40
    """Default number of nodes on the outline of each whole hole."""
    core: Sequence[float] | None = None
    """Point whose rotation is the plate's core rotation, mm.

    None for the middle of the plate, of a periodic one that of its frame.
    """
    gel: object = None
    """Default ``materials.Gel`` with concrete numbers, or None."""
    unit: str = "mm"
    """Unit of length in figures and tables. Swelling has no intrinsic length scale, so any unit may
    replace mm here."""
    reference: "Plate | None" = None  # pyright: ignore[reportGeneralTypeIssues]
    """The concrete plate that this one was moved from by ``at``.

    None for a plate that was not moved.
    """

    def __repr__(self) -> str:
        """Name, size and what is in it."""
        inside = [
            f"{len(part)} {one}{'s' * (len(part) != 1)}"
            for one, part in (("hole", self.holes), ("region", self.regions))
            if part
        ]
        return f"Plate {self.name!r}: " + ", ".join(
            [f"{self.width:g} x {self.height:g} {self.unit}", *inside, self.kinematics]
        )

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            if not (np.ndim(value) == 0 and np.isfinite(value) and value > 0):
                raise Inadmissible(f"{name}: {value!r} is not a positive length in mm")
            object.__setattr__(self, name, float(value))
        one_of("kinematics", self.kinematics, KINEMATICS)
        object.__setattr__(
            self, "axial_stretch", _checked_stretch(self.axial_stretch, self.kinematics)
        )
        object.__setattr__(self, "edges", checked_edges(self.edges))
        object.__setattr__(self, "deformation", checked_deformation(self.deformation, self.edges))
        object.__setattr__(
            self, "displacement", checked_displacement(self.displacement, self.edges)
        )
        object.__setattr__(
            self, "core", None if self.core is None else tuple(float(c) for c in self.core)
        )
        object.__setattr__(self, "obstacles", checked_obstacles(self.obstacles))
        for name in ("holes", "regions"):
            outlines = getattr(self, name)
            object.__setattr__(
                self, name, (outlines,) if isinstance(outlines, Hole) else tuple(outlines)
            )
            for k, outline in enumerate(getattr(self, name)):
                if not isinstance(outline, Hole):
                    raise ValueError(
                        f"{name}[{k}]: {outline!r} is not a {name[:-1]} such as Circle(centre=(0, "
                        "0), radius=1)"
                    )

    theta_of_regions = OldAttribute(instead="tuple(region.theta for region in plate.regions)")

    @property
    def moved(self) -> bool:
        """Whether ``deformation`` or ``displacement`` moves an edge."""
        return self.dry_deformation != ((1.0, 0.0), (0.0, 1.0)) or any(
            map(any, self.displacement.values())
        )

    @property
    def dry_deformation(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """``deformation`` with the free components as they are in the dry plate."""
        return tuple(
            tuple(float(i == j) if F == FREE else F for j, F in enumerate(row))
            for i, row in enumerate(self.deformation)
        )

    @property
    def free_strains(self) -> tuple[tuple[int, int], ...]:
        """The free components (i, j), i <= j, of ``deformation``: the macroscopic unknowns."""
        return tuple((i, j) for i, j in ((0, 0), (1, 1), (0, 1)) if self.deformation[i][j] == FREE)

    @property
    def theta(self) -> tuple[dict[str, Array], ...]:
        """Parameters of all holes: a tuple of dicts, name -> array, the argument of ``at``.

        A pytree.
        """
        return tuple(hole.theta for hole in self.holes)  # pyright: ignore[reportGeneralTypeIssues]

    @property
    def with_regions_as_holes(self) -> "Plate":
        """The plate whose holes are this one's regions, for `arcs` and other functions."""
        return dataclasses.replace(self, holes=self.regions, regions=(), reference=None)

    def at(
        self,
        theta: Sequence[Mapping[str, object]],
        regions: Sequence[Mapping[str, object]] | None = None,
    ) -> "Plate":
        """The plate with new parameters of its holes and, if given, ``regions``; traceable.

        ``theta`` has one dict per hole, name -> value; what is left out stays as it is. The
        result's ``reference`` is the plate that was first moved. Raises ValueError for a wrong
        number of holes, an unknown name or a value of another shape.
        """
        holes = _all_at(self.holes, theta, "theta", "hole")
        moved = (
            self.regions if regions is None else _all_at(self.regions, regions, "regions", "region")
        )
        reference = self if self.reference is None and not is_traced(self) else self.reference
        return dataclasses.replace(self, holes=holes, regions=moved, reference=reference)


def reference_plate(plate: Plate) -> Plate:
    """Concrete plate of the topology of ``plate``: its ``reference``, itself, or its values.

    Its values under differentiation. Raises ValueError when no values exist, that is under
    ``jax.jit`` or ``jax.vmap`` of a plate made from traced parameters.
    """
    reference = plate if plate.reference is None else plate.reference
    if is_traced(reference):
        # leaves JAX's differentiation, not jit
        reference = jax.tree.map(jax.lax.stop_gradient, reference)
    if is_traced(reference):
        raise ValueError(
            "plate: its hole parameters have no values inside jit; make a concrete plate outside "
            "and move it by plate.at"
        )
    return reference


def edge_lines(plate: Plate) -> dict[str, tuple[int, float]]:
    """Edge -> (axis, coordinate): the edge is x (axis 0) or y (axis 1) = coordinate, mm."""
    w, h = plate.width / 2, plate.height / 2
    return {"left": (0, -w), "right": (0, w), "bottom": (1, -h), "top": (1, h)}


def periods(plate: Plate) -> Float[np.ndarray, " 2"]:
    """Periods (2,) of a plate along x and y, mm; 0 along an axis whose edges are not periodic."""
    sides = plate.width, plate.height
    return np.array(
        [
            side if plate.edges[edges[0]] == "periodic" else 0.0
            for side, edges in zip(sides, FRAME_EDGES, strict=True)
        ]
    )


def image_offsets(plate: Plate) -> Float[np.ndarray, "m 2"]:
    """Translations (m, 2), mm, of a periodic plate to its neighbours, first (0, 0).

    Other plates have (0, 0) alone.
    """
    steps = [(0.0, -period, period) if period else (0.0,) for period in periods(plate)]
    return np.array(list(itertools.product(*steps)))


def _all_at(outlines, theta, name, kind):
    """The holes or regions with the parameters of ``theta``, a dict for each."""
    if isinstance(theta, Mapping | str) or not all(isinstance(new, Mapping) for new in theta):
        example = (
            f"[{{{', '.join(f'{part!r}: ...' for part in list(outlines[0].theta)[:1])}}}]"
            if outlines
            else "[]"
        )
        raise ValueError(
            f"{name}: {theta!r} is not accepted; give a list with one dict of parameters per "
            f"{kind}, such as {example}"
        )
    if len(theta) != len(outlines):
        raise ValueError(
            f"{name}: {len(theta)} entries for {len(outlines)} {kind}s; give one dict of "
            f"parameters per {kind}"
        )
    for k, (hole, new) in enumerate(zip(outlines, theta, strict=True)):
        for parameter, value in new.items():
            if parameter not in hole.theta:
                known = did_you_mean(parameter, hole.theta)
                raise ValueError(
                    f"{name}[{k}]: unknown parameter {parameter!r} of {type(hole).__name__}; "
                    f"{known}"
                )
            own = hole.theta[parameter].shape
            if np.shape(value) != own:
                raise ValueError(
                    f"{name}[{k}]: {parameter} has shape {np.shape(value)}, but the hole's own "
                    f"has {own}"
                )
    return tuple(
        dataclasses.replace(hole, **new) for hole, new in zip(outlines, theta, strict=True)
    )


def _checked_stretch(value, kinematics):
    """The axial stretch as an array (), None if the kinematics have none.

    ValueError for what is not accepted.
    """
    if kinematics != "generalised plane strain":
        if value is not None:
            raise ValueError(
                f"axial_stretch: {value!r} is not accepted in {kinematics}, only in generalised "
                "plane strain"
            )
        return None
    if value is None:
        raise ValueError(
            "axial_stretch: is missing; generalised plane strain takes a finite number > 0, 1 for "
            "plane strain"
        )
    message = f"axial_stretch: {value!r} is not accepted, it must be a finite number > 0"
    try:
        value = checked_parameter(value, (), "axial_stretch")
    except ValueError:
        raise ValueError(message) from None
    if not is_traced(value) and not (np.isfinite(value) and value > 0):
        raise Inadmissible(message)
    return value
