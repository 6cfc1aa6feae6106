"""Neighbour lists: the nodes whose supports reach given points."""

import numpy as np
from scipy.spatial import cKDTree

from .._sizes import step
from .._types import Float, Int
from ..cloud import Topology

# room for nodes of other patches and of points: 26 to 34, 39 to 46, 48 to 55, 62 to 69
NEIGHBOURS = (20, 34, 46, 56, 70, 84, 112, 144)
# of a support: a node that is so near its end has weight 0 to round-off, and would be listed for
# one mirror image only
AT_THE_END = 1e-9


def neighbours_of_points(
    topology: Topology, dmax: float, reference_points: Float[np.ndarray, "p 2"]
) -> tuple[Int[np.ndarray, "p a"], Float[np.ndarray, "p a"]]:
    """Node lists and supports of material points, padded to one of the ``NEIGHBOURS``."""
    support = dmax * topology.node_spacing
    regions = topology.regions_at(reference_points)
    reaching = reaching_nodes(
        topology, reference_points, np.arange(len(reference_points)), regions, support
    )
    lists, supports = pad_nodes(*reaching, support)
    more = (0, 0), (0, step(lists.shape[1], NEIGHBOURS) - lists.shape[1])
    return np.pad(lists, more), np.pad(supports, more)


def reaching_nodes(
    topology: Topology,
    points: Float[np.ndarray, "p 2"],
    owner: Int[np.ndarray, " p"],
    regions: Int[np.ndarray, " p"],
    support: Float[np.ndarray, " n"],
    also: tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]] = (
        np.zeros(0, int),
        np.zeros(0, int),
    ),
) -> tuple[Int[np.ndarray, " r"], Int[np.ndarray, " o"]]:
    """Ascending numbers of the nodes that reach a point of each owner, and counts.

    Nodes reach as far as their ``support``. ``points`` lie on the reference plate, in these
    ``regions``, whose nodes alone reach them; ``owner`` numbers count from 0. ``also`` are owners
    and nodes that these list in any case.
    """
    nodes = topology.nodes
    pairs = pairs_in_reach(points, nodes, support)
    if topology.interfaces:
        pairs = pairs[(topology.node_regions[pairs["j"]] == regions[pairs["i"], None]).any(axis=1)]
    key = np.unique(
        np.concatenate(
            [owner[pairs["i"]] * len(nodes) + pairs["j"], also[0] * len(nodes) + also[1]]
        )
    )
    return key % len(nodes), np.bincount(key // len(nodes), minlength=owner.max() + 1)


def pairs_in_reach(
    points: Float[np.ndarray, "p 2"],
    places: Float[np.ndarray, "n 2"],
    support: Float[np.ndarray, " n"],
) -> np.ndarray:
    """Records of pairs: point ``i`` in the ``support`` of place ``j``, at the distance ``v``."""
    pairs = cKDTree(points).sparse_distance_matrix(
        cKDTree(places), support.max(), output_type="ndarray"
    )
    return pairs[pairs["v"] < (1 - AT_THE_END) * support[pairs["j"]]]


def pad_nodes(
    nodes: Int[np.ndarray, " r"], counts: Int[np.ndarray, " o"], support: Float[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, "o a"], Float[np.ndarray, "o a"]]:
    """Padded node lists and their supports from concatenated lists.

    Lists are padded with their first node, supports with 0.
    """
    numbers = pad_rows(np.arange(len(nodes)), counts, np.arange(len(counts)))
    padded = nodes[np.where(numbers >= 0, numbers, numbers[:, :1])].astype(np.int32)
    return padded, np.where(numbers >= 0, support[padded], 0.0)


def pad_rows(
    values: Int[np.ndarray, " r"], counts: Int[np.ndarray, " o"], rows: Int[np.ndarray, " s"]
) -> Int[np.ndarray, "s m"]:
    """Chosen ``rows`` of concatenated values with ``counts`` in each, padded with -1."""
    column = np.arange(counts[rows].max())
    start = np.concatenate([[0], np.cumsum(counts)])[rows]
    real = column < counts[rows][:, None]
    return np.where(real, values[np.where(real, start[:, None] + column, 0)], -1)
