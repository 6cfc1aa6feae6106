"""Boundary conditions against closed forms; periodic cells against mirrors and elements."""

import dataclasses
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxgel
from jaxgel.cases import case_text, explicit, from_table, study_from_table
from jaxgel.mechanics import free_dofs, residual
from jaxgel.paper import FINITE_ELEMENTS

GEL = jaxgel.Gel(Nv=1e-3, chi=1e-4)
HOLE = [jaxgel.Circle((0.0, 0.0), 0.7)]
EXACT = 1e-9  # of lengths of order 1 mm: Newton stops at 1e-10 of the network's forces


def swept(plate, mu, *, loads=None, gel=GEL, **sizes):
    """The path at ``mu`` and the dry nodes (n, 2)."""
    model = jaxgel.discretise(jaxgel.make_cloud(plate, **sizes))
    return jaxgel.sweep(
        jaxgel.Problem(model, gel, loads=loads and loads.of(model), contact=False), mu
    ), np.asarray(model.cloud.nodes)


@pytest.mark.thorough
def test_quarter_of_a_free_standing_plate_swells_freely():
    """Mirror symmetry at the left and the bottom, nothing else: x = stretch * X from the corner."""
    mu = [-4.0, -2.0, -1.0]
    path, X = swept(jaxgel.Plate(2, 1, edges={"right": "free", "top": "free"}), mu, spacing=0.25)
    corner = X.min(axis=0)
    exact = [corner + float(jaxgel.free_swelling(value, GEL)) * (X - corner) for value in mu]
    np.testing.assert_allclose(path.x, exact, rtol=0, atol=EXACT)
    np.testing.assert_allclose(
        path.energy,
        [
            2 * jaxgel.free_energy(s * jnp.eye(2), m, GEL)
            for s, m in zip(map(jaxgel.free_swelling, mu, [GEL] * 3), mu, strict=True)
        ],
        rtol=1e-12,
    )


@pytest.mark.parametrize("sides", ["periodic", pytest.param("roller", marks=pytest.mark.slow)])
def test_film_on_a_rigid_base_swells_uniaxially(sides):
    """Deng et al. (2020), Eq. (59)."""
    mu = [-4.0, -2.0, -1.0]
    plate = jaxgel.Plate(
        2, 1, edges={"left": sides, "right": sides, "bottom": "fixed", "top": "free"}
    )
    path, X = swept(plate, mu, spacing=0.25)
    stretch = np.array([float(jaxgel.uniaxial_swelling(value, GEL)) for value in mu])
    np.testing.assert_allclose(path.x[:, :, 0], np.tile(X[:, 0], (3, 1)), rtol=0, atol=EXACT)
    np.testing.assert_allclose(
        path.x[:, :, 1] + 0.5, stretch[:, None] * (X[:, 1] + 0.5), rtol=0, atol=EXACT
    )


@pytest.mark.parametrize(
    ("edges", "F"),
    [
        pytest.param("roller", ((1.2, 0.0), (0.0, 0.9)), marks=pytest.mark.slow),
        pytest.param("fixed", ((1.2, 0.2), (0.1, 0.9)), marks=pytest.mark.slow),
        ("periodic", ((1.2, 0.2), (0.1, 0.9))),
    ],
)
def test_gel_without_holes_follows_the_macroscopic_deformation(edges, F):
    """At the mu of the pressure -Nv: many times that makes the discrete gel unstable.

    See docs/howto/trust.md.
    """
    mu = float(jaxgel.materials.osmotic(np.linalg.det(F), 0.0, GEL) + GEL.Nv)
    path, X = swept(jaxgel.Plate(4, 2, edges=edges, deformation=F), [mu], spacing=0.5)
    np.testing.assert_allclose(path.x[0], X @ np.array(F).T, rtol=0, atol=EXACT)
    assert float(path.energy[0]) == pytest.approx(
        8 * float(jaxgel.free_energy(jnp.array(F), mu, GEL)), rel=1e-12
    )
    assert path.negative_pivots[0] == 0


def test_bar_that_is_pulled_narrows_as_its_free_sides_say():
    """The top is lifted by a quarter, the right side is free: F = diag(l, 1.25), dW/dl = 0."""
    plate = jaxgel.Plate(2, 1, edges={"right": "free"}, displacement={"top": (0.0, 0.25)})
    path, X = swept(plate, [-2.0], spacing=0.25)
    across = jax.jit(
        jax.grad(lambda s: jaxgel.free_energy(jnp.diag(jnp.array([s, 1.25])), -2.0, GEL))
    )
    width = brentq(lambda s: float(across(s)), 0.8 + 1e-9, 2.0, xtol=1e-14)
    np.testing.assert_allclose(
        path.x[0], X * [width, 1.25] + [width - 1, 0.125], rtol=0, atol=EXACT
    )


def test_edges_that_cannot_be_moved_at_once_move_in_steps():
    """Pulled by a quarter while nearly dry: moved at once, Newton's method fails.

    The forces on the ends balance.
    """
    edges = {"left": "free", "right": "free", "bottom": "fixed", "top": "fixed"}
    path, X = swept(
        jaxgel.Plate(2, 1, edges=edges, displacement={"top": (0.0, 0.25)}), [-4.0], spacing=0.25
    )
    forces = np.asarray(
        jax.jit(residual)(path.x[0], path.model, GEL, -4.0, jnp.zeros_like(path.x[0]))
    )
    top, bottom = (
        forces[path.model.lists.topology.edge_nodes[edge]].sum(axis=0) for edge in ("top", "bottom")
    )
    assert top[1] > 1e-4
    np.testing.assert_allclose(top + bottom, 0.0, atol=1e-9)
    np.testing.assert_allclose(path.x[0][np.abs(X[:, 1] - 0.5) < 1e-9, 1], 0.75, rtol=0, atol=1e-14)


@pytest.mark.slow
def test_traction_presses_a_film_as_the_uniaxial_closed_form_says():
    """With rollers at the sides the stress along y is dW/dl at F = diag(1, l): the traction."""
    mu = -2.0
    stretch = 1 + 0.8 * (float(jaxgel.uniaxial_swelling(mu, GEL)) - 1)
    traction = float(
        jax.grad(lambda s: jaxgel.free_energy(jnp.diag(jnp.array([1.0, s])), mu, GEL))(stretch)
    )
    loads = jaxgel.Loads(traction={"top": (0.0, traction)})
    path, X = swept(
        jaxgel.Plate(2, 1, edges={"top": "free"}), [-4.0, mu], loads=loads, spacing=0.25
    )
    np.testing.assert_allclose(path.x[1, :, 1] + 0.5, stretch * (X[:, 1] + 0.5), rtol=0, atol=EXACT)


@pytest.mark.slow
def test_column_under_its_weight_has_the_closed_form_of_its_height():
    """dW/dl = -b (H - Y) at every Y: the top is the integral of l, by Gauss quadrature.

    The stretch varies along the column, so the cloud is not exact: 12 and 24 intervals leave 1.6
    and 0.35 % of the settlement.
    """
    gel, mu, b = jaxgel.Gel(Nv=0.05, chi=1e-4), -1.0, -0.05
    plate = jaxgel.Plate(0.5, 1, edges={"top": "free"})
    path, X = swept(
        plate, [-3.0, mu], gel=gel, loads=jaxgel.Loads(body_force=(0.0, b)), spacing=1 / 24
    )
    points, weights = np.polynomial.legendre.leggauss(20)
    stress = jax.jit(jax.grad(lambda s: jaxgel.free_energy(jnp.diag(jnp.array([1.0, s])), mu, gel)))
    free = float(jaxgel.uniaxial_swelling(mu, gel))
    stretch = [
        brentq(lambda s, depth=depth: float(stress(s)) - b * depth, 1 + 1e-9, free)
        for depth in (1 - points) / 2
    ]
    settlement = free - weights @ np.array(stretch) / 2
    top = path.x[1][np.abs(X[:, 1] - 0.5) < 1e-9, 1] + 0.5
    np.testing.assert_allclose(free - top, settlement, rtol=0.006)


@pytest.mark.thorough
def test_periodic_cell_with_mirror_symmetry_is_the_cell_between_rollers():
    """One round hole: the periodic state has the rollers' mirror symmetry, to round-off."""
    sizes = dict(spacing=0.2, nodes_per_hole=20)
    periodic, _ = swept(jaxgel.Plate(2, 2, HOLE, edges="periodic"), [-3.0, -1.0], **sizes)
    between, _ = swept(jaxgel.Plate(2, 2, HOLE), [-3.0, -1.0], **sizes)
    np.testing.assert_allclose(periodic.x, between.x, rtol=0, atol=EXACT)
    np.testing.assert_allclose(periodic.energy, between.energy, rtol=1e-12)


def test_sheared_cell_keeps_its_period_and_its_mean_deformation():
    """Opposite sides differ by the period's deformation: the mean gradient is F."""
    F = np.array([[1.1, 0.15], [0.0, 1.05]])
    path, X = swept(
        jaxgel.Plate(2, 2, HOLE, edges="periodic", deformation=F.tolist()),
        [-1.5],
        spacing=0.2,
        nodes_per_hole=20,
    )
    walls = path.model.lists.topology.edge_nodes
    for low, high, period in (("left", "right", [2.0, 0.0]), ("bottom", "top", [0.0, 2.0])):
        apart = path.x[0][walls[high]] - path.x[0][walls[low]]
        np.testing.assert_allclose(apart, np.tile(F @ period, (len(apart), 1)), rtol=0, atol=1e-14)
    assert np.abs(path.x[0] - X @ F.T).max() > 0.01  # the fluctuation that periodicity leaves free


@pytest.mark.slow
def test_two_by_two_cell_buckles_before_the_unit_cell_as_the_infinite_lattice_does():
    """The lattice's checkerboard, core rotation and energy of finite elements at mu = -1.9678."""
    known = FINITE_ELEMENTS["lattice"]["buckled"]
    gel, centres = jaxgel.Gel(Nv=1e-3, chi=1e-5), [(x, y) for x in (-1.0, 1.0) for y in (-1.0, 1.0)]
    sizes = dict(spacing=0.2, nodes_per_hole=20)
    cell = jaxgel.Plate(4, 4, [jaxgel.Circle(centre, 0.9) for centre in centres], edges="periodic")
    path, _ = swept(cell, [-4.0, -1.9678], gel=gel, spacing=0.1)
    assert path.switched.tolist() == [False, True]
    assert path.negative_pivots.tolist() == [0, 0]
    # 829 nodes: 13.372, 0.13 %
    assert abs(float(jaxgel.core_rotation(path)[1])) == pytest.approx(known["core"][0], abs=0.03)
    assert 4 * float(path.energy[1]) == pytest.approx(known["energy"][0], rel=1e-3)  # -1.26474
    unit, _ = swept(
        jaxgel.Plate(2, 2, [jaxgel.Circle((0.0, 0.0), 0.9)], edges="periodic"),
        [-4.0, -1.9678],
        gel=gel,
        **sizes,
    )
    assert not unit.switched.any()
    assert unit.negative_pivots.tolist() == [0, 0]


@pytest.mark.thorough
@pytest.mark.parametrize(
    "moved", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["gel", "hole"]
)
def test_derivatives_pass_through_a_periodic_cell(moved):
    """Area reduction by chi or the hole's radius, against central differences good to 1e-9."""
    plate = jaxgel.Plate(2, 2, HOLE, edges="periodic", deformation=((1.05, 0.1), (0.0, 1.0)))
    cloud = jaxgel.make_cloud(plate, spacing=0.2, nodes_per_hole=20)

    def reduction(by):
        placed = cloud.at(plate.at([{"radius": 0.7 + by}])) if moved else cloud
        gel = GEL if moved else jaxgel.Gel(GEL.Nv, 0.1 + by)
        return jaxgel.area_reduction(
            jaxgel.sweep(jaxgel.Problem(jaxgel.discretise(placed), gel, contact=False), [-1.5])
        )[0]

    slope, h = float(jax.jvp(reduction, (0.0,), (1.0,))[1]), 1e-4
    assert slope == pytest.approx(float(reduction(h) - reduction(-h)) / (2 * h), rel=1e-6)


def test_a_case_file_can_say_all_of_it():
    table = {
        "plate": {
            "width": 2.0,
            "height": 1.0,
            "edges": {"left": "periodic", "right": "periodic", "top": "free", "bottom": "fixed"},
            "deformation": [[1.1, 0.0], [0.0, 1.0]],
            "displacement": {"bottom": [0.0, 0.5]},
        },
        "loads": {"body_force": [0.0, -1e-4], "traction": {"top": [0.0, 1e-3]}},
        "discretisation": {"spacing": 0.25},
    }
    case = from_table(table, "film")
    assert from_table(case.table(), "film").loads == case.loads
    model = case.model()
    np.testing.assert_allclose(
        case.loads.of(model).sum(axis=0), [0.0, 2 * 1e-3 - 2 * 1e-4], atol=1e-15
    )
    path = jaxgel.sweep(jaxgel.Problem(model, case.gel, loads=case.loads.of(model)), [-2.0])
    base = path.model.lists.topology.edge_nodes["bottom"]
    np.testing.assert_allclose(
        path.x[0][base], np.asarray(model.cloud.nodes)[base] * [1.1, 1.0] + [0.0, 0.5], atol=1e-14
    )


def test_a_case_file_keeps_how_its_plate_is_held_and_a_study_its_loads():
    plate = jaxgel.Plate(
        2,
        1,
        HOLE[:0],
        edges={"top": "fixed"},
        deformation=((1.1, 0.0), (0.0, 1.0)),
        displacement={"top": (0.0, 0.1)},
    )
    case = dataclasses.replace(
        from_table({"plate": {"width": 2.0, "height": 1.0}}, "held"), plate=plate
    )
    again = from_table(tomllib.loads(case_text(explicit(case))), "again").plate
    assert (again.edges, again.deformation, again.displacement) == (
        plate.edges,
        plate.deformation,
        plate.displacement,
    )
    loaded = {
        "plate": {"width": 2.0, "height": 1.0},
        "loads": {"body_force": [0.0, 1e-4]},
        "sweep": {"mu": [-2.0, -1.0]},
    }
    loaded["parameters"] = [{"of": "chi", "lower": 1e-5, "upper": 0.2}]
    loaded["objective"] = [{"of": "area_reduction", "goal": "maximise", "at": -1.0}]
    assert study_from_table(loaded, "loaded").problem.loads.body_force == (0.0, 1e-4)


def test_conditions_that_cannot_be_met_are_refused(refused):
    refused(
        lambda entries: jaxgel.Plate(2, 2, **entries),
        [
            (
                dict(edges={"left": "periodic"}),
                "^edges: left = 'periodic' needs right = 'periodic'$",
            ),
            (
                dict(deformation=((1, 0.1), (0, 1))),
                (
                    "^deformation: .* tilts the roller edge left; make the edge fixed or "
                    "periodic, or drop"
                ),
            ),
            (
                dict(deformation=((1, 0), (0, -1))),
                "^deformation: .* has the determinant -1, it must be positive$",
            ),
            (
                dict(deformation=(1, 2, 3)),
                r"^deformation: \(1, 2, 3\) is not 2 x 2 finite numbers$",
            ),
            (
                dict(displacement={"top": (0.1, 0.0)}),
                "^displacement: top = .* moves a roller edge in a direction that is not held$",
            ),
            (
                dict(displacement={"roof": (0.1, 0.0)}),
                "^displacement: unknown edge 'roof'; accepted: left, right, bottom, top$",
            ),
            (
                dict(edges="fixed", displacement={"top": (0, 0.1)}),
                "^displacement: left and top move the corner between them to different",
            ),
        ],
    )


def test_load_that_nothing_holds_is_refused():
    model = jaxgel.discretise(jaxgel.make_cloud(jaxgel.Plate(2, 1, edges="periodic"), spacing=0.25))
    with pytest.raises(
        ValueError,
        match=r"^loads: a resultant of -0\.002 kT/v mm along y, in which no edge holds the plate$",
    ):
        jaxgel.Loads(body_force=(0.0, -1e-3)).of(model)
    # the images are no unknowns of their own, and one node is pinned
    assert len(free_dofs(model.lists.topology)) == 2 * 8 * 4 - 2
