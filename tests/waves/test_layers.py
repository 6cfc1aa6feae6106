"""Wrinkles of layers on a rigid base, beside exact waves of uniform states.

See tests/layers.py.
"""

import jax
import numpy as np
import pytest
from layers import critical_mu, graded, onset, stretch

import jaxgel

STRIP = {"left": "periodic", "right": "periodic", "bottom": "fixed", "top": "free"}
NV, CHI, WIDTH = 1e-3, 0.1, 0.4  # of the lower layer; mm, of a strip of layers 1 mm thick together
WAVES = np.linspace(1.0, 8.0, 8)  # rad/mm


def model_of(spacing, upper=None, width=WIDTH):
    regions = [] if upper is None else [jaxgel.Rectangle((0, 0.5), (4, 2 * upper))]
    return jaxgel.discretise(
        jaxgel.make_cloud(jaxgel.Plate(width, 1.0, edges=STRIP, regions=regions, spacing=spacing))
    )


def bilayer(ratio):
    return jaxgel.Composite(jaxgel.Gel(NV, CHI), (jaxgel.Gel(ratio * NV, CHI),))


def compare(found, exact, Nv):
    """Within 1 % in mu, surface volume ratio and wave number, as asked of finite elements.

    Measured: at most 0.22 % in mu, 0.06 % in the volume ratio, 0.9 % in the wave number, this one
    of the graded layer on ten squares.
    """
    mu, k = exact
    assert found.mu == pytest.approx(mu, rel=1e-2)
    assert stretch(Nv, CHI, float(found.mu)) == pytest.approx(stretch(Nv, CHI, mu), rel=1e-2)
    assert (
        found.kind == "short wave"
        and abs(found.wave_vector[0]) == pytest.approx(k, rel=1e-2)
        and found.wave_vector[1] == 0
    )


slow = pytest.mark.slow


@pytest.mark.slow
@pytest.mark.parametrize(
    ("upper", "ratio", "window", "spacing"),
    [
        (0.1, 10, (-0.8, -0.65), 0.1),
        pytest.param(0.1, 3, (-0.35, -0.22), 0.1, marks=slow),
        pytest.param(0.2, 3, (-0.35, -0.22), 0.1, marks=slow),
        pytest.param(0.2, 10, (-0.8, -0.6), 0.05, marks=slow),
    ],
)
def test_bilayers_wrinkle_with_the_exact_wave(upper, ratio, window, spacing):
    found = jaxgel.lattice_onset(
        jaxgel.Problem(model_of(spacing, upper), bilayer(ratio)), window, divisions=4
    )
    exact = onset([(1 - upper, NV, CHI), (upper, ratio * NV, CHI)], np.linspace(*window, 6), WAVES)
    compare(found, exact, ratio * NV)


@slow
@pytest.mark.parametrize("spacing", [0.1, 0.05])
def test_a_graded_layer_wrinkles_with_the_exact_wave(spacing):
    gel = jaxgel.Gel(lambda X: NV * (5.5 + 9 * X[1]), CHI)
    found = jaxgel.lattice_onset(jaxgel.Problem(model_of(spacing), gel), (-0.2, -0.1), divisions=4)
    compare(
        found,
        onset(graded(lambda y: NV * (1 + 9 * y), CHI), np.linspace(-0.2, -0.1, 5), WAVES[:3]),
        10 * NV,
    )


@slow
def test_the_onset_of_a_bilayer_changes_with_its_gel_as_the_exact_one_does():
    """Within 1 % as the onsets themselves."""
    model = model_of(0.1, 0.1)
    slope = jax.grad(
        lambda ratio: (
            jaxgel.lattice_onset(
                jaxgel.Problem(model, bilayer(ratio)), (-0.8, -0.65), divisions=4
            ).mu
        )
    )(10.0)
    sides = [
        onset([(0.9, NV, CHI), (0.1, ratio * NV, CHI)], np.linspace(-0.8, -0.65, 6), WAVES)[0]
        for ratio in (9.9, 10.1)
    ]
    assert float(slope) == pytest.approx((sides[1] - sides[0]) / 0.2, rel=1e-2)


@slow
def test_a_homogeneous_layer_is_unstable_to_the_shortest_waves_of_the_cloud_whatever_the_spacing():
    """The exact onset is that of a half-plane, which all short waves share (Kang & Huang 2010).

    A cloud is a little softer to its shortest waves, at a volume ratio up to 12 % lower; those on
    six squares do not see the base, and are images of each other.
    """
    exact = critical_mu([(1.0, NV, CHI)], 20.0, np.linspace(-0.3, -0.02, 20))
    assert stretch(NV, CHI, exact) == pytest.approx(3.317, abs=1e-3)
    gel, found = jaxgel.Gel(NV, CHI), []
    for spacing in (0.05, 0.025):
        found.append(
            float(
                jaxgel.lattice_onset(
                    jaxgel.Problem(model_of(spacing, width=6 * spacing), gel),
                    (-0.1, -0.045),
                    divisions=4,
                ).mu
            )
        )
    assert found[0] == pytest.approx(found[1], rel=1e-6)
    assert 0.88 < stretch(NV, CHI, found[0]) / stretch(NV, CHI, exact) < 1
