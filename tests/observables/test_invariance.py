"""Observables are properties of the gel: invariant under mirrors and turns, convergent.

States are smooth motions of random plates with a hole inside, one over an edge and one over a
corner of free edges.
"""

import functools
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.observables import QUANTITIES, aspect_ratio

TURNS = {
    "plain": np.eye(2),
    "mirrored": np.diag([-1.0, 1.0]),
    "turned": np.array([[0.0, -1.0], [1.0, 0.0]]),
}
# where these edges go
TOP_RIGHT = {"plain": ("right", "top"), "mirrored": ("left", "top"), "turned": ("top", "left")}
ALIKE = ("area_reduction", "J_min", "J_max", "J_mean", "gap", "min_gap")


@functools.cache
def quantities_of(seed, how, spacing=0.4):
    """Name -> value of a random plate that is turned or mirrored with its motion.

    Angles of the core and of the midline besides.
    """
    plate, motion = random_plate(seed, how, spacing)
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    states = SimpleNamespace(
        model=model, x=jnp.asarray(motion(np.asarray(model.cloud.nodes)))[None]
    )
    found = {
        name: float(QUANTITIES[name].function(states)[0])
        for name in (*ALIKE, "core_rotation", "rotation")
    }
    return found | per_hole(states)


def per_hole(states):
    """Name -> area reduction and aspect ratio of each hole in the last state."""
    values = jaxgel.area_reduction_per_hole(states)[-1], aspect_ratio(states)[-1]
    return {
        f"{name} of hole {k}": float(some[k])
        for name, some in zip(("area", "aspect"), values, strict=True)
        for k in range(3)
    }


def random_plate(seed, how, spacing):
    """A random plate, turned or mirrored, and its motion of points (p, 2), turned with it."""
    draw, Q = np.random.default_rng(seed).uniform, TURNS[how]
    inside = (draw(-0.6, -0.3), draw(0.2, 0.6)), draw(0.3, 0.65, 2), draw(0.0, 3.0)
    corner = draw(1.8, 2.1, 2), draw(0.5, 0.8, 2), draw(0.0, 3.0)
    bottom = (draw(0.2, 0.6), draw(-2.1, -1.9)), draw(0.4, 0.7, 2), draw(0.0, 3.0)
    amplitude, phase = draw(0.1, 0.3, 4), draw(0.0, 6.0, 2)
    angle = {"plain": lambda a: a, "mirrored": lambda a: -a, "turned": lambda a: a + np.pi / 2}[how]
    holes = [
        jaxgel.Ellipse(Q @ centre, axes, angle(a)) for centre, axes, a in (inside, corner, bottom)
    ]
    edges = dict.fromkeys(TOP_RIGHT[how], "free")
    sizes = dict(spacing=spacing, nodes_per_hole=round(9.6 / spacing), core=Q @ [1.0, -0.3])

    def motion(points):
        X = points @ Q
        x, y = X.T
        stretch = amplitude[:2] + amplitude[2:] * np.stack(
            [np.cos(1.1 * y + phase[0]), np.sin(1.3 * x + phase[1])], axis=1
        )
        return (X + (X + 2) / 4 * stretch) @ Q.T

    return jaxgel.Plate(4, 4, holes, edges=edges, **sizes), motion


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "how"), [(0, "mirrored"), (0, "turned")])
def test_a_plate_that_is_mirrored_or_turned_has_the_same_observables(seed, how):
    """To round-off in clouds alike. Angles change their sign in a mirror.

    The midline of a turned plate is another line of the gel.
    """
    plain, moved = (quantities_of(seed, name) for name in ("plain", how))
    sign = -1.0 if how == "mirrored" else 1.0
    expected = plain | {
        "core_rotation": sign * plain["core_rotation"],
        "rotation": sign * plain["rotation"],
    }
    for name in expected.keys() - ({"rotation"} if how == "turned" else set()):
        assert moved[name] == pytest.approx(expected[name], rel=1e-6, abs=1e-8), name


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_observables_converge_on_finer_clouds(seed):
    """Ten and twenty spacings to a side: ratios and angles (degrees) to a few per cent."""
    coarse, fine = (quantities_of(seed, "plain", spacing) for spacing in (0.4, 0.2))
    for name in coarse.keys() - {"gap", "min_gap"}:
        assert coarse[name] == pytest.approx(
            fine[name], rel=0.02, abs=0.3 if "rotation" in name else 0.01
        ), name


def state_of(seed, how):
    """Name -> value of all quantities of a random plate's equilibrium, turned or mirrored."""
    plate, _ = random_plate(seed, how, spacing=0.8)
    path = jaxgel.sweep(
        jaxgel.Problem(jaxgel.discretise(jaxgel.make_cloud(plate)), jaxgel.Gel(1e-2, 0.1)),
        [-4.0, -1.0, -0.3],
    )
    assert path.stop.ok
    # those of the iteration
    names = QUANTITIES.keys() - {"status", "switched", "newton_iterations", "residual"}
    return {name: float(QUANTITIES[name].function(path)[-1]) for name in names} | per_hole(path)


SLOW = [
    pytest.param(seed, ("mirrored", "turned")[seed % 2], marks=pytest.mark.slow)
    for seed in range(4)
]


@pytest.mark.parametrize(("seed", "how"), SLOW)
def test_equilibria_of_a_plate_that_is_mirrored_or_turned_have_the_same_table(seed, how):
    """To the tolerance of Newton's method."""
    plain, moved = (state_of(seed, name) for name in ("plain", how))
    signs = {
        "core_rotation": -1.0 if how == "mirrored" else 1.0,
        "rotation": -1.0 if how == "mirrored" else np.nan,
    }
    for name, value in plain.items():
        expected = signs.get(name, 1.0) * value
        if np.isfinite(expected):  # the midline of a turned plate is another line of the gel
            assert moved[name] == pytest.approx(expected, rel=1e-6, abs=1e-8), name
