"""The paper's algorithm, u' from the freely swollen plate, finds the equilibria of the total energy."""

import jax
import numpy as np
import pytest

import jaxgel
from jaxgel.mechanics import all_volumes

MU = [-3.0, -2.0, -1.5]


@pytest.fixture(scope="module")
def paths(tiny_displacement_model):
    """The plate with a hole by both formulations."""
    model = tiny_displacement_model
    return [jaxgel.sweep(model, model.cloud.plate.gel, mu=MU, contact="off", formulation=name) for name in ("total", "incremental")]


def test_both_formulations_have_the_same_equilibria(paths):
    total, incremental = paths
    assert incremental.stop.ok and incremental.newton_iterations.min() >= 2
    np.testing.assert_allclose(incremental.x, total.x, atol=1e-8)  # mm, on a plate 4 mm wide; both residuals are below 1e-10
    np.testing.assert_allclose(incremental.energy, total.energy, rtol=1e-12)
    real = np.asarray(all_volumes(total.model)) > 0
    np.testing.assert_allclose(incremental.pressure[:, real], total.pressure[:, real], atol=1e-8)
    np.testing.assert_array_equal(incremental.negative_pivots, total.negative_pivots)


def test_rollers_come_back_to_their_place(paths):
    model, x = paths[1].model, paths[1].x
    wall = model.cloud.topology.edge_nodes
    nodes = np.asarray(model.cloud.nodes)
    for edge, axis in (("left", 0), ("right", 0), ("bottom", 1)):
        np.testing.assert_allclose(x[:, wall[edge], axis], np.broadcast_to(nodes[wall[edge], axis], (len(x), len(wall[edge]))), atol=1e-13)
    assert np.abs(x[-1, wall["top"], 1] - 2.0).max() > 0.1  # mm: the free edge does not


def test_what_the_paper_has_no_equations_for_is_refused(tiny_model, tiny_displacement_model):
    gel = tiny_model.cloud.plate.gel
    with pytest.raises(
        ValueError, match="formulation: 'incremental' needs method 'displacement' and conditions at the 'nodes', not 'mixed'"
    ):
        jaxgel.sweep(tiny_model, gel, mu=MU, formulation="incremental")
    with pytest.raises(ValueError, match="formulation: 'updated' is not one of total, incremental"):
        jaxgel.sweep(tiny_model, gel, mu=MU, formulation="updated")
    with pytest.raises(ValueError, match="needs the Flory-Rehner energy"):
        jaxgel.sweep(tiny_displacement_model, jaxgel.Gel(1e-3, 1e-4, network=jaxgel.Gent(10.0)), mu=MU, formulation="incremental")
    with pytest.raises(ValueError, match="'incremental' cannot be differentiated"):
        jax.grad(lambda Nv: jaxgel.sweep(tiny_displacement_model, jaxgel.Gel(Nv, 0.1), mu=MU, formulation="incremental").energy[0])(1e-3)
