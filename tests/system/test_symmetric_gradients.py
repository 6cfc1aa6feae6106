"""Gradients of symmetric sweeps: from a part of the plate where the cotangent is symmetric, from all of it otherwise."""

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.equilibrium import implicit
from jaxgel.symmetry import NAMES, orbits

CIRCLES = [jaxgel.Circle((x, y), 0.75) for x in (-1, 1) for y in (-1, 1)]
TURNED = [jaxgel.Ellipse((s, t), (0.8, 0.5), 0.0 if s * t > 0 else np.pi / 2) for s, t in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
PLATES = {
    "D4": jaxgel.Plate(4, 4, CIRCLES, spacing=0.5),
    "C4": jaxgel.Plate(4, 4, TURNED, spacing=0.4),
    "periodic": jaxgel.Plate(4, 4, CIRCLES, edges="periodic", spacing=0.5),
    "film": jaxgel.Plate(4, 4, CIRCLES, kinematics="plane stress", spacing=0.5),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PLATES)
def test_gradients_from_a_part_of_the_plate_are_those_of_all_of_it(name, monkeypatch):
    """By the parameters of every hole for itself, which break the symmetry, and of the gel."""
    plate, visited = PLATES[name], []
    monkeypatch.setattr(implicit, "LARGE", 0)
    monkeypatch.setattr(implicit, "orbits", lambda model, group: visited.append(NAMES[group]) or orbits(model, group))
    cloud = jaxgel.make_cloud(plate)
    weights = np.random.default_rng(0).normal(size=(len(cloud.nodes), 2))

    def gradients(symmetry):
        def values(theta, gel):
            model = jaxgel.discretise(cloud.at(plate.at(theta)))
            path = jaxgel.sweep(model, gel, mu=[-4.0, -3.0, -2.0], branch="symmetric", symmetry=symmetry)
            area = jnp.sum(jaxgel.area_reduction(path)[:2])
            return area, area + 1e-3 * jnp.sum(weights * path.x[2])

        pull, found = jax.vjp(values, plate.theta, jaxgel.Gel(1e-3, 0.1))[1], []
        for cotangent in ((1.0, 0.0), (0.0, 1.0)):
            visited.append("")
            found.append(jax.flatten_util.ravel_pytree(pull(tuple(map(jnp.asarray, cotangent))))[0])
        return found

    whole = gradients("off")
    assert visited == ["", ""]
    part, group = gradients("auto"), "C4" if name == "C4" else "D4"
    assert visited[2:] == ["", group, "", group]  # of the second value two states are symmetric
    for one, other in zip(part, whole, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * np.abs(other).max())
