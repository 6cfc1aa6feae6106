"""A problem of equilibrium with the solvent that moves in it: all that a transient state depends on besides bath and time."""

import dataclasses
import functools

import jax
import numpy as np
import scipy.sparse as sp

from .._memo import once_per_owner
from .._types import Bool, Int, Scalar
from ..discretisation import Body, Connectivity, room
from ..linalg import Pattern, analyse
from ..mechanics import MOMENTS, Equations, Problem, Solvent, node_pairs, places_of, reference_groups, solvent_of, unknowns


@functools.partial(jax.tree_util.register_dataclass, data_fields=["problem", "solvent", "D"], meta_fields=["wetted"])
@dataclasses.dataclass(frozen=True, eq=False)
class Transport:
    """Equations of equilibrium and the solvent that moves; a pytree."""

    problem: Equations
    """A `Problem` driven by the chemical potential, without contact; in the ``shared`` form its `Equations`."""
    solvent: Solvent
    """The chemical potential as a field."""
    D: Scalar
    """Diffusivity of the solvent, mm^2 per unit of time."""
    wetted: tuple[str | int, ...]
    """The wetted parts of the boundary; none in the ``shared`` form, where numbers stand for them."""

    @property
    def model(self) -> Body:
        """The discretised plate."""
        return self.problem.model

    @property
    def lengths(self) -> dict[str, int]:
        """Numbers by letter, see `Equations`; ``w`` of wetted nodes."""
        return {**self.problem.lengths, "w": len(self.solvent.wetting.node_parts)}

    @functools.cached_property
    def shared(self) -> "Transport":
        """The same as the compiled programs take it."""
        problem = self.problem.shared
        return Transport(problem, self.solvent.shared(problem.model, self.model), np.asarray(self.D, float), ())

    @functools.cached_property
    def saddle(self) -> "Saddle":
        """The pattern of the matrix of a Newton step."""
        return saddle(self.problem.model.lists, self.wetted, tuple(block.places.shape for block in self.shared.solvent.blocks))


def transport(problem: Problem, wetted: tuple[str | int, ...], D: Scalar = 1.0) -> Transport:
    """`Transport` of a problem whose boundary is ``wetted`` in these parts."""
    return Transport(problem, solvent_of(problem.model, wetted), D, wetted)


# --- the matrix of a Newton step -------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class Saddle:
    """Where the entries of the matrix [[K, -B^T], [-B, -A]] about positions and mu go; NumPy."""

    pattern: Pattern
    """Its pattern; the unknowns of mu come after those of the positions."""
    real: tuple[Bool[np.ndarray, "..."], ...]
    """Per block (c, a), which nodes of the patches' lists are no padding."""
    slots: tuple[Int[np.ndarray, "..."], ...]
    """Per block (c, t) the pair of places of each entry a <= b of a patch's list, both in the sizes of the ``shared`` form."""
    room: int
    """Room for pairs of places; the slot of those that are none."""
    pairs: Int[np.ndarray, "s 2"]
    """Pairs i <= j of groups that are places of one patch."""
    groups: Int[np.ndarray, " u"]
    """Groups in which the unknowns of mu are kept."""


@once_per_owner
def saddle(lists: Connectivity, wetted: tuple[str | int, ...], shapes: tuple[tuple[int, int], ...]) -> Saddle:
    """`Saddle` of a model with these ``lists``; ``shapes`` are those (c, b) of the lists of places in the shared form."""
    positions, first = reference_groups(lists)
    nodes, n = lists.topology.partition.vertices[lists.topology.node_vertices], len(lists.topology.node_vertices)
    moments, groups = _moments(lists, first, len(positions))
    pairs, slots, size = _place_pairs(lists, wetted, len(positions), shapes)
    real = tuple(lists.support[patches][:, : int((lists.support[patches] > 0).sum(axis=1).max())] > 0 for patches in lists.patches)
    couplings = []
    for patches, own in zip(lists.patches, real, strict=True):
        numbers = n + first[patches][:, None] + np.arange(_count(lists, patches))
        ends = np.broadcast_arrays(lists.nodes[patches][:, None, : own.shape[1]], numbers[:, :, None])
        couplings.append(np.stack(ends, axis=-1)[np.broadcast_to(own[:, None], ends[0].shape)])
    free, each = unknowns(lists), np.arange(len(positions))
    first_components = sp.csr_array((np.ones(len(each)), (2 * each, each)), (2 * len(each), len(each)))
    fields = sp.csr_matrix(sp.block_diag([free.matrix, first_components @ moments]))
    masters = np.concatenate([np.asarray(free.masters), 2 * (n + groups)])
    every = np.concatenate([node_pairs(lists)[0], *couplings, n + pairs])
    pattern = analyse(every, np.concatenate([nodes, positions]), masters, [fields], late=n)
    return Saddle(pattern, real, slots, size, pairs, groups)


def _count(lists, patches):
    """Number of the groups that carry volume of each of these patches, of one kind."""
    return len(MOMENTS) if lists.linear[patches[0]] else 1


def _moments(lists, first, size):
    """Matrix (g, u) from the unknowns of mu to its values in the groups that carry volume, and the groups in which they are kept."""
    linear, alone = first[lists.linear], first[~lists.linear]
    kept = np.sort(np.concatenate([(linear[:, None] + np.arange(MOMENTS.shape[1])).ravel(), alone]))
    column = np.searchsorted(kept, linear)[:, None, None] + np.arange(MOMENTS.shape[1])
    row = linear[:, None, None] + np.arange(len(MOMENTS))[:, None]
    row, column, values = (part.ravel() for part in np.broadcast_arrays(row, column, MOMENTS))
    rows, columns = np.concatenate([row, alone]), np.concatenate([column, np.searchsorted(kept, alone)])
    return sp.csr_array((np.concatenate([values, np.ones(len(alone))]), (rows, columns)), (size, len(kept))), kept


def _place_pairs(lists, wetted, size, shapes):
    """Pairs of places that are groups, their slots and room, see `Saddle`."""
    (at, supports), _ = places_of(lists, wetted)
    keys, numbers = [], []
    for patches, (_, wide) in zip(lists.patches, shapes, strict=True):
        a, b = np.triu_indices(at.shape[1])
        own, real = at[patches], (supports[patches] > 0) & (at[patches] < size)
        low, high = np.minimum(own[:, a], own[:, b]), np.maximum(own[:, a], own[:, b])
        keys.append(np.where(real[:, a] & real[:, b], low.astype(np.int64) * size + high, size * size))
        numbers.append(a * wide - a * (a - 1) // 2 + b - a)
    unique = np.unique(np.concatenate([key.ravel() for key in keys]))
    unique = unique[unique < size * size]
    most, slots = room(len(unique)), []
    for key, number, (c, wide) in zip(keys, numbers, shapes, strict=True):
        found = np.full((c, wide * (wide + 1) // 2), most, np.int32)
        found[: len(key), number] = np.where(key < size * size, np.searchsorted(unique, key), most)
        slots.append(found)
    return np.stack([unique // size, unique % size], axis=1), tuple(slots), most
