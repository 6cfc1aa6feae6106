"""Symmetries of a problem and of its states, among those of the square.

They take its cloud, gel and loads, and a state of it, to themselves. A group is a tuple of names of
``geometry.SYMMETRIES``, the identity left out. Host NumPy: where each symmetry takes nodes,
quadrature points and patches is found once for a cloud; whether it does so to round-off is asked of
every model.
"""

import dataclasses
import functools
import operator
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from .._memo import once_per_owner
from .._tracing import is_traced, outside_traces
from .._types import Array, Bool, Float, Int
from ..cloud import Topology
from ..discretisation import Connectivity, Model
from ..geometry import SYMMETRIES, keeps_edges
from ..materials import LocalGel, LocalValues, neo_hookean
from ..mechanics import Problem, free_dofs

EXACT = 1e-10  # of the spacing: how far a place may lie from its image's; round-off leaves 1e-12
EQUAL = 1e-10  # relative difference of weights, loads and parameters that are equal
NEAREST = 1e-6  # of the spacing, where the places of a cloud belong together
STATE = 1e-9  # of the spacing: how far a symmetric state may be from its image
IDENTITY = "identity"
NAMES: dict[tuple[str, ...], str] = {
    (): "C1",
    ("rotation by 180",): "C2",
    ("rotation by 90", "rotation by 180", "rotation by 270"): "C4",
    ("x -> -x",): "D1 (x -> -x)",
    ("y -> -y",): "D1 (y -> -y)",
    ("x <-> y",): "D1 (x <-> y)",
    ("x <-> -y",): "D1 (x <-> -y)",
    ("x -> -x", "y -> -y", "rotation by 180"): "D2 (axes)",
    ("x <-> y", "x <-> -y", "rotation by 180"): "D2 (diagonals)",
    tuple(SYMMETRIES): "D4",
}
"""Group -> its name: cyclic groups C and dihedral groups D of the square, by Schoenflies."""


@dataclasses.dataclass(frozen=True, eq=False)
class Images:
    """Where one symmetry takes what a cloud consists of; NumPy arrays."""

    matrix: Float[np.ndarray, "2 2"]
    """Its matrix."""
    nodes: Int[np.ndarray, " n"]
    """The node to which each node goes."""
    points: Int[np.ndarray, " p"]
    """The quadrature point to which each point goes."""
    patches: Int[np.ndarray, " c"]
    """The patch to which each patch goes."""

    @property
    def dofs(self) -> Int[np.ndarray, " d"]:
        """The degree of freedom to which each one goes, ~ that number if its sign changes."""
        component = np.abs(self.matrix).argmax(axis=0)  # where a unit vector of each component goes
        numbers = 2 * self.nodes[:, None] + component
        return np.where(self.matrix[component, [0, 1]] < 0, ~numbers, numbers).ravel()


def symmetries_of(problem: Problem) -> tuple[str, ...]:
    """Group of a problem: symmetries of plate, cloud, gel and loads, to round-off.

    None if only nearly, or if places, loads or fields are traced, whose numbers are not known.
    """
    found = possible_symmetries(problem) if are_places_known(problem) else ()
    return _closed(tuple(name for name in found if has_symmetries(problem, (name,))))


def possible_symmetries(problem: Problem) -> tuple[str, ...]:
    """Those of the reference cloud of a problem; none if its network may have a direction."""
    found = tuple(images(problem.model.lists))
    return found if found and _is_isotropic(problem.gel) else ()


def are_places_known(problem: Problem) -> bool:
    """Whether none of the numbers that `has_symmetries` compares is traced."""
    model = problem.model
    blocks = [(block.position, block.weight) for block in model.blocks]
    return not is_traced(model.nodes, blocks, problem.loads, _fields(problem.gel))


def has_symmetries(problem: Problem, group: tuple[str, ...]) -> np.bool_ | Bool[Array, ""]:
    """Whether places, loads and fields of a problem have a ``group``, to round-off.

    The group is one of the reference cloud's. Numbers of the problem may be traced.
    """
    found = images(problem.model.lists)
    return functools.reduce(
        operator.and_, [_keeps(found[name], problem) for name in group], np.True_
    )


def symmetries_of_state(
    x: Float[Array, "n 2"], model: Model, group: tuple[str, ...]
) -> tuple[str, ...]:
    """The symmetries of a ``group`` that a state with the nodal positions ``x`` (n, 2) has."""
    return _kept_by(np.asarray(x), model, group, STATE * model.cloud.spacing)


def symmetries_of_field(
    field: Float[Array, "n 2"], model: Model, group: tuple[str, ...]
) -> tuple[str, ...]:
    """Symmetries of a ``group`` that a nodal field (n, 2) has, to ``STATE`` of its maximum.

    The field may be a mode; relative to its largest value.
    """
    field = np.asarray(field)
    return _kept_by(field, model, group, STATE * np.abs(field).max())


def _kept_by(field, model, group, tolerance):
    found = images(model.lists) if group else {}
    apart = {
        name: np.abs(field[found[name].nodes] - field @ found[name].matrix.T).max()
        for name in group
    }
    return _closed(tuple(name for name in group if apart[name] < tolerance))


def _closed(group):
    """The group, or none if round-off has let only a part of it pass."""
    return group if group in NAMES else ()


@once_per_owner
def node_images(topology: Topology) -> dict[str, Int[np.ndarray, " n"]]:
    """Name -> image of each node, for the symmetries of edges and reference nodes.

    The plate's edges and the nodes of the reference cloud.
    """
    nodes, found = topology.partition.vertices[topology.node_vertices], {}
    tree = cKDTree(nodes)
    for name, matrix in SYMMETRIES.items():
        apart, image = tree.query(nodes @ np.array(matrix, dtype=float).T)
        if apart.max() < NEAREST * topology.spacing and keeps_edges(
            topology.plate, np.array(matrix, dtype=float)
        ):
            found[name] = image
    return found


@once_per_owner
def images(lists: Connectivity) -> dict[str, Images]:
    """Name -> `Images` of the symmetries that the reference cloud has, with its cells."""
    topology, found = lists.topology, {}
    points = np.asarray(topology.quadrature.points(topology.partition.vertices))
    tree = cKDTree(points)
    for name, node in node_images(topology).items():
        matrix = np.array(SYMMETRIES[name], dtype=float)
        away, point = tree.query(points @ matrix.T)
        patches = np.zeros(len(lists.linear), dtype=int)
        patches[lists.owner] = lists.owner[point]
        together = np.array_equal(patches[lists.owner], lists.owner[point]) and np.array_equal(
            lists.linear[patches], lists.linear
        )
        same = np.allclose(topology.node_spacing[node], topology.node_spacing, rtol=EQUAL, atol=0.0)
        between = topology.node_regions[:, 0] != topology.node_regions[:, 1]
        same = same and np.array_equal(between[node], between)
        if (
            away.max() < NEAREST * topology.spacing
            and together
            and same
            and len(np.unique(point)) == len(point)
        ):
            found[name] = Images(matrix, node, point, patches)
    return found


def characters(modes: Float[np.ndarray, "m n 2"], model: Model) -> dict[str, float]:
    """Name -> trace of each symmetry in the space of orthonormalised modes (m, n, 2)."""
    fields = np.linalg.qr(modes.reshape(len(modes), -1).T)[0].T.reshape(modes.shape)
    nodes, traces = np.asarray(model.cloud.nodes), {}
    for name, image in node_images(model.lists.topology).items():
        matrix = np.array(SYMMETRIES[name], dtype=float)
        # where the holes of the cloud have moved alike
        if np.abs(nodes[image] - nodes @ matrix.T).max() < NEAREST * model.cloud.spacing:
            moved = np.empty_like(fields)
            moved[:, image] = fields @ matrix.T
            traces[name] = float(np.sum(fields * moved))
    return traces


def _keeps(image, problem):
    """Whether a symmetry keeps nodes, weighted quadrature points, gel parameters and loads."""
    model, tolerance = problem.model, EXACT * problem.model.cloud.spacing
    nodes, loads = (
        part if is_traced(part) else np.asarray(part) for part in (model.nodes, problem.loads)
    )
    held, there = (
        free_dofs(model.lists.topology).held,
        np.where(image.dofs < 0, ~image.dofs, image.dofs),
    )
    positions, weights = (
        _by_point(model.lists, [getattr(block, name) for block in model.blocks])
        for name in ("position", "weight")
    )
    fields = [_by_point(model.lists, field.points) for field in _fields(problem.gel)]
    moved = [  # values at the images, those that they should have, and how far these may be apart
        (nodes[image.nodes], nodes @ image.matrix.T, tolerance),
        (positions[image.points], positions @ image.matrix.T, tolerance),
        (weights[image.points], weights, EQUAL * weights.max()),
        (loads[image.nodes], loads @ image.matrix.T, EQUAL * abs(loads).max()),
        *((values[image.points], values, EQUAL * abs(values)) for values in fields),
    ]
    # of a cell that is periodic one way a corner is held
    same = np.bool_(np.array_equal(held[there], held))
    return functools.reduce(
        operator.and_, [(abs(one - other) <= most).all() for one, other, most in moved], same
    )


def _by_point(
    lists: Connectivity, parts: Sequence[Float[Array, "_ _ ..."]]
) -> Float[Array, "p ..."]:
    """Values (p, ...) of all quadrature points by number, from those (c, q, ...) of each block."""
    numbers = np.concatenate([block.ravel() for block in lists.points])
    place = np.zeros(len(lists.cell_of_point), dtype=int)
    place[numbers[numbers >= 0]] = np.flatnonzero(numbers >= 0)
    if is_traced(parts):
        return jnp.concatenate([part.reshape(-1, *part.shape[2:]) for part in parts])[place]
    # in NumPy: nothing is compiled
    own = [np.asarray(part) for part in parts]
    return np.concatenate([part.reshape(-1, *part.shape[2:]) for part in own])[place]


def _fields(gel):
    """The parameters of a gel that differ from place to place."""
    return [part for part in jax.tree.leaves(gel, is_leaf=_is_local) if _is_local(part)]


def _is_local(part):
    return isinstance(part, LocalValues)


def _is_isotropic(gel: LocalGel) -> bool:
    """Whether the network's energy is invariant under rotations and mirrors of the deformation.

    It is tried at a few deformations and both ends of each field; unknown if they are traced.
    """
    if gel.network is neo_hookean:
        return True
    if is_traced(gel):
        return False
    F = np.array([[[1.31, 0.23], [-0.11, 1.17]], [[1.05, -0.34], [0.21, 1.43]]])
    with outside_traces():  # numbers, also inside jit
        some = [
            jax.tree.map(
                lambda part, at=at: at(part.groups) if _is_local(part) else part,
                gel,
                is_leaf=_is_local,
            )
            for at in (jnp.min, jnp.max)
        ]
        energies = [
            [float(gel.network(jnp.asarray(M @ one @ M.T), at)) for one in F for at in some]
            for M in (
                [np.eye(2), *(np.array(matrix, dtype=float) for matrix in SYMMETRIES.values())]
            )
        ]
    return bool(np.allclose(energies, energies[0], rtol=1e-12, atol=0.0))
