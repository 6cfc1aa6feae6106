"""Plates of every symmetry."""

import numpy as np
import pytest

from jaxgel import Circle, Ellipse, Gel, Plate, Problem, discretise, make_cloud

TURNED = [
    Ellipse((s, t), (0.8, 0.5), 0.0 if s * t > 0 else np.pi / 2)
    for s, t in ((1, 1), (-1, 1), (-1, -1), (1, -1))
]


@pytest.fixture(scope="session")
def plates():
    """Name of a group -> plate with these symmetries, 4 mm wide."""
    square = {
        "D4": [Circle((0, 0), 1)],
        "C4": TURNED,
        "D2 (diagonals)": [Ellipse((0, 0), (1.2, 0.7), np.pi / 4)],
        "C2": [Ellipse((0, 0), (1.2, 0.7), 0.3)],
        "D1 (x -> -x)": [Circle((0, 0.5), 1)],
        "D1 (x <-> -y)": [Circle((0.5, -0.5), 1)],
        "C1": [Circle((0.3, 0.2), 1)],
    }
    found = {name: Plate(4, 4, holes, spacing=0.25) for name, holes in square.items()}
    return found | {"D2 (axes)": Plate(4, 3, [Circle((0, 0), 1)], spacing=0.25)}


@pytest.fixture(scope="session")
def gel():
    return Gel(1e-3, 0.1)


@pytest.fixture(scope="session")
def problem_of(gel):
    """Function that prepares a plate's problem, with other gel, loads and discretisation."""

    def prepared(plate, own=None, loads=None, **options):
        return Problem(
            discretise(make_cloud(plate), **options), own or gel, loads=loads, contact=False
        ).prepared

    return prepared
