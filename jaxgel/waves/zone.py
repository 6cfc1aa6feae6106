"""Wave vectors of a periodic cell: those of its Brillouin zone that differ under its symmetries, and the way along the zone's edge."""

import itertools

import numpy as np

from .._types import Float
from ..geometry import SYMMETRIES, Plate
from .cells import check_periodic

LONG = 0.02  # of pi over the cell's side: the wave number that stands for infinitely long waves
DIRECTIONS = 24  # of long waves in the plane, 15 degrees apart
DIGITS = 9  # to which wave vectors over pi / side are compared


def wave_vectors_of_zone(plate: Plate, divisions: int, group: tuple[str, ...] = ()) -> Float[np.ndarray, "w 2"]:
    """Wave vectors (w, 2), rad/mm, that the symmetries of a ``group`` and k -> -k do not take to each other: long waves first.

    Those of the zone are a grid with ``divisions`` steps from its middle to its edge, 0 included; long waves have `LONG` of the
    zone's half width in `DIRECTIONS`. Along an edge that is not periodic all components are 0.
    """
    axes = np.array(check_periodic(plate))
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    ring = LONG * np.stack([np.cos(angles), np.sin(angles)], axis=1) if axes.all() else LONG * axes[None]
    steps = [np.arange(-divisions + 1, divisions + 1) / divisions if along else np.zeros(1) for along in axes]
    grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    both = np.concatenate([_different(ring, group), _different(grid, group)])
    return both * np.pi / np.array([plate.width, plate.height])


def _different(wave_vectors, group):
    """Of wave vectors (w, 2) over pi / side one of each set of images."""
    matrices = [np.eye(2), *(np.array(SYMMETRIES[name], dtype=float) for name in group)]
    images = np.stack([sign * wave_vectors @ matrix.T for matrix in matrices for sign in (1, -1)])  # (s, w, 2)
    images = np.round(1 - np.mod(1 - images, 2.0), DIGITS) + 0.0  # in (-1, 1]
    first = [max(map(tuple, some)) for some in images.swapaxes(0, 1)]
    return np.array(sorted(set(first)))


def brillouin_path(
    plate: Plate, points: int, group: tuple[str, ...] = ()
) -> tuple[Float[np.ndarray, "w 2"], Float[np.ndarray, " w"], dict[str, float]]:
    """Wave vectors (w, 2), rad/mm, along the edge of the part of the zone that symmetry leaves, ``points`` from corner to corner.

    Then the distance (w,) along the way, rad/mm, and label -> that of the corners: Gamma is the middle of the zone, X and Y the middles of
    its sides, M its corner. Where x and y are alike the way is Gamma X M Gamma, otherwise Gamma X M Y Gamma, and of a strip Gamma X.
    """
    axes = np.array(check_periodic(plate))
    corner = np.pi / np.array([plate.width, plate.height])
    square = {"x <-> y", "rotation by 90"} & set(group)
    names = "ΓXMΓ" if square else "ΓXMYΓ"
    names = names if axes.all() else "ΓX" if axes[0] else "ΓY"
    place = {"Γ": (0, 0), "X": (1, 0), "Y": (0, 1), "M": (1, 1)}
    ends = np.array([place[name] for name in names]) * corner
    share = np.arange(points) / points
    legs = [start + share[:, None] * (end - start) for start, end in itertools.pairwise(ends)]
    wave_vectors = np.concatenate([*legs, ends[-1:]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(wave_vectors, axis=0), axis=1))])
    labels = [*names[:-1], names[-1] + (" " if names[-1] in names[:-1] else "")]
    return wave_vectors, along, dict(zip(labels, along[::points].tolist(), strict=True))
