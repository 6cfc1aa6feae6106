"""Stability of the free surfaces, hole outlines and free edges of the plate, to short waves."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._compiled import compiled
from .._memo import once_per_owner
from .._types import Array, Float, Int
from ..cloud import Topology
from ..continuation import Path
from ..geometry import inside_holes
from ..materials import VolumeLaw, elementwise, gel_on_outline
from ..materials import surface_stability as stability_at
from ..mechanics import Equations, gradients_by_block, volume_law
from .states import of_path, with_room
from .surface import (
    areal_stretches,
    chords_of,
    lengths,
    normal_stretch,
    on_outlines,
    padded_ends,
    surface_swelling,
    traction_free_pressure,
)


@of_path
def surface_stability(path: Path) -> Float[Array, " k"]:
    """Least stability (k,) of the free surfaces to short waves, dimensionless, < 0 if one wrinkles.

    Arguments:

    - `path`: the `Path` of k states.

    The free surfaces are the hole outlines and the plate's free edges. Returns 1 for a plate
    without either; at -1 the gel there is unstable, see `materials.surface_stability`. The
    stretches, the chemical potential and the gel at each place decide, in plane strain, generalised
    plane strain and films; these waves of a film are in its plane, those out of it are by
    `membrane_stress`. The tangential stretch is that of the chord over one node spacing, the finest
    that the cloud resolves.

    >>> import jaxgel
    >>> cloud = jaxgel.make_cloud(jaxgel.Plate(1.0, 1.0, edges={"top": "free"}), spacing=0.25)
    >>> problem = jaxgel.Problem(jaxgel.discretise(cloud), jaxgel.Gel(1e-3, 0.1), contact=False)
    >>> bool(surface_stability(jaxgel.sweep(problem, [-0.4]))[0] > 0)
    True
    """
    model, topology = path.model, path.model.lists.topology
    chords, edges = _free_surfaces(topology)
    if not len(chords) + len(edges):
        return jnp.ones(len(path.x))
    problem = path.problem.shared if len(edges) else on_outlines(path.problem)
    on_edges = len(model.outline.points) + np.searchsorted(topology.free_edge_nodes, edges)
    tangential, near, law = _surface_stretches(
        with_room(path.x), path.value, problem, chords, edges, on_edges
    )
    return jnp.min(_stability(tangential, surface_swelling(tangential, near, law), law), axis=1)


@compiled()
@functools.partial(jax.vmap, in_axes=(0, 0, None, None, None, None))
def _surface_stretches(
    x: Any, at: Any, problem: Equations, chords: Any, edges: Any, on_edges: Any
) -> Any:
    """The arguments of `surface_swelling` for the chords of all free surfaces.

    ``on_edges`` are the nodes of those of free ``edges`` as `gel_on_outline` numbers them.
    """
    model, (now, mu) = problem.model, problem.at(at)
    near = areal_stretches(x, model, chords)
    if len(edges):
        points = _nearest_points(model.nodes[edges].mean(axis=1), model)
        F = jnp.concatenate([part.reshape(-1, 2, 2) for part in gradients_by_block(x, model)])[
            points
        ]
        near = jnp.concatenate([near, jax.lax.stop_gradient(jnp.linalg.det(F))])
    dry, deformed = (
        jnp.concatenate([lengths(model.outline.position(y), chords), lengths(y, edges)])
        for y in (model.nodes, x)
    )
    return (
        deformed / dry,
        near,
        volume_law(model, gel_on_outline(now.gel, jnp.concatenate([chords, on_edges])), mu),
    )


@once_per_owner
def _free_surfaces(topology: Topology) -> tuple[Int[np.ndarray, "m 2"], Int[np.ndarray, "e 2"]]:
    """`chords_of` the outlines, and nodes (e, 2) of free-edge chords, padded as `padded_ends`."""
    chords, edges, nodes = (
        chords_of(topology),
        [np.zeros((0, 2), dtype=int)],
        topology.partition.vertices[topology.node_vertices],
    )
    for edge, condition in topology.plate.edges.items():
        ends = np.stack([topology.edge_nodes[edge][:-1], topology.edge_nodes[edge][1:]], axis=1)
        edges += (
            [ends[~inside_holes(topology.plate, nodes[ends].mean(axis=1))]]
            if condition == "free"
            else []
        )
    edges = np.concatenate(edges)
    return padded_ends(chords), padded_ends(edges)


def _nearest_points(middles, model):
    """Numbers (e,) of the quadrature points nearest to the ``middles`` (e, 2) of chords.

    Block after block, on the dry plate.
    """
    points = jax.lax.stop_gradient(
        jnp.concatenate([block.position.reshape(-1, 2) for block in model.blocks])
    )
    return jax.lax.map(
        lambda at: jnp.argmin(jnp.sum((points - at) ** 2, axis=1)), jax.lax.stop_gradient(middles)
    )


@compiled()
@jax.vmap
def _stability(
    tangential: Float[Array, " m"], J: Float[Array, " m"], law: VolumeLaw
) -> Float[Array, " m"]:
    """`materials.surface_stability` (m,) of traction-free surfaces of volume ratio ``J`` (m,)."""
    normal, _ = normal_stretch(tangential, J, law)
    pressure, stiffness = (
        traction_free_pressure(tangential, normal, law),
        law.stiffness(tangential * normal, J),
    )

    def of_place(stretches, pressure, stiffness, gel):
        return stability_at(stretches, pressure, stiffness, gel, law.axial)

    return elementwise(
        of_place,
        jnp.stack([tangential, normal], axis=1),
        pressure,
        stiffness,
        law.gel,
        signature="(i)->()",
    )
