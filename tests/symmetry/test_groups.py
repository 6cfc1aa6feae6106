"""Facts about the symmetries of plates, clouds and states."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import monitoring
from scipy.spatial import cKDTree

import jaxgel
from jaxgel import Problem
from jaxgel.geometry import SYMMETRIES, Circle, Plate, Rectangle, keeps_edges
from jaxgel.materials import Gel, PixelField
from jaxgel.mechanics import load_vector
from jaxgel.symmetry import NAMES, images, symmetries_of, symmetries_of_state

NAMED = ["D4", "C4", "D2 (axes)", "D2 (diagonals)", "C2", "D1 (x -> -x)", "D1 (x <-> -y)", "C1"]


def name_of(problem):
    return NAMES[symmetries_of(problem)]


@pytest.mark.parametrize("name", NAMED)
def test_group_of_a_plate_is_that_of_its_holes(name, plates, problem_of):
    assert name_of(problem_of(plates[name])) == name


def test_symmetries_are_found_without_a_program(plates, problem_of):
    """Also if quadrature points and weights are arrays of JAX."""
    problem, heard = problem_of(plates["C4"]), []

    blocks = tuple(
        dataclasses.replace(
            block, position=jnp.asarray(block.position), weight=jnp.asarray(block.weight)
        )
        for block in problem.model.blocks
    )
    problem = problem.replace(model=dataclasses.replace(problem.model, blocks=blocks))
    jax.clear_caches()

    def hear(event, duration, **_):
        heard.append(event)

    monitoring.register_event_duration_secs_listener(hear)
    try:
        assert name_of(problem) == "C4"
    finally:
        monitoring.unregister_event_duration_listener(hear)
    assert [event for event in heard if event.startswith("/jax/core/compile/")] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "sample-1",
        "lattice",
        *(pytest.param(f"sample-{k}", marks=pytest.mark.slow) for k in (4, 5, 9)),
    ],
)
def test_clouds_of_the_samples_are_symmetric_to_round_off(name, problem_of):
    """Nodes, quadrature points and weights: the largest distance is 3e-13 of the spacing."""
    plate = jaxgel.sample(name)
    problem = problem_of(plate, plate.gel)
    assert name_of(problem) == ("C4" if name == "sample-1" else "D4")
    model = problem.model
    for image in images(model.lists).values():
        for block in model.blocks:
            points, weight = (
                np.asarray(values).reshape(len(block.weight.ravel()), -1)
                for values in (block.position, block.weight)
            )
            real = weight[:, 0] > 0
            apart, there = cKDTree(points[real]).query(points[real] @ image.matrix.T)
            assert apart.max() < 1e-12 * model.cloud.spacing
            np.testing.assert_allclose(weight[real][there], weight[real], rtol=1e-10)


@pytest.mark.parametrize("shift", [1e-9, 1e-5, 1e-2])
def test_plate_that_is_nearly_symmetric_is_not(shift, plates, gel, problem_of):
    plate = Plate(4, 4, [Circle((shift * 0.25, 0), 1)], spacing=0.25)
    assert name_of(problem_of(plate)) in ("C1", "D1 (y -> -y)")
    cloud = jaxgel.make_cloud(plates["D4"])
    moved = cloud.at(cloud.plate.at([{"centre": jnp.array([shift * 0.25, 0.0])}]))
    assert name_of(Problem(jaxgel.discretise(moved), gel, contact=False).prepared) == "D1 (y -> -y)"


def test_moved_cloud_keeps_the_symmetries_of_its_plate(plates, gel):
    cloud = jaxgel.make_cloud(plates["D4"])
    moved = cloud.at(cloud.plate.at([{"radius": jnp.asarray(1.1)}]))
    assert name_of(Problem(jaxgel.discretise(moved), gel, contact=False).prepared) == "D4"


@pytest.mark.slow
def test_edges_loads_and_fields_take_symmetries_away(plates, gel, problem_of):
    plate = plates["D4"]
    assert (
        name_of(problem_of(Plate(4, 4, plate.holes, spacing=0.25, edges={"top": "free"})))
        == "D1 (x -> -x)"
    )
    assert (
        name_of(
            problem_of(
                Plate(
                    4,
                    4,
                    plate.holes,
                    spacing=0.25,
                    displacement={"right": (0.1, 0.0), "left": (-0.1, 0.0)},
                )
            )
        )
        == "D2 (axes)"
    )
    assert (
        name_of(
            problem_of(Plate(4, 4, plate.holes, spacing=0.25, deformation=((1.1, 0.0), (0.0, 1.1))))
        )
        == "D4"
    )
    for others in ("roller", "free"):  # a corner is held, and its image in y is not
        edges = {"left": "periodic", "right": "periodic", "top": others, "bottom": others}
        assert (
            name_of(problem_of(Plate(4, 4, plate.holes, spacing=0.25, edges=edges)))
            == "D1 (x -> -x)"
        )
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    assert (
        name_of(
            Problem(
                model, gel, loads=load_vector(model, body_force=(0.0, -1e-5)), contact=False
            ).prepared
        )
        == "D1 (x -> -x)"
    )
    stripes = PixelField(np.array([[1e-3, 2e-3, 1e-3]]), (-2.0, 2.0, -2.0, 2.0))
    assert name_of(Problem(model, Gel(stripes, 0.1), contact=False).prepared) == "D2 (axes)"
    graded = PixelField(np.array([[1e-3, 2e-3]]), (-2.0, 2.0, -2.0, 2.0))
    assert name_of(Problem(model, Gel(graded, 0.1), contact=False).prepared) == "D1 (y -> -y)"


def test_network_with_fibres_has_no_symmetry(plates):
    def fibres(F, gel):
        return gel.Nv / 2 * (jnp.sum(F**2) + 0.1 * (F[0, 0] ** 2 + F[1, 0] ** 2) ** 2)

    model = jaxgel.discretise(jaxgel.make_cloud(plates["D4"]))
    assert name_of(Problem(model, Gel(1e-3, 0.1, network=fibres), contact=False).prepared) == "C1"
    assert (
        name_of(Problem(model, Gel(1e-3, 0.1, network=jaxgel.Gent(30.0)), contact=False).prepared)
        == "D4"
    )


def test_group_of_a_state(plates, problem_of):
    problem = problem_of(plates["D4"])
    group, x = symmetries_of(problem), np.array(problem.model.cloud.nodes)
    assert NAMES[symmetries_of_state(x, problem.model, group)] == "D4"
    assert NAMES[symmetries_of_state(x * [1.1, 1.0], problem.model, group)] == "D2 (axes)"
    assert NAMES[symmetries_of_state(x + 1e-6 * x[:, ::-1] * [1, -1], problem.model, group)] == "C4"
    assert NAMES[symmetries_of_state(x + 1e-6 * np.sin(x), problem.model, group)] == "D4"
    assert NAMES[symmetries_of_state(x + 1e-6 * np.cos(x), problem.model, group)] == "D1 (x <-> y)"


@pytest.mark.parametrize("name", SYMMETRIES)
def test_images_of_nodes_and_degrees_of_freedom(name, plates, problem_of):
    model = problem_of(plates["D4"]).model
    image, x = images(model.lists)[name], np.asarray(model.cloud.nodes)
    np.testing.assert_allclose(x[image.nodes], x @ image.matrix.T, atol=1e-12)
    field = np.random.default_rng(0).normal(size=x.shape)
    moved = np.empty_like(field)
    moved[image.nodes] = field @ image.matrix.T
    numbers, sign = (
        np.where(image.dofs < 0, ~image.dofs, image.dofs),
        np.where(image.dofs < 0, -1.0, 1.0),
    )
    np.testing.assert_allclose(moved.ravel()[numbers], sign * field.ravel(), rtol=1e-15)


@pytest.mark.slow
def test_edges_of_a_plate():
    plate = Plate(4, 4, [Rectangle((0, 0), (1, 1))], edges={"left": "fixed", "right": "fixed"})
    kept = [name for name, matrix in SYMMETRIES.items() if keeps_edges(plate, np.array(matrix))]
    assert kept == ["x -> -x", "y -> -y", "rotation by 180"]
