"""Gaps between facing points of a hole's outline."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from scipy.spatial.distance import cdist

from .areas import dry_outlines, outlines


def min_gap(path):
    """Smallest gap (k,) between facing points of one hole's outline, mm; 0 where an outline crosses itself. Not differentiable.

    Points face each other if the line between them leaves both surfaces at less than 60 degrees to the normal; pairs closer than
    two node spacings on the dry plate are neighbours and do not count. inf for a plate without holes.
    """
    dry = [np.asarray(loop) for loop in dry_outlines(path.model)]
    loops = [np.asarray(loop) for loop in outlines(path)]
    near = [_near_pairs(loop, 2 * path.model.cloud.spacing) for loop in dry]
    gaps = [[_gap(states[k], pairs) for states, pairs in zip(loops, near, strict=True)] for k in range(len(path.mu))]
    return np.array([min(gap, default=np.inf) for gap in gaps])


def _near_pairs(loop, distance):
    return cdist(loop, loop) < distance


def _gap(loop, near):
    """Smallest distance between facing points of a closed loop (m, 2), gel outside; 0 if it crosses itself."""
    if not shapely.LinearRing(loop).is_simple:
        return 0.0
    tangent = np.roll(loop, -1, axis=0) - np.roll(loop, 1, axis=0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    distance, height = cdist(loop, loop), normal @ loop.T  # over the tangent at each point, from the origin
    leaving = height - np.diagonal(height)[:, None] > 0.5 * distance
    facing = leaving & leaving.T & ~near
    return float(distance[facing].min(initial=np.inf))


FACING = 0.5  # cosine of the largest angle between a gap and the normals at its ends


def gap(path):
    """Smallest gap (k,) between facing points of one hole's outline, mm, as `observables.min_gap`, with derivatives.

    They are those of the nearest pair; the plate's shorter side where nothing faces. An outline that crosses itself is not noticed.
    """
    plate = path.model.lists.topology.plate
    distant, neighbours = min(plate.width, plate.height), 2 * path.model.cloud.spacing
    gaps = [
        jax.vmap(functools.partial(_facing_gap, dry=dry, neighbours=neighbours, distant=distant))(loop)
        for dry, loop in zip(dry_outlines(path.model), outlines(path), strict=True)
    ]
    return jnp.min(jnp.stack(gaps), axis=0) if gaps else jnp.full(len(path.mu), distant)


def _facing_gap(loop, dry, neighbours, distant):
    """Smallest distance () between facing points of a closed loop (m, 2), gel outside, that are no neighbours on the dry loop."""
    fixed, start = jax.lax.stop_gradient(loop), jax.lax.stop_gradient(dry)
    tangent = jnp.roll(fixed, -1, axis=0) - jnp.roll(fixed, 1, axis=0)
    normal = jnp.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / jnp.linalg.norm(tangent, axis=1, keepdims=True)
    between = fixed[None] - fixed[:, None]
    squared = jnp.sum(between**2, axis=2)
    leaving = jnp.einsum("abi,ai->ab", between, normal) > FACING * jnp.sqrt(squared)
    apart = jnp.sum((start[None] - start[:, None]) ** 2, axis=2) >= neighbours**2
    squared = jnp.where(leaving & leaving.T & apart, squared, distant**2)
    a, b = jnp.unravel_index(jnp.argmin(squared), squared.shape)
    facing = squared[a, b] < distant**2
    d2 = jnp.sum((loop[a] - loop[b]) ** 2)
    return jnp.where(facing, jnp.sqrt(jnp.where(facing, d2, 1.0)), distant)
