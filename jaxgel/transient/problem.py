"""Problem of transient swelling: the problem of equilibrium with the solvent that moves in it."""

import dataclasses
import functools
from typing import NamedTuple

import jax
import numpy as np
import scipy.sparse as sp

from .._memo import once_per_owner
from .._tracing import is_traced
from .._types import Bool, Float, Int, Scalar
from ..discretisation import Body, Connectivity
from ..linalg import Pattern, analyse
from ..mechanics import (
    MOMENTS,
    Equations,
    Problem,
    Solvent,
    node_pairs,
    pair_slots,
    places_of,
    reference_groups,
    solvent_of,
    unknowns,
    wetted_groups,
)


class PatchLists(NamedTuple):
    """Places and nodes of the patches of a block, and gradients at their points; NumPy.

    Rows of the gradients are the components at one quadrature point after the other, d = 2 q.
    """

    places: Int[np.ndarray, "c b"]
    """Places on which mu depends."""
    nodes: Int[np.ndarray, "c a"]
    """Nodes."""
    means: Int[np.ndarray, " c"]
    """Unknowns that are the mean of mu in each patch."""
    gradients: Float[np.ndarray, "c d b"]
    """Gradients of the shape functions of places, 1/mm."""
    stretches: Float[np.ndarray, "c d a"]
    """Those of nodes."""


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["problem", "solvent", "D"],
    meta_fields=["wetted"],
)
@dataclasses.dataclass(frozen=True, eq=False)
class Transport:
    """Equations of equilibrium and the solvent that moves; a pytree."""

    problem: Equations
    """A `Problem` driven by the chemical potential, without contact.

    In the ``shared`` form its `Equations`.
    """
    solvent: Solvent
    """The chemical potential as a field."""
    D: Scalar
    """Diffusivity of the solvent, mm^2 per unit of time."""
    wetted: tuple[str | int, ...]
    """The wetted parts of the boundary; none in the ``shared`` form, if numbers stand for them."""

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
        D = self.D if is_traced(self.D) else np.asarray(self.D, float)
        made = Transport(problem, self.solvent.shared(problem.model, self.model), D, ())
        # NumPy's arrays would be copied at every call of a program
        return made if is_traced(made) else jax.device_put(made)

    @functools.cached_property
    def lists(self) -> list[PatchLists]:
        """Per block what the patches know of."""
        blocks = zip(self.solvent.blocks, self.model.blocks, self.saddle.means, strict=True)
        return [
            PatchLists(
                *map(np.asarray, (on.places, block.nodes, means)),
                *map(_rows, (on.dpsi, block.dphi)),
            )
            for on, block, means in blocks
        ]

    @functools.cached_property
    def saddle(self) -> "Saddle":
        """The pattern of the matrix of a Newton step."""
        return saddle(self.problem.model.lists, self.wetted)


def _rows(gradients):
    """Gradients (c, q, b, 2) as matrices (c, 2q, b)."""
    c, q, b, _ = gradients.shape
    return np.ascontiguousarray(np.asarray(gradients).swapaxes(2, 3)).reshape(c, 2 * q, b)


def transport(problem: Problem, wetted: tuple[str | int, ...], D: Scalar = 1.0) -> Transport:
    """`Transport` of a problem whose boundary is ``wetted`` in these parts."""
    return Transport(problem, solvent_of(problem.model, wetted), D, wetted)


# --- the matrix of a Newton step ------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class Saddle:
    """Where the entries of the matrix [[K, -B^T], [-B, -A]] about positions and mu go; NumPy."""

    pattern: Pattern
    """Its pattern; the unknowns of mu come after those of the positions."""
    real: tuple[Bool[np.ndarray, "..."], ...]
    """Per block (c, a), which nodes of the patches' lists are no padding."""
    slots: tuple[Int[np.ndarray, "..."], ...]
    """Per block (c, t) the pair of places of each entry a <= b of a patch's list."""
    pairs: Int[np.ndarray, "s 2"]
    """Pairs i <= j of groups that are places of one patch.

    One more slot stands for those that are none.
    """
    groups: Int[np.ndarray, " u"]
    """Groups in which the unknowns of mu are kept."""
    fields: sp.csr_matrix
    """Matrix (2n, f) from the unknowns of the positions to nodal fields."""
    values: sp.csr_array
    """Matrix (g, u) from the unknowns of mu to its values in the groups."""
    means: tuple[Int[np.ndarray, "..."], ...]
    """Per block (c,) the unknown that is the mean of mu in each patch."""
    sides: tuple[Int[np.ndarray, "3 _"], ...]
    """Per block the groups with wetted sides: numbers in ``Wetting``, patches, places.

    Places are those in the lists.
    """


@once_per_owner
def saddle(lists: Connectivity, wetted: tuple[str | int, ...]) -> Saddle:
    """`Saddle` of a model with these ``lists``, whose boundary is ``wetted`` in these parts."""
    positions, first = reference_groups(lists)
    nodes, n = (
        lists.topology.partition.vertices[lists.topology.node_vertices],
        len(lists.topology.node_vertices),
    )
    values, groups = _values(lists, first, len(positions))
    at, supports = places_of(lists, wetted)[0]
    counts = (supports > 0) & (at < len(positions))  # places that are groups
    pairs, slots = pair_slots(
        [(at[patches], counts[patches]) for patches in lists.patches], len(positions)
    )
    real = tuple(
        lists.support[patches][:, : int((lists.support[patches] > 0).sum(axis=1).max())] > 0
        for patches in lists.patches
    )
    means, couplings, sides = [], [], []
    wet = wetted_groups(lists, wetted)
    for patches, own in zip(lists.patches, real, strict=True):
        numbers = n + first[patches][:, None] + np.arange(_count(lists, patches))
        ends = np.broadcast_arrays(
            lists.nodes[patches][:, None, : own.shape[1]], numbers[:, :, None]
        )
        couplings.append(np.stack(ends, axis=-1)[np.broadcast_to(own[:, None], ends[0].shape)])
        means.append(np.searchsorted(groups, first[patches]))
        inside = at[patches] - first[patches][:, None]  # a group of the patch itself
        patch, place = np.nonzero(
            (inside >= 0)
            & (inside < _count(lists, patches))
            & (supports[patches] > 0)
            & np.isin(at[patches], wet)
        )
        sides.append(np.stack([np.searchsorted(wet, at[patches][patch, place]), patch, place]))
    free, each = unknowns(lists), np.arange(len(positions))
    first_components = sp.csr_array(
        (np.ones(len(each)), (2 * each, each)), (2 * len(each), len(each))
    )
    fields = sp.csr_matrix(sp.block_diag([free.matrix, first_components @ values]))
    masters = np.concatenate([np.asarray(free.masters), 2 * (n + groups)])
    every = np.concatenate([node_pairs(lists)[0], *couplings, n + pairs])
    pattern = analyse(every, np.concatenate([nodes, positions]), masters, [fields], late=n)
    return Saddle(
        pattern, real, slots, pairs, groups, free.matrix, values, tuple(means), tuple(sides)
    )


def _count(lists, patches):
    """Number of the groups that carry volume of each of these patches, of one kind."""
    return len(MOMENTS) if lists.linear[patches[0]] else 1


def _values(lists, first, size):
    """Matrix (g, u) from the unknowns of mu to groups with volume, and the groups of these.

    The latter are the groups in which they are kept.
    """
    linear, alone = first[lists.linear], first[~lists.linear]
    kept = np.sort(np.concatenate([(linear[:, None] + np.arange(MOMENTS.shape[1])).ravel(), alone]))
    column = np.searchsorted(kept, linear)[:, None, None] + np.arange(MOMENTS.shape[1])
    row = linear[:, None, None] + np.arange(len(MOMENTS))[:, None]
    row, column, values = (part.ravel() for part in np.broadcast_arrays(row, column, MOMENTS))
    rows, columns = (
        np.concatenate([row, alone]),
        np.concatenate([column, np.searchsorted(kept, alone)]),
    )
    return sp.csr_array(
        (np.concatenate([values, np.ones(len(alone))]), (rows, columns)), (size, len(kept))
    ), kept
