"""Inert padding of shared equations; similar plates share programs of sweep and gradient."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import monitoring

import jaxgel
from jaxgel import _sizes, observables
from jaxgel.cloud import cloud as placing
from jaxgel.discretisation import body, ladder, layout, neighbours
from jaxgel.mechanics import (
    condensed_rhs,
    conditions,
    energy_at,
    linearise,
    state_pressure,
    tangent,
)

GEL = jaxgel.Gel(Nv=1e-3, chi=0.2)
VALUES = [-3.5, -2.5]
ROLLERS = {"left": "roller", "bottom": "roller"}
slow = functools.partial(pytest.param, marks=pytest.mark.slow)


def plate_of(axes, **options):
    hole = jaxgel.Ellipse((0.3, -0.2), axes, 0.4)
    return jaxgel.Plate(8, 8, [hole], spacing=1.2, nodes_per_hole=8, core=(3.2, 3.0), **options)


def turned(axes, plate, gel=GEL, values=VALUES):
    """Rotation of the core of a plate with these semi-axes in the last state, and the path."""
    cloud = jaxgel.make_cloud(plate)
    path = jaxgel.sweep(
        jaxgel.Problem(jaxgel.discretise(cloud.at(plate.at([{"semi_axes": axes}]))), gel), values
    )
    return jaxgel.core_rotation(path)[-1] + path.energy[-1], path


def _numbers(plate, gel):
    axes = jnp.array([2.4, 1.6])
    (value, path), slopes = jax.value_and_grad(turned, has_aux=True)(axes, plate, gel)
    return value, path.x, path.pressure, path.negative_pivots, slopes


def _widen(patch):
    """More room for everything."""
    wider = {"NODES": 1000, "MANY": 2048, "SHARE": 3.0, "NEIGHBOURS": (150,), "OF_SQUARES": (150,)}
    for name, more in {**wider, "LINEAR": ((200, 70),), "CONSTANT": ((210, 75),)}.items():
        modules = [
            module
            for module in (_sizes, body, conditions, ladder, layout, neighbours, placing)
            if hasattr(module, name)
        ]
        assert modules
        for module in modules:
            patch.setattr(module, name, more)


@pytest.mark.thorough
def test_energy_forces_and_tangent_do_not_depend_on_the_padding(tiny_plate, monkeypatch):
    def found():
        model = jaxgel.discretise(jaxgel.make_cloud(tiny_plate))
        problem, x = (
            jaxgel.Problem(model, GEL, contact=False).prepared,
            np.asarray(model.cloud.nodes),
        )
        x = 1.3 * x + 0.02 * np.random.default_rng(1).normal(size=x.shape)
        p = state_pressure(x, model, GEL, -2.0)
        now = linearise(problem, x, p, -2.0)
        energy, K = (
            energy_at(x, model, GEL, -2.0, problem.loads),
            problem.pattern.matrix(tangent(problem, x, p, now)),
        )
        return energy, p, condensed_rhs(problem, now, now), K.toarray()

    once = found()
    _widen(monkeypatch)
    for one, two in zip(once, found(), strict=True):
        np.testing.assert_allclose(two, one, rtol=1e-9, atol=1e-11 * np.abs(one).max())


@pytest.mark.parametrize(
    ("options", "gel"),
    [
        slow(
            {},
            jaxgel.Gel(Nv=1e-3, chi=lambda X: 0.2 + 0.01 * X[0], network=jaxgel.Gent(30.0)),
            id="field and Gent",
        ),
        slow(
            {"edges": {**ROLLERS, "right": "free", "top": "free"}, "kinematics": "plane stress"},
            GEL,
            id="film",
        ),
        slow(
            {"edges": dict.fromkeys(("left", "right", "bottom", "top"), "periodic")},
            GEL,
            id="periodic",
        ),
    ],
)
def test_padding_is_inert(options, gel, monkeypatch):
    """More room leaves states, pressures and slopes by a hole as they are."""
    plate = dataclasses.replace(
        plate_of((2.4, 1.6), **options), spacing=0.7, nodes_per_hole=32, core=(3.0, 3.0)
    )
    once = _numbers(plate, gel)
    _widen(monkeypatch)
    for one, two in zip(once, _numbers(plate, gel), strict=True):
        np.testing.assert_allclose(two, one, rtol=1e-9, atol=1e-11 * np.abs(one).max())


def compiled(run):
    """Names of the functions that are compiled in a ``run``."""
    names = []

    def hear(event, *_, fun_name="", **__):
        if event.endswith("backend_compile_duration"):
            names.append(fun_name)

    monitoring.register_event_duration_secs_listener(hear)
    try:
        run()
    finally:
        monitoring.unregister_event_duration_listener(hear)
    return names


@pytest.mark.thorough
def test_a_second_plate_compiles_nothing_and_a_first_one_little():
    """Neither for its cloud and sweep nor for the gradient by its holes; it has other numbers."""
    sizes = []

    def rotation(axes, plate, cloud):
        model = jaxgel.discretise(cloud.at(plate.at([{"semi_axes": axes}])))
        return jaxgel.core_rotation(jaxgel.sweep(jaxgel.Problem(model, GEL), VALUES))[-1]

    def run(axes):
        cloud = jaxgel.make_cloud(plate_of(axes))
        jaxgel.sweep(jaxgel.Problem(jaxgel.discretise(cloud), GEL), VALUES)
        sizes.append((len(cloud.nodes), len(cloud.vertices)))

    def differentiate(axes):
        plate = plate_of(axes)
        jax.grad(rotation)(jnp.array(axes), plate, jaxgel.make_cloud(plate))

    jax.clear_caches()
    assert 10 < len(compiled(lambda: run((2.34, 1.66)))) <= 25
    assert 10 < len(compiled(lambda: differentiate((2.34, 1.66)))) <= 25
    assert compiled(lambda: (run((2.0, 1.6)), differentiate((2.0, 1.6)))) == []
    assert sizes[0][0] != sizes[1][0] and sizes[0][1] != sizes[1][1]


@pytest.mark.thorough
def test_a_state_in_which_nothing_touches_takes_the_programs_of_a_problem_without_contact(
    tiny_model,
):
    """To the bit: linearisation, forces and tangent do not depend on separate outlines."""

    def run(contact):
        problem, x = (
            jaxgel.Problem(tiny_model, GEL, contact=contact).prepared,
            np.asarray(tiny_model.nodes),
        )
        p = np.full(len(tiny_model.carries), -1e-3)
        now = linearise(problem, x, p, -2.0)
        found.append(
            [np.asarray(condensed_rhs(problem, now, now)), np.asarray(tangent(problem, x, p, now))]
        )

    found = []
    run(True)
    assert compiled(lambda: run(False)) == []
    for one, two in zip(*found, strict=True):
        np.testing.assert_array_equal(one, two)


OBSERVED = (
    jaxgel.area_reduction,
    jaxgel.rotation_angle,
    observables.gap,
    observables.surface_ratio,
    observables.mean_volume_ratio,
)
FIELDS = (
    observables.outlines,
    observables.deformed_vertices,
    observables.cauchy_stress,
    observables.aspect_ratio,
)


@pytest.mark.slow
def test_the_observables_of_a_second_plate_compile_nothing():
    """Neither the path's table and fields nor gradients by its holes depend on its sizes.

    It has other numbers of nodes and vertices; but for sums.
    """
    sizes = []

    def run(axes):
        def observed(axes):
            path = turned(axes, plate)[1]
            return sum(of(path)[-1] for of in OBSERVED), path

        plate = plate_of(axes)
        path = jax.value_and_grad(observed, has_aux=True)(jnp.array(axes))[0][1]
        path = dataclasses.replace(path)
        sizes.append((path.model.n_nodes, len(path.model.cloud.vertices)))
        observables.history(path)
        for field in FIELDS:
            field(path)

    run((2.34, 1.66))
    # JAX's sums of cotangents, one for each shape
    assert set(compiled(lambda: run((2.0, 1.8)))) <= {"jit(add)"}
    assert all(np.not_equal(*sizes))
