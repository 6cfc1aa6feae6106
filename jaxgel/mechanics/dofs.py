"""Essential conditions of a plate: free, coupled and prescribed degrees of freedom.

Degrees of freedom are numbered 2 node + component; `free_dofs` are those that may move, see `Free`.
Held ones follow the plate's macroscopic deformation and the displacement of their edge, and so do
the two sides of a periodic cell relative to each other: a roller holds the component normal to its
edge, a fixed edge both.
"""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from .._memo import once_per_owner
from .._tracing import is_traced
from .._types import Array, Bool, Float, Int
from .._validation import Inadmissible
from ..cloud import Topology, thin_plate_matrix
from ..controls import Setting
from ..discretisation import Connectivity
from ..geometry import EDGES, Plate, held_components
from .conditions import Free

ROUND_OFF = 1e-12  # of the extent of held nodes: their extent across a line, if they lie on one


@once_per_owner
def free_dofs(topology: Topology) -> Free:
    """The unknowns of a plate; ValueError as `check_edges`."""
    plate, walls = topology.plate, topology.edge_nodes
    held, first = held_dofs(topology), periodic_images(topology)
    if "periodic" in plate.edges.values():
        corner = first[
            walls["left"][0] if plate.edges["left"] == "periodic" else walls["bottom"][0]
        ]
        held[corner, ~held.any(axis=0)] = True  # a periodic cell has its place by convention
        np.logical_or.at(held, first, held)
    else:
        check_edges(plate)
    stands = first == np.arange(len(first))
    number = np.where(stands[:, None] & ~held, 0, -1)
    masters = np.flatnonzero(number == 0)
    number.ravel()[masters] = np.arange(len(masters))
    unknown = number[first].ravel()
    dofs = np.flatnonzero(unknown >= 0)
    fields = sp.csr_matrix(
        (np.ones(len(dofs)), (dofs, unknown[dofs])), shape=(held.size, len(masters))
    )
    readings = sp.csr_matrix(
        (np.ones(len(masters)), (np.arange(len(masters)), masters)), shape=(len(masters), held.size)
    )
    if not plate.free_strains:
        return Free.of(masters, fields, readings)
    strains, sides = _strains(topology)
    beyond = sp.csr_matrix(strains.reshape(len(strains), -1))
    # at a master less what the macroscopic deformation moves it
    readings = sp.vstack([readings - (readings @ beyond.T) @ sides, sides])
    return Free.of(
        np.append(masters, held.size + np.arange(len(strains))),
        sp.hstack([fields, beyond.T]).tocsr(),
        readings.tocsr(),
    )


def held_dofs(topology: Topology) -> Bool[np.ndarray, "n 2"]:
    """Which degrees of freedom the plate's edges hold, (n, 2)."""
    held = np.zeros((len(topology.node_vertices), 2), dtype=bool)
    for edge in EDGES:
        for component in held_components(topology.plate.edges, edge):
            held[topology.edge_nodes[edge], component] = True
    return held


def unknowns(lists: Connectivity) -> Free:
    """The unknowns of a model with these ``lists``."""
    return free_dofs(lists.topology) if lists.unknowns is None else lists.unknowns


def check_edges(plate: Plate) -> None:
    """Raise ValueError, one line, for edges that leave the plate free to slide."""
    held = {component for edge in EDGES for component in held_components(plate.edges, edge)}
    if len(held) < 2 and "periodic" not in plate.edges.values():
        raise ValueError(
            f"edges: {_named(plate)} leave the plate free to slide; hold at least one edge normal "
            "to each direction"
        )


def check_room(plate: Plate) -> None:
    """Raise ValueError, one line, for a plate that fills a closed box: J > 1 is impossible.

    No state has a volume ratio above 1 everywhere. A film may get thicker; the box of a free
    macroscopic deformation is not closed.
    """
    axial = 1.0 if plate.axial_stretch is None else plate.axial_stretch
    if (
        plate.kinematics != "plane stress"
        and not plate.holes
        and not plate.free_strains
        and "free" not in plate.edges.values()
        and not axial * _box_area(plate) > plate.width * plate.height * (1 + 1e-12)
    ):
        raise ValueError(
            f"edges: {_named(plate)} leave no room to swell in; add a hole, free an edge or move "
            "one outwards"
        )


def check_moving(topology: Topology) -> None:
    """Raise ValueError, one line, for a plate whose edges no control may move.

    What a hole meets at a held edge is known at rest only.
    """
    for outline in topology.outlines:
        for edge in (outline.arc.start_edge, outline.arc.end_edge):
            if edge is not None and topology.plate.edges[edge] != "free":
                raise Inadmissible(
                    f"control: a hole is open to the {edge} edge, which is "
                    f"{topology.plate.edges[edge]} and cannot be moved by it"
                )


def _named(plate):
    return ", ".join(f"{edge} {condition}" for edge, condition in plate.edges.items())


def _box_area(plate):
    """Area of the parallelogram of the plate's edges once they have moved."""
    (w, h), F, by = (plate.width, plate.height), np.array(plate.dry_deformation), plate.displacement
    corners = ("left", "bottom"), ("right", "bottom"), ("left", "top")
    at = [
        F @ [w * (side == "right"), h * (end == "top")] + [by[side][0], by[end][1]]
        for side, end in corners
    ]
    return float(np.linalg.det([at[1] - at[0], at[2] - at[0]]))


def periodic_images(topology: Topology) -> Int[np.ndarray, " n"]:
    """Master node (n,) of each node: itself, or its image on the left or bottom edge.

    ValueError if there is none.
    """
    plate, first = topology.plate, np.arange(len(topology.node_vertices))
    nodes = topology.partition.vertices[topology.node_vertices]
    for edge, opposite, along in (("right", "left", 1), ("top", "bottom", 0)):
        if plate.edges[edge] != "periodic":
            continue
        here, there = topology.edge_nodes[edge], topology.edge_nodes[opposite]
        if (
            len(here) != len(there)
            or np.abs(nodes[here, along] - nodes[there, along]).max() > 1e-9 * topology.spacing
        ):
            raise Inadmissible(
                f"edges: {edge} and {opposite} are periodic but their nodes do not face each "
                "other; refine them alike"
            )
        first[here] = first[there]
    return first[first]


def _strains(topology):
    """Fields (m, n, 2) of the macroscopic unknowns, and the matrix (m, 2n) to read them off.

    A macroscopic unknown is how far a side of the cell moves beyond the opposite one, mm, while the
    middle of the cell stays where it is: of F11 and F12 = F21 the right edge beyond the left one,
    of F22 the top beyond the bottom. Its field is 0 but for periodic edges.
    """
    plate, walls = topology.plate, topology.edge_nodes
    sides, beyond = (
        np.array([plate.width, plate.height]),
        np.zeros((len(topology.node_vertices), 2)),
    )
    for axis, (edge, opposite) in enumerate((("right", "left"), ("top", "bottom"))):
        if plate.edges[edge] == "periodic":
            beyond[walls[edge], axis], beyond[walls[opposite], axis] = (
                sides[axis] / 2,
                -sides[axis] / 2,
            )
    fields, ends = [], []
    for i, j in plate.free_strains:
        F = np.zeros((2, 2))
        F[i, j] = F[j, i] = 1 / sides[i]
        fields.append(beyond @ F)
        ends.append([2 * node + j for node in _period(topology, i)])
    difference = (
        np.tile([1.0, -1.0], len(ends)),
        (np.repeat(np.arange(len(ends)), 2), np.ravel(ends)),
    )
    return np.stack(fields), sp.csr_matrix(difference, shape=(len(ends), beyond.size))


def _period(topology, axis):
    """Right and left end nodes of the bottom edge of a cell periodic along x, axis 0.

    Along y those of the left edge.
    """
    edge, opposite = (("right", "left"), ("top", "bottom"))[axis]
    return int(topology.edge_nodes[edge][0]), int(topology.edge_nodes[opposite][0])


class Periods(NamedTuple):
    """The periods of a cell along x and y."""

    ends: Int[Array, "2 2"]
    """Far and near node of each."""
    length: Float[Array, " 2"]
    """Their dry lengths, mm."""
    periodic: Bool[Array, " 2"]
    """Whether the plate is periodic along each."""


@once_per_owner
def periods_of(topology: Topology) -> Periods:
    """The ``Periods`` of a plate."""
    plate = topology.plate
    periodic = [plate.edges[edge] == "periodic" for edge in ("right", "top")]
    ends = [_period(topology, axis) if periodic[axis] else (0, 0) for axis in range(2)]
    return Periods(np.array(ends), np.array([plate.width, plate.height], float), np.array(periodic))


def deformation_of(
    x: Float[Array, "n 2"], periods: Periods, held: Float[Array, "2 2"]
) -> Float[Array, "2 2"]:
    """Macroscopic deformation gradient (2, 2) of a plate with nodal positions ``x`` (n, 2).

    It is that of the positions between the sides of a periodic cell, free components included, and
    elsewhere the one that is ``held``.
    """
    between = (x[periods.ends[:, 0]] - x[periods.ends[:, 1]]) / periods.length[:, None]
    return jnp.where(periods.periodic, between.T, held)


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["deformation", "displacement", "fields"],
    meta_fields=["at_rest"],
)
@dataclasses.dataclass(frozen=True, eq=False)
class Edges:
    """How the edges of a plate move, and the nodes with them; a pytree.

    Edges are in the order of ``geometry.EDGES``.
    """

    deformation: Float[Array, "2 2"]
    """Macroscopic deformation that they follow."""
    displacement: Float[Array, "4 2"]
    """Displacement of each held edge, mm."""
    fields: Float[Array, "4 n 2"]
    """Nodal displacements for those of each edge, component by component."""
    at_rest: bool
    """Whether they are where they are on the dry plate."""

    def positions(self, nodes: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """Nodal positions (n, 2), mm, of the conditions: ``nodes`` (n, 2) moved with the edges.

        These are the dry nodes.
        """
        nodes = nodes if is_traced(nodes, self) else np.asarray(nodes)
        return nodes @ self.deformation.T + (self.fields * self.displacement[:, None]).sum(axis=0)

    def moved(self, setting: Setting) -> "Edges":
        """The edges as a setting moves them; those that it does not name as they are."""
        given = setting.displacement or {}
        displacement = [
            given.get(edge, own) for edge, own in zip(EDGES, self.displacement, strict=True)
        ]
        deformation = (
            self.deformation
            if setting.deformation is None
            else jnp.asarray(setting.deformation, float)
        )
        return dataclasses.replace(
            self,
            deformation=deformation,
            displacement=jnp.stack([jnp.asarray(d, float) for d in displacement]),
        )


@once_per_owner
def edges_of(topology: Topology, driven: bool = False) -> Edges:
    """The `Edges` of a plate, which a control moves if they are ``driven``."""
    plate, shape = topology.plate, (len(EDGES), len(topology.node_vertices), 2)
    displacement = np.array([plate.displacement[edge] for edge in EDGES], dtype=float)
    fields = _edge_fields(topology) if driven or displacement.any() else np.zeros(shape)
    return Edges(np.array(plate.dry_deformation), displacement, fields, not plate.moved)


def _edge_fields(topology):
    """Nodal displacements (4, n, 2) of edge displacements, continued by thin-plate splines."""
    plate, nodes = topology.plate, topology.partition.vertices[topology.node_vertices]
    fields = np.zeros((len(EDGES), len(nodes), 2))
    for component in range(2):
        prescribed = {}
        for number, edge in enumerate(EDGES):
            if component in held_components(plate.edges, edge):
                prescribed |= dict.fromkeys(topology.edge_nodes[edge].tolist(), number)
        at, by = (
            np.array(list(prescribed), dtype=int),
            np.array(list(prescribed.values()), dtype=int),
        )
        if len(at):
            fields[:, :, component] = _carried(
                nodes, at, np.equal.outer(by, np.arange(len(EDGES))).astype(float), plate.width
            ).T
    return fields[:, periodic_images(topology)]


def _carried(nodes, at, values, width):
    """Displacements (n, e) that are ``values`` (a, e) at the nodes ``at``.

    The first everywhere else if these lie on one line.
    """
    extent = np.ptp(nodes[at], axis=0)
    # there is no spline through points of a line; if it cuts holes, to round-off
    flat = extent.min() <= ROUND_OFF * extent.max()
    field = (
        np.repeat(values[:1], len(nodes), axis=0)
        if flat
        else thin_plate_matrix(nodes[at], nodes, width) @ values
    )
    field[at] = values
    return field
