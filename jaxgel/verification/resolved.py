"""Resolution of a plate: squares across ligaments, nodes and turns along the outlines."""

import dataclasses

import numpy as np
from scipy.spatial import cKDTree

from .._types import Float, Int
from .._validation import check_kind
from ..cloud import OUTLINE_SEGMENTS, Cloud, Outline, shortest_lines

# squares across a ligament that bends: with 1 the lattice buckles 11 % late, with 1.6 2.1 %
# (benchmarks/howto.py cell)
LEAST_ACROSS = 1.5
MOST_TURN = 45.0  # degrees between outline nodes: an octagon in place of a circle
ACROSS = 2.0  # squares across the narrowest ligament that is suggested


@dataclasses.dataclass(frozen=True)
class Resolution:
    """Fineness of a cloud across ligaments and along outlines; `resolution` returns it."""

    squares_across: float
    """Fewest squares across a ligament, of the size around it; infinite without ligaments."""
    ligament: float
    """Width of that ligament, mm."""
    narrowest: float
    """Width of the narrowest ligament, mm, which has more squares if they are halved."""
    between: str
    """What the ligament lies between, as "holes[0] and the top edge"."""
    nodes_per_square: float
    """Largest number of outline nodes to a side of a square; 0 for a plate without holes."""
    turn: float
    """Largest change of an outline's direction between two neighbouring nodes, degrees.

    Corners, which are nodes, do not count.
    """
    turns: str
    """The hole with the outline of `turn`, as "holes[0]"."""
    nodes_per_hole: int
    """Nodes on the outline of a whole hole."""
    unit: str = "mm"
    """Unit of length of the plate."""

    @property
    def warnings(self) -> list[str]:
        """A line for all that is too coarse: what, by how much, and the option that resolves it.

        Empty for a cloud that is fine enough.
        """
        found = []
        if self.squares_across < LEAST_ACROSS:
            spacing, most = (
                rounded_down(self.narrowest / ACROSS),
                f"{self.ligament:.3g} {self.unit}",
            )
            found.append(
                f"spacing: the {most} ligament between {self.between} is "
                f"{self.squares_across:.2g} squares wide, and {LEAST_ACROSS:g} are "
                "needed where it bends; rotations may be wrong by tens of per cent; use spacing "
                f"= {spacing:g}, or across = 4"
            )
        if self.turn > MOST_TURN:
            nodes = 4 * int(np.ceil(self.nodes_per_hole * self.turn / MOST_TURN * 2 / 4))
            found.append(
                f"nodes_per_hole: the outline of {self.turns} turns by {self.turn:.0f} degrees "
                "between two nodes, and at most "
                f"{MOST_TURN:g} are resolved; use a smaller spacing, or nodes_per_hole = {nodes}"
            )
        return found

    def table(self) -> dict[str, float | str | None]:
        """The numbers as JSON holds them; None for a plate without ligaments or holes."""
        numbers = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name != "unit"
        }
        return {name: None if value in (np.inf, "") else value for name, value in numbers.items()}


def resolution(cloud: Cloud) -> Resolution:
    """`Resolution` of a cloud, with its holes at their present positions.

    Arguments:

    - `cloud`: the `Cloud`, of `make_cloud`.

    Returns the fineness across ligaments and along outlines, with warnings if it is too coarse.

    >>> import jaxgel
    >>> found = jaxgel.resolution(jaxgel.make_cloud(jaxgel.sample("sample-1")))
    >>> round(found.squares_across, 2), found.between, found.warnings
    (1.82, 'holes[0] and holes[1]', [])
    """
    check_kind("cloud", cloud, Cloud, "a Cloud, as make_cloud(plate) returns it")
    topology, placed = cloud.topology, np.asarray(cloud.vertices)
    moved = tuple(
        dataclasses.replace(outline, points=placed[outline.vertices])
        for outline in topology.outlines
    )
    tree, sides = cKDTree(np.asarray(cloud.nodes)), topology.node_spacing
    ligaments = [(np.inf, np.inf, "")]
    for first, second, line in shortest_lines(dataclasses.replace(topology, outlines=moved)):
        squares = line.length / _near(tree, sides, np.asarray(line.centroid.coords))[0]
        ligaments.append((float(squares), line.length, f"{first} and {second}"))
    crowded, turns = [0.0], [(0.0, "")]
    for outline in moved:
        lengths = (
            np.linalg.norm(np.diff(outline.line, axis=0), axis=1)
            .reshape(-1, OUTLINE_SEGMENTS)
            .sum(axis=1)
        )
        ends = outline.points[::OUTLINE_SEGMENTS][: len(lengths)]
        crowded.append(float((_near(tree, sides, ends) / lengths).max()))
        turns.append((_most_turn(outline), f"holes[{outline.arc.hole}]"))
    narrowest = min(width for _, width, _ in ligaments)
    return Resolution(
        *min(ligaments)[:2],
        narrowest,
        min(ligaments)[2],
        max(crowded),
        *max(turns),
        topology.nodes_per_hole,
        cloud.plate.unit,
    )


def rounded_down(value: float) -> float:
    """A positive number rounded down to two digits."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.floor(value / unit * (1 + 1e-9)) * unit:.2g}")


def _near(
    tree: cKDTree, sides: Float[np.ndarray, " n"], points: Float[np.ndarray, "p 2"]
) -> Float[np.ndarray, " p"]:
    """Sides (p,) of the squares around the nodes nearest to ``points``, mm."""
    at: Int[np.ndarray, " p"] = tree.query(points)[1]
    return sides[at]


def _most_turn(outline: Outline) -> float:
    """Largest turn of an outline between neighbouring nodes, degrees, by its fine vertices."""
    along = np.diff(outline.line, axis=0).reshape(-1, OUTLINE_SEGMENTS, 2)
    before, after = along[:, :-1], along[:, 1:]
    sine = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    angles = np.abs(np.arctan2(sine, (before * after).sum(axis=-1)))
    return float(np.degrees(angles.sum(axis=1).max()) * OUTLINE_SEGMENTS / (OUTLINE_SEGMENTS - 1))
