"""Small periodic cells."""

import pytest

import jaxgel

GEL = jaxgel.Gel(Nv=1e-3, chi=1e-5)


@pytest.fixture(scope="session")
def model_of():
    """Function that gives the model of a periodic cell (2, 2) with one hole."""

    def make(hole):
        return jaxgel.discretise(
            jaxgel.make_cloud(
                jaxgel.Plate(2, 2, [hole], edges="periodic"), spacing=0.25, nodes_per_hole=16
            )
        )

    return make


@pytest.fixture(scope="session")
def gel():
    """The gel of the paper's lattice."""
    return GEL


@pytest.fixture(scope="session")
def cell(model_of):
    """One cell of the lattice."""
    return model_of(jaxgel.Circle((0, 0), 0.9))


@pytest.fixture(scope="session")
def onset(cell, gel):
    """Its onset."""
    return jaxgel.lattice_onset(jaxgel.Problem(cell, gel), (-3.6, -2.4), divisions=4)
