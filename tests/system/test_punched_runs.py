"""A run whose control moves an obstacle: its table, files and figures, and how it resumes."""

import csv
import shutil
from xml.etree import ElementTree

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import PathCollection
from studies import killed

import jaxgel
from jaxgel.cases import load_path
from jaxgel.cli import command_line as cli
from jaxgel.io import load_run, write_series
from jaxgel.observables import COLUMNS, OF_OBSTACLES, obstacle_displacement
from jaxgel.plotting import animate_pattern, plot_curves, plot_pattern, plot_patterns

pytestmark = pytest.mark.slow

CASE = """
[plate]
width = 1.0
height = 1.0
edges = { top = "free" }
spacing = 0.25
[[obstacles]]
kind = "disc"
centre = [0.0, 9.0]
radius = 1.0
[[obstacles]]
kind = "half-plane"
point = [0.4, 1.3]
normal = [0.0, -2.0]
[gel]
Nv = 1e-3
chi = 0.1
[sweep]
control = "punch"
values = [0.0, 0.3, 0.4, 0.5]
obstacle = 1
displacement = [0.0, -1.0]
at_mu = -0.3
contact_range = 0.02
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of the whole run, next to it those of the same run killed after k states."""
    return killed(CASE, tmp_path_factory.mktemp("punched"))[0]


@pytest.fixture(scope="module")
def pressed(folder):
    return load_path(folder)


def test_the_table_has_the_displacement_of_the_punch_and_the_force(folder, pressed):
    with (folder / "history.csv").open() as stream:
        assert next(csv.reader(stream)) == ["punch", *COLUMNS, *OF_OBSTACLES]
    run = load_run(folder)
    np.testing.assert_array_equal(run.history["punch"], [0.0, 0.3, 0.4, 0.5])
    force = np.asarray(jaxgel.obstacle_force(pressed))
    np.testing.assert_allclose(run.history["obstacle_force"], force[:, 1, 1], rtol=1e-12)
    np.testing.assert_allclose(force[:, 0], 0.0, atol=1e-15)
    assert force[0, 1, 1] == 0 and np.all(np.diff(force[:, 1, 1]) > 0)


@pytest.mark.slow
def test_a_killed_run_goes_on(folder, tmp_path):
    copy = tmp_path / "after-2"
    shutil.copytree(folder.with_name(copy.name), copy)
    assert cli.main(["resume", str(copy), "--quiet", "--no-plots"]) == 0
    whole, run = load_run(folder), load_run(copy)
    np.testing.assert_array_equal(run.value, whole.value)
    np.testing.assert_allclose(run.x, whole.x, atol=1e-9)  # Newton's method ends at its tolerance
    np.testing.assert_allclose(
        run.history["obstacle_force"], whole.history["obstacle_force"], rtol=1e-6
    )


def lowest(patch):
    """The lowest point of a patch, in the data of its axes."""
    points = patch.get_transform().transform(patch.get_path().vertices)
    return patch.axes.transData.inverted().transform(points)[:, 1].min()


def test_figures_have_the_obstacles_where_they_are_in_each_state(pressed, tmp_path):
    np.testing.assert_allclose(
        obstacle_displacement(pressed)[:, 1], np.outer(pressed.value, [0.0, -1.0])
    )
    np.testing.assert_array_equal(obstacle_displacement(pressed)[:, 0], 0.0)
    for k, axes in [
        (-1, plot_pattern(pressed)),
        (0, plot_pattern(pressed, 0)),
        *zip((0, 2), plot_patterns(pressed, at=[0.0, 0.4]), strict=True),
    ]:
        pin, wall = (patch for patch in axes.patches if patch.get_facecolor()[0] == 0.85)
        assert lowest(wall) == pytest.approx(1.3 - pressed.value[k])
        assert lowest(pin) == pytest.approx(8.0)
        marks = [
            part.get_offsets() for part in axes.collections if isinstance(part, PathCollection)
        ]
        # the punch has reached the top, which is within its range of the wall
        assert len(marks) == (k in (-1, 2))
        assert all(abs(part[:, 1].max() - (1.3 - pressed.value[k])) < 0.05 for part in marks)
    animate_pattern(pressed, tmp_path / "pressed.gif")
    labels = [axes.get_ylabel() for axes in plot_curves(pressed)[-2:, 0]]
    assert labels == ["force on obstacles (kT/v mm)", "open area beside obstacles per depth (mm)"]
    plt.close("all")


def test_paraview_files_have_the_obstacles_where_they_are_in_each_state(pressed, tmp_path):
    write_series(pressed, tmp_path)
    sets = ElementTree.parse(tmp_path / "obstacles.pvd").getroot().findall("Collection/DataSet")
    assert [float(entry.get("timestep")) for entry in sets] == pressed.value.tolist()
    assert len(
        ElementTree.parse(tmp_path / "contact.pvd").getroot().findall("Collection/DataSet")
    ) == len(pressed)
    pyvista = pytest.importorskip("pyvista")
    for entry, value in zip(sets, pressed.value, strict=True):
        mesh = pyvista.read(tmp_path / entry.get("file"))
        assert mesh.cell_data["obstacle"].tolist() == [0, 1]
        assert mesh.extract_cells([1]).bounds[2:4][0] == pytest.approx(1.3 - value)
    points, pressure = jaxgel.contact_pressure(pressed)
    mesh = pyvista.read(tmp_path / "vtu" / "contact-0003.vtu")
    np.testing.assert_allclose(mesh.points[:, :2], points, rtol=0, atol=1e-12)
    np.testing.assert_allclose(mesh.point_data["contact_pressure"], pressure, rtol=1e-12)
    assert pressure.max() > 0


def test_a_wrong_number_of_an_obstacle_ends_a_run_in_one_line(tmp_path, capsys):
    file = tmp_path / "case.toml"
    file.write_text(CASE.replace("obstacle = 1", "obstacle = 2"))
    assert cli.main(["run", str(file), "--quiet", "--out", str(tmp_path / "out")]) == 2
    assert (
        capsys.readouterr().err
        == "jaxgel: error: sweep.obstacle: 2 is not an obstacle, the plate has 2, numbered from 0\n"
    )


def test_an_obstacle_that_a_plate_does_not_have_is_refused(pressed):
    problem = jaxgel.Problem(
        pressed.model, jaxgel.Gel(1e-3, 0.1), control=jaxgel.Punch((0.0, -1.0), obstacle=2)
    )
    with pytest.raises(
        ValueError, match=r"^punch: obstacle 2 is not accepted, the plate has 2, numbered from 0$"
    ):
        jaxgel.sweep(problem, [0.0])
