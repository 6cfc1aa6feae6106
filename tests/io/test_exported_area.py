"""Area of exported gels: dry area times mean volume ratio; files are in test_drawings."""

import functools
from unittest.mock import NonCallableMock

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import jaxgel
from jaxgel.continuation import Path
from jaxgel.controls import ChemicalPotential
from jaxgel.io import dry_gel, swollen_gel, write_outline
from jaxgel.mechanics import held_dofs
from jaxgel.observables import cell_volumes, deformed_vertices

CIRCLE = functools.partial(jaxgel.Circle, radius=1.0)
FREE = {"right": "free", "top": "free"}
MOVED = {"deformation": ((1.2, 0.0), (0.0, 1.1))}
PLATES = {
    "held, whole": {"holes": [CIRCLE((0.2, 0.1))]},
    "held, edge": {"holes": [CIRCLE((2.0, 0.2))]},
    "moved, corner": {"holes": [CIRCLE((2.0, 2.0))], **MOVED},
    "free, whole": {"holes": [CIRCLE((0.2, 0.1))], "edges": FREE},
    "free, edge": {"holes": [CIRCLE((2.0, 0.2))], "edges": FREE},
    "free, corner": {"holes": [CIRCLE((2.0, 2.0))], "edges": FREE},
    "periodic": {"holes": [CIRCLE((0.0, 0.0))], "edges": "periodic"},
    "more hole than gel": {"holes": [CIRCLE((0.0, 0.0), radius=1.6)]},
}
SOME = ("moved, corner", "free, edge", "periodic", "more hole than gel")


class States(NonCallableMock):
    """A path of one state that is no equilibrium; the areas are those of any motion."""

    def __getitem__(self, _):
        return self


@functools.cache
def swollen(name):
    """A state with edges bent where they can, and the area of its gel by the cells."""
    plate = jaxgel.Plate(4, 4, **PLATES[name], spacing=0.4, nodes_per_hole=24)
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    X = np.asarray(model.cloud.nodes)
    x, y = X.T
    if plate.edges["left"] == "periodic":
        bend = np.stack(
            [0.1 * np.cos(np.pi * y) + 0.1 * np.sin(np.pi * x / 2), 0.1 * np.sin(np.pi * x)], axis=1
        )
    elif plate.edges["right"] == "roller":
        bend = 0.1 * np.stack(
            [
                np.sin(np.pi * x / 2) * np.cos(np.pi * y / 4),
                np.sin(np.pi * y / 2) * np.cos(np.pi * x / 4),
            ],
            axis=1,
        )
    else:
        bend = np.stack(
            [
                (x + 2) * (0.05 + 0.08 * np.cos(np.pi * y / 4)),
                (y + 2) * (0.05 + 0.08 * np.cos(np.pi * x / 4)),
            ],
            axis=1,
        )
    bend = np.where(held_dofs(model.lists.topology), 0.0, bend)
    x = jnp.asarray(X @ np.array(plate.dry_deformation).T + bend)
    states = States(Path, model=model, x=x[None], value=np.zeros(1), control=ChemicalPotential())
    return states, float(
        np.asarray(cell_volumes(model)) @ np.asarray(jaxgel.volume_ratio(states))[0]
    )


def area_of_picture(file, gel):
    grey = np.asarray(Image.open(file), dtype=float) / 255
    left, low, right, high = gel.bounds
    return grey.mean() * (right - left) * (high - low)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name",
    [*SOME, *(pytest.param(name, marks=pytest.mark.slow) for name in PLATES if name not in SOME)],
)
def test_exported_gel_has_the_area_of_its_cells(name):
    """To 3e-4: chords of outlines miss 5e-5, and 2e-4 of the gel around the large hole."""
    states, area = swollen(name)
    gel = swollen_gel(states, 0)
    assert gel.is_valid
    assert gel.area == pytest.approx(area, rel=3e-4)
    dry = float(np.sum(cell_volumes(states.model)))
    # 720 chords of an outline
    assert dry_gel(states.model.cloud.topology.plate).area == pytest.approx(dry, rel=2e-5)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["free, edge", "periodic"])
def test_triangles_of_paraview_files_have_the_area_of_the_cells(name):
    """To 1e-3: triangle sides are chords of a free edge that bends 0.3 mm over ten of them."""
    states, area = swollen(name)
    vertices, triangles = (
        np.asarray(deformed_vertices(states))[0],
        np.asarray(states.model.cloud.triangles),
    )
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    assert np.sum(np.linalg.det(np.stack([b - a, c - a], axis=1))) / 2 == pytest.approx(
        area, rel=1e-3
    )


def test_pictures_hold_the_area_of_the_gel(tmp_path):
    """Each pixel's share of gel to half a grey value, 2e-3 of the pixels on the outline."""
    states, area = swollen("moved, corner")
    gel = swollen_gel(states, 0)
    file = write_outline(gel, tmp_path / "wet.png", pixels_per_mm=20.0)
    assert area_of_picture(file, gel) == pytest.approx(area, rel=2e-4)


def test_a_hole_that_crosses_the_plates_edge_is_refused():
    states, _ = swollen("more hole than gel")
    far = States(
        model=states.model, x=1.5 * states.x, value=np.zeros(1), control=ChemicalPotential()
    )
    far.x = jnp.where(held_dofs(states.model.lists.topology), states.x, far.x)
    with pytest.raises(ValueError, match=r"^state: the outline at mu = 0 crosses itself$"):
        swollen_gel(far, 0)
