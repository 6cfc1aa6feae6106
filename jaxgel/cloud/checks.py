"""Validation of node spacing and ligament resolution."""

import numpy as np
import shapely
from scipy.spatial import cKDTree

from .._types import Float
from .._validation import Inadmissible
from ..geometry import Plate, periods
from .ligaments import shortest_lines
from .outlines import OUTLINE_SEGMENTS, Lines

# spacings: width of a ligament that may be why shape functions cannot be made next to it
NARROW = 0.5
MAX_NODES = 1_000_000  # of a cloud: a model of a million nodes takes tens of gigabytes


def check_sizes(
    plate: Plate, spacing: float | None, nodes_per_hole: int | None, across: int | None
) -> tuple[float, int]:
    """Spacing in mm and nodes per hole, the plate's own if they are None.

    ValueError for unusable ones.
    """
    own, shorter = (
        plate.spacing or min(plate.width, plate.height) / 40,
        min(plate.width, plate.height),
    )
    spacing = own if spacing is None else float(spacing)
    if not (np.isfinite(spacing) and 0 < spacing <= shorter / 2):
        raise Inadmissible(
            f"spacing: {spacing} is not in (0, {shorter / 2:g}], half the plate's shorter side"
        )
    if across is not None and not (
        isinstance(across, int | np.integer) and not isinstance(across, bool) and across >= 2
    ):
        raise ValueError(
            f"across: {across!r} is not a whole number of at least 2, the two nodes on the "
            "outlines included"
        )
    if nodes_per_hole is not None and not (
        isinstance(nodes_per_hole, int | np.integer) and 3 <= nodes_per_hole <= MAX_NODES
    ):
        raise ValueError(
            f"nodes_per_hole: {nodes_per_hole!r} is not a whole number of 3 to {MAX_NODES}"
        )
    sides = [len(hole.corners) for hole in plate.holes]
    if nodes_per_hole is not None and nodes_per_hole < max(sides, default=0):
        k = int(np.argmax(sides))
        raise ValueError(
            f"nodes_per_hole: {nodes_per_hole} are too few for holes[{k}] with {sides[k]} sides; "
            f"give at least {sides[k]}"
        )
    background = plate.width / spacing * plate.height / spacing
    if not background <= MAX_NODES:
        raise Inadmissible(
            f"spacing: {spacing:g} mm makes about {background:.2g} nodes, {MAX_NODES} are "
            "accepted at most; use a larger one"
        )
    if nodes_per_hole is None:  # whole quarters, so that turns and mirrors of a hole keep its nodes
        nodes_per_hole = (
            plate.nodes_per_hole
            if spacing == own
            else max(8, 4 * round(plate.nodes_per_hole * own / spacing / 4))
        )
    if nodes_per_hole * len(plate.holes) > MAX_NODES // OUTLINE_SEGMENTS:
        raise Inadmissible(
            f"nodes_per_hole: {nodes_per_hole} on each of {len(plate.holes)} holes are more than "
            f"the {MAX_NODES // OUTLINE_SEGMENTS} "
            "accepted; use fewer, or a larger spacing"
        )
    return spacing, nodes_per_hole


def check_ligaments(lines: Lines, spacing: float, nodes: Float[np.ndarray, "n 2"]) -> None:
    """Refuse a ligament narrower than the ``spacing`` without any of the ``nodes`` (n, 2) in it.

    The nodes are those of the background.
    """
    tree, along = cKDTree(nodes) if len(nodes) else None, periods(lines.plate)
    for name, other_name, line in shortest_lines(lines):
        if line.length >= spacing:
            continue
        middle = np.asarray(line.centroid.coords)[0]
        middle -= along * np.round(middle / np.where(along > 0, along, 1.0))
        if tree is None or tree.query(middle)[0] > spacing:
            raise Inadmissible(
                f"spacing: {spacing:g} mm leaves no node in the {line.length:.3g} mm ligament "
                f"between {name} and {other_name}; "
                f"use a spacing below {line.length:.3g}, or {line.length / 2:.3g} to have two "
                "squares across it"
            )


def refuse_ligament(
    lines: Lines, spacing: float, place: Float[np.ndarray, " 2"], reach: float
) -> None:
    """ValueError with the narrowest ligament within ``reach``, mm, of a place without neighbours.

    The place has no usable shape functions; the ligament is below ``NARROW`` spacings, otherwise
    there is no error.
    """
    point = shapely.Point(place)
    near = [
        (line.length, name, other)
        for name, other, line in shortest_lines(lines)
        if line.distance(point) < reach
    ]
    width, name, other = min(near, default=(np.inf, "", ""))
    if width < NARROW * spacing:
        raise Inadmissible(
            f"holes: a ligament of {width:.3g} mm between {name} and {other} is too narrow for "
            f"the spacing {spacing:g} mm; move the "
            "outlines apart, or across the edge, or use a smaller spacing"
        )
