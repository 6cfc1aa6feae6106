"""Shape functions at points of a cloud: each point has the list of the nodes whose supports reach it, padded with support 0.

Index letters: ``p`` point, ``a`` node of a list, ``l`` list, ``i j`` space.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._parallel import over_parts
from .moving_least_squares import shape_functions, shape_functions_and_gradients
from .neighbours import is_moved, pad_nodes, reaching_nodes

BATCH = 64  # points whose shape functions are evaluated together
CHUNK = 512  # points of one call of the program that evaluates them: no shape in it is a cloud's own, so one program serves them all
TOGETHER = 64  # such calls whose neighbours are in memory together
NEIGHBOURS = 16  # its neighbours are padded to a multiple of this
SKIN = 0.25  # room in the neighbour lists of a cloud that moves, in units of the spacing


@functools.partial(jax.tree_util.register_dataclass, data_fields=["points", "nodes", "support", "phi", "dphi"], meta_fields=[])
@dataclasses.dataclass(frozen=True)
class Probe:
    """Shape functions at chosen material points."""

    points: jax.Array
    """(p, 2) the points on the dry plate, mm."""
    nodes: jax.Array
    """(p, a) node numbers."""
    support: jax.Array
    """(p, a) support radius of each node, mm; 0 for padding."""
    phi: jax.Array
    """(p, a) shape functions."""
    dphi: jax.Array
    """(p, a, 2) their gradients, 1/mm."""

    def position(self, x):
        """Deformed positions (p, 2) of the points for nodal positions ``x`` (n, 2), mm."""
        return in_plane(jnp.einsum("pa,pai->pi", self.phi, x[self.nodes]))

    def deformation_gradient(self, x):
        """Deformation gradients (p, 2, 2) at the points."""
        return in_plane(jnp.einsum("pai,paj->pij", x[self.nodes], self.dphi), axis=1)


def make_probe(model, points, reference_points=None):
    """``Probe`` at material points (p, 2) of the dry plate, mm; ``points`` may be traced if their values on the reference are given."""
    reference_points = np.asarray(points if reference_points is None else reference_points)
    topology = model.cloud.topology
    neighbours = probe_lists(topology, model.dmax, reference_points, SKIN * topology.spacing * is_moved(model.cloud))
    return probe_at(model.cloud, jnp.asarray(points), neighbours, model.basis, model.kind)


def probe_at(cloud, points, neighbours, basis, kind):
    """``Probe`` at points (p, 2) with their lists of ``neighbours``, see ``probe_lists``."""
    lists, supports = neighbours
    phi, dphi = evaluate_points(cloud.nodes, points, lists, supports, np.arange(len(lists)), basis=basis, kind=kind)
    return Probe(points, lists, supports, phi, dphi)


def probe_lists(topology, dmax, reference_points, room=0.0):
    """Padded node lists (p, a) and supports (p, a) of material points (p, 2) and all points within ``room`` mm of them."""
    support = dmax * topology.node_spacing
    reaching = reaching_nodes(topology, reference_points, np.arange(len(reference_points)), support, room)
    return pad_nodes(*reaching, support)


def evaluate_points(nodes, points, lists, supports, owner, *, basis, kind, gradients=True):
    """Shape functions (p, a) at ``points`` (p, 2) with the node list (l, a) and supports of their owners (p,), and their gradients.

    Without ``gradients`` only the values; with them the pair of values (p, a) and gradients (p, a, 2).
    """
    count, width = len(points), lists.shape[1]
    owner = np.concatenate([owner, np.repeat(owner[:1], -count % CHUNK)]).reshape(-1, CHUNK)
    lists, supports = (np.pad(part, ((0, 0), (0, -width % NEIGHBOURS))) for part in (lists, supports))
    at, function, values = _in_rows(points, len(owner)), _Evaluation(basis, kind, gradients), []
    for first in range(0, len(owner), TOGETHER):
        own = owner[first : first + TOGETHER]
        values.append(over_parts(function, (at[first : first + TOGETHER], _picked(nodes, lists[own]), supports[own])))
    values = _together(values, count, width)
    return values if gradients else values[0]


@functools.partial(jax.jit, static_argnames="number")
def _in_rows(points, number):
    """The points in rows (number, CHUNK, 2), padded with the first one."""
    return jnp.concatenate([points, jnp.broadcast_to(points[:1], (number * CHUNK - len(points), 2))]).reshape(number, CHUNK, 2)


@jax.jit
def _picked(nodes, lists):
    return nodes[lists]


@functools.partial(jax.jit, static_argnames=("count", "width"))
def _together(parts, count, width):
    """The first ``count`` rows and ``width`` columns of values (k, CHUNK, ...) that lie in parts."""

    def joined(*values):
        values = jnp.concatenate(values)
        return values.reshape(-1, *values.shape[2:])[:count, :width]

    return jax.tree.map(joined, *parts)


@dataclasses.dataclass(frozen=True)
class _Evaluation:
    """`evaluate_points` of points (p, 2) with neighbours (p, a, 2) and supports (p, a) of their own."""

    basis: str
    kind: str
    gradients: bool

    def __call__(self, points, neighbours, supports):
        @jax.checkpoint
        def one(point):
            options = dict(basis=self.basis, kind=self.kind)
            found = shape_functions_and_gradients(*point, **options) if self.gradients else (shape_functions(*point, **options),)
            return [value.real if self.kind == "iicvmls" else value for value in found]

        return lax.map(one, (points, neighbours, supports), batch_size=BATCH)


def in_plane(field, axis=-1):
    """A sum of shape functions and nodal values: as it is, or, for complex shape functions, which act on x1 + i x2, in components.

    The components lie along ``axis``.
    """
    if not jnp.iscomplexobj(field):
        return field
    first, second = jnp.moveaxis(field, axis, 0)
    z = first + 1j * second
    return jnp.stack([z.real, z.imag], axis=axis)
