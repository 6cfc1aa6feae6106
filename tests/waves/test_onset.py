"""Onset of infinite lattices: kinds, derivatives, and buckling of larger cells."""

import json

import jax
import numpy as np
import pytest

import jaxgel
from jaxgel import Problem
from jaxgel.cli import command_line as cli
from jaxgel.continuation import SweepFailed, lowest_eigenvalue
from jaxgel.plotting import plot_lattice, plot_zone, save_figure
from jaxgel.waves import BlochStates

pytestmark = pytest.mark.thorough

WINDOW = (-3.6, -2.4)


def test_round_holes_buckle_in_a_pattern_of_two_by_two_cells(onset):
    assert onset.kind == "short wave" and onset.periods == (2, 2)
    np.testing.assert_allclose(np.abs(onset.wave_vector), np.pi / 2)
    assert onset.slope < 0 and np.all(onset.eigenvalues > -1e-8)
    assert onset.text.endswith("a pattern that repeats after 2 x 2 cells")


def test_the_waves_change_their_stability_at_the_onset(onset, cell, gel):
    path = jaxgel.sweep(
        jaxgel.Problem(cell, gel), [WINDOW[0], onset.mu - 1e-4, onset.mu + 1e-4], branch="symmetric"
    )
    before, after = (
        BlochStates(Problem(cell, gel, contact=False).prepared, path[k]) for k in (1, 2)
    )
    assert [waves.negative(onset.wave_vector) for waves in (before, after)] == [0, 1]
    rise = after.lowest(onset.wave_vector)[0][0] - before.lowest(onset.wave_vector)[0][0]
    assert rise / 2e-4 == pytest.approx(onset.slope, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.0, 0.12])
def test_flat_holes_lose_their_ellipticity(angle, model_of, gel):
    """A long wave in the direction of least energy: along x, or between the first ones."""
    model = model_of(jaxgel.Ellipse((0, 0), (0.9, 0.6), angle))
    onset = jaxgel.lattice_onset(jaxgel.Problem(model, gel), (-2.5, -0.9), divisions=2)
    assert onset.kind == "long wave" and onset.periods is None and "ellipticity" in onset.text
    waves = BlochStates(
        Problem(model, gel, contact=False).prepared,
        jaxgel.sweep(jaxgel.Problem(model, gel), [-2.5, onset.mu], branch="symmetric")[-1],
    )
    turns = [
        np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in (-0.02, 0.0, 0.02)
    ]
    values = [waves.lowest(turn @ onset.wave_vector)[0][0] for turn in turns]
    assert values[1] < min(values[0], values[2]) and abs(values[1]) < 1e-5
    assert (abs(onset.wave_vector[1]) < 1e-3 * abs(onset.wave_vector[0])) == (angle == 0)


# bottom and top
STRIPS = {"fixed": ("fixed", "free"), "roller": ("roller", "free"), "free": ("free", "free")}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["fixed", *(pytest.param(name, marks=pytest.mark.slow) for name in ("roller", "free"))]
)
def test_waves_of_a_strip(name, gel):
    """Those that are the same in all cells are those of the sweep.

    Two cells have those of one at k and at k plus half of its reciprocal vector, but for what a
    cloud does at a cell's edges: 0.3 % on these.
    """
    edges, waves = (
        {
            "left": "periodic",
            "right": "periodic",
            "bottom": STRIPS[name][0],
            "top": STRIPS[name][1],
        },
        [],
    )
    for count in (1, 2):
        holes = [jaxgel.Circle((1 + 2 * i - count, 0), 0.5) for i in range(count)]
        model = jaxgel.discretise(
            jaxgel.make_cloud(
                jaxgel.Plate(2 * count, 2, holes, edges=edges), spacing=0.2, nodes_per_hole=20
            )
        )
        path = jaxgel.sweep(jaxgel.Problem(model, gel), [-2.5], branch="symmetric", symmetry="off")
        waves.append(BlochStates(Problem(model, gel, contact=False).prepared, path[0]))
        assert waves[-1].lowest(np.zeros(2))[0][0] == pytest.approx(
            float(lowest_eigenvalue(path)[0]), rel=1e-7
        )
    (one, two), k = waves, np.array([0.6, 0.0])
    both = np.sort(np.concatenate([one.lowest(k, 3)[0], one.lowest(k + [np.pi / 2, 0], 3)[0]]))
    np.testing.assert_allclose(two.lowest(k, 3)[0], both[:3], rtol=5e-3)


@pytest.mark.slow
def test_onset_is_that_of_the_larger_cell(gel):
    """Four cells that buckle on their own: the clouds differ at the cells' edges."""

    def model(side, centres):
        plate = jaxgel.Plate(
            side, side, [jaxgel.Circle(centre, 0.7) for centre in centres], edges="periodic"
        )
        return jaxgel.discretise(jaxgel.make_cloud(plate, spacing=1 / 12, nodes_per_hole=48))

    (point,) = jaxgel.critical_points(
        jaxgel.Problem(model(4, [(x, y) for x in (-1, 1) for y in (-1, 1)]), gel),
        (-1.9, -1.4),
        most=1,
    )
    onset = jaxgel.lattice_onset(jaxgel.Problem(model(2, [(0, 0)]), gel), (-1.9, -1.4), divisions=2)
    assert onset.mu == pytest.approx(point.mu, rel=1e-3)


@pytest.mark.slow
def test_onset_of_a_strip_between_mirrors_of_the_lattice_is_that_of_finite_elements(tmp_path):
    """Rollers through the hole centres; -2.14015 is the lattice's, 0.16 % measured.

    By `benchmarks/waves.py`; the lattice is infinite.
    """
    edges = {"left": "periodic", "right": "periodic", "bottom": "roller", "top": "roller"}
    plate = jaxgel.Plate(2, 2, [jaxgel.Circle((0, y), 0.8) for y in (-1, 1)], edges=edges)
    model = jaxgel.discretise(jaxgel.make_cloud(plate, spacing=0.1, nodes_per_hole=40))
    onset = jaxgel.lattice_onset(
        jaxgel.Problem(model, jaxgel.Gel(Nv=1e-3, chi=1e-4)), (-3.0, -1.6), divisions=4
    )
    assert onset.mu == pytest.approx(-2.14015, rel=3e-3) and onset.periods == (2, 1)
    np.testing.assert_allclose(onset.wave_vector, [np.pi / 2, 0], atol=1e-12)
    for name, draw in (("zone", plot_zone), ("pattern", plot_lattice)):
        save_figure(draw(onset, model).figure, tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").stat().st_size > 5000


@pytest.mark.slow
@pytest.mark.parametrize("of", ["radius", pytest.param("gel", marks=pytest.mark.slow)])
def test_derivatives_are_differences_of_relocated_onsets(of, cell, gel, onset):
    plate = cell.cloud.plate

    def critical(v):
        moved = (
            jaxgel.discretise(cell.cloud.at(plate.at([{"radius": v}]))) if of == "radius" else cell
        )
        own = gel if of == "radius" else jaxgel.Gel(1e-3, v)
        return jaxgel.lattice_onset(
            jaxgel.Problem(moved, own), (onset.mu - 0.05, onset.mu + 0.05), divisions=1
        ).mu

    at, h = (0.9, 1e-4) if of == "radius" else (0.01, 1e-3)
    value, slope = jax.value_and_grad(critical)(at)
    assert float(value) == pytest.approx(onset.mu, abs=0.02)
    assert float(slope) == pytest.approx((critical(at + h) - critical(at - h)) / (2 * h), rel=1e-5)


@pytest.mark.slow
def test_a_larger_cell_has_an_onset_of_its_own(gel, tmp_path):
    """For two by two cells the pattern is the same in all: the cell's own bifurcation."""
    holes = [jaxgel.Circle((x, y), 0.9) for x in (-1, 1) for y in (-1, 1)]
    model = jaxgel.discretise(
        jaxgel.make_cloud(
            jaxgel.Plate(4, 4, holes, edges="periodic"), spacing=0.25, nodes_per_hole=16
        )
    )

    def lattice(chi):
        return jaxgel.lattice_onset(
            jaxgel.Problem(model, jaxgel.Gel(gel.Nv, chi)), WINDOW, divisions=1
        )

    def cell(chi):
        return jaxgel.critical_points(
            jaxgel.Problem(model, jaxgel.Gel(gel.Nv, chi)), WINDOW, most=1
        )[0].mu

    onset = lattice(gel.chi)
    save_figure(plot_lattice(onset, model).figure, tmp_path / "pattern.png")  # of one real mode
    assert (
        onset.kind == "short wave"
        and onset.periods == (1, 1)
        and not onset.wave_vector.any()
        and "the cell's own" in onset.text
    )
    (mu, slope), (expected, by_cell) = (
        jax.value_and_grad(lambda chi: lattice(chi).mu)(0.01),
        jax.value_and_grad(cell)(0.01),
    )
    assert float(mu) == pytest.approx(float(expected), abs=1e-6) and float(slope) == pytest.approx(
        float(by_cell), rel=1e-4
    )


def test_waves_that_cannot_be_had_are_refused(cell, gel, refused):
    walls = jaxgel.discretise(
        jaxgel.make_cloud(jaxgel.Plate(2, 2, [jaxgel.Circle((0, 0), 0.7)]), spacing=0.25)
    )
    own, driven = (
        jaxgel.Problem(cell, gel),
        jaxgel.Problem(cell, gel, control=jaxgel.controls.chi()),
    )
    refused(
        lambda problem, ends, divisions: jaxgel.lattice_onset(problem, ends, divisions=divisions),
        [
            (jaxgel.Problem(walls, gel), WINDOW, 8, "edges: no two opposite edges are periodic"),
            (own, (-2.6, -2.5), 2, r"mu: the lattice is unstable at the first state, mu = -2\.6"),
            (own, [-3.0, -2.0, -1.0], 8, r"mu: \[-3.*it must be two numbers"),
            (driven, (0.1, 0.3), 8, r"lattice_onset: is not available with the control 'chi'"),
            (own, WINDOW, 0, "divisions: 0 is not a positive whole number"),
        ],
    )
    with pytest.raises(ValueError, match="lattice_onset: is not available inside jit or vmap"):
        jax.jit(
            lambda chi: jaxgel.lattice_onset(jaxgel.Problem(cell, jaxgel.Gel(1e-3, chi)), WINDOW).mu
        )(0.0)


@pytest.mark.slow
def test_a_stable_lattice_has_no_onset_and_a_branch_that_ends_says_so(cell, model_of, gel):
    assert jaxgel.lattice_onset(jaxgel.Problem(cell, gel), (-4.6, -3.8), divisions=2) is None
    with pytest.raises(
        SweepFailed, match="no wave is unstable on the states found; stopped after mu = -3"
    ):
        jaxgel.lattice_onset(
            jaxgel.Problem(model_of(jaxgel.Ellipse((0, 0), (0.6, 0.1))), gel),
            (-4.6, -0.6),
            divisions=1,
        )


@pytest.mark.slow
def test_the_command_finds_the_cell_of_a_larger_one(tmp_path, capsys, onset):
    holes = "".join(
        f"[[holes]]\nkind = 'circle'\ncentre = [{x}, {y}]\nradius = 0.9\n"
        for x in (-1, 1)
        for y in (-1, 1)
    )
    text = (
        "[plate]\nwidth = 4\nheight = 4\nedges = 'periodic'\n"
        + holes
        + "[gel]\nNv = 1e-3\nchi = 1e-5\n"
    )
    (tmp_path / "four.toml").write_text(
        text + "[discretisation]\nspacing = 0.25\nnodes_per_hole = 16\n"
    )
    command = [
        "waves",
        str(tmp_path / "four.toml"),
        "--out",
        str(tmp_path / "out"),
        "--mu-start",
        "-3.6",
        "--mu-end",
        "-2.4",
    ]
    assert cli.main([*command, "--divisions", "4"]) == 0
    said = capsys.readouterr().out
    assert "four consists of equal cells, 2 x 2 mm" in said and "repeats after 2 x 2 cells" in said
    record = json.loads((tmp_path / "out" / "waves.json").read_text())
    assert record["onset"]["mu"] == pytest.approx(onset.mu, abs=1e-8) and record["onset"][
        "periods"
    ] == [2, 2]
    assert all(
        (tmp_path / "out" / f"{name}.png").stat().st_size > 5000 for name in ("zone", "pattern")
    )
