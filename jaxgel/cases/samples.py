"""Built-in cases: samples, lattice and square of Deng et al. (2020), and cases in time.

Samples by name are those of Table 1, the lattice is Fig. 13, the square Fig. 1. Lengths in mm. The
numbers are those that reproduce the paper's node and Gauss-point counts.
"""

import itertools
import math
from typing import Any

from .._validation import did_you_mean
from ..geometry import Circle, Ellipse, Plate, Rectangle
from ..materials import Gel

SIDE = 22.0  # of the plates of samples 1-9
GRID = 40  # background intervals per side
# distance of a circle's centre from the axes: the largest leave 1 mm between them
_CIRCLES = (2 * math.sqrt(20) + 1) / 2
_SQUARES = (math.sqrt(20 * math.pi) + 1) / 2  # the same for squares


def sample_names() -> list[str]:
    """Names that `sample` accepts, a list of str; no arguments.

    >>> sample_names()[:2]
    ['sample-1', 'sample-2']
    """
    return list(_SAMPLES)


def sample(name: str) -> Plate:
    """`Plate` of a case of the paper with its gel, spacing, nodes per hole and edge conditions.

    Arguments:

    - `name`: "sample-1" ... "sample-9", "lattice" or "square"; see `sample_names`.

    Returns the plate; lengths in mm.

    Raises `ValueError` for another name.

    Source: Deng et al. (2020), Table 1, Figs. 1 and 13.

    >>> sample("square").holes
    ()
    """
    if name not in _SAMPLES:
        raise ValueError(f"case: unknown name {name!r}; {did_you_mean(name, _SAMPLES)}")
    return _SAMPLES[name](name)


def case_names() -> list[str]:
    """Names of the built-in cases, a list of str: those of ``sample``, and those in time."""
    return [*_SAMPLES, *_IN_TIME]


def built_in(name: str) -> dict[str, Any]:
    """The table of a built-in case, as a case file has it; ValueError for an unknown name."""
    if name in _IN_TIME:
        return _IN_TIME[name]
    if name not in _SAMPLES:
        raise ValueError(f"case: unknown name {name!r}; {did_you_mean(name, case_names())}")
    return {"plate": {"sample": name}}


def _four_holes(name, distance, hole):
    """A 22 mm plate with ``hole(centre, angle)`` at (+-distance, +-distance).

    The angle alternates between 0 and a right angle.
    """
    centres = [(x * distance, y * distance) for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    holes = [hole(centre, 0.0 if centre[0] * centre[1] > 0 else math.pi / 2) for centre in centres]
    gel = Gel(Nv=1e-3, chi=1e-4)
    return Plate(SIDE, SIDE, holes, name=name, spacing=SIDE / GRID, nodes_per_hole=40, gel=gel)


def _ellipses(length, width):
    return lambda name: _four_holes(
        name, 5.0, lambda centre, angle: Ellipse(centre, (length / 2, width / 2), angle)
    )


def _circles(radius_squared):
    return lambda name: _four_holes(
        name, _CIRCLES, lambda centre, _: Circle(centre, math.sqrt(radius_squared))
    )


def _squares(area_over_pi):
    side = math.sqrt(area_over_pi * math.pi)
    return lambda name: _four_holes(
        name, _SQUARES, lambda centre, _: Rectangle(centre, (side, side))
    )


def _lattice(name):
    """Lengths in 1e-3 mm; the edge cuts the outer holes to halves and quarters."""
    holes = [
        Circle(centre, 0.9) for centre in itertools.product((-4.0, -2.0, 0.0, 2.0, 4.0), repeat=2)
    ]
    gel = Gel(Nv=1e-3, chi=1e-5)
    return Plate(
        8.0,
        8.0,
        holes,
        name=name,
        spacing=8.0 / GRID,
        nodes_per_hole=20,
        core=(1.0, 1.0),
        gel=gel,
        unit="1e-3 mm",
    )


def _square(name):
    """The unit square for uniaxial swelling, free at the top."""
    gel = Gel(Nv=1e-3, chi=0.1)
    return Plate(1.0, 1.0, edges={"top": "free"}, name=name, spacing=1 / 6, gel=gel)


_SAMPLES = {
    "sample-1": _ellipses(10.0, 8.0),
    "sample-2": _ellipses(10.0, 6.0),
    "sample-3": _ellipses(8.0, 5.0),
    "sample-4": _circles(20.0),
    "sample-5": _circles(15.0),
    "sample-6": _circles(10.0),
    "sample-7": _squares(20.0),
    "sample-8": _squares(15.0),
    "sample-9": _squares(10.0),
    "lattice": _lattice,
    "square": _square,
}

_IN_TIME = {
    "sample-1-bath": {
        "plate": {"sample": "sample-1"},
        "sweep": {"mu_start": -4.9678},
        "time": {"end": 60.0},
        "bath": {"mu": -0.9678},
    },
    "two-sizes": {
        "plate": {"width": 16.0, "height": 8.0},
        "holes": [
            {"kind": "circle", "centre": [-4.0, 0.0], "radius": 2.5},
            {"kind": "circle", "centre": [4.0, 0.0], "radius": 1.25},
        ],
        "gel": {"Nv": 1e-3, "chi": 1e-4},
        "sweep": {"mu_start": -4.9678},
        "time": {"end": 100.0},
        "bath": {"mu": -1.4678},
        "discretisation": {"spacing": 0.5},
    },
}
