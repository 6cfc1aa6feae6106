"""Deformed outlines of the holes as closed loops."""

import jax
import jax.numpy as jnp
import numpy as np
import shapely

from .._memo import once_per_owner
from .._types import Array, Float
from ..cloud import Topology
from ..discretisation import Model
from ..geometry import edge_lines, held_components

_ANTICLOCKWISE = ("bottom", "right", "top", "left")


def outline_loops(x: Float[Array, "n 2"], model: Model) -> list[jax.Array]:
    """Outline of each hole at nodal positions ``x`` (n, 2): a list over holes of closed loops (m, 2), mm; along the plate's edge if cut."""
    points = model.outline.position(x)
    loops = []
    for parts in _loop_layout(model.lists.topology):
        loops.append(jnp.concatenate([points[part] if isinstance(part, slice) else jnp.asarray(part) for part in parts]))
    return loops


@once_per_owner
def _loop_layout(topology):
    """Per hole the slices of outline points and the plate's corners (j, 2) that make its closed loop, anticlockwise."""
    stops = np.cumsum([0] + [len(o.s) for o in topology.outlines])
    layout = []
    for k in range(len(topology.plate.holes)):
        own = [i for i, o in enumerate(topology.outlines) if o.arc.hole == k]
        parts = []
        for i, following in zip(own, own[1:] + own[:1], strict=True):
            parts.append(slice(int(stops[i]), int(stops[i + 1])))
            if not topology.outlines[i].closed:
                parts.append(_corners_between(topology, topology.outlines[i], topology.outlines[following]))
        layout.append(parts)
    return layout


def _corners_between(topology, outline, following):
    """Corners (j, 2) of the plate between the end of one arc and the start of the next, going round the plate anticlockwise."""
    w, h = topology.plate.width / 2, topology.plate.height / 2
    corner_after = {"bottom": (w, -h), "right": (w, h), "top": (-w, h), "left": (-w, -h)}
    first = _ANTICLOCKWISE.index(outline.arc.end_edge)
    last = _ANTICLOCKWISE.index(following.arc.start_edge)
    passed = [_ANTICLOCKWISE[(first + j) % 4] for j in range((last - first) % 4)]
    return np.array([corner_after[edge] for edge in passed]).reshape(-1, 2)


def walls(x: Float[Array, "n 2"], topology: Topology) -> Float[Array, "e 2 2"]:
    """Ends (e, 2, 2), mm, of the edges that are held, at nodal positions ``x`` (n, 2); the plate lies to the left of each."""
    nodes, ends = topology.partition.vertices[topology.node_vertices], []
    for edge, (axis, coordinate) in edge_lines(topology.plate).items():
        wall = topology.wall_nodes[edge]
        if held_components(topology.plate.edges, edge) and len(wall) > 1:
            along = np.argsort(nodes[wall, 1 - axis])[[0, -1]]
            ends.append(wall[along if (coordinate > 0) == (axis == 0) else along[::-1]])
    return x[np.array(ends, dtype=int).reshape(-1, 2)]


def crosses(loops: list[np.ndarray], held: Float[np.ndarray, "e 2 2"], tolerance: float = 1e-9) -> bool:
    """Whether a hole's deformed outline, one of the closed ``loops`` (m, 2), crosses itself, another one or one of the `walls`; host."""
    rings = [shapely.LinearRing(loop) for loop in loops]
    if not all(ring.is_simple for ring in rings):
        return True
    for start, end in np.asarray(held):
        (dx, dy), length = end - start, np.linalg.norm(end - start)
        if any(np.max((loop - start) @ [dy, -dx]) > tolerance * length**2 for loop in loops):
            return True
    if len(rings) < 2:
        return False
    first, second = shapely.STRtree(rings).query(rings, predicate="intersects")
    return bool(np.any(first != second))


_compiled_loops = jax.jit(outline_loops)


def overlaps(x: Float[Array, "n 2"], model: Model) -> bool:
    """Whether a hole's outline crosses itself, another one or an edge of the plate."""
    return crosses([np.asarray(loop) for loop in _compiled_loops(x, model)], np.asarray(walls(x, model.lists.topology)))
