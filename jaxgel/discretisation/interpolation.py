"""Shape functions at points of a cloud, also where rotations are read: on the horizontal midline of the dry plate and at its core point.

Each point has the list of the nodes whose supports reach it, padded with support 0.

Index letters: ``p`` point, ``a`` node of a list, ``l`` list, ``i j`` space.
"""

import dataclasses
import functools
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._memo import once_per_owner
from .._types import Array, Float, Inexact, Int
from ..cloud import Cloud, Topology
from ..geometry import inside_holes
from .moving_least_squares import shape_functions, shape_functions_and_gradients
from .neighbours import SKIN, is_moved, neighbours_of_points

if TYPE_CHECKING:
    from .model import Model

BATCH = 64  # points whose shape functions are evaluated together
LARGE, SMALL = 4096, 512  # points of one call of the program that evaluates them: two sizes, so two programs serve every cloud
NEIGHBOURS = 16  # the program's neighbours are padded to a multiple of this
MIDLINE_POINTS = 401  # samples of the plate's midline, those in holes included


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
    phi: Inexact[Array, "p a"]
    """Shape functions."""
    dphi: Inexact[Array, "p a 2"]
    """Their gradients, 1/mm."""

    @jax.jit
    def position(self, x: Float[Array, "n d"]) -> Float[Array, "p d"]:
        """Deformed positions of the points for nodal positions ``x``, mm, or other fields (d) of the nodes."""
        return in_plane(jnp.einsum("pa,pai->pi", self.phi, x[self.nodes]))

    @jax.jit
    def deformation_gradient(self, x: Float[Array, "n 2"]) -> Float[Array, "p 2 2"]:
        """Deformation gradients at the points."""
        return in_plane(jnp.einsum("pai,paj->pij", x[self.nodes], self.dphi), axis=1)


def make_probe(model: "Model", points: Float[Array, "p 2"], reference_points: Float[Array, "p 2"] | None = None) -> Interpolation:
    """``Interpolation`` at material points of the dry plate, mm.

    ``points`` may be traced if ``reference_points``, their values on the reference plate, are given.
    """
    reference_points = np.asarray(points if reference_points is None else reference_points)
    topology = model.cloud.topology
    neighbours = neighbours_of_points(topology, model.dmax, reference_points, SKIN * topology.spacing * is_moved(model.cloud))
    return interpolate(model.cloud, jnp.asarray(points), neighbours, model.basis, model.kind)


def midline_probe(model: "Model") -> Interpolation:
    """``Interpolation`` at the points (p, 2) of the gel on y = 0 in the dry plate, from left to right; it follows the model's cloud."""
    points, neighbours = _midline(model.cloud.topology, model.dmax)
    return interpolate(model.cloud, jnp.asarray(points), neighbours, model.basis, model.kind)


def midline_points(topology: Topology, dmax: float) -> Float[np.ndarray, "p 2"]:
    """The points (p, 2) of `midline_probe`, mm; ``dmax`` is the model's."""
    return _midline(topology, dmax)[0]


def core_probe(model: "Model") -> Interpolation:
    """``Interpolation`` at the plate's core point (1, 2) on the model's cloud; its gradients are nan where the core lies in a hole."""
    points, neighbours, in_hole = _core(model.cloud.topology, model.dmax)
    probe = interpolate(model.cloud, jnp.asarray(points), neighbours, model.basis, model.kind)
    return dataclasses.replace(probe, dphi=jnp.full_like(probe.dphi, jnp.nan)) if in_hole else probe


def interpolate(
    cloud: Cloud,
    points: Float[Array, "p 2"],
    neighbours: tuple[Int[np.ndarray, "p a"], Float[np.ndarray, "p a"]],
    basis: str,
    kind: str,
) -> Interpolation:
    """``Interpolation`` at points with their lists of ``neighbours``, see ``neighbours_of_points``."""
    lists, supports = neighbours
    phi, dphi = evaluate_points(cloud.nodes, points, lists, supports, np.arange(len(lists)), basis=basis, kind=kind)
    return Interpolation(points, lists, supports, phi, dphi)


def evaluate_points(
    nodes: Float[Array, "n 2"],
    points: Float[Array, "p 2"],
    lists: Int[np.ndarray, "l a"],
    supports: Float[np.ndarray, "l a"],
    owner: Int[np.ndarray, " p"],
    *,
    basis: str,
    kind: str,
    gradients: bool = True,
) -> Inexact[Array, "p a"] | tuple[Inexact[Array, "p a"], Inexact[Array, "p a 2"]]:
    """Shape functions at ``points`` with the node lists and supports of their owners, and their gradients.

    Without ``gradients`` only the values; with them the pair of values (p, a) and gradients (p, a, 2).
    """
    count, width = len(points), lists.shape[1]
    lists, supports = (np.pad(part, ((0, 0), (0, -width % NEIGHBOURS))) for part in (lists, supports))
    sizes = [LARGE] * (count // LARGE) + [SMALL] * -(-(count % LARGE) // SMALL)
    groups, start = [], 0
    for size in sizes:
        numbers = np.minimum(np.arange(start, start + size), count - 1)
        own = owner[numbers]
        at = _rows(points, numbers), _rows(nodes, lists[own])
        groups.append(_evaluated(*at, supports[own], basis=basis, kind=kind, gradients=gradients))
        start += size
    values = tuple(_joined(parts, count, width) for parts in zip(*groups, strict=True))
    return values if gradients else values[0]


def _rows(values, numbers):
    """Rows of an array; by NumPy where nothing is traced, so that no program is compiled for every number of points."""
    return values[numbers] if isinstance(values, jax.core.Tracer) else np.asarray(values)[numbers]


def _joined(parts, count, width):
    """The first ``count`` rows and ``width`` columns of the values (g, a, ...) of all groups, likewise."""
    if isinstance(parts[0], jax.core.Tracer):
        return jnp.concatenate(parts)[:count, :width]
    return jax.device_put(np.concatenate(parts)[:count, :width])


@functools.partial(jax.jit, static_argnames=("basis", "kind", "gradients"))
def _evaluated(points, neighbours, supports, *, basis, kind, gradients):
    """Shape functions (g, a) at points (g, 2) with neighbours (g, a, 2) and supports (g, a) of their own, and their gradients."""

    @jax.checkpoint
    def one(point):
        function = shape_functions_and_gradients if gradients else shape_functions
        values = function(*point, basis=basis, kind=kind)
        values = values if gradients else (values,)
        return [value.real if kind == "iicvmls" else value for value in values]

    return lax.map(one, (points, neighbours, supports), batch_size=BATCH)


def in_plane(field: Inexact[Array, "..."], axis: int = -1) -> Float[Array, "..."]:
    """A sum of shape functions and nodal values: as it is, or, for complex shape functions, which act on x1 + i x2, in components.

    The components lie along ``axis``.
    """
    if not jnp.iscomplexobj(field):
        return field
    first, second = jnp.moveaxis(field, axis, 0)
    z = first + 1j * second
    return jnp.stack([z.real, z.imag], axis=axis)


@once_per_owner
def _midline(topology: Topology, dmax: float):
    """Points (p, 2) of the gel on the midline, mm, and their neighbour lists."""
    plate = topology.plate
    x = plate.width * np.linspace(-0.5, 0.5, MIDLINE_POINTS)
    points = np.stack([x, np.zeros_like(x)], axis=1)
    points = points[~inside_holes(plate, points, -1e-9 * topology.spacing)]
    return points, neighbours_of_points(topology, dmax, points, SKIN * topology.spacing)


@once_per_owner
def _core(topology: Topology, dmax: float):
    """The core point (1, 2), mm, its neighbour lists, and whether it lies in a hole.

    In a hole it is replaced by a point of the gel: 0 times nan would spoil every reverse derivative.
    """
    plate = topology.plate
    in_hole = bool(inside_holes(plate, [plate.core])[0])
    points = _midline(topology, dmax)[0][:1] if in_hole else np.array([plate.core])
    return points, neighbours_of_points(topology, dmax, points, SKIN * topology.spacing), in_hole
