"""Essential conditions of a plate: which degrees of freedom are free, and the lift from them to all nodal positions.

Degrees of freedom are numbered 2 node + component. Constrained ones keep their place on the dry plate: a roller holds the component
normal to its edge, a fixed edge both.
"""

import numpy as np

from .geometry import edge_lines


def free_dofs(topology):
    """Numbers (f,) of the free degrees of freedom, ascending; ValueError where rigid motion is left free."""
    free = np.ones((len(topology.node_vertices), 2), dtype=bool)
    held = np.zeros(2, dtype=int)
    for edge, (axis, _) in edge_lines(topology.plate).items():
        condition = topology.plate.edges[edge]
        components = {"roller": [axis], "fixed": [0, 1], "free": []}[condition]
        for component in components:
            free[topology.wall_nodes[edge], component] = False
            held[component] += len(topology.wall_nodes[edge])
    if held.min() == 0:
        names = ", ".join(f"{edge} {condition}" for edge, condition in dict(topology.plate.edges).items())
        raise ValueError(f"edges: {names} leave the plate free to slide; hold at least one edge normal to each direction")
    return np.flatnonzero(free.ravel())


def lift(free_values, nodes, free):
    """Nodal positions (n, 2) with the free degrees of freedom (f,) given and the others at the dry ``nodes`` (n, 2); mm."""
    return nodes.ravel().at[free].set(free_values).reshape(nodes.shape)
