"""Periodic cells with free macroscopic strain: no mean stress, states, derivatives."""

import dataclasses
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel import Problem
from jaxgel.bifurcation import CriticalPoint, imperfection
from jaxgel.cases import case_text, explicit, from_table, load_path
from jaxgel.io import Recorder, load_run
from jaxgel.materials import isotropic_swelling
from jaxgel.mechanics import (
    check_room,
    deformation_of,
    factorised_tangent,
    gather,
    linearise,
    node_pairs,
    periods_of,
    residual,
    restrict,
    scatter,
    tangent,
    total_energy,
    with_free_values,
)
from jaxgel.observables import COLUMNS, history, macroscopic_deformation
from jaxgel.plotting import plot_pattern
from jaxgel.symmetry import bases, region, symmetries_of
from jaxgel.waves.bloch import BlochStates

pytestmark = pytest.mark.thorough

GEL = jaxgel.Gel(Nv=1e-3, chi=1e-4)
SIZES = dict(spacing=0.25, nodes_per_hole=12)
COARSE = dict(spacing=0.4, nodes_per_hole=8)
STRIP = {"left": "periodic", "right": "periodic", "bottom": "free", "top": "free"}
TILTED = jaxgel.Ellipse((0.05, -0.1), (0.8, 0.5), 0.4)
PULLED = ((1.1, "free"), ("free", "free"))
# Newton's method stops at 1e-10 of the network's forces; its last step leaves the square of the
# error
EXACT = 1e-10


def cell(deformation, holes=(TILTED,), side=2.0, **kw):
    return jaxgel.Plate(side, side, holes, edges="periodic", deformation=deformation, **kw)


def model_of(plate, sizes=SIZES):
    return jaxgel.discretise(jaxgel.make_cloud(plate, **sizes))


def swept(plate, mu=(-1.5,), gel=GEL, sizes=SIZES, **kw):
    return jaxgel.sweep(
        jaxgel.Problem(model_of(plate, sizes), gel), list(mu), eigenvalues=True, **kw
    )


@pytest.fixture(scope="module")
def pulled():
    """A cell with a tilted hole, pulled along x: its other strains are free."""
    return swept(cell(PULLED), [-2.5, -1.5])


@pytest.fixture(scope="module")
def squeezed():
    """The 2 x 2 cell of large holes, shorter along x: its symmetric state is unstable."""
    return swept(four_holes(0.9), [-2.0], sizes=COARSE, branch="symmetric")


def four_holes(F11):
    holes = [jaxgel.Circle((x, y), 0.8) for x in (-1, 1) for y in (-1, 1)]
    return cell(((F11, "free"), ("free", "free")), holes, 4.0)


@pytest.mark.parametrize(
    ("edges", "kinematics", "stretch"),
    [
        ("periodic", "plane strain", jaxgel.free_swelling),
        pytest.param("periodic", "plane stress", isotropic_swelling, marks=pytest.mark.slow),
        pytest.param(
            "periodic",
            "generalised plane strain",
            lambda mu, gel: jaxgel.free_swelling(mu, gel, 1.05),
            marks=pytest.mark.slow,
        ),
        pytest.param(STRIP, "plane strain", jaxgel.free_swelling, marks=pytest.mark.slow),
    ],
)
def test_an_infinite_lattice_without_holes_swells_freely(edges, kinematics, stretch):
    mu = [-3.0, -0.5]
    axial = 1.05 if kinematics == "generalised plane strain" else None
    plate = jaxgel.Plate(
        2, 1.5, edges=edges, deformation="free", kinematics=kinematics, axial_stretch=axial
    )
    check_room(plate)
    path = jaxgel.sweep(
        jaxgel.Problem(jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.5)), GEL), mu
    )
    exact = np.array([float(stretch(value, GEL)) for value in mu])
    X = np.asarray(path.model.cloud.nodes)
    corner = int(np.argmin(X.sum(axis=1)))  # of a strip it has its height by convention
    np.testing.assert_allclose(
        path.x - path.x[:, [corner]], exact[:, None, None] * (X - X[corner]), rtol=0, atol=EXACT
    )
    # a strip has no period along y
    F = np.eye(2) + (exact - 1)[:, None, None] * np.diag([1.0, edges == "periodic"])
    np.testing.assert_allclose(macroscopic_deformation(path), F, rtol=0, atol=EXACT)
    assert path.negative_pivots.tolist() == [0, 0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "holes",
    [(TILTED,), pytest.param([jaxgel.Circle((0, 0), 0.8)], marks=pytest.mark.slow)],
    ids=["tilted", "round"],
)
def test_holes_do_not_matter_to_a_lattice_that_swells_freely(holes):
    """Nothing holds it, so nothing closes or buckles: every state is the stretched dry one."""
    path = swept(cell("free", holes), [-3.0, -0.5])
    np.testing.assert_allclose(
        path.x[1],
        float(jaxgel.free_swelling(-0.5, GEL)) * np.asarray(path.model.cloud.nodes),
        rtol=0,
        atol=EXACT,
    )
    assert path.negative_pivots.tolist() == [0, 0] and path.lowest_eigenvalue.min() > 0.2


def test_the_state_is_that_under_the_deformation_it_found(pulled):
    F = np.asarray(macroscopic_deformation(pulled))[-1]
    assert abs(F[0, 1]) > 1e-3 and F[0, 1] == pytest.approx(F[1, 0], abs=1e-14)
    held = swept(cell(F.tolist()))
    np.testing.assert_allclose(held.x[-1], pulled.x[-1], rtol=0, atol=1e-9)
    assert held.energy[-1] == pytest.approx(pulled.energy[-1], rel=1e-12)
    np.testing.assert_allclose(macroscopic_deformation(held)[-1], F, rtol=0, atol=1e-14)


def test_no_mean_stress_acts_along_free_components(pulled):
    """Mean first Piola-Kirchhoff stress P = sum of forces times dry positions: only P11.

    That holds the cell pulled; they are nodal forces.
    """
    model, x = pulled.model, jnp.asarray(pulled.x[-1])
    forces = jax.jit(residual)(
        x, model, GEL, pulled.mu[-1], jnp.zeros_like(x), jnp.asarray(pulled.pressure[-1])
    )
    P = np.asarray(forces).T @ np.asarray(model.cloud.nodes) / 4.0
    assert P[0, 0] > 5e-5
    np.testing.assert_allclose([P[1, 1], P[0, 1] + P[1, 0]], 0, atol=1e-8 * P[0, 0])


@pytest.mark.slow
def test_energy_of_held_cells_has_no_slope_along_free_components(pulled):
    """Virtual work: the energy of held cells about the deformation has no slope.

    Only what was held has one. Differences at two steps, extrapolated: their own error is 1e-9 of
    the slope along x.
    """
    F = np.asarray(macroscopic_deformation(pulled))[-1]

    def slope(direction):
        def difference(h):
            ends = [
                float(
                    swept(
                        cell((F + side * h * np.array(direction)).tolist()), symmetry="off"
                    ).energy[0]
                )
                for side in (1, -1)
            ]
            return (ends[0] - ends[1]) / (2 * h)

        return (4 * difference(1e-3) - difference(2e-3)) / 3

    work = abs(slope([[1, 0], [0, 0]]))
    assert work > 1e-4
    assert abs(slope([[0, 0], [0, 1]])) < 1e-8 * work
    assert abs(slope([[0, 1], [1, 0]])) < 1e-8 * work


@pytest.mark.parametrize("name", ["pulled", pytest.param("squeezed", marks=pytest.mark.slow)])
def test_tangent_and_count_of_negative_eigenvalues_are_those_of_the_hessian(name, request):
    """Of the energy as a function of all unknowns, the macroscopic ones included, by JAX."""
    path = request.getfixturevalue(name)
    model, problem = path.model, Problem(path.model, GEL, contact=False).prepared
    x, p, mu, free = (
        jnp.asarray(path.x[-1]),
        jnp.asarray(path.pressure[-1]),
        float(path.mu[-1]),
        problem.free,
    )
    at = restrict(x, free)
    np.testing.assert_allclose(with_free_values(at, x, free), x, rtol=0, atol=1e-15)
    v = np.random.default_rng(0).normal(size=len(free))
    np.testing.assert_allclose(restrict(scatter(v, free), free), v, rtol=0, atol=1e-14)

    def energy(values):
        return total_energy(with_free_values(values, x, free), model, GEL, mu, problem.loads)

    H = np.asarray(jax.jit(jax.hessian(energy))(at))
    now = linearise(problem, x, p, mu)
    made = factorised_tangent(problem, x, p, now)
    scale = np.abs(H).max()
    # J of the state is J*(p) to 1e-11 of the swelling
    np.testing.assert_allclose(made.matrix.toarray(), H, rtol=0, atol=1e-9 * scale)
    np.testing.assert_allclose(
        made.solve(v)[0],
        np.linalg.solve(made.matrix.toarray(), v),
        rtol=1e-6,
        atol=1e-9 * np.abs(1 / scale),
    )
    negative = int(np.sum(np.linalg.eigvalsh(H) < 0))
    assert path.negative_pivots[-1] == made.negative_pivots == negative == (name == "squeezed")


def test_strains_soften_a_cell(squeezed):
    """A held cell has fewer fields: Cauchy's interlacing of the lowest eigenvalues."""
    F = np.asarray(macroscopic_deformation(squeezed))[0]
    held = swept(
        dataclasses.replace(squeezed.model.cloud.plate, deformation=F.tolist()),
        [-2.0],
        sizes=COARSE,
        branch="symmetric",
    )
    np.testing.assert_allclose(held.x, squeezed.x, rtol=0, atol=1e-9)
    assert held.lowest_eigenvalue[0] >= squeezed.lowest_eigenvalue[0] * (1 + 1e-3)


@pytest.mark.slow
def test_symmetric_and_whole_states_agree(squeezed):
    """Found on a quarter, with the blocks of its tangent, and on the whole cell."""
    assert squeezed.symmetry == ("D2 (axes)",)
    whole = swept(
        squeezed.model.cloud.plate, [-2.0], sizes=COARSE, branch="symmetric", symmetry="off"
    )
    np.testing.assert_allclose(whole.x, squeezed.x, rtol=0, atol=1e-9)
    assert whole.negative_pivots[0] == squeezed.negative_pivots[0] == 1
    assert whole.lowest_eigenvalue[0] == pytest.approx(squeezed.lowest_eigenvalue[0], rel=3e-3)


@pytest.mark.slow
def test_a_square_cell_has_all_symmetries_and_its_blocks_make_the_tangent():
    path = swept(cell("free", [jaxgel.Circle((0, 0), 0.6)]))
    problem, x, mu = (
        Problem(path.model, GEL, contact=False).prepared,
        jnp.asarray(path.x[-1]),
        float(path.mu[-1]),
    )
    group = symmetries_of(problem)
    assert len(group) == 7 and path.symmetry == ("D4",)
    reduced = region(problem, group)
    own = np.asarray(path.pressure[-1])[reduced.own]
    whole = factorised_tangent(
        problem, x, path.pressure[-1], linearise(problem, x, path.pressure[-1], mu)
    ).matrix
    pairs, size = (
        np.asarray(tangent(reduced.problem, x, own, linearise(reduced.problem, x, own, mu))),
        0,
    )
    for basis in bases(path.model.lists, group):
        block = basis.pattern.matrix(pairs)
        for fields in basis.fields:
            np.testing.assert_allclose(
                (fields.T @ whole @ fields - block).toarray(), 0, atol=1e-11 * np.abs(whole).max()
            )
            size += fields.shape[1]
    assert size == len(problem.free)


@pytest.mark.slow
def test_one_cell_swells_as_two_by_two():
    """A stiff inclusion, so that the lattice does not swell as the gel alone.

    Below any bifurcation.
    """

    def strains(n):
        centres = [
            (2.0 * (i - (n - 1) / 2), 2.0 * (j - (n - 1) / 2)) for i in range(n) for j in range(n)
        ]
        inclusions = [jaxgel.Ellipse(centre, (0.7, 0.5), 0.0) for centre in centres]
        plate = dataclasses.replace(cell("free", (), 2.0 * n), regions=inclusions)
        gel = jaxgel.Composite(GEL, (jaxgel.Elastomer(Nv=0.01, bulk=1.0),) * n * n)
        path = swept(plate, [-2.0, -1.0], gel)
        assert path.negative_pivots.max() == 0
        return np.asarray(macroscopic_deformation(path))

    one = strains(1)
    assert one[-1][0, 0] < one[-1][1, 1] < float(jaxgel.free_swelling(-1.0, GEL)) - 1e-3
    # the clouds of the four cells are not the same
    np.testing.assert_allclose(strains(2), one, rtol=0, atol=2e-4)


def strains(by, of):
    """F22 and F12 (2,) by the semi-axes of the tilted hole, or by chi and mu."""
    cloud = jaxgel.make_cloud(cell(PULLED), **SIZES)
    if of == "hole":
        cloud = cloud.at(
            cloud.plate.at(
                [{"semi_axes": jnp.array(TILTED.semi_axes) + by * jnp.array([1.0, 0.3])}]
            )
        )
    by = 0.0 if of == "hole" else by
    path = jaxgel.sweep(
        Problem(jaxgel.discretise(cloud), jaxgel.Gel(GEL.Nv, 0.1 + by), contact=False),
        [-1.5 - 0.6 * by],
    )
    return macroscopic_deformation(path)[0, :, 1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("of", "h"), [("chi and mu", 1e-3), pytest.param("hole", 2e-5, marks=pytest.mark.slow)]
)
def test_derivatives_of_the_deformation_are_differences_of_resolved_states(of, h):
    """Of central differences, extrapolated.

    And what a tangent leaves of a step falls as its square: Taylor's rate 2. Shape functions of
    nodes that move are smooth only as long as the nodes near a point stay the same: the steps of a
    hole are short.
    """
    slope = np.asarray(jax.jvp(lambda by: strains(by, of), (0.0,), (1.0,))[1])
    np.testing.assert_allclose(jax.jacrev(lambda by: strains(by, of))(0.0), slope, rtol=1e-9)
    ends = [[np.asarray(strains(side * step, of)) for side in (1, -1)] for step in (h, 2 * h)]
    once, twice = (
        (plus - minus) / (2 * step) for (plus, minus), step in zip(ends, (h, 2 * h), strict=True)
    )
    np.testing.assert_allclose(slope, (4 * once - twice) / 3, rtol=1e-6)
    start = np.asarray(strains(0.0, of))
    left = [
        np.abs(plus - start - step * slope)
        for (plus, _), step in zip(ends, (h, 2 * h), strict=True)
    ]
    np.testing.assert_allclose(np.log2(left[1] / left[0]), 2.0, atol=0.05)


def test_waves_of_all_cells_are_the_modes_of_the_cell_with_its_strains(squeezed):
    """Waves that are the same in all cells may strain them.

    Their eigenvalue is that of the cell, accurate to 1e-3.
    """
    waves = BlochStates(Problem(squeezed.model, GEL, contact=False).prepared, squeezed[0])
    assert waves.negative(np.zeros(2)) == 1
    values, fields = waves.lowest(np.zeros(2), 2)
    assert (
        values[0] == pytest.approx(squeezed.lowest_eigenvalue[0], rel=2e-3)
        and values[0] < 0 < values[1]
    )
    assert fields.shape == (2, *squeezed.x.shape[1:])


@pytest.mark.slow
def test_onset_of_the_squeezed_lattice_and_its_derivative():
    """That of the cell's waves repeats after 2 x 2 cells, where the 2 x 2 cell buckles.

    Derivatives against searches at other chi.
    """
    four = model_of(four_holes(0.95), COARSE)
    one = model_of(jaxgel.primitive_cell(four.cloud.plate), COARSE)
    assert one.cloud.plate.free_strains == ((1, 1), (0, 1))

    def critical(chi):
        return jaxgel.critical_points(
            jaxgel.Problem(four, jaxgel.Gel(1e-3, chi)), (-3.0, -1.0), most=1
        )[0].mu

    def onset(chi):
        return jaxgel.lattice_onset(
            jaxgel.Problem(one, jaxgel.Gel(1e-3, chi)), (-4.0, -0.5), divisions=2
        )

    found = onset(0.1)
    assert found.periods == (2, 2)
    # the clouds have other nodes: -1.198 and -1.257
    assert found.mu == pytest.approx(critical(0.1), abs=0.1)
    for of in (critical, lambda chi: onset(chi).mu):
        slope, h = float(jax.jvp(of, (0.1,), (1.0,))[1]), 1e-4
        assert slope == pytest.approx((of(0.1 + h) - of(0.1 - h)) / (2 * h), rel=1e-5)


def test_an_imperfection_pushes_along_a_mode_and_its_strains():
    """Its generalised forces are the network's against the mode, whichever nodes carry them."""
    model = model_of(cell(PULLED))
    problem = Problem(model, GEL, contact=False).prepared
    mode = np.asarray(
        scatter(np.random.default_rng(1).normal(size=len(problem.free)), problem.free)
    )
    unused = dict(
        x=mode,
        pressure=np.zeros(0),
        eigenvalues=np.zeros(1),
        slope=-1.0,
        curvature=1.0,
        imperfection=0.0,
        symmetries={},
    )
    point = CriticalPoint(
        value=-1.0,
        mu=-1.0,
        kind="bifurcation",
        modes=mode[None],
        unstable=0,
        correction=mode,
        **unused,
    )
    loads = imperfection(Problem(model, GEL, contact=False), point, 0.1)
    network = problem.network
    (i, j), nodal = node_pairs(problem.model.lists)[0].T, np.zeros_like(mode)
    np.add.at(nodal, i, network[:, None] * mode[j])
    np.add.at(nodal, j, np.where(i == j, 0.0, network)[:, None] * mode[i])
    forces = (
        np.asarray(gather(nodal, problem.free))
        * 0.1
        * model.cloud.spacing
        / np.linalg.norm(mode, axis=1).max()
    )
    np.testing.assert_allclose(
        gather(loads, problem.free), forces, rtol=0, atol=1e-12 * np.abs(forces).max()
    )


def test_case_file_and_run_folder_of_a_free_cell(tmp_path):
    """The deformation survives the case file.

    The table has its components, and only that of such a cell.
    """
    plate = {
        "width": 2.0,
        "height": 2.0,
        "edges": "periodic",
        "deformation": [[1.05, 0.0], [0.0, "free"]],
    }
    table = {"plate": plate, "sweep": {"mu": [-2.0]}, "discretisation": {"spacing": 0.5}}
    case = from_table(table, "cell")
    again = from_table(tomllib.loads(case_text(explicit(case))), "again")
    assert again.plate.deformation == case.plate.deformation == ((1.05, 0.0), (0.0, "free"))
    assert from_table(
        table | {"plate": plate | {"deformation": "free"}}, "cell"
    ).plate.free_strains == ((0, 0), (1, 1), (0, 1))
    model = case.model()
    recorder = Recorder(tmp_path, case, case.problem(model))
    path = case.path(model, observer=jaxgel.Observer(accepted=recorder))
    recorder.finish("complete", path.stop_text)
    columns = load_run(tmp_path).history
    assert list(columns) == [*COLUMNS, "F11", "F22", "F12"] == list(history(path))
    assert columns["F22"][0] == float(macroscopic_deformation(path)[0, 1, 1]) > 1.002
    np.testing.assert_allclose(load_path(tmp_path).x, path.x, rtol=0, atol=0)
    held = from_table(table | {"plate": plate | {"deformation": [[1.05, 0.0], [0.0, 1.0]]}}, "held")
    assert list(history(held.path(held.model()))) == list(COLUMNS)


def test_pictures_show_the_cell_as_long_as_it_is():
    """The hatched bars below and above a strip between rollers follow its free stretch along x."""
    edges = {"left": "periodic", "right": "periodic", "bottom": "roller", "top": "roller"}
    plate = jaxgel.Plate(2, 2, [jaxgel.Circle((0, 0), 0.6)], edges=edges, deformation="free")
    path = swept(plate, [-1.0])
    topology = path.model.lists.topology
    F = np.asarray(
        deformation_of(path.x[0], periods_of(topology), np.array(topology.plate.dry_deformation))
    )
    assert F[0, 0] > 1.05 and F[1, 1] == 1.0
    ax = plot_pattern(path)
    bars = [patch.get_xy() for patch in ax.patches if patch.get_hatch()]
    assert len(bars) == 2
    for bar in bars:
        np.testing.assert_allclose(np.abs(bar[:, 0]), F[0, 0], rtol=0, atol=1e-3)


@pytest.mark.slow
def test_components_that_cannot_be_free_are_refused(refused):
    refused(
        lambda edges, deformation: jaxgel.Plate(2, 2, edges=edges, deformation=deformation),
        [
            ("periodic", "frei", "^deformation: 'frei' is neither a number nor 'free'$"),
            (
                "periodic",
                ((1.0, "open"), ("open", 1.0)),
                "^deformation: 'open' is neither a number nor 'free'$",
            ),
            (
                "roller",
                "free",
                (
                    "^deformation: 'free' is that of a periodic cell; make two opposite edges "
                    "periodic$"
                ),
            ),
            (
                STRIP,
                ((1, 0), (0, "free")),
                (
                    "^deformation: the component 22 is 'free', but the edges bottom and top are "
                    "not periodic$"
                ),
            ),
            (
                STRIP,
                ((1, "free"), ("free", 1)),
                (
                    "^deformation: the component 12 is 'free', but the edges bottom and top are "
                    "not periodic$"
                ),
            ),
            (
                STRIP | {"top": "fixed"},
                "free",
                "^deformation: the component 11 is 'free', but the fixed edge top holds it$",
            ),
            (
                "periodic",
                ((1, "free"), (0, 1)),
                (
                    "^deformation: a free shear is one unknown, F12 = F21; make both 'free', or "
                    "both numbers$"
                ),
            ),
            (
                "periodic",
                ((-1, 0), (0, "free")),
                "^deformation: .* has the determinant -1, it must be positive$",
            ),
        ],
    )
