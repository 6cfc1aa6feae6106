"""Solvent in one material point, and layers that are held sideways."""

import jax
import numpy as np
import pytest

from jaxgel import materials
from jaxgel.materials import Gel, Gent

layer_potential, layer_stretch, layer_uptake = map(
    jax.jit, (materials.layer_potential, materials.layer_stretch, materials.layer_uptake)
)
GEL = Gel(1e-3, 0.1)


@pytest.mark.thorough
@pytest.mark.parametrize("gel", [GEL, Gel(1e-3, 0.1, network=Gent(30.0))])
def test_the_stretch_of_a_layer_is_the_inverse_of_its_potential(gel):
    """Also sideways stretched and held at an axial stretch; with its derivative, by differences."""
    for mu, along, axial in ((-4.0, 1.0, None), (-0.3, 1.2, 1.1), (-0.05, 1.5, None)):
        normal = layer_stretch(mu, along, gel, axial)
        assert layer_potential(normal, along, gel, axial) == pytest.approx(mu, rel=1e-10)
    # the confined film by finite volumes
    assert float(layer_stretch(-1.0, 1.0, GEL)) == pytest.approx(1.17021, abs=5e-6)
    difference = (
        layer_potential(1.5 + 1e-6, 1.2, gel) - layer_potential(1.5 - 1e-6, 1.2, gel)
    ) / 2e-6
    expected = 2.0 * (1.5 * 1.2 - 1) / 1.5**2 * difference / 1.2
    assert materials.layer_diffusivity(1.5, 1.2, gel, None, 2.0) == pytest.approx(
        float(expected), rel=1e-6
    )


@pytest.mark.parametrize(
    ("mu", "bath", "amplitude", "accuracy"),
    [(-0.5, -0.4999, 0.5683, 2e-4), (-1.0, -0.1, 0.3204, 0.05), (-0.1, -1.0, 0.4832, 0.03)],
)
def test_a_surface_takes_up_what_finite_volumes_do(mu, bath, amplitude, accuracy):
    """U / sqrt(t) of a film of thickness 1 at small times, by the mean diffusivity.

    That is good to some per cent if it changes twentyfold.
    """
    change, D = layer_uptake(mu, bath, 1.0, GEL, None, 1.0)
    assert 2 * np.sqrt(float(D) / np.pi) == pytest.approx(amplitude, rel=accuracy)
    assert float(change) == pytest.approx(
        float(layer_stretch(bath, 1.0, GEL) - layer_stretch(mu, 1.0, GEL)), rel=1e-12
    )
