"""Self-contact: energy, derivatives, forces, sweeps into contact, and their derivatives."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import jaxgel
from jaxgel import Problem
from jaxgel.continuation import Followed, Following
from jaxgel.equilibrium import Status
from jaxgel.mechanics import (
    all_pairs,
    contact,
    couplings,
    gather,
    linearise,
    overlaps,
    pair_energy,
    scatter,
    state_pressure,
    tangent,
    touches,
    with_contact,
)

GEL = jaxgel.Gel(Nv=1e-3, chi=1e-4)
contact_energy, contact_force = jax.jit(contact.contact_energy), jax.jit(contact.contact_force)
RANGE = 0.25  # mm
MU = [-3.0, -2.0, -1.5]  # the slit's tips close before the last
DEEP = [-3.0, -2.0, -1.6, -1.4, -1.3, -1.25]  # and would cross before the last of these


@pytest.fixture(scope="module")
def slit():
    """Cloud of a small plate with a flat hole, a round one cut by a wall, and one in a corner."""
    holes = [
        jaxgel.Ellipse((0.1, -0.05), (1.2, 0.45), 0.1),
        jaxgel.Circle((0.2, -2.0), 0.4),
        jaxgel.Circle((-2.0, 2.0), 0.6),
    ]
    return jaxgel.make_cloud(jaxgel.Plate(4, 4, holes, spacing=0.5, nodes_per_hole=16, gel=GEL))


@pytest.fixture(scope="module")
def closed(slit):
    """The slit with its sides in contact."""
    return jaxgel.sweep(Problem(jaxgel.discretise(slit), GEL, contact_range=RANGE), MU)


@pytest.fixture(scope="module")
def squeezed(slit):
    """The plate with nodal positions in which all three holes touch themselves."""
    model = with_contact(jaxgel.discretise(slit), GEL, range=RANGE)
    X = np.asarray(model.cloud.nodes)
    wall = np.array([-2.0, 2.0])  # the corner stays where it is
    x = wall + (X - wall) * [0.16, 1.0] + 0.01 * np.sin(7 * X[:, ::-1]) * (np.abs(X) < 1.99)
    return Problem(model, GEL).touching(x).model, x


@pytest.mark.slow
def test_corrections_that_throw_points_deep_into_each_other_are_halved(slit):
    """Newton's method else cycles through six iterations until the step is cut.

    154 for the last state, 22 so.
    """
    model = jaxgel.discretise(jaxgel.make_cloud(slit.plate))
    path = jaxgel.sweep(Problem(model, GEL, contact_range=RANGE), [-4.0, -3.0, -2.0, -1.5])
    assert path.stop.ok
    assert path.newton_iterations[-1] < 35


def test_energy_is_zero_where_nothing_is_near(slit):
    model = with_contact(jaxgel.discretise(slit), GEL, range=RANGE)
    x = model.cloud.nodes
    assert float(contact_energy(x, model)) == 0.0
    assert np.all(np.asarray(contact_force(x, model)) == 0.0)
    assert not touches(x, model)


@pytest.mark.smoke
def test_force_is_the_difference_of_energies(squeezed):
    model, x = squeezed
    assert float(contact_energy(x, model)) > 0
    direction = np.random.default_rng(0).normal(size=x.shape)
    difference = (
        contact_energy(x + 1e-6 * direction, model) - contact_energy(x - 1e-6 * direction, model)
    ) / 2e-6
    # central difference, step^2 times the third derivative, large where points are close
    np.testing.assert_allclose(
        np.sum(np.asarray(contact_force(x, model)) * direction), difference, rtol=1e-5
    )


@pytest.mark.thorough
@pytest.mark.smoke
def test_tangent_with_contact_is_the_hessian_of_the_energy(squeezed):
    """Tangent with contact less without, over all node pairs, against the force's derivative."""
    model, x = squeezed
    problem, p = (
        Problem(model, GEL).touching(x).prepared,
        state_pressure(1.3 * model.cloud.nodes, model, GEL, -1.0),
    )
    linearisation = linearise(problem, x, p, -1.0)
    blocks, gel = (
        np.array(tangent(problem, x, p, linearisation)),
        tangent(problem.without_pairs, x, p, linearisation),
    )
    blocks[: len(gel)] -= gel
    i, j = all_pairs(model.lists, couplings(problem.model)).T
    free = gather(jnp.asarray(np.random.default_rng(1).normal(size=x.shape)), problem.free)
    # walls, at which images mirror the points, do not move
    direction = np.asarray(scatter(free, problem.free))
    product, other = np.zeros_like(direction), i != j
    np.add.at(product, i, np.einsum("pkl,pl->pk", blocks, direction[j]))
    np.add.at(product, j[other], np.einsum("plk,pl->pk", blocks[other], direction[i[other]]))
    _, expected = jax.jvp(
        lambda x: contact_force(x, model), (jnp.asarray(x),), (jnp.asarray(direction),)
    )
    product, expected = (
        np.asarray(gather(jnp.asarray(field), problem.free)) for field in (product, expected)
    )
    # the gel's own tangent cancels
    np.testing.assert_allclose(product, expected, atol=1e-9 * np.abs(expected).max())


def test_pairs_of_a_state_are_those_of_the_full_sum(squeezed):
    """Against the sum over all pairs of points of each hole and its mirror images.

    At the walls x = -2, y = 2 and y = -2.
    """
    model, x = squeezed
    y, dry, total = np.asarray(model.outline.position(x)), np.asarray(model.outline.points), 0.0
    hole = np.concatenate([np.full(len(o.s), o.arc.hole) for o in model.lists.topology.outlines])
    mirrors = {0: [(1, 1)], 1: [(1, 1), (1, -1)], 2: [(1, 1), (-1, 1), (1, -1), (-1, -1)]}
    for number, signs in mirrors.items():
        own, wall = hole == number, np.array([-2.0, 2.0 if number == 2 else -2.0])
        closed = number == 0
        length = np.linalg.norm(np.roll(dry[own], -1, axis=0) - dry[own], axis=1) * (
            closed | (np.arange(own.sum()) < own.sum() - 1)
        )
        weight = 0.5 * (length + np.roll(length, 1))
        for sign in signs:
            D, d = (
                np.linalg.norm(p[own][:, None] - (wall + sign * (p[own] - wall)), axis=2)
                for p in (dry, y)
            )
            reach = np.minimum(D / 3, float(model.contact.range))
            s = np.where(
                (d < reach) & (d > 0) & (reach > 1e-12), d / np.where(reach > 0, reach, 1.0), 1.0
            )
            total += 0.5 * np.sum(weight[:, None] * weight * (1 - s) ** 3 / s)
    # order of the sum
    np.testing.assert_allclose(
        float(contact_energy(x, model)), float(model.contact.stiffness) * total, rtol=1e-12
    )


def test_forces_on_each_hole_sum_to_zero_along_its_walls(squeezed):
    """A whole hole's in both directions, a cut hole's along its wall.

    There its mirror image takes up the rest.
    """
    model, x = squeezed
    points = model.outline.position(x)
    force = np.asarray(contact_force(points, _carried(model)))
    hole = np.concatenate([np.full(len(o.s), o.arc.hole) for o in model.lists.topology.outlines])
    total = np.stack([force[hole == k].sum(axis=0) for k in range(3)])
    scale = np.abs(force).max()
    assert all(np.abs(force[hole == k]).max() > 0 for k in range(3))
    np.testing.assert_allclose(total[0], 0.0, atol=1e-12 * scale)
    assert abs(total[1, 0]) < 1e-12 * scale  # along the wall at the bottom
    np.testing.assert_allclose(
        np.sum(np.asarray(contact_force(x, model)), axis=0), total.sum(axis=0), atol=1e-10 * scale
    )


def _carried(model):
    """The model with outline positions themselves as its degrees of freedom."""
    m = len(model.outline.points)
    one = jnp.ones((m, 1))
    outline = dataclasses.replace(
        model.outline, nodes=np.arange(m)[:, None], support=one, phi=one, dphi=jnp.zeros((m, 1, 2))
    )
    return dataclasses.replace(model, outline=outline)


@pytest.mark.parametrize(("gap", "pressure"), [(0.75, 0.169), (0.5, 1.25), (0.25, 5.62)])
def test_parallel_surfaces_press_each_other_as_documented(gap, pressure):
    slope = jax.jit(jax.grad(lambda g, t: pair_energy(jnp.stack([t, g]), 1.0)))
    reach = np.sqrt(1 - gap**2)
    value = -quad(lambda t: float(slope(gap, t)), -reach, reach)[0]
    assert value == pytest.approx(pressure, rel=5e-3)  # as many digits as are printed


@pytest.mark.thorough
def test_contact_changes_nothing_before_holes_touch(slit):
    model = jaxgel.discretise(slit)
    on, off = (
        jaxgel.sweep(jaxgel.Problem(model, GEL, contact=contact), MU[:2])
        for contact in (True, False)
    )
    np.testing.assert_array_equal(on.x, off.x)
    np.testing.assert_array_equal(on.newton_iterations, off.newton_iterations)


def assert_closed(path):
    assert path.stop.ok
    assert touches(path.x[-1], path.model) and not overlaps(path.x[-1], path.model)
    assert path.negative_pivots[-1] == 0 and path.residual.max() < 1e-10


@pytest.mark.thorough
def test_sides_that_touch_do_not_overlap_and_are_in_equilibrium(closed):
    assert_closed(closed)


@pytest.mark.slow
def test_sides_do_not_overlap_where_they_would_without_contact(slit):
    model = jaxgel.discretise(slit)
    assert_closed(jaxgel.sweep(Problem(model, GEL, contact_range=RANGE), DEEP))
    apart = jaxgel.sweep(jaxgel.Problem(model, GEL, contact=False), DEEP)
    assert overlaps(apart.x[-1], apart.model)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("value", "status"),
    [
        pytest.param(-1.25, Status.NOT_CONVERGED, marks=pytest.mark.slow),
        (-1.4, Status.BEYOND_CONTACT),
    ],
)
def test_a_leap_into_contact_is_refused(value, status, slit):
    """Prediction and last state are apart.

    Where Newton's method closes the slit from there is not where a gel that swells slowly would.
    """
    steps, model = [], with_contact(jaxgel.discretise(slit), GEL, range=RANGE)
    jaxgel.sweep(
        Problem(model, GEL, contact_range=RANGE),
        MU[:1],
        observer=jaxgel.Observer(accepted=steps.append),
    )
    refused = []
    options = Following(
        symmetry="off",
        steps=jaxgel.StepControl(max_cuts=0),
        observer=jaxgel.Observer(refused=refused.append),
    )
    assert not list(
        Followed(Problem(model, GEL, contact_range=RANGE).prepared, [value], options, steps)
    )
    (found,) = refused
    assert found.status is status
    assert np.abs(found.x - steps[0].x).max() > float(model.contact.range) and not touches(
        steps[0].x, model
    )


@pytest.mark.thorough
def test_a_sweep_told_to_stop_ends_before_the_overlap(slit):
    path = jaxgel.sweep(
        jaxgel.Problem(jaxgel.discretise(slit), GEL, contact=False),
        [-3.0, -2.0, -1.0],
        until_contact=True,
    )
    assert path.stop is jaxgel.Status.SELF_CONTACT
    assert path.stop_text == f"stopped after mu = -2: {path.stop.text}"
    assert list(path.mu) == [-3.0, -2.0]


@pytest.mark.slow
def test_squares_close_without_crossing(cloud_of):
    """Sample 7, on the symmetric branch: the sides meet from the corners.

    Without contact they overlap.
    """
    model, mu = jaxgel.discretise(cloud_of("sample-7")), [-2.0, -1.0, -0.55, -0.4]
    path = jaxgel.sweep(jaxgel.Problem(model, GEL), mu, branch="symmetric")
    assert path.stop.ok and touches(path.x[-1], path.model)
    assert not any(overlaps(x, path.model) for x in path.x)
    volumes = np.asarray(jaxgel.observables.cell_volumes(model))
    phi = 1 - volumes.sum() / 22.0**2
    mean = np.asarray(jaxgel.volume_ratio(path)) @ volumes / volumes.sum()
    # outlines and cells are independent measures of the same loss; measured 1.5e-4
    np.testing.assert_allclose(jaxgel.area_reduction(path), (mean - 1) * (1 - phi) / phi, rtol=5e-4)


@pytest.mark.slow
def test_gradient_through_contact_is_that_of_the_resolved_problem(slit, closed):
    """By Nv (which sets contact's stiffness, too), last mu and a semi-axis, in one direction."""
    plate, nodes = slit.plate, slit.nodes

    def height(v):
        model = jaxgel.discretise(
            slit.at(plate.at([dict(semi_axes=jnp.stack([jnp.asarray(1.2), v[0]])), {}, {}]))
        )
        mu = jnp.append(jnp.array(DEEP[:3]), v[2])
        return jnp.sum(
            (
                jaxgel.sweep(Problem(model, jaxgel.Gel(v[1], 1e-4), contact_range=RANGE), mu).x[-1]
                - nodes
            )
            ** 2
        )

    at, direction = np.array([0.45, 1e-3, DEEP[3]]), np.array([0.1, 1e-3, 0.2])
    _, slope = jax.jvp(height, (jnp.asarray(at),), (jnp.asarray(direction),))
    difference = (
        float(height(at + 1e-5 * direction)) - float(height(at - 1e-5 * direction))
    ) / 2e-5
    # states to 1e-11 over a step of 1e-5
    assert float(slope) == pytest.approx(difference, rel=1e-5)
    assert touches(closed.x[-1], closed.model)  # at a lower mu


@pytest.mark.thorough
def test_a_hole_at_a_fixed_edge_that_turns_is_refused():
    """Wall contact is that with the hole's mirror image, which a sheared plate has not.

    The mirror would have to turn with its edge.
    """
    plate = jaxgel.Plate(
        4,
        4,
        [jaxgel.Circle((0.2, -2.0), 0.8)],
        edges="fixed",
        deformation=((1.2, 0.0), (0.1, 1.2)),
        spacing=0.8,
    )
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    with pytest.raises(
        ValueError, match="deformation: it turns the bottom edge, to which a hole is open"
    ):
        jaxgel.sweep(Problem(model, GEL, contact_range=RANGE), [-4.0])


def test_a_sweep_until_contact_has_none(slit):
    with pytest.raises(
        ValueError, match=r"^until_contact: holes with contact never overlap; give Problem"
    ):
        jaxgel.sweep(
            Problem(jaxgel.discretise(slit), GEL, contact_range=RANGE), [-3.0], until_contact=True
        )


@pytest.mark.slow
def test_contact_does_not_depend_on_the_cloud(slit):
    """The same energy on nodes 0.5 and 0.25 mm apart, with a range of 0.05 mm.

    A tenth of the coarser spacing; more outline nodes round the hole.
    """
    energy = []
    for spacing, count in ((0.5, 16), (0.25, 16), (0.25, 32)):
        cloud = jaxgel.make_cloud(slit.plate, spacing=spacing, nodes_per_hole=count)
        model = with_contact(jaxgel.discretise(cloud), GEL, range=0.05, stiffness=1.0)
        x = np.asarray(model.cloud.nodes) * [1.0, 0.04]
        energy.append(float(contact.contact_energy(x, Problem(model, GEL).touching(x).model)))
    assert energy[0] == pytest.approx(energy[1], rel=1e-10) and energy[0] > 0
    # 1.2 %: the chords of a coarser outline
    assert energy[0] == pytest.approx(energy[2], rel=0.015)


@pytest.fixture(scope="module")
def notched():
    """A plate with a notch in its free top, whose sides and rim close; between rollers."""
    plate = jaxgel.Plate(
        2,
        2,
        [jaxgel.Ellipse((0.1, 1.0), (0.12, 0.7), 0.05)],
        edges={"top": "free"},
        spacing=0.25,
        nodes_per_hole=24,
    )
    return jaxgel.discretise(jaxgel.make_cloud(plate))


@pytest.mark.slow
def test_a_hole_open_to_a_free_edge_closes_without_crossing(notched):
    """Its sides meet, and the two halves of the edge belong to the same surface.

    By mu and Nv the state moves as differences say.
    """

    def state(v):
        return jaxgel.sweep(
            Problem(notched, jaxgel.Gel(v[1], 1e-4), contact_range=0.08),
            jnp.append(jnp.array([-3.0, -1.5]), v[0]),
        ).x[-1]

    at, direction = np.array([-0.9, 1e-3]), np.array([0.1, 1e-4])
    x, moved = jax.jvp(state, (jnp.asarray(at),), (jnp.asarray(direction),))
    model = Problem(notched, GEL, contact_range=0.08).model
    assert touches(x, model) and not overlaps(x, model)
    difference = (
        np.asarray(state(jnp.asarray(at + 1e-4 * direction)))
        - np.asarray(state(jnp.asarray(at - 1e-4 * direction)))
    ) / 2e-4
    # square of the step
    np.testing.assert_allclose(moved, difference, atol=1e-6 * np.abs(difference).max())


@pytest.mark.slow
def test_a_free_edge_meets_its_image_across_a_periodic_edge():
    """A notch on a strip's seam: each half touches the other's image; forces sum to zero."""
    edges = {"left": "periodic", "right": "periodic", "top": "free"}
    plate = jaxgel.Plate(
        2, 1, [jaxgel.Ellipse((0.0, 0.5), (0.3, 0.4))], edges=edges, spacing=0.25, nodes_per_hole=16
    )
    model = with_contact(jaxgel.discretise(jaxgel.make_cloud(plate)), GEL, range=0.1)
    X = np.asarray(model.cloud.nodes)
    x = X + np.stack(
        [
            0.28 * np.sin(np.pi * X[:, 0]) * (X[:, 1] + 0.5) ** 2,
            0.4 * np.cos(np.pi * X[:, 0]) * (X[:, 1] + 0.5) ** 2,
        ],
        axis=1,
    )
    x[:, 0] *= 0.3
    near = Problem(model, GEL).touching(x).model
    energy = float(contact_energy(x, near))
    assert energy > 0
    direction = np.random.default_rng(0).normal(size=x.shape)

    def at(step):
        return float(
            contact_energy(
                x + step * direction, Problem(model, GEL).touching(x + step * direction).model
            )
        )

    force = np.asarray(contact_force(x, near))
    # square of the step
    assert np.sum(force * direction) == pytest.approx((at(1e-6) - at(-1e-6)) / 2e-6, rel=1e-5)
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-12 * np.abs(force).sum())
