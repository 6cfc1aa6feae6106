"""Facts about the fundamental region of a symmetric problem and the blocks of its tangent."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.equilibrium import dry_state, solve
from jaxgel.geometry import Circle, Plate
from jaxgel.linalg import block_elimination_of, factor, network_matrix
from jaxgel.materials import Gel, PixelField
from jaxgel.mechanics import (
    all_volumes,
    closest,
    contact_energy,
    energy_at,
    gather,
    linearise,
    scatter,
    tangent,
    touches,
    with_contact,
)
from jaxgel.symmetry import NAMES, bases, blocks_of_plate, region, symmetries_of
from jaxgel.symmetry.groups import images

MU = -2.0
OTHERS = {
    "periodic": dict(edges="periodic", spacing=0.25),
    "periodic one way": dict(
        edges={"left": "periodic", "right": "periodic", "top": "free", "bottom": "free"},
        spacing=0.25,
    ),
    "fixed and free": dict(
        edges={"left": "fixed", "right": "fixed", "top": "free", "bottom": "free"}, spacing=0.25
    ),
    "odd number of squares": dict(spacing=4 / 15),
    "film": dict(kinematics="plane stress", spacing=0.25),
    "axial stretch": dict(kinematics="generalised plane strain", axial_stretch=1.05, spacing=0.25),
}
OPTIONS = {"linear": dict(basis="linear")}
NAMED = ["D4", "C4", "D2 (axes)", "D2 (diagonals)", "C2", "D1 (x -> -x)", "D1 (x <-> -y)"]


ALL = [*NAMED, *OTHERS, *OPTIONS, "field", "network"]


@pytest.fixture(
    scope="module",
    params=[name if name == "D4" else pytest.param(name, marks=pytest.mark.slow) for name in ALL],
)
def problem(request, plates, problem_of):
    """Plates, edges, discretisations, a film, a field and another network, all with symmetries."""
    name, circle = request.param, Circle((0, 0), 1)
    if name in OTHERS:
        return problem_of(Plate(4, 4, [circle], **OTHERS[name]))
    if name == "field":
        return problem_of(
            plates["D4"],
            Gel(PixelField(np.array([[1e-3, 2e-3, 1e-3]]), (-2.0, 2.0, -2.0, 2.0)), 0.1),
        )
    if name == "network":
        return problem_of(plates["C2"], Gel(1e-3, 0.1, network=jaxgel.Gent(30.0)))
    return problem_of(plates["D4" if name in OPTIONS else name], **OPTIONS.get(name, {}))


@pytest.fixture(scope="module")
def whole_and_region(problem):
    """A state of the whole problem, its region and a state of that."""
    reduced = region(problem, symmetries_of(problem))
    found = [solve(one, MU, *dry_state(one), own_factor=True) for one in (problem, reduced.problem)]
    assert all(state.status.ok for state in found)
    return found[0], reduced, found[1]


@pytest.mark.thorough
def test_state_and_energy_of_the_region_are_those_of_the_plate(problem, whole_and_region):
    whole, reduced, found = whole_and_region
    np.testing.assert_allclose(found.x, whole.x, atol=1e-11)
    spread = reduced.spread @ np.asarray(found.pressure)
    # Newton's method ends where J agrees to 1e-11 of the swelling: of the pressure that leaves 1e-8
    real = np.asarray(all_volumes(problem.model)) > 0
    np.testing.assert_allclose(
        spread[real], whole.pressure[real], rtol=1e-7, atol=1e-8 * np.abs(whole.pressure).max()
    )
    energies = [
        energy_at(found.x, one.model, one.gel, MU, one.loads) for one in (problem, reduced.problem)
    ]
    assert energies[1] == pytest.approx(float(energies[0]), rel=1e-13)
    at = linearise(problem, found.x, spread, MU)
    assert at.residual_norm < 1e-9 and at.violation < 1e-9


@pytest.mark.thorough
def test_blocks_are_those_of_the_whole_tangent(problem, whole_and_region):
    """B^T K B = the block that the region gives.

    Together they have all unknowns, all negative eigenvalues and no coupling.
    """
    whole, reduced, found = whole_and_region
    K, group = whole.factor.matrix, reduced.group
    pairs = np.asarray(tangent(reduced.problem, found.x, found.pressure, found.linearisation))
    network = reduced.problem.network
    N = network_matrix(problem.pattern, problem.network)
    blocks = bases(problem.model.lists, group)
    size, negative = 0, 0
    for basis in blocks:
        made = factor(basis.pattern, pairs)
        for fields in basis.fields:
            np.testing.assert_allclose(
                (fields.T @ K @ fields - made.matrix).toarray(), 0, atol=1e-11 * np.abs(K).max()
            )
            stiffness = network_matrix(basis.pattern, network)
            np.testing.assert_allclose(
                (fields.T @ N @ fields - stiffness).toarray(), 0, atol=1e-12 * np.abs(N).max()
            )
            size, negative = size + fields.shape[1], negative + made.negative_pivots
    assert (size, negative) == (K.shape[0], whole.factor.negative_pivots)
    every = [fields for basis in blocks for fields in basis.fields]
    for i, one in enumerate(every):
        for other in every[:i]:
            assert abs(one.T @ K @ other).max() < 1e-11 * abs(K).max()
            assert abs(one.T @ other).max() == 0


@pytest.mark.thorough
def test_solutions_by_blocks_are_those_of_the_whole_tangent(problem, whole_and_region):
    """In a program, of a right-hand side without any symmetry."""
    whole, reduced, _ = whole_and_region
    blocks = block_elimination_of(blocks_of_plate(problem.model.lists, reduced.group))
    rhs = np.random.default_rng(3).normal(size=blocks.size)
    pairs = tangent(problem, whole.x, whole.pressure, whole.linearisation)
    expected = whole.factor.accurate(rhs)
    found = jax.jit(lambda blocks, pairs, rhs: blocks.solve(blocks.cholesky(pairs), rhs))(
        blocks, pairs, rhs
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_region_has_one_patch_of_each_orbit(plates, problem_of):
    problem = problem_of(plates["D4"])
    reduced = region(problem, symmetries_of(problem)).problem.model
    count = sum(len(block.patches) for block in problem.model.blocks)
    # those on mirrors have smaller orbits
    assert count / 8 <= sum(len(block.patches) for block in reduced.blocks) < count / 5
    volumes = [
        sum(float(jnp.sum(block.weight)) for block in model.blocks)
        for model in (problem.model, reduced)
    ]
    assert volumes[1] == pytest.approx(volumes[0], rel=1e-14)


def test_mirror_images_have_as_many_neighbours_if_supports_end_on_grid_lines(problem_of):
    """Round-off once listed a node at the end of its support for one of two images only.

    The region could not be made.
    """
    whole = problem_of(
        Plate(4, 4, [Circle((0, 0), 0.9)], spacing=4 / 14, nodes_per_hole=12), dmax=3.0
    )
    lists, group = whole.model.lists, symmetries_of(whole)
    counts, found = (lists.support > 0).sum(axis=1), images(lists)
    assert len(group) == 7 and all(
        np.array_equal(counts[found[name].patches], counts) for name in group
    )


@pytest.mark.slow
def test_unknowns_are_symmetric_fields(plates, problem_of):
    problem = problem_of(plates["C4"])
    reduced = region(problem, symmetries_of(problem)).problem
    v = np.random.default_rng(1).normal(size=len(reduced.free))
    field = np.asarray(scatter(v, reduced.free))
    forces = np.random.default_rng(2).normal(size=field.shape)
    assert np.vdot(forces, field) == pytest.approx(
        float(np.asarray(gather(forces, reduced.free)) @ v), rel=1e-13
    )
    assert len(reduced.free) == len(problem.free) // 4


@pytest.mark.slow
def test_subgroups_have_regions_of_their_own(plates, problem_of):
    problem = problem_of(plates["D4"])
    whole = solve(problem, MU, *dry_state(problem))
    for group in NAMES:
        if group:
            one = region(problem, group).problem
            found = solve(one, MU, *dry_state(one))
            np.testing.assert_allclose(found.x, whole.x, atol=1e-11, err_msg=NAMES[group])


@pytest.mark.slow
def test_contact_of_a_region_is_that_of_the_plate(plates, problem_of):
    plate = plates["C4"]
    problem = problem_of(plate)
    model = with_contact(problem.model, problem.gel, range=4.0)
    x = 0.2 * model.cloud.nodes
    problem = problem.replace(model=model).touching(x)
    reduced = region(problem, symmetries_of(problem)).problem
    assert touches(x, model) and touches(x, reduced.model)
    assert closest(x, reduced.model) == pytest.approx(closest(x, model), rel=1e-12)
    assert (
        float(contact_energy(x, reduced.model))
        == pytest.approx(float(contact_energy(x, problem.model)), rel=1e-12)
        != 0
    )
