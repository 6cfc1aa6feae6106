"""Facts about essential conditions: where the edges take the dry nodes."""

import jax
import numpy as np

import jaxgel
from jaxgel.mechanics import start_positions


def test_a_traced_motion_of_the_one_held_edge_moves_all_nodes_alike_although_it_cuts_a_hole():
    """Nodes where an edge cuts a hole lie on it to round-off: no spline goes through points of a line."""
    edges = {"top": "fixed", "left": "free", "right": "free", "bottom": "free"}
    plate = jaxgel.Plate(8, 8, [jaxgel.Circle((0.1, 3.8), 1.6)], edges=edges, spacing=1.2, nodes_per_hole=16)
    topology = jaxgel.make_cloud(plate).topology
    nodes = topology.partition.vertices[topology.node_vertices]

    def moved(u):
        still = dict.fromkeys(("left", "right", "bottom"), (0.0, 0.0))
        return start_positions(topology, nodes, (np.eye(2), {**still, "top": (0.0, u)})) - nodes

    np.testing.assert_allclose(jax.jit(moved)(0.5), np.broadcast_to([0.0, 0.5], nodes.shape), atol=1e-13)  # round-off of the positions
