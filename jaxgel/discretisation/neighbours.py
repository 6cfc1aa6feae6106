"""Which nodes reach which points."""

import numpy as np
from scipy.spatial import cKDTree


def is_moved(cloud):
    """Whether the cloud is placed on another plate than its reference."""
    return cloud.plate is not cloud.topology.plate


def reaching_nodes(topology, points, owner, support, skin):
    """Numbers of the nodes that reach each owner's points, ascending, all owners in a row, and their counts (owners,)."""
    nodes = topology.partition.vertices[topology.node_vertices]
    pairs = cKDTree(points).sparse_distance_matrix(cKDTree(nodes), support.max() + skin, output_type="ndarray")
    pairs = pairs[pairs["v"] < support[pairs["j"]] + skin]
    key = np.unique(owner[pairs["i"]] * len(nodes) + pairs["j"])
    return key % len(nodes), np.bincount(key // len(nodes), minlength=owner.max() + 1)


def pad_nodes(nodes, counts, support):
    """Padded node lists (l, a) and supports (l, a), 0 for padding, from lists in a row."""
    numbers = pad_rows(np.arange(len(nodes)), counts, np.arange(len(counts)))
    real = numbers >= 0
    padded = nodes[np.where(real, numbers, numbers[:, :1])].astype(np.int32)
    return padded, np.where(real, support[padded], 0.0)


def pad_rows(values, counts, rows):
    """Rows (r, m) of values that lie in a row with ``counts``, padded with -1."""
    column = np.arange(counts[rows].max())
    start = np.concatenate([[0], np.cumsum(counts)])[rows]
    real = column < counts[rows][:, None]
    return np.where(real, values[np.where(real, start[:, None] + column, 0)], -1)
