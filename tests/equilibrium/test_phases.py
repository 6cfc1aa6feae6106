"""Collapsed and swollen gels at one temperature: homogeneous states by root finding."""

import dataclasses
import functools
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxgel
from jaxgel import Problem
from jaxgel.continuation import Path
from jaxgel.equilibrium import accepted, advanced, dry_state, solve, starting, state_tangents
from jaxgel.materials import (
    Gel,
    flory_huggins,
    gel_in_groups,
    neo_hookean,
    osmotic,
    phase_of,
    stiff_until,
)
from jaxgel.mechanics import (
    SOFT,
    all_volumes,
    axial_stretch,
    condensed_rhs,
    energy_at,
    factorised_tangent,
    free_dofs,
    hessian_product,
    linearised_about,
    localised,
    residual,
    scatter,
    shared_tangents,
    state_pressure,
    stiffness_at,
    volume_ratios,
)
from jaxgel.observables import surface_ratios

TWO = 305.0  # K: free swelling has three volume ratios, in plane strain and in space, at mu = 0


def mixing_of_pnipam(J, gel):
    """Flory-Rehner energy with chi = chi0 + chi1/J of the temperature, Cai & Suo (2011)."""
    chi0, chi1 = -12.947 + 0.04496 * gel.T, 17.92 - 0.0569 * gel.T
    # (chi0 + chi1/J) (1 - 1/J) less chi0
    return flory_huggins(J, chi0 - chi1 * (1 - 1 / J)) - gel.Nv * jnp.log(J)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Pnipam:
    """A gel whose solvent is the poorer the warmer it is."""

    T: Any
    Nv: Any = 0.01
    network: Any = dataclasses.field(default=neo_hookean, metadata={"static": True})
    volumetric: Any = dataclasses.field(default=mixing_of_pnipam, metadata={"static": True})


def in_plane(J):
    return jnp.sqrt(J) * jnp.eye(2), 1.0


def along_y(J):
    return jnp.diag(jnp.stack([jnp.ones_like(J), J])), 1.0


def isotropic(J):
    return jnp.cbrt(J) * jnp.eye(2), jnp.cbrt(J)


def energy_by(kind, J, gel):
    """Energy () at mu = 0 of a homogeneous state with the volume ratio ``J``."""
    F, axial = kind(J)
    return gel.network(F, gel, axial) + gel.volumetric(J, gel)


slope_by = jax.jit(jax.grad(energy_by, argnums=1), static_argnums=0)
slopes_by = jax.jit(
    jax.vmap(jax.grad(energy_by, argnums=1), in_axes=(None, 0, None)), static_argnums=0
)
curvature_by = jax.jit(jax.grad(jax.grad(energy_by, argnums=1), argnums=1), static_argnums=0)


@functools.cache
def roots(kind, gel):
    """All volume ratios below 200 at which the energy is stationary."""
    J = 1 + np.geomspace(1e-3, 199.0, 1000)
    values = np.asarray(slopes_by(kind, J, gel))
    crossings = np.flatnonzero(values[:-1] * values[1:] < 0)
    return [
        brentq(lambda J: float(slope_by(kind, J, gel)), J[k], J[k + 1], xtol=1e-14, rtol=1e-15)
        for k in crossings
    ]


def model_of(right="free", top="free", holes=(), **kinematics):
    """36 nodes without holes, some 80 with one."""
    size = {"spacing": 0.5, "nodes_per_hole": 12} if holes else {"spacing": 0.8}
    plate = jaxgel.Plate(
        4, 4, list(holes), edges={"top": top, "right": right}, **size, **kinematics
    )
    return jaxgel.discretise(jaxgel.make_cloud(plate))


@pytest.fixture(scope="module")
def models():
    """Plates of 4 x 4 mm without holes: free but for symmetry, and one that swells along y."""
    return {in_plane: model_of(), along_y: model_of("roller")}


def placed(model, F):
    """The nodes (n, 2) after the deformation F about the corner that stays."""
    return (np.asarray(model.cloud.nodes) + 2) @ np.asarray(F).T - 2


def solved(model, gel, x, pressure=None):
    pressure = state_pressure(x, model, gel, 0.0) if pressure is None else pressure
    return solve(Problem(model, gel, contact=False).prepared, 0.0, x, pressure, own_factor=True)


CASES = [(in_plane, TWO), (along_y, 303.0), (along_y, 303.7), (along_y, 304.0)]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "T"), CASES, ids=lambda value: getattr(value, "__name__", value))
def test_homogeneous_states_of_every_phase_are_the_roots_of_one_equation(kind, T, models):
    model, gel, rng = models[kind], Pnipam(T), np.random.default_rng(0)
    found = roots(kind, gel)
    assert len(found) == (3 if (kind, T) == (in_plane, TWO) else 1)
    for J in found:
        exact = placed(model, kind(J)[0])
        x = exact + 0.02 * (exact - model.cloud.nodes)
        x += 1e-3 * np.where(
            np.isin(np.arange(x.size), free_dofs(model.cloud.topology).masters),
            rng.normal(size=x.size),
            0,
        ).reshape(x.shape)
        state = solved(model, gel, x)
        assert state.status.ok
        # the start is off by 2 % of the swelling: 1e-2, 1e-4, 1e-8, 1e-16
        assert state.newton_iterations <= 5
        np.testing.assert_allclose(state.x, exact, atol=1e-9)
        ratios = np.asarray(volume_ratios(state.x, model))[
            model.carries & (np.asarray(all_volumes(model)) > 0)
        ]
        assert np.all(phase_of(ratios, gel) == phase_of(J, gel))
        # no surface of such a state is compressed along itself, which would wrinkle it
        if kind is in_plane:
            assert (state.factor.negative_pivots == 0) == (curvature_by(kind, J, gel) > 0)


def test_phases_of_the_roots():
    """The roots above have every phase, one with dp/dJ < 0, stable by its constraint."""
    found = {
        (kind, T): [int(phase_of(J, Pnipam(T))) for J in roots(kind, Pnipam(T))]
        for kind, T in CASES
    }
    assert found[in_plane, TWO] == [0, 1, 2]
    assert found[along_y, 303.0] == [2]
    assert found[along_y, 303.7] == [1]
    assert found[along_y, 304.0] == [0]


@pytest.mark.thorough
@pytest.mark.parametrize("branch", [0, 1, 2])
def test_newton_converges_quadratically_in_every_phase(branch, models):
    model, gel = models[in_plane], Pnipam(TWO)
    J = roots(in_plane, gel)[branch]
    exact = placed(model, in_plane(J)[0])
    problem, x = Problem(model, gel, contact=False).prepared, 0.99 * (exact + 2) - 2
    state = starting(problem, 0.0, x, state_pressure(x, model, gel, 0.0))
    errors = [float(np.abs(state.x - exact).max())]
    for _ in range(4):
        now = state.linearisation
        dx, _ = factorised_tangent(problem, state.x, state.pressure, now).solve(
            np.asarray(condensed_rhs(problem, now, now))
        )
        state = advanced(problem, state, dx, now)
        errors.append(float(np.abs(state.x - exact).max()))
    rates = [after / before**2 for before, after in itertools.pairwise(errors) if before > 1e-5]
    assert len(rates) >= 2
    # of lengths in mm: about half the third derivative of the energy over its second
    assert max(rates) < 20
    assert errors[-1] < 1e-10


def phases(state, model, gel):
    """The phases of the volume groups."""
    real = model.carries & (np.asarray(all_volumes(model)) > 0)
    J = np.where(real, axial_stretch(model) * volume_ratios(state.x, model), 2.0)
    return set(np.asarray(phase_of(J, gel_in_groups(gel)))[real].tolist())


# --- states that are not homogeneous --------------------------------------------------------------


forces = jax.jit(residual)


@jax.jit
def products(fields, x, model, gel, loads):
    """Products (m, n, 2) of the Hessian of the energy and several fields."""
    return jax.vmap(lambda field: hessian_product(x, field, model, gel, 0.0, loads))(fields)


def assert_balanced(state, model, gel):
    """The next Newton step in the positions alone, with a dense Hessian, moves nothing."""
    loads, free = np.zeros(state.x.shape), free_dofs(model.cloud.topology)
    force = np.asarray(forces(state.x, model, gel, 0.0, loads)).ravel()[free.masters]
    units = free.matrix.toarray().T.reshape(len(free), *state.x.shape)
    hessian = np.asarray(products(units, state.x, model, gel, loads)).reshape(len(free), -1)[
        :, free.masters
    ]
    assert np.abs(np.linalg.solve(hessian, force)).max() < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize(("T", "stretch", "phase"), [(303.0, 2.3, 2), (307.0, 1.17, 0)])
def test_a_plate_with_a_hole_in_a_frame_is_in_equilibrium_in_displacements_alone(T, stretch, phase):
    model, gel = model_of("roller", "roller", [jaxgel.Circle((-0.3, -0.4), 0.9)]), Pnipam(T)
    # all edges hold the plate at this stretch
    state = solved(model, gel, stretch * np.asarray(model.cloud.nodes))
    assert state.status.ok
    assert state.newton_iterations <= 6
    assert_balanced(state, model, gel)
    assert phases(state, model, gel) == {phase}


GRADED = 304.0, -0.3  # K in the middle, and K/mm along y


@pytest.fixture(scope="module")
def graded(models):
    """Plate that swells along y, swollen at its cool edge, collapsed at the warm one."""
    model, (T, slope) = models[along_y], GRADED
    gel = localised(model, Pnipam(lambda X: T + slope * X[1]))
    Y = np.linspace(-2, 2, 9)
    J = [roots(along_y, Pnipam(T + slope * y))[0] for y in Y]
    heights = np.append(-2, -2 + np.cumsum(np.diff(Y) * (np.array(J)[1:] + J[:-1]) / 2))
    x = np.array(model.cloud.nodes)
    x[:, 1] = np.interp(x[:, 1], Y, heights)
    state = solved(model, gel, x)
    assert state.status.ok
    assert state.newton_iterations <= 6
    return model, gel, state


@pytest.mark.slow
def test_a_graded_gel_has_all_phases_at_once(graded):
    model, gel, state = graded
    assert_balanced(state, model, gel)
    assert phases(state, model, gel) == {0, 1, 2}


def zero_tangent(leaf):
    is_float = jnp.issubdtype(jnp.result_type(leaf), jnp.floating)
    return jnp.zeros_like(leaf) if is_float else np.zeros(np.shape(leaf), jax.dtypes.float0)


@jax.jit
def force_of_temperature(x, model, gel, loads):
    """Derivative (n, 2) of the residual by the temperature of all places."""
    warmer = dataclasses.replace(
        jax.tree.map(jnp.zeros_like, gel), T=jax.tree.map(jnp.ones_like, gel.T)
    )
    return jax.jvp(lambda gel: residual(x, model, gel, 0.0, loads), (gel,), (warmer,))[1]


def mean_height(x):
    return np.mean(np.asarray(x)[:, 1] ** 2)


@pytest.fixture(scope="module")
def rise(graded):
    """Derivative of the graded plate's mean height by temperature: fourth-order differences."""
    model, gel, first = graded
    step = 0.01  # K: the fifth derivative leaves 1e-8, the states 1e-11 / step

    def again(warmer):
        warm = dataclasses.replace(gel, T=jax.tree.map(lambda T: np.asarray(T) + warmer, gel.T))
        return mean_height(
            solve(Problem(model, warm, contact=False).prepared, 0.0, first.x, first.pressure).x
        )

    return (8 * (again(step) - again(-step)) - again(2 * step) + again(-2 * step)) / (12 * step)


@pytest.mark.thorough
def test_the_tangent_takes_the_force_of_the_temperature_to_the_change_of_the_state(graded, rise):
    """Of a plate in all phases at once."""
    model, gel, state = graded
    free, loads = free_dofs(model.cloud.topology), np.zeros(state.x.shape)
    force = np.asarray(force_of_temperature(state.x, model, gel, loads)).ravel()[free.masters]
    problem = Problem(model, gel, contact=False).prepared
    x_dot, _ = factorised_tangent(problem, state.x, state.pressure, state.linearisation).solve(
        -force
    )
    x_dot = scatter(x_dot, free)
    assert float(2 * np.mean(np.asarray(state.x)[:, 1] * x_dot[:, 1])) == pytest.approx(
        rise, rel=1e-6
    )


@pytest.mark.slow
def test_derivatives_by_the_temperature_are_those_of_states_found_again(graded, rise):
    """Of a plate in all phases at once."""
    model, gel, first = graded
    problem = Problem(model, gel, contact=False).prepared
    zero = jax.tree.map(zero_tangent, problem)
    dot = zero.replace(
        gel=dataclasses.replace(zero.gel, T=jax.tree.map(jnp.ones_like, gel.T)), operators=None
    )
    shared = shared_tangents(problem, dot)
    x_dot = state_tangents(
        first.x[None], first.pressure[None], problem, jnp.zeros(1), *shared, jnp.zeros(1)
    )[0, : model.n_nodes]
    assert float(2 * jnp.mean(first.x[:, 1] * x_dot[:, 1])) == pytest.approx(rise, rel=1e-6)


# --- other kinematics -----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("branch", [0, 1, 2])
def test_a_block_held_at_the_axial_stretch_of_a_phase_is_in_that_phase(branch):
    gel = Pnipam(TWO)
    J = roots(isotropic, gel)[branch]
    stretch = J ** (1 / 3)
    model = model_of(kinematics="generalised plane strain", axial_stretch=stretch)
    x, exact = placed(model, 0.99 * stretch * np.eye(2)), placed(model, stretch * np.eye(2))
    carries = model.carries
    pressure = jnp.where(
        carries, stretch * osmotic(J, 0.0, gel), state_pressure(x, model, gel, 0.0)
    )
    state = solved(model, gel, x, pressure)
    assert state.status.ok
    assert state.newton_iterations <= 5
    np.testing.assert_allclose(state.x, exact, atol=1e-9)
    done = accepted(Problem(model, gel, contact=False).prepared, state, None)
    assert done.energy == pytest.approx(16 * float(energy_by(isotropic, J, gel)), rel=1e-9)
    assert phases(state, model, gel) == {branch}


@pytest.mark.slow
@pytest.mark.parametrize("branch", [0, 2])
def test_a_free_film_is_collapsed_or_swollen(branch):
    """No other thickness balances: the swollen film is larger than any collapsed one."""
    gel, model = Pnipam(TWO), model_of(kinematics="plane stress")
    stretch = roots(isotropic, gel)[branch] ** (1 / 3)
    state = solved(model, gel, placed(model, 0.99 * stretch * np.eye(2)))
    assert state.status.ok
    np.testing.assert_allclose(state.x, placed(model, stretch * np.eye(2)), atol=1e-9)
    assert state.factor.negative_pivots == 0


# --- what it is linearised about ------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.parametrize("J", [1.5, 1.78, 2.4, 4.0])
def test_a_held_plate_is_stable_while_the_gel_is_elliptic(J):
    """All edges held at J: longitudinal waves have stiffness Nv + J dp/dJ, transverse Nv.

    In any direction. One J is between the spinodals and stable, one is not.
    """
    gel, model = Pnipam(TWO), model_of("roller", "roller")
    state = solved(model, gel, np.sqrt(J) * np.asarray(model.cloud.nodes))
    assert state.status.ok
    assert state.newton_iterations == 0
    assert int(phase_of(J, gel)) == {1.5: 0, 1.78: 1, 2.4: 1, 4.0: 2}[J]
    stiffness = float(gel.Nv + J * jax.grad(jax.grad(lambda J: gel.volumetric(J, gel)))(J))
    assert (state.factor.negative_pivots == 0) == (stiffness > 0) == (J != 2.4)


def test_a_pressure_that_the_gel_cannot_carry_is_brought_into_its_range(models):
    """At dry positions and beyond the spinodal: about the end of the stiff range.

    There dp/dJ is SOFT Nv; so a step has a direction.
    """
    model, gel = models[in_plane], Gel(0.01, 0.9)
    p = jnp.full(len(all_volumes(model)), float(osmotic(stiff_until(0.0, gel), 0.0, gel)) + 0.1)
    real = model.carries & (np.asarray(all_volumes(model)) > 0)
    about, gap = linearised_about(p, jnp.full_like(p, 0.9), model, gel, 0.0)
    np.testing.assert_allclose(stiffness_at(about, model, gel, 0.0)[real], SOFT * gel.Nv, rtol=1e-6)
    np.testing.assert_allclose((p + gap)[real], osmotic(about[real], 0.0, gel), rtol=1e-12)
    # a good solvent
    assert np.all(linearised_about(p, jnp.full_like(p, 0.9), model, Gel(0.01, 0.3), 0.0)[1] == 0)


def test_a_collapsed_gel_is_found_from_the_dry_state(models):
    gel, model = Pnipam(304.0), models[along_y]
    state = solve(
        Problem(model, gel, contact=False).prepared,
        0.0,
        *dry_state(Problem(model, gel, contact=False).prepared),
    )
    (J,) = roots(along_y, gel)
    np.testing.assert_allclose(state.x, placed(model, along_y(J)[0]), atol=1e-9)


@pytest.mark.slow
def test_a_free_surface_has_the_phase_of_the_gel_behind_it():
    """Freely swollen, each phase: the surface is stretched alike along and across."""
    gel, model = Pnipam(TWO), model_of(holes=[jaxgel.Circle((0.0, 0.0), 0.9)])
    states = []
    for J in roots(in_plane, gel):
        states.append(
            accepted(
                Problem(model, gel, contact=False).prepared,
                solved(model, gel, placed(model, in_plane(J)[0])),
                None,
            )
        )
        assert states[-1].status.ok
        assert states[-1].energy == pytest.approx(
            float(
                energy_at(
                    model.cloud.nodes * np.sqrt(J),
                    model,
                    gel,
                    0.0,
                    jnp.zeros_like(model.cloud.nodes),
                )
            ),
            rel=1e-9,
        )
    np.testing.assert_allclose(
        surface_ratios(Path.from_states(Problem(model, gel, contact=False), states)), 1.0, atol=1e-8
    )
