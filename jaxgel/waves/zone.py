"""Wave vectors of a periodic cell: those of its Brillouin zone that differ under its symmetries."""

import numpy as np

from .._types import Float
from ..geometry import SYMMETRIES, Plate
from .cells import check_periodic

# of pi over the cell's longer side: the wave number that stands for infinitely long waves
LONG = 0.02
DIRECTIONS = 24  # of long waves in the plane, 15 degrees apart
DIGITS = 9  # to which wave vectors over pi / side are compared


def wave_vectors_of_zone(
    plate: Plate, divisions: int, group: tuple[str, ...] = ()
) -> Float[np.ndarray, "w 2"]:
    """Wave vectors (w, 2), rad/mm, irreducible under a ``group`` and k -> -k, long waves first.

    Those of the zone are a grid with ``divisions`` steps from its middle to its edge, 0 included;
    long waves have the `long_wave_number` and `DIRECTIONS` all round. Along an edge that is not
    periodic all components are 0.
    """
    axes, sides = np.array(check_periodic(plate)), np.array([plate.width, plate.height])
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    directions = (
        np.stack([np.cos(angles), np.sin(angles)], axis=1) if axes.all() else 1.0 * axes[None]
    )
    ring = long_wave_number(plate) * directions * sides / np.pi
    steps = [
        np.arange(-divisions + 1, divisions + 1) / divisions if along else np.zeros(1)
        for along in axes
    ]
    grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    both = np.concatenate([_different(ring, group), _different(grid, group)])
    return both * np.pi / sides


def long_wave_number(plate: Plate) -> float:
    """Wave number, rad/mm, that stands for infinitely long waves: 100 cells long."""
    return (
        LONG
        * np.pi
        / max(
            side
            for side, along in zip((plate.width, plate.height), check_periodic(plate), strict=True)
            if along
        )
    )


def _different(wave_vectors, group):
    """Of wave vectors (w, 2) over pi / side one of each set of images."""
    matrices = [np.eye(2), *(np.array(SYMMETRIES[name], dtype=float) for name in group)]
    # (s, w, 2)
    images = np.stack([sign * wave_vectors @ matrix.T for matrix in matrices for sign in (1, -1)])
    images = np.round(1 - np.mod(1 - images, 2.0), DIGITS) + 0.0  # in (-1, 1]
    first = [max(map(tuple, some)) for some in images.swapaxes(0, 1)]
    return np.array(sorted(set(first)))
