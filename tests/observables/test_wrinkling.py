"""Least stability of free surfaces: outlines, free edges, films, printed gels, old files."""

import csv
import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.continuation import Path
from jaxgel.materials import (
    Gel,
    VolumeLaw,
    bulk_stiffness,
    osmotic,
    surface_stability,
    volume_ratio_at,
)
from jaxgel.observables import events, surface_ratios
from jaxgel.observables import surface_stability as least_stability

STRIP = {"left": "periodic", "right": "periodic", "bottom": "fixed", "top": "free"}
NV, CHI = 1e-3, 0.4


def strip(kinematics="plane strain", **options):
    plate = jaxgel.Plate(1.0, 0.5, edges=STRIP, spacing=0.125, kinematics=kinematics, **options)
    return jaxgel.discretise(jaxgel.make_cloud(plate))


def stretched(model, gel, mu, normal):
    """Path of made-up states stretched by ``normal`` (k,) along y: positions, mu and gel."""
    nodes, k = np.asarray(model.cloud.nodes), len(mu)
    x = np.stack([np.stack([nodes[:, 0], l * nodes[:, 1]], axis=1) for l in normal])  # noqa: E741
    zeros, groups = (
        np.zeros(k),
        sum(block.weight.shape[0] * block.n_groups for block in model.blocks),
    )
    integers = zeros.astype(int)
    return Path(
        problem=jaxgel.Problem(model, gel, contact=False),
        value=np.asarray(mu),
        mu=np.asarray(mu),
        x=x,
        pressure=np.zeros((k, groups)),
        status=integers,
        derivative=integers,
        newton_iterations=integers,
        residual=zeros,
        energy=zeros,
        negative_pivots=integers,
        lowest_eigenvalue=zeros,
        switched=integers,
    )


def confined_mu(J, Nv=NV, chi=CHI):
    """mu of a layer on a rigid base that has swollen to ``J``."""
    return np.log1p(-1 / J) + 1 / J + chi / J**2 - Nv / J + Nv * J


@pytest.mark.slow
def test_the_free_edge_of_a_confined_layer_is_a_surface():
    """It wrinkles at J = 3.265; positions are exact, so is the value."""
    J, gel = np.array([2.0, 3.26, 3.27]), Gel(NV, CHI)
    found = np.asarray(least_stability(stretched(strip(), gel, confined_mu(J), J)))
    exact = [
        surface_stability(jnp.array([1.0, v]), -NV * v, bulk_stiffness(v, gel), gel) for v in J
    ]
    np.testing.assert_allclose(found, exact, atol=1e-9)
    assert found[1] > 0 > found[2]


@pytest.mark.slow
def test_the_free_edge_of_a_printed_layer_has_the_gel_there():
    """Nv falls from 9e-3 at the base to 1e-3 at the surface; the surface has that of its nodes."""
    J, model = np.array([2.0, 3.0]), strip()
    gel = Gel(lambda X: NV * (5 - 16 * X[1]), CHI)
    found = np.asarray(least_stability(stretched(model, gel, confined_mu(J), J)))
    there = Gel(NV, CHI)
    exact = [
        surface_stability(jnp.array([1.0, v]), -NV * v, bulk_stiffness(v, there), there) for v in J
    ]
    np.testing.assert_allclose(found, exact, atol=1e-9)


@pytest.mark.slow
def test_the_free_edge_of_a_film_is_a_surface():
    """F = diag(1, l) with the thickness l: mu = potential(l^2) + Nv."""
    gel, stretch = Gel(NV, CHI), np.array([1.5, 2.0])
    J = stretch**2
    mu = np.log1p(-1 / J) + 1 / J + CHI / J**2 - NV / J + NV
    found = np.asarray(least_stability(stretched(strip("plane stress"), gel, mu, stretch)))
    exact = [
        surface_stability(
            jnp.array([1.0, v]),
            VolumeLaw(gel, m, film=True).pressure(v),
            VolumeLaw(gel, m, film=True).stiffness(v),
            gel,
        )
        for v, m in zip(stretch, mu, strict=True)
    ]
    np.testing.assert_allclose(found, exact, atol=1e-9)


@pytest.mark.slow
def test_the_free_edge_of_a_plate_held_at_an_axial_stretch_is_a_surface():
    """A plate held at 1.1 has J = 1.1 l, with thickness stretch l, and p = -Nv l in-plane."""
    gel, axial, stretch = Gel(NV, CHI), 1.1, np.array([2.0, 3.4])
    J = axial * stretch
    mu = np.log1p(-1 / J) + 1 / J + CHI / J**2 - NV / J + NV * stretch / axial
    model = strip("generalised plane strain", axial_stretch=axial)
    found = np.asarray(least_stability(stretched(model, gel, mu, stretch)))
    exact = [
        surface_stability(
            jnp.array([1.0, v]), -NV * v, axial**2 * bulk_stiffness(axial * v, gel), gel, axial
        )
        for v in stretch
    ]
    np.testing.assert_allclose(found, exact, atol=1e-9)


@pytest.mark.slow
def test_outlines_have_the_stability_of_their_surface_ratios(coarse_path):
    """The traction-free surface with the ratio r has p = -Nv r, whatever its stretch.

    Sample 1 has no free edge.
    """
    gel, mu = coarse_path.gel, np.asarray(coarse_path.mu)
    ratio = np.asarray(surface_ratios(coarse_path)).max(axis=1)
    J = np.asarray(volume_ratio_at(-gel.Nv * ratio, mu, gel))
    np.testing.assert_allclose(osmotic(J, mu, gel), -gel.Nv * ratio, rtol=1e-6)
    exact = [
        float(
            surface_stability(
                jnp.array([np.sqrt(v / r), np.sqrt(v * r)]),
                -gel.Nv * r,
                bulk_stiffness(v, gel),
                gel,
            )
        )
        for v, r in zip(J, ratio, strict=True)
    ]
    np.testing.assert_allclose(least_stability(coarse_path), exact, atol=1e-8)


def test_a_plate_without_free_surfaces_is_stable():
    model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.Plate(1.0, 1.0, spacing=0.25)))
    np.testing.assert_array_equal(
        least_stability(stretched(model, Gel(NV, CHI), [-1.0], [1.0])), [1.0]
    )


def test_the_first_unstable_surface_is_an_event():
    table = {
        "mu": np.array([-0.3, -0.2, -0.1]),
        "negative_pivots": np.zeros(3, int),
        "surface_ratio": np.ones(3),
        "min_gap": np.ones(3),
    }
    (event,) = events(table | {"surface_stability": np.array([0.5, -0.1, -0.2])})
    assert (event["event"], event["mu"], event["mu_before"]) == ("wrinkle", -0.2, -0.3)
    assert events(table | {"surface_stability": np.full(3, np.nan)}) == []


def test_a_table_without_the_column_is_read_with_no_value(run_folder, tmp_path):
    """As earlier versions wrote it."""
    for name in ("summary.json", "states.npz"):
        (tmp_path / name).write_bytes((run_folder / name).read_bytes())
    with (run_folder / "history.csv").open(newline="") as stream:
        rows = [dict(row) for row in csv.DictReader(stream)]
    with (tmp_path / "history.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(
            stream,
            [name for name in rows[0] if name != "surface_stability"],
            extrasaction="ignore",
            lineterminator="\n",
        )
        writer.writeheader()
        writer.writerows(rows)
    read = jaxgel.io.load_run(tmp_path).history
    assert set(read) == set(rows[0]) and np.isnan(read["surface_stability"]).all()


@pytest.mark.slow
def test_a_skin_of_elastomer_has_the_stability_of_the_elastomer():
    """Compressed to 0.6: p = K (J - 1) - Nv/J = -Nv J / 0.6^2, dp/dJ = K + Nv/J^2.

    Along x, at its surface without traction.
    """
    Nv, K, t = 1e-2, 0.5, 0.6
    plate = jaxgel.Plate(
        1.0, 0.5, edges=STRIP, regions=[jaxgel.Rectangle((0, 0.25), (4, 0.3))], spacing=0.125
    )
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    path = stretched(
        model, jaxgel.Composite(Gel(NV, CHI), (jaxgel.Elastomer(Nv, K),)), [-1.0], [1.0]
    )
    path = dataclasses.replace(path, x=path.x * np.array([t, 1.0]))
    J = max(np.roots([K + Nv / t**2, -K, -Nv]).real)
    exact = surface_stability(jnp.array([t, J / t]), -Nv * J / t**2, K + Nv / J**2, Gel(Nv, CHI))
    np.testing.assert_allclose(
        least_stability(path), [exact], atol=1e-6
    )  # six steps, each with an error of Nv / (K t^2) = 0.06 of the last
