"""Frame of a periodic cell: the computed rectangle of the lattice, with its holes and regions.

The frame is arbitrary: a periodic edge may lie along any straight line that crosses no hole.
Lengths in mm; host NumPy.
"""

import dataclasses

import numpy as np

from .._sizes import at_numbers
from .._types import Array, Float
from .._validation import Inadmissible
from .boundary import FRAME_EDGES
from .hole import Hole, outline_points
from .plate import Plate, periods

TOUCH = 1e-5  # gaps below this fraction of the plate's shorter side count as contact
EQUAL = 1e-9  # relative difference of two clearances that are equal
SAMPLES = 1440  # points of a whole outline


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """The rectangle of a periodic lattice that is computed, relative to the plate as given."""

    middle: Float[np.ndarray, "2"]
    """Middle of the rectangle in the coordinates of the plate as given.

    These count from the middle of the plate.
    """
    periods: Float[np.ndarray, "2"]
    """Periods of the lattice along x and y, see `periods`."""
    holes: Float[np.ndarray, "h 2"]
    """Translation of each hole into the rectangle, in whose coordinates it then is."""
    regions: Float[np.ndarray, "r 2"]
    """Translation of each region."""

    @property
    def is_given(self) -> bool:
        """Whether the rectangle and all that lies in it are as given."""
        return not (self.middle.any() or self.holes.any() or self.regions.any())

    def of(self, plate: Plate) -> Plate:
        """The ``plate``, whose parameters may be traced, in this frame.

        The plate itself if the frame is as given.
        """
        if self.is_given:
            return plate
        holes, regions = (
            tuple(outline.translated(by) for outline, by in zip(outlines, offsets, strict=True))
            for outlines, offsets in ((plate.holes, self.holes), (plate.regions, self.regions))
        )
        core = None if plate.core is None else self.from_given(np.array([plate.core]))[0].tolist()
        return dataclasses.replace(plate, holes=holes, regions=regions, core=core, reference=None)

    def from_given(self, points: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
        """Coordinates (..., 2) in this frame of ``points`` (..., 2) of the plate or images.

        The plate as given.
        """
        return points if self.is_given else _wrapped(points - self.middle, self.periods)

    def to_given(self, points: Float[Array, "*b 2"]) -> Float[Array, "*b 2"]:
        """Coordinates (..., 2) on the plate of ``points`` (..., 2) in this frame; may be traced.

        Points outside the plate as given are taken at their images there.
        """
        return points if self.is_given else _wrapped(points + self.middle, self.periods)


def frame_of(plate: Plate) -> Frame:
    """`Frame` of a concrete plate: its periodic edges lie in the widest gap between holes.

    They lie in the middle of the gap, which may also be between regions, seen along the edges. So
    the frame does not depend on that of the plate as given, which is kept if its edges lie in the
    middle of one of the widest gaps. Raises ValueError, one line, if there is no gap: every line
    along an edge then crosses a hole or one of its images.
    """
    along, samples = (
        periods(plate),
        [[sampled_outline(o) for o in outlines] for outlines in (plate.holes, plate.regions)],
    )
    spans = [
        np.array([[end(p, axis=0) for p in points] for end in (np.min, np.max)]).reshape(2, -1, 2)
        for points in samples
    ]
    middle, layers = np.zeros(2), (spans[1][0] < -along / 2) & (spans[1][1] > along / 2)
    for axis in np.flatnonzero(along):
        low, high = np.concatenate([spans[0], spans[1][:, ~layers[:, axis]]], axis=1)[:, :, axis]
        clearances, cuts = _gaps(low, high, along[axis])
        room = TOUCH * min(plate.width, plate.height) / 2
        best, given = clearances.max(initial=-np.inf), clearances[-1:].min(initial=np.inf)
        if len(cuts) == 0:
            continue
        edges, line = " and ".join(FRAME_EDGES[axis]), "yx"[axis]
        if layers[:, axis].any():
            if given > room:
                continue
            k = int(np.flatnonzero(layers[:, axis])[0])
            raise Inadmissible(
                f"edges: {edges} are periodic and cross a hole or region, but regions[{k}] is a "
                "layer across the cell, which keeps its "
                "place; translate holes and regions so that these edges cross layers only"
            )
        if best <= room:
            raise Inadmissible(
                f"edges: {edges} are periodic, but every line along {line} crosses a hole or "
                "region of the lattice or touches one; leave "
                f"more than {2 * room:.2g} mm between them, seen along {line}, or use roller "
                "edges along mirror lines of the lattice"
            )
        widest = cuts[clearances > best * (1 - EQUAL)]
        middle[axis] = widest[np.argmin(np.abs(widest))]
    holes, regions = (
        _wrapped(span.mean(axis=0) - middle, along) - span.mean(axis=0) for span in spans
    )
    regions[layers] = 0.0
    return Frame(middle, along, holes, regions)


def sampled_outline(outline: Hole) -> Float[np.ndarray, "p 2"]:
    """Points (p, 2) of an outline with its corners, mm, for its extent and orientation."""
    return at_numbers(
        outline_points, outline, np.union1d(np.arange(SAMPLES) / SAMPLES, outline.corners)
    )


def _gaps(low, high, period):
    """Clearances (k,) of the gaps between intervals (k,) and images, and distances from edges.

    Distances are those of the gaps' middles. Negative if there is no gap. The last clearance is
    that of the edges as given.
    """
    start = (low + period / 2) % period
    order = np.argsort(start, kind="stable")
    start, stop = start[order], (start + (high - low))[order]
    reach = np.maximum.accumulate(np.concatenate([stop - period, stop]))[len(stop) :]
    following = np.append(start[1:], start[:1] + period)
    cuts = (reach + following) / 2
    given = np.minimum(period - reach[-1:], following[-1:] - period)
    return np.append((following - reach) / 2, given), np.append(
        _wrapped(cuts, period), np.zeros(len(given))
    )


def _wrapped(points, along):
    """The images of ``points`` nearest the origin for the periods ``along``, 0 for none."""
    return points - along * np.round(points / np.where(np.equal(along, 0), 1.0, along))
