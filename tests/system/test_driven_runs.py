"""A run with another control than mu that turns back: files, figures, page, resumption.

They speak of the control, and it resumes to the bit.
"""

import csv
import json
import shutil
from xml.etree import ElementTree

import matplotlib.pyplot as plt
import numpy as np
import pytest
from studies import TINY, killed

from jaxgel.cases import load_path
from jaxgel.cases.page import page
from jaxgel.cli import command_line as cli
from jaxgel.equilibrium import State
from jaxgel.io import Progress, export, load_run, swollen_gel, write_outline, write_series
from jaxgel.observables import COLUMNS, events, history
from jaxgel.plotting import plot_curve, plot_curves, plot_pattern, plot_patterns

pytestmark = pytest.mark.thorough

CASE = (
    TINY
    + """
[gel]
Nv = 1e-3
chi = 0.1
[sweep]
control = "chi"
from = 0.5
to = 0.3
back = true
steps = "auto"
at_mu = -2.0
"""
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of the whole run, next to it those of the same run killed after k states."""
    return killed(CASE, tmp_path_factory.mktemp("driven"))[0]


@pytest.fixture(scope="module")
def turned(folder):
    return load_path(folder)


def test_the_files_speak_of_the_control(folder):
    run = load_run(folder)
    with (folder / "history.csv").open() as stream:
        assert next(csv.reader(stream)) == ["chi", *COLUMNS]
    assert (
        run.summary["control"] == {"name": "chi", "unit": ""}
        and run.summary["value_reached"] == 0.5
    )
    np.testing.assert_array_equal(run.states["value"], run.history["chi"])
    np.testing.assert_array_equal(run.states["mu"], -2.0)
    assert (run.value[0], run.value.min(), run.value[-1]) == (0.5, 0.3, 0.5)


def test_the_way_back_has_the_states_of_the_way_there(turned):
    """Without a fold: both ends have equal states on both ways, to Newton's tolerance."""
    np.testing.assert_allclose(turned.x[-1], turned.x[0], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    "states", ["middle", *(pytest.param(k, marks=pytest.mark.slow) for k in (1, "all but one"))]
)
def test_a_killed_run_goes_on_from_its_last_state_by_way_of_the_turning_point(
    states, folder, tmp_path
):
    whole = load_run(folder)
    count = len(whole.mu)
    k = {"middle": count // 2 + 1, "all but one": count - 1}.get(states, states)
    copy = tmp_path / f"after-{k}"
    shutil.copytree(folder.with_name(copy.name), copy)
    assert cli.main(["resume", str(copy), "--quiet", "--no-plots"]) == 0
    run = load_run(copy)
    np.testing.assert_array_equal(run.x[:k], whole.x[:k])
    assert (run.value[0], run.value.min(), run.value[-1]) == (0.5, 0.3, 0.5)
    for value in (0.3, 0.5):
        x, expected = (r.x[np.flatnonzero(r.value == value)[-1]] for r in (run, whole))
        np.testing.assert_allclose(x, expected, atol=1e-9)


def test_a_run_of_another_control_is_refused_in_one_line(folder, tmp_path, capsys):
    other = tmp_path / "other"
    shutil.copytree(folder, other)
    summary = json.loads((other / "summary.json").read_text())
    summary["options"]["sweep"] = {"control": "stretch", "from": 1.0, "to": 1.1}
    (other / "summary.json").write_text(json.dumps(summary))
    assert cli.main(["resume", str(other), "--quiet"]) == 2
    assert "the control of the run in" in capsys.readouterr().err


@pytest.mark.slow
def test_time_in_paraview_increases_and_the_control_is_a_field(turned, tmp_path):
    write_series(turned, tmp_path)
    sets = ElementTree.parse(tmp_path / "series.pvd").getroot().findall("Collection/DataSet")
    assert [float(entry.get("timestep")) for entry in sets] == [
        float(k) for k in range(len(turned))
    ]
    pyvista = pytest.importorskip("pyvista")
    assert [
        float(pyvista.read(tmp_path / entry.get("file")).cell_data["chi"][0]) for entry in sets
    ] == turned.value.tolist()


def test_netcdf_has_the_control_as_a_coordinate(folder, tmp_path):
    xarray = pytest.importorskip("xarray")
    with xarray.open_dataset(export(folder, tmp_path / "run.nc"), engine="h5netcdf") as found:
        assert {"chi", "mu"} <= set(found.coords) and found["chi"].attrs["units"] == "1"
        np.testing.assert_array_equal(found["chi"], load_run(folder).value)


@pytest.mark.slow
def test_figures_and_page_name_the_control_and_show_both_ways(turned):
    axes = plot_curves(turned)
    assert axes[-1, 0].get_xlabel() == r"Flory's parameter $\chi$"
    labels = [
        text.get_text() for legend in axes[0, 0].figure.legends for text in legend.get_texts()
    ]
    assert labels == ["control falls", "control rises"]
    markers = [
        line.get_marker()
        for line in plot_curve(turned, "area_reduction").lines
        if line.get_linestyle() == "-"
    ]
    assert markers == ["<", ">"]
    assert plot_pattern(turned, 0).get_title() == r"Flory's parameter $\chi$ = 0.5000"
    # evenly spaced along the way, there and back
    assert [ax.get_title()[-6:] for ax in plot_patterns(turned)][-1] == "0.5000"
    plt.close("all")
    data = json.loads(page(turned).split('id="data">')[1].split("</script>")[0])
    assert (
        data["control"] == {"label": "Flory's parameter χ", "unit": ""}
        and data["value"] == turned.value.tolist()
    )


@pytest.mark.slow
def test_events_say_where_the_control_was_and_which_way_it_went(turned):
    table = history(turned)
    pivots = np.zeros(len(turned), dtype=int)
    pivots[-1] = 1
    (event,) = events(table | {"negative_pivots": pivots})
    assert (event["state"], event["chi"], event["chi_before"]) == (
        len(turned) - 1,
        0.5,
        turned.value[-2],
    )
    assert event["text"].endswith(f"between chi = {turned.value[-2]:.4f} and 0.5000")


def test_an_outline_is_that_at_a_value_of_the_control(folder, tmp_path):
    assert (
        cli.main(
            [
                "outline",
                str(folder),
                "--at",
                "0.31",
                "--format",
                "svg",
                "--out",
                str(tmp_path / "gel.svg"),
            ]
        )
        == 0
    )
    turning = int(load_run(folder).value.argmin())
    write_outline(swollen_gel(load_path(folder), turning), tmp_path / "turning.svg")
    assert (tmp_path / "gel.svg").read_bytes() == (tmp_path / "turning.svg").read_bytes()


def test_progress_goes_on_where_the_control_turns():
    with Progress(
        [25.0, 40.0, 25.0], quiet=True, name="temperature", unit="°C", done=[25.0, 40.0]
    ) as progress:
        progress.show(State(30.0, 0.0, np.zeros((1, 2)), np.zeros(1)))
        assert progress.way == 25.0 and progress.bar.total == 30.0
