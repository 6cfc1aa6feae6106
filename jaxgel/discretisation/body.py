"""The arrays of a discretised gel, and their sizes.

Index letters: ``c`` patch, ``q`` quadrature point of a patch, ``g`` volume group, ``p`` point,
``a b`` node of a patch's list, ``i j`` space, ``r`` row of an area form. A patch is a group of
integration cells with one pressure field; see `patches` and `pressures`. Its node list holds all
nodes whose support reaches the patch or its contour; padding has support 0. Patches of similar size
share a ``PatchBlock`` of padded arrays.

A body of a model has arrays of the model's own sizes. That which the compiled programs take, its
`shared_body`, has those of `ladder`. Padded patches come after ``count`` others, from which
programs that go from patch to patch stop; all padding is without weight.
"""

import dataclasses
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._memo import once_per_owner
from .._sizes import NODES, resized, room, rung
from .._types import Array, Bool, Float, Int, Scalar, Shaped
from .interpolation import Interpolation
from .ladder import of_patch, patches_of_blocks

NONE = 2**30  # number of a volume group that no model has


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PatchBlock:
    """Patches of similar size; a pytree."""

    patches: Int[Array, " c"]
    """Patch numbers."""
    groups: Int[Array, "c g"]
    """Numbers of the volume groups; none of the model's for padding."""
    nodes: Int[Array, "c a"]
    """Node numbers in ascending order, padded with the first one."""
    position: Float[Array, " c #q 2"]
    """Dry positions of the quadrature points, mm; padding repeats a point."""
    dphi: Float[Array, " c #q a 2"]
    """Shape function gradients, 1/mm, at each point or their cell mean; 0 for padded nodes."""
    weight: Float[Array, " c #q"]
    """Quadrature weights, mm^2; 0 for padded points."""
    group_weight: Float[Array, "c _ g"]
    """Weights of J at the points in each volume group, see `pressures`."""
    contour: Float[Array, "c 2 r a"]
    """Rows of the area form of the contour, see `consistency.area_rows`."""
    carrying: int = dataclasses.field(metadata={"static": True})
    """Number of the groups of a patch that carry its volume, in equal shares.

    The others are held.
    """
    count: Int[Array, ""] | None = None
    """Number of the patches, of which padding repeats the last without weight.

    None if all are patches.
    """

    @property
    def n_groups(self) -> int:
        """Number of volume groups of a patch."""
        return self.group_weight.shape[2]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, kw_only=True)
class Body:
    """All that is needed to integrate an energy, as arrays; a pytree."""

    nodes: Float[Array, "n 2"]
    """Dry positions of the nodes, mm."""
    blocks: tuple[PatchBlock, ...]
    """Patches, in blocks of similar size."""
    carries: Shaped[Array, " g"]
    """Whether each volume group carries volume, bool; the others are held.

    Of tangents what JAX puts in its place.
    """
    outline: Interpolation | None
    """Shape functions at all outline vertices, arc after arc.

    None if a derivative does not depend on them.
    """
    axial_stretch: Scalar | None
    """Axial stretch of generalised plane strain; None for other kinematics."""
    across: Scalar
    """Side of the plate over the smallest spacing of the nodes."""
    film: bool = dataclasses.field(metadata={"static": True})
    """Whether the plate is a film in plane stress."""
    contact: Any = None
    """The ``mechanics.Contact`` of hole boundaries with themselves; None if they may overlap."""

    @property
    def lengths(self) -> dict[str, int]:
        """Numbers of nodes and volume groups, by letter."""
        return {"n": self.nodes.shape[0], "g": self.carries.shape[0]}


def numbered(blocks: Iterable[PatchBlock]) -> tuple[PatchBlock, ...]:
    """The blocks with their volume groups numbered block after block, patch after patch."""
    found, first = [], 0
    for block in blocks:
        groups = first + np.arange(len(block.nodes) * block.n_groups).reshape(-1, block.n_groups)
        found.append(dataclasses.replace(block, groups=groups))
        first += groups.size
    return tuple(found)


def carrying_groups(blocks: tuple[PatchBlock, ...]) -> Bool[np.ndarray, " g"]:
    """Whether each volume group of the blocks carries volume."""
    return np.concatenate(
        [np.tile(np.arange(block.n_groups) < block.carrying, len(block.nodes)) for block in blocks]
    )


# --- sizes that models share ----------------------------------------------------------------------


def shared_body(body: Body) -> Body:
    """The arrays of a body in sizes that similar bodies share."""
    nodes = room(len(body.nodes), NODES)
    shapes = [
        (len(block.nodes), block.weight.shape[1], block.carrying > 1) for block in body.blocks
    ]
    blocks = tuple(
        map(_padded, body.blocks, patches_of_blocks(*map(list, zip(*shapes, strict=True)), nodes))
    )
    outline = None if body.outline is None else _padded_outline(body.outline)
    return Body(
        nodes=resized(body.nodes, (nodes, 2)),
        blocks=blocks,
        carries=resized(body.carries, (room(len(body.carries)),)),
        outline=outline,
        axial_stretch=None
        if body.axial_stretch is None
        else jnp.asarray(body.axial_stretch, float),
        across=jnp.asarray(body.across, float),
        film=body.film,
        contact=body.contact,
    )


@once_per_owner
def _padded(block, patches):
    """A block with room for so many ``patches``.

    Further points repeat the last one of their patch.
    """
    c, q, a, _ = block.dphi.shape
    r, g = block.contour.shape[2], block.n_groups
    points, rows, neighbours = of_patch(q, r, a, linear=block.carrying > 1)

    def more(values, *shape):
        return resized(values, (patches, *shape), edge=True)

    groups = np.full((patches, g), NONE)
    groups[:c] = block.groups
    return PatchBlock(
        patches=more(block.patches),
        groups=groups,
        nodes=more(block.nodes, neighbours),
        position=more(block.position, points, 2),
        dphi=more(resized(block.dphi, (c, q, neighbours, 2)), points, neighbours, 2),
        weight=resized(block.weight, (patches, points)),
        group_weight=more(block.group_weight, points, g),
        contour=resized(block.contour, (patches, 2, rows, neighbours)),
        carrying=block.carrying,
        count=np.asarray(c, np.int32),
    )


@once_per_owner
def _padded_outline(outline):
    """An interpolation with room for more points."""
    return outline.with_room(rung(len(outline.points)))
