"""The paper's scheme on a small plate."""

import pytest

import jaxgel
from jaxgel.paper import make_scheme


@pytest.fixture(scope="session")
def tiny_scheme(tiny_plate):
    """The tiny plate with the paper's scheme: J at every Gauss point of 8 x 8 cells."""
    return make_scheme(jaxgel.make_cloud(tiny_plate), dmax=2.5)
