"""The frame of a periodic cell is arbitrary: results are the lattice's.

Wherever its holes lie relative to the given edges.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel import waves
from jaxgel.mechanics import load_vector, localised
from jaxgel.observables import history

STRIP = {"left": "periodic", "right": "periodic", "bottom": "fixed", "top": "free"}
F = ((1.05, 0.1), (0.0, 0.95))
HOLES = [jaxgel.Ellipse((0.1, -0.2), (0.6, 0.4), 0.5), jaxgel.Circle((-0.85, 0.75), 0.15)]
SIZES = dict(spacing=0.4, nodes_per_hole=12)
EQUAL = 1e-6  # relative: two clouds that differ by round-off, and Newton's tolerance


def shifted(by, holes=HOLES, **entries):
    holes = [hole.translated(np.array(by)) for hole in holes]
    return jaxgel.Plate(
        2,
        2,
        holes,
        core=tuple(np.add((-0.7, 0.3), by).tolist()),
        **({"edges": "periodic", "deformation": F} | entries),
    )


def modelled(plate):
    return jaxgel.discretise(jaxgel.make_cloud(plate, **SIZES))


def table(plate, mu=(-3.0, -1.5)):
    path = jaxgel.sweep(
        jaxgel.Problem(modelled(plate), jaxgel.Gel(1e-3, 0.1), contact=False), list(mu)
    )
    columns = {
        name: np.asarray(values, float)
        for name, values in history(path).items()
        if np.asarray(values).dtype.kind in "fi"
    }
    return path, columns | {"per hole": np.asarray(jaxgel.area_reduction_per_hole(path))}


def assert_equal(one, other):
    for name, values in one.items():
        if "residual" not in name and "iterations" not in name:
            np.testing.assert_allclose(values, other[name], rtol=EQUAL, atol=EQUAL, err_msg=name)


@pytest.mark.slow
def test_all_columns_of_the_table_are_those_of_the_lattice():
    """Two holes, one of them across a corner of the shifted cell."""
    path, given = table(shifted((0.0, 0.0)))
    _, moved = table(shifted((-0.2, 0.3)))
    assert_equal(given, moved)
    X = np.asarray(path.model.cloud.nodes)
    np.testing.assert_allclose(jaxgel.macroscopic_deformation(path)[-1], F, rtol=0, atol=1e-12)
    # the holes make it non-affine
    assert np.abs(np.asarray(path.x)[-1] - X @ np.array(F).T).max() > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("edges", ["periodic", STRIP])
@pytest.mark.parametrize("seed", range(3))
def test_random_cells_have_the_results_of_their_shifted_ones(seed, edges):
    rng = np.random.default_rng(seed)
    axes = rng.uniform(0.35, 0.6, 2)
    holes = [
        jaxgel.Ellipse(rng.uniform(-0.1, 0.1, 2), axes, rng.uniform(0, 3)),
        jaxgel.Circle((0.8, 0.8), rng.uniform(0.08, 0.15)),
    ]
    entries = dict(
        holes=holes, edges=edges, deformation=F if edges == "periodic" else ((1.0, 0.0), (0.0, 1.0))
    )
    by = rng.uniform(-1, 1, 2) * ([1.0, 1.0] if edges == "periodic" else [1.0, 0.0])
    assert_equal(table(shifted((0.0, 0.0), **entries))[1], table(shifted(by, **entries))[1])


def test_affine_fields_have_their_gradient_on_a_cell_whose_frame_was_moved():
    model = modelled(shifted((-0.2, 0.3)))
    assert model.cloud.topology.frame.middle.any()
    x = np.asarray(model.cloud.nodes) @ np.array(F).T
    for block in model.blocks:
        gradient = np.einsum("cqaj,cai->cqij", np.asarray(block.dphi), x[np.asarray(block.nodes)])
        real = np.asarray(block.weight) > 0
        np.testing.assert_allclose(
            gradient[real], np.broadcast_to(F, gradient[real].shape), rtol=0, atol=1e-9
        )
    area = sum(float(np.asarray(block.weight).sum()) for block in model.blocks)
    # outlines are parabolas through 12 nodes
    assert area == pytest.approx(4 - np.pi * (0.24 + 0.15**2), rel=1e-3)


@pytest.mark.thorough
def test_fields_and_loads_are_functions_of_the_coordinates_as_given():
    """A field and a body force that move with the lattice are the same in its frame."""

    def values(by):
        def wave(X):
            return jnp.cos(jnp.pi * (X[0] - by[0])) + X[1] ** 2

        model = modelled(shifted(by, edges=STRIP, deformation=((1.0, 0.0), (0.0, 1.0))))
        gel = localised(model, jaxgel.Gel(1e-3, lambda X: 0.1 + 0.01 * wave(X)))
        load = load_vector(
            model,
            body_force=lambda X: 1e-4 * jnp.stack([jnp.cos(jnp.pi * (X[0] - by[0])), 0.0 * X[0]]),
        )
        return [*gel.chi.points, gel.chi.groups, gel.chi.outline, load]

    for one, other in zip(values((0.0, 0.0)), values((-0.9, 0.0)), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_symmetries_are_found_about_the_middle_of_the_frame():
    """A hole across a corner of the cell has the group of the one in the middle."""
    path = table(jaxgel.Plate(2, 2, [jaxgel.Circle((1.0, 0.9), 0.6)], edges="periodic"), [-3.0])[0]
    assert set(path.symmetry) == {"D4"}


@pytest.mark.slow
def test_a_cell_of_the_lattice_is_found_if_its_holes_lie_across_the_edges():
    centres = [(x, y) for x in (0, 2) for y in (-2, 0)]
    cell = waves.primitive_cell(
        jaxgel.Plate(4, 4, [jaxgel.Circle(centre, 0.7) for centre in centres], edges="periodic")
    )
    assert (cell.width, cell.height, len(cell.holes)) == (2.0, 2.0, 1)
    framed = jaxgel.make_cloud(cell, **SIZES).topology.plate
    np.testing.assert_allclose(framed.holes[0].centre, 0.0, rtol=0, atol=1e-12)
