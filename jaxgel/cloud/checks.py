"""What a cloud is refused for: unusable sizes, and ligaments that its spacing leaves empty."""

import itertools
from typing import TYPE_CHECKING

import numpy as np
import shapely
from scipy.spatial import cKDTree

from .._validation import Inadmissible
from ..geometry import Plate
from .ligaments import sides
from .outlines import OUTLINE_SEGMENTS, loop

if TYPE_CHECKING:
    from .topology import Topology

MAX_NODES = 1_000_000  # of a cloud: a model of a million nodes takes tens of gigabytes


def check_sizes(plate: Plate, spacing: float | None, nodes_per_hole: int | None, across: int | None) -> tuple[float, int]:
    """Spacing in mm and nodes per hole, the plate's own where they are None; ValueError for unusable ones."""
    own, shorter = plate.spacing or min(plate.width, plate.height) / 40, min(plate.width, plate.height)
    spacing = own if spacing is None else float(spacing)
    if not (np.isfinite(spacing) and 0 < spacing <= shorter / 2):
        raise Inadmissible(f"spacing: {spacing} is not in (0, {shorter / 2:g}], half the plate's shorter side")
    if across is not None and not (isinstance(across, int | np.integer) and not isinstance(across, bool) and across >= 2):
        raise ValueError(f"across: {across!r} is not a whole number of at least 2, the two nodes on the outlines included")
    if nodes_per_hole is not None and not (isinstance(nodes_per_hole, int | np.integer) and 3 <= nodes_per_hole <= MAX_NODES):
        raise ValueError(f"nodes_per_hole: {nodes_per_hole!r} is not a whole number of 3 to {MAX_NODES}")
    background = plate.width / spacing * plate.height / spacing
    if not background <= MAX_NODES:
        raise Inadmissible(
            f"spacing: {spacing:g} mm makes about {background:.2g} nodes, {MAX_NODES} are accepted at most; use a larger one"
        )
    if nodes_per_hole is None:  # whole quarters, so that turns and mirrors of a hole keep its nodes
        nodes_per_hole = plate.nodes_per_hole if spacing == own else max(8, 4 * round(plate.nodes_per_hole * own / spacing / 4))
    if nodes_per_hole * len(plate.holes) > MAX_NODES // OUTLINE_SEGMENTS:
        raise Inadmissible(
            f"nodes_per_hole: {nodes_per_hole} on each of {len(plate.holes)} holes are more than the {MAX_NODES // OUTLINE_SEGMENTS} "
            "accepted; use fewer, or a larger spacing"
        )
    return spacing, nodes_per_hole


def check_ligaments(topology: "Topology") -> None:
    """Refuse a cloud with a ligament narrower than the spacing and no node in it."""
    part, n = topology.partition, topology.n_background
    free = topology.node_vertices[topology.node_vertices < n]
    tree = cKDTree(part.vertices[free]) if len(free) else None
    boundaries = [(f"holes[{o.arc.hole}]", o.closed, shapely.LineString(part.vertices[loop(o)])) for o in topology.outlines]
    boundaries += [("the plate's edge", False, line) for line in sides(topology.plate)]
    for (name, closed, curve), (other_name, _, other) in itertools.combinations(boundaries, 2):
        cut = not closed and other_name == "the plate's edge"
        line = shapely.shortest_line(curve, other)
        if name == other_name or cut or line.length >= topology.spacing:
            continue  # arcs of one hole, a hole that the edge cuts, a wide ligament
        middle = np.asarray(line.centroid.coords)[0]
        if tree is None or tree.query(middle)[0] > topology.spacing:
            raise Inadmissible(
                f"spacing: {topology.spacing:g} mm leaves no node in the {line.length:.3g} mm ligament between {name} and {other_name}; "
                f"use a spacing below {line.length:.3g}"
            )
