"""Interpolation where rotations are read: on the horizontal midline of the dry plate and at its core point."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from .._memo import once_per_owner
from ..cloud import Topology
from ..geometry import inside_holes
from .interpolation import SKIN, Interpolation, interpolate, neighbours_of_points
from .model import Model

MIDLINE_POINTS = 401  # samples of the plate's midline, those in holes included


def midline_probe(model: Model) -> Interpolation:
    """``Interpolation`` at the points (p, 2) of the gel on y = 0 in the dry plate, from left to right; it follows the model's cloud.

    The neighbour lists serve all points of the line within one sample of the points too.
    """
    points, neighbours = _midline(model.cloud.topology, model.dmax)
    return interpolate(model.cloud, jnp.asarray(points), neighbours, model.basis, model.kind)


def core_probe(model: Model) -> Interpolation:
    """``Interpolation`` at the plate's core point (1, 2) on the model's cloud; its gradients are nan where the core lies in a hole."""
    points, neighbours, in_hole = _core(model.cloud.topology, model.dmax)
    probe = interpolate(model.cloud, jnp.asarray(points), neighbours, model.basis, model.kind)
    return dataclasses.replace(probe, dphi=jnp.full_like(probe.dphi, jnp.nan)) if in_hole else probe


@once_per_owner
def _midline(topology: Topology, dmax: float):
    """Points (p, 2) of the gel on the midline, mm, and their neighbour lists."""
    plate = topology.plate
    x = plate.width * np.linspace(-0.5, 0.5, MIDLINE_POINTS)
    points = np.stack([x, np.zeros_like(x)], axis=1)
    points = points[~inside_holes(plate, points, -1e-9 * topology.spacing)]
    return points, neighbours_of_points(topology, dmax, points, SKIN * topology.spacing + plate.width / (MIDLINE_POINTS - 1))


@once_per_owner
def _core(topology: Topology, dmax: float):
    """The core point (1, 2), mm, its neighbour lists, and whether it lies in a hole.

    In a hole it is replaced by a point of the gel: 0 times nan would spoil every reverse derivative.
    """
    plate = topology.plate
    in_hole = bool(inside_holes(plate, [plate.core])[0])
    points = _midline(topology, dmax)[0][:1] if in_hole else np.array([plate.core])
    return points, neighbours_of_points(topology, dmax, points, SKIN * topology.spacing), in_hole
