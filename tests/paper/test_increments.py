"""The paper's algorithm, u' from the swollen plate, finds equilibria of the total energy."""

import numpy as np
import pytest

from jaxgel.paper import equilibria, make_scheme

MU = [-3.0, -2.0, -1.5]


@pytest.fixture(scope="module")
def both(tiny_scheme):
    """The plate with a hole by both algorithms."""
    return [
        list(equilibria(tiny_scheme, tiny_scheme.cloud.plate.gel, MU, algorithm=name))
        for name in ("total", "incremental")
    ]


@pytest.mark.slow
def test_both_algorithms_have_the_same_equilibria(both):
    for total, incremental in zip(*both, strict=True):
        assert incremental.status.ok and incremental.newton_iterations >= 2
        # mm, on a plate 4 mm wide; both residuals are below 1e-10
        np.testing.assert_allclose(incremental.x, total.x, atol=1e-8)
        np.testing.assert_allclose(incremental.energy, total.energy, rtol=1e-12)
        assert incremental.negative_pivots == total.negative_pivots == 0


@pytest.mark.slow
def test_rollers_come_back_to_their_place(both, tiny_scheme):
    wall, nodes = tiny_scheme.cloud.topology.edge_nodes, np.asarray(tiny_scheme.cloud.nodes)
    for state in both[1]:
        for edge, axis in (("left", 0), ("right", 0), ("bottom", 1)):
            np.testing.assert_allclose(
                state.x[wall[edge], axis], nodes[wall[edge], axis], atol=1e-13
            )
    assert np.abs(both[1][-1].x[wall["top"], 1] - 2.0).max() > 0.1  # mm: the free edge does not


@pytest.mark.slow
def test_what_the_paper_has_no_equations_for_is_refused(cloud_of):
    cloud = cloud_of("square")
    gel = cloud.plate.gel
    for options in (dict(method="cells"), dict(conditions="penalty")):
        given = "'cells' and 'nodes'" if "method" in options else "'displacement' and 'penalty'"
        with pytest.raises(
            ValueError,
            match=(
                r"^algorithm: 'incremental' needs method 'displacement' and conditions at the "
                rf"'nodes', not {given}"
            ),
        ):
            equilibria(make_scheme(cloud, **options), gel, MU, algorithm="incremental")
    with pytest.raises(ValueError, match=r"^algorithm: 'updated' is not one of total, incremental"):
        equilibria(make_scheme(cloud), gel, MU, algorithm="updated")
