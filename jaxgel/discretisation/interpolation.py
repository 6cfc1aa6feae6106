"""Shape functions at points of a cloud, by lists of the nodes in reach, padded by support 0.

Index letters: ``p`` point, ``a`` node of a list, ``l`` list, ``i j`` space.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._compiled import compiled
from .._primitives import differentiated_value
from .._sizes import joined, padded, resized, rung, step, taken
from .._tracing import is_traced
from .._types import Array, Float, Int, Num
from ..cloud import Cloud
from .moving_least_squares import shape_functions, shape_functions_and_gradients

BATCH = 64  # points whose shape functions are evaluated together
# points of one call of the program that evaluates them: one size, so that it serves every cloud
GROUP = 1024
FINE = 2  # sizes to a doubling of the number of groups: each group costs time
# room for neighbours in the program that evaluates them: few, and few programs
WIDTHS = (72, 96, 128, 192)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Interpolation:
    """Shape functions at chosen material points; a pytree."""

    points: Float[Array, "p 2"]
    """The points on the dry plate, mm."""
    nodes: Int[Array, "p a"]
    """Node numbers."""
    support: Float[Array, "p a"]
    """Support radius of each node, mm; 0 for padding."""
    phi: Float[Array, "p a"]
    """Shape functions."""
    dphi: Float[Array, "p a 2"]
    """Their gradients, 1/mm."""

    @compiled()
    def position(self, x: Float[Array, "n d"]) -> Float[Array, "p d"]:
        """Deformed positions of the points for nodal ``x``, mm, or other nodal fields (d)."""
        return jnp.einsum("pa,pai->pi", self.phi, x[self.nodes])

    @compiled()
    def deformation_gradient(self, x: Float[Array, "n 2"]) -> Float[Array, "p 2 2"]:
        """Deformation gradients at the points."""
        return jnp.einsum("pai,paj->pij", x[self.nodes], self.dphi)

    def with_room(self, count: int) -> "Interpolation":
        """The same with room for ``count`` points: the last one again."""
        return jax.tree.map(lambda values: padded(values, count), self)


def interpolate(
    cloud: Cloud,
    points: Float[Array, "p 2"],
    neighbours: tuple[Int[np.ndarray, "p a"], Float[np.ndarray, "p a"]],
    basis: str,
) -> Interpolation:
    """``Interpolation`` at points with lists of ``neighbours``, see ``neighbours_of_points``."""
    lists, supports = neighbours
    phi, dphi = evaluate_points(
        cloud.nodes, points, lists, supports, np.arange(len(lists)), basis=basis
    )
    return Interpolation(points, lists, supports, phi, dphi)


def evaluate_points(
    nodes: Float[Array, "n 2"],
    points: Float[Array, "p 2"],
    lists: Int[np.ndarray, "l a"],
    supports: Float[np.ndarray, "l a"],
    owner: Int[np.ndarray, " p"],
    *,
    basis: str,
    gradients: bool = True,
) -> tuple[Float[Array, "p a *i"], ...]:
    """Shape functions at ``points`` with the lists of their owners, and their ``gradients``.

    The lists are those of nodes and supports.
    """
    count, shape = len(points), (len(points), lists.shape[1])
    points, owner = (padded(part, size_of_groups(count)) for part in (points, owner))
    lists, supports = widened(lists), widened(supports)
    values = evaluate_groups(
        padded(nodes, rung(len(nodes))),
        points,
        lists,
        supports,
        owner,
        count,
        basis=basis,
        gradients=gradients,
    )
    return tuple(resized(value, (*shape, *value.shape[2:])) for value in values)


def size_of_groups(count: int) -> int:
    """Number of points of the groups that hold ``count`` points."""
    return GROUP * rung(-(-count // GROUP), FINE)


def widened(lists: Num[np.ndarray, "l a"]) -> Num[np.ndarray, "l b"]:
    """Lists of nodes or supports, padded with zero columns to one of the ``WIDTHS``."""
    return np.pad(lists, ((0, 0), (0, step(lists.shape[1], WIDTHS) - lists.shape[1])))


def evaluate_groups(
    nodes: Float[Array, "n 2"],
    points: Float[Array, "p 2"],
    lists: Int[np.ndarray, "l a"],
    supports: Float[np.ndarray, "l a"],
    owner: Int[np.ndarray, " p"],
    count: int,
    *,
    basis: str,
    gradients: bool = True,
) -> tuple[Float[Array, "p a *i"], ...]:
    """`evaluate_points` for whole groups of points and `widened` lists.

    The first ``count`` are asked for. Groups without one of these hold the values of another group;
    in a trace, whose programs must not depend on ``count``, their own. In another program all
    points are one group, and their functions are compiled once.
    """
    in_program = is_traced(jax.tree.map(differentiated_value, (nodes, points)))
    own = owner.reshape(-1, len(owner) if in_program else GROUP)
    used = own if is_traced(nodes, points) else own[: -(-count // GROUP)]
    groups = [
        _evaluated(
            taken(points, numbers),
            taken(nodes, lists[of]),
            supports[of],
            basis=basis,
            gradients=gradients,
        )
        for numbers, of in zip(np.arange(used.size).reshape(used.shape), used, strict=True)
    ]
    return tuple(
        joined([*parts, *parts[-1:] * (len(own) - len(used))])
        for parts in zip(*groups, strict=True)
    )


@compiled(static=("basis", "gradients"))
def _evaluated(points, neighbours, supports, *, basis, gradients):
    """Shape functions (g, a) and gradients at points (g, 2) with neighbours (g, a, 2).

    Each point has supports (g, a) of its own.
    """

    @jax.checkpoint
    def one(point):
        function = shape_functions_and_gradients if gradients else shape_functions
        values = function(*point, basis=basis, kind="imls")
        return values if gradients else (values,)

    return lax.map(one, (points, neighbours, supports), batch_size=BATCH)
