"""Facts about quadrature points and gradients: the patch test, consistency, and what is refused."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel.cloud import EDGE_POINTS
from jaxgel.discretisation import interpolation, midline_probe, reaching_nodes, shape_functions
from jaxgel.materials import bulk_stiffness
from jaxgel.mechanics import deformation_gradients, free_dofs, network_energy, residual

deformation_gradients, network_energy, residual = map(
    jax.jit, (deformation_gradients, network_energy, residual)
)
# --- patch test -----------------------------------------------------------------------------------


@functools.cache
def square(side, basis, dmax):
    plate = jaxgel.sample("square")
    return jaxgel.discretise(
        jaxgel.make_cloud(plate, spacing=1 / (side - 1)), basis=basis, dmax=dmax
    )


def stretched(nodes, stretch):
    """The unit square's nodes after the uniaxial stretch along y, its bottom at rest."""
    return jnp.stack([nodes[:, 0], stretch * (nodes[:, 1] + 0.5) - 0.5], axis=1)


@pytest.mark.parametrize(
    ("side", "basis", "dmax"),
    [
        (7, "quadratic", 2.5),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                (7, "linear", 2.5),
                (7, "quadratic", 3.5),
                (15, "linear", 3.5),
                (15, "quadratic", 2.5),
            )
        ),
    ],
)
def test_patch_test_gives_the_uniaxial_stretch_at_every_mu(side, basis, dmax):
    model, gel = square(side, basis, dmax), jaxgel.sample("square").gel
    mu = np.append(np.arange(-4.9, -0.05, 0.35), 0.0)
    path = jaxgel.sweep(jaxgel.Problem(model, gel), mu)
    assert path.stop.ok
    exact = jaxgel.uniaxial_swelling(mu, gel)  # Eq. (59); up to 7.7
    for x, stretch in zip(path.x, exact, strict=True):
        # every node to 1e-10 of the stretch: the equilibrium tolerance, as round-off alone gives
        # 1e-13
        np.testing.assert_allclose(
            x, stretched(model.cloud.nodes, stretch), rtol=0, atol=1e-10 * float(stretch)
        )
    assert np.all(path.newton_iterations[:-1] <= 3)


@pytest.mark.parametrize(
    ("side", "basis"),
    [(9, "linear"), (11, "quadratic"), pytest.param(13, "linear", marks=pytest.mark.slow)],
)
def test_exact_uniaxial_state_is_in_equilibrium_on_other_clouds(side, basis):
    model, gel = square(side, basis, 2.5), jaxgel.sample("square").gel
    free = free_dofs(model.cloud.topology).masters
    for mu in (-4.9, -2.0, 0.0):
        stretch = jaxgel.uniaxial_swelling(mu, gel)
        x = stretched(model.cloud.nodes, stretch)
        free_forces = np.asarray(jax.jit(residual)(x, model, gel, mu, jnp.zeros_like(x))).ravel()[
            free
        ]
        # round-off: in J, times the bulk stiffness, 400 near the dry state; and in the network's
        # stress
        np.testing.assert_allclose(
            free_forces,
            0.0,
            atol=2e-15 * float(bulk_stiffness(stretch, gel)) + 2e-14 * gel.Nv * float(stretch),
        )


# --- consistency ----------------------------------------------------------------------------------


def integrals(model):
    """Sum over all points of weight times gradient, (n, 2)."""
    total = np.zeros((model.n_nodes, 2))
    for block in model.blocks:
        np.add.at(
            total, np.asarray(block.nodes), np.einsum("cq,cqai->cai", block.weight, block.dphi)
        )
    return total


def test_integrated_gradients_are_those_of_the_linear_trace_on_held_walls():
    """sum w dphi = contour integral of phi n.

    On a wall of spacing h that is h n, h/2 n at corners, 0 inside.
    """
    plate = jaxgel.Plate(1, 1, spacing=1 / 6)
    model = jaxgel.discretise(jaxgel.make_cloud(plate))
    nodes = np.asarray(model.cloud.nodes)
    on_wall = np.isclose(np.abs(nodes), 0.5)
    share = np.where(on_wall.all(axis=1), 0.5, 1.0)[:, None]
    np.testing.assert_allclose(integrals(model), np.sign(nodes) * on_wall * share / 6, atol=1e-14)


def sides(topology):
    """Start, middle and end (e, 3, 2) of the sides of all cells."""
    ends, vertices = topology.partition.contour_edges[0], topology.partition.vertices
    at, weights = topology.middles(ends)
    return np.stack(
        [
            vertices[ends[:, 0]],
            np.einsum("ek,eki->ei", weights, vertices[at]),
            vertices[ends[:, 1]],
        ],
        axis=1,
    )


def cross(a, b):
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def test_every_patch_integrates_gradients_to_the_flux_through_its_contour(tiny_model):
    """By shape functions of all nodes at once on patches that touch no held wall.

    The side of a cell is a parabola through three points, and the trace along it the one with their
    values.
    """
    topology, nodes = tiny_model.cloud.topology, tiny_model.cloud.nodes
    phi = jax.jit(
        jax.vmap(
            lambda x: shape_functions(
                x, nodes, tiny_model.dmax * tiny_model.cloud.spacing, kind="imls"
            )
        )
    )
    edges, points = topology.partition.contour_edges[0], sides(topology)
    owner = tiny_model.lists.patch_of_cell[topology.partition.contour_edges[1]]
    traces = np.asarray(phi(points.reshape(-1, 2))).reshape(len(edges), 3, -1)
    t, w = (EDGE_POINTS, [0.5, 0.5])  # exact for the cubics below
    values = np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)])
    slopes = np.stack([4 * t - 3, 4 - 8 * t, 4 * t - 1])
    along = np.einsum("kq,eki->eqi", slopes, points)
    normal = np.stack([along[..., 1], -along[..., 0]], axis=2)
    flux_of_edge = np.einsum("q,kq,eka,eqi->eai", w, values, traces, normal)
    held = (np.abs(points) > 2 - 1e-9).all(axis=1) & ~(
        (points[:, :, 1] > 2 - 1e-9).all(axis=1)[:, None] & np.array([False, True])
    )
    held = held.any(axis=1)  # all but the top
    checked = 0
    for block in tiny_model.blocks:
        for patch, numbers, weight, dphi in zip(
            block.patches, block.nodes, block.weight, block.dphi, strict=True
        ):
            own = owner == patch
            if np.any(held & own):
                continue
            flux = flux_of_edge[own].sum(axis=0)
            mine = np.zeros_like(flux)
            np.add.at(mine, np.asarray(numbers), np.einsum("q,qai->ai", weight, dphi))
            np.testing.assert_allclose(mine, flux, atol=1e-13)
            checked += 1
    assert checked > 10


@pytest.mark.parametrize("fixture", ["coarse_model", "tiny_model", "square_model"])
def test_linear_fields_have_their_gradient_at_every_point(fixture, request):
    model = request.getfixturevalue(fixture)
    A = jnp.array([[1.3, 0.2], [-0.4, 0.9]])
    x = model.cloud.nodes @ A.T + jnp.array([3.0, -1.0])
    for block in model.blocks:
        F = np.asarray(deformation_gradients(x, block))[np.asarray(block.weight) > 0]
        np.testing.assert_allclose(F, np.broadcast_to(A, F.shape), atol=1e-10)
    for probe in (midline_probe(model), model.outline):
        np.testing.assert_allclose(
            probe.position(x),
            probe.position(model.cloud.nodes) @ A.T + jnp.array([3.0, -1.0]),
            atol=1e-11,
        )


@pytest.mark.parametrize("count", [1, interpolation.GROUP, interpolation.GROUP + 1])
def test_points_have_the_same_shape_functions_in_groups_of_any_size(count, coarse_model):
    points = np.random.default_rng(4).uniform(-11, 11, (2 * interpolation.GROUP + 1, 2))
    every, some = (
        jaxgel.make_probe(coarse_model, points[:number]) for number in (len(points), count)
    )
    x = np.sin(np.asarray(coarse_model.cloud.nodes))
    np.testing.assert_allclose(some.position(x), every.position(x)[:count], atol=1e-14)
    np.testing.assert_allclose(
        some.deformation_gradient(x), every.deformation_gradient(x)[:count], atol=1e-12
    )


@pytest.mark.parametrize("fixture", ["coarse_model", "tiny_model", "square_model"])
def test_weights_are_positive_and_add_up_to_the_area_of_the_cells(fixture, request):
    """Between chords that of triangles; two thirds of chord times sagitta up to the parabola.

    The parabola's part is Archimedes'.
    """
    model = request.getfixturevalue(fixture)
    part, (start, middle, end) = (
        model.cloud.topology.partition,
        np.moveaxis(sides(model.cloud.topology), 1, 0),
    )
    a, b, c = (part.vertices[part.triangles[:, k]] for k in range(3))
    area = np.bincount(part.cell_of_triangle, cross(b - a, c - a) / 2)
    area += np.bincount(
        part.contour_edges[1], 2 / 3 * cross(middle - (start + end) / 2, end - start)
    )
    patches = np.bincount(model.lists.patch_of_cell, area)
    for block in model.blocks:
        np.testing.assert_allclose(
            np.sum(block.weight, axis=1), patches[np.asarray(block.patches)], rtol=1e-12
        )
        assert np.min(block.weight) >= 0
    assert model.n_points == 4 * len(part.quadrilaterals) + 3 * (
        len(part.triangles) - 2 * len(part.quadrilaterals)
    )
    assert model.n_cells == part.n_cells


# --- probes ---------------------------------------------------------------------------------------


def test_probe_at_nodes_reads_nodal_values(coarse_model):
    probe = jaxgel.make_probe(coarse_model, coarse_model.cloud.nodes)
    x = coarse_model.cloud.nodes + np.random.default_rng(1).normal(size=(coarse_model.n_nodes, 2))
    np.testing.assert_allclose(probe.position(x), x, atol=1e-13)


def test_probe_reproduces_quadratic_fields_between_nodes(coarse_model):
    points = np.random.default_rng(2).uniform(-11, 11, (200, 2))
    points = points[~np.asarray(jaxgel.geometry.inside_holes(coarse_model.cloud.plate, points))]
    probe = jaxgel.make_probe(coarse_model, points)

    def field(p):
        return jnp.stack([p[:, 0] ** 2 - p[:, 1], 0.5 * p[:, 0] * p[:, 1] + p[:, 1] ** 2], axis=1)

    np.testing.assert_allclose(
        probe.position(field(coarse_model.cloud.nodes)), field(points), atol=1e-10
    )
    slope = np.stack(
        [
            np.stack([2 * points[:, 0], -np.ones(len(points))]),
            np.stack([points[:, 1] / 2, points[:, 0] / 2 + 2 * points[:, 1]]),
        ]
    )
    np.testing.assert_allclose(
        probe.deformation_gradient(field(coarse_model.cloud.nodes)),
        slope.transpose(2, 0, 1),
        atol=1e-9,
    )


def test_midline_lies_in_the_gel_from_wall_to_wall(coarse_model, cloud_of):
    line = np.asarray(midline_probe(coarse_model).position(coarse_model.cloud.nodes))
    np.testing.assert_allclose(line[:, 1], 0.0, atol=1e-12)
    np.testing.assert_allclose(line[[0, -1], 0], [-11, 11], atol=1e-12)
    assert np.all(np.diff(line[:, 0]) > 0)
    assert not np.any(jaxgel.geometry.inside_holes(coarse_model.cloud.plate, line, -1e-9))


# --- moved clouds ---------------------------------------------------------------------------------


def test_nodes_that_come_to_reach_a_point_are_not_missed(tiny_plate, monkeypatch):
    """A moved cloud keeps its lists: nodes that come to reach a point carry little weight.

    The hole moves by up to a fifth of a spacing; with all those nodes listed the energy of a rough
    field changes by 3e-6 of itself.
    """
    plate = tiny_plate.at(({"radius": jnp.asarray(1.15), "centre": jnp.asarray([0.15, -0.2])},))
    energies, x = [], None
    for wider in (0.0, 0.3):
        monkeypatch.setattr(
            "jaxgel.discretisation.connectivity.reaching_nodes",
            lambda topology, points, owner, regions, support, also, wider=wider: reaching_nodes(
                topology, points, owner, regions, support + wider * topology.spacing, also
            ),
        )
        model = jaxgel.discretise(jaxgel.make_cloud(tiny_plate).at(plate))
        x = (
            model.nodes + 0.02 * np.random.default_rng(3).normal(size=model.nodes.shape)
            if x is None
            else x
        )
        energies.append(float(network_energy(x, model, tiny_plate.gel)))
    assert energies[0] != energies[1]
    assert energies[0] == pytest.approx(energies[1], rel=1e-5)


def test_moved_cloud_passes_the_patch_test_of_a_linear_field(tiny_plate):
    cloud = jaxgel.make_cloud(tiny_plate)
    plate = tiny_plate.at(({"radius": jnp.asarray(1.2)},))
    model = jaxgel.discretise(cloud.at(plate), basis="linear")
    stretch = float(jaxgel.free_swelling(-1.0, tiny_plate.gel))
    x = stretch * model.cloud.nodes
    forces = np.asarray(jax.jit(residual)(x, model, tiny_plate.gel, -1.0, jnp.zeros_like(x)))
    # the freely swollen gel is free of stress, with any hole: 1e-12 of bulk stiffness ~ 1 times
    # length ~ 1
    np.testing.assert_allclose(forces, 0.0, atol=1e-12)


# --- what is refused ------------------------------------------------------------------------------


def test_unknown_options_are_refused(cloud_of, refused):
    refused(
        lambda options: jaxgel.discretise(cloud_of("square"), **options),
        [
            ({"basis": "cubic"}, r"basis: 'cubic' is not one of linear, quadratic"),
            ({"dmax": 1.0}, r"dmax: 1.0 is too small; the support must reach beyond the next node"),
            ({"dmax": np.nan}, r"dmax: nan is too small"),
        ],
        start=True,
    )


def test_too_small_support_is_refused_with_the_point(cloud_of):
    message = (
        r"^dmax: a support of 1.43 mm reaches fewer than 7 nodes at the point \(-?\d+\.?\d*, "
        r"-?\d+\.?\d*\), too few for the quadratic"
    )
    with pytest.raises(ValueError, match=message) as error:
        jaxgel.discretise(cloud_of("sample-1"), dmax=1.3)
    assert "\n" not in str(error.value)
    x, y = (float(text) for text in str(error.value).split("(")[1].split(")")[0].split(","))
    nodes = np.asarray(cloud_of("sample-1").nodes)
    assert np.sum(np.linalg.norm(nodes - np.array([x, y]), axis=1) < 1.43) < 7


def test_neighbours_on_too_few_lines_are_refused_with_the_point():
    """In the ligament below a rectangle a point reaches enough nodes, but on two lines."""
    cloud = jaxgel.make_cloud(
        jaxgel.Plate(8, 8, [jaxgel.Rectangle((0.0, -2.0), (5.0, 3.2))]),
        spacing=0.5,
        nodes_per_hole=36,
    )
    message = (
        r"^dmax: 2.5 is too small for the quadratic basis near the point \(-?\d\S*, -?\d\S*\): "
        r"its neighbours lie on too few lines"
    )
    with pytest.raises(ValueError, match=message):
        jaxgel.discretise(cloud, dmax=2.5)


def test_a_cloud_is_discretised_inside_jit_without_lists_made_before(tiny_plate):
    cloud = jaxgel.make_cloud(tiny_plate)  # a topology of its own, so without lists

    def volume(radius):
        model = jaxgel.discretise(cloud.at(tiny_plate.at([{"radius": radius}])), basis="linear")
        return sum(jnp.sum(block.weight) for block in model.blocks)

    whole, smaller = (float(jax.jit(volume)(radius)) for radius in (1.1, 1.0))
    # outlines of 96 chords
    assert smaller - whole == pytest.approx(np.pi * (1.1**2 - 1.0**2), rel=5e-3)
