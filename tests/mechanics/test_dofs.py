"""Essential conditions: nodal fields of the unknowns, tangent, and motion of the edges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.controls import Setting
from jaxgel.discretisation.connectivity import make_connectivity
from jaxgel.mechanics import (
    edges_of,
    free_dofs,
    gather,
    node_pairs,
    restrict,
    scatter,
    tangent_pattern,
)

PLATES = {
    "held": dict(edges={"top": "free"}),
    "periodic": dict(edges="periodic"),
    "strained": dict(edges="periodic", deformation="free"),
    "strip": dict(
        edges={"left": "periodic", "right": "periodic", "top": "free"},
        deformation=(("free", 0.0), (0.0, 1.0)),
    ),
}


@pytest.mark.parametrize("name", PLATES)
def test_forces_tangent_and_values_of_the_unknowns_follow_from_one_matrix(name):
    """C^T F and C^T K C by dense algebra, with a random K of the node pairs.

    Values at the unknowns invert C.
    """
    plate = jaxgel.Plate(2, 2, [jaxgel.Circle((0.1, 0.0), 0.4)], **PLATES[name], spacing=0.5)
    lists = make_connectivity(jaxgel.make_cloud(plate).topology, "quadratic", 2.95)
    free, pairs, random = free_dofs(lists.topology), node_pairs(lists)[0], np.random.default_rng(0)
    C, shape = free.matrix.toarray(), (free.size // 2, 2)
    v, F = random.normal(size=len(free)), random.normal(size=shape)
    np.testing.assert_allclose(scatter(v, free), (C @ v).reshape(shape), atol=1e-15)
    np.testing.assert_allclose(gather(F, free), C.T @ F.ravel(), atol=1e-14)
    for field in ((C @ v).reshape(shape), jnp.asarray((C @ v).reshape(shape))):
        np.testing.assert_allclose(restrict(field, free), v, atol=1e-14)
    blocks, K = random.normal(size=(len(pairs), 2, 2)), np.zeros((free.size, free.size))
    for (i, j), block in zip(pairs, blocks, strict=True):
        block[...] = block + block.T if i == j else block
        K[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = block
        K[2 * j : 2 * j + 2, 2 * i : 2 * i + 2] = block.T
    np.testing.assert_allclose(
        tangent_pattern(lists).matrix(blocks).toarray(), C.T @ K @ C, atol=1e-12
    )


def test_a_traced_motion_of_the_one_held_edge_moves_all_nodes_alike_although_it_cuts_a_hole():
    """Nodes where an edge cuts a hole lie on it to round-off: no spline of collinear points."""
    edges = {"top": "fixed", "left": "free", "right": "free", "bottom": "free"}
    plate = jaxgel.Plate(
        8, 8, [jaxgel.Circle((0.1, 3.8), 1.6)], edges=edges, spacing=1.2, nodes_per_hole=16
    )
    topology = jaxgel.make_cloud(plate).topology
    nodes = topology.partition.vertices[topology.node_vertices]

    def moved(u):
        return (
            edges_of(topology, True)
            .moved(Setting(0.0, None, displacement={"top": jnp.stack([0.0 * u, u])}))
            .positions(nodes)
            - nodes
        )

    # round-off of the positions
    np.testing.assert_allclose(
        jax.jit(moved)(0.5), np.broadcast_to([0.0, 0.5], nodes.shape), atol=1e-13
    )
