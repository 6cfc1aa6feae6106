"""Standard deviations of numbers from those of their inputs: closed forms, cases, samples."""

import csv
import json

import numpy as np
import pytest

import jaxgel
from jaxgel.cases import (
    from_table,
    sampled_deviations,
    uncertain_inputs,
    uncertain_samples,
    uncertainty_of,
)
from jaxgel.cases.as_made import as_made

HOLE = {"kind": "ellipse", "centre": [0.15, -0.1], "semi_axes": [1.2, 0.8], "angle_deg": 20.0}
TABLE = {
    "plate": {"width": 4.0, "height": 4.0, "spacing": 0.6, "nodes_per_hole": 8, "core": [1.6, 1.5]},
    "holes": [HOLE],
    "sweep": {"mu": [-4.0, -3.0, -2.0], "contact": "off"},
}


@pytest.fixture(scope="module")
def case():
    """A plate with one tilted ellipse and three uncertain inputs."""
    return from_table(
        TABLE | {"uncertainty": {"Nv": "5 %", "semi_axes": 0.01, "holes[0].angle_deg": 1.0}},
        "tilted",
    )


@pytest.fixture(scope="module")
def found(case):
    """Its standard deviations to first order."""
    return uncertainty_of(case, uncertain_inputs(case), ["core_rotation", "area_reduction"])


def test_linear_functions_have_the_exact_deviation():
    """The variance of a . x + b is the sum of (a s)^2, and shares follow."""
    a, s = np.array([1.0, -2.0, 0.0]), np.array([0.3, 0.2, 5.0])
    found = jaxgel.uncertainty(
        lambda v: {"sum": a @ v["x"] + 3.0, "none": 0.0 * v["x"][0]}, {"x": np.ones(3)}, {"x": s}
    )
    assert found.deviations == pytest.approx([0.5, 0.0]) and found.values == pytest.approx(
        [2.0, 0.0]
    )
    assert found.inputs == ("x_0", "x_1", "x_2") and found.ranked("none") == []
    assert found.ranked("sum") == [("x_1", pytest.approx(0.64)), ("x_0", pytest.approx(0.36))]


def test_inputs_without_a_deviation_are_refused(refused):
    """Every input has one, finite and not negative."""
    rows = [
        ({"b": 1.0}, "deviations: .*'b'.* for the inputs .*'a'"),
        ({"a": -1.0}, "deviations: -1.0 of a is not"),
        ({"a": np.nan}, "deviations: nan of a"),
    ]
    refused(lambda deviations: jaxgel.uncertainty(lambda v: v, {"a": 1.0}, deviations), rows)


def test_entries_name_components_and_shares(case):
    """A share is one of the input's value; a hole parameter has a component for each."""
    inputs = {one.parameter["name"]: one for one in uncertain_inputs(case)}
    assert set(inputs) == {"Nv", "holes[0].semi_axes", "holes[0].angle_deg"}
    assert inputs["Nv"].deviation == pytest.approx(5e-5) and inputs[
        "holes[0].semi_axes"
    ].deviation == pytest.approx([0.01, 0.01])
    assert case.table()["uncertainty"] == {
        "Nv": "5 %",
        "semi_axes": 0.01,
        "holes[0].angle_deg": 1.0,
    }
    assert from_table(case.table(), "again").uncertainty == case.uncertainty


def test_wrong_entries_are_refused(case, refused):
    """One line with the entry, its value and what is accepted."""
    rows = [
        ({}, "uncertainty: is missing"),
        ({"Nw": 0.1}, "uncertainty.Nw.of: 'Nw' is unknown; did you mean 'Nv'"),
        (
            {"holes[3].semi_axes": 0.1},
            r"uncertainty: 'holes\[3\].semi_axes' is unknown; did you mean 'holes\[0\].semi_axes'",
        ),
        ({"Nv": "much"}, "uncertainty.Nv: 'much' is not a positive number, nor a share as '5 %'"),
        ({"Nv": "-5 %"}, "uncertainty.Nv: '-5 %' is not a positive number"),
        ({"chi": 0.0}, "uncertainty.chi: 0.0 is not a positive number"),
        (
            {"semi_axes": 0.1, "holes[0].semi_axes": 0.1},
            r"uncertainty: holes\[0\].semi_axes is given twice",
        ),
    ]
    refused(lambda entries: uncertain_inputs(case, entries), rows)
    with pytest.raises(ValueError, match="quantities: 'turn' is unknown"):
        uncertainty_of(case, uncertain_inputs(case), ["turn"])


@pytest.mark.slow
def test_slopes_are_differences_of_sweeps(case, found):
    """Every derivative beside a central difference of the whole case."""
    steps = {
        "Nv": 1e-6,
        "holes[0].angle_deg": 1e-3,
        "holes[0].semi_axes_0": 1e-5,
        "holes[0].semi_axes_1": 1e-5,
    }
    assert set(steps) == set(found.inputs)

    def swept(name, step):
        table = json.loads(json.dumps(TABLE))
        hole = table["holes"][0]
        if name == "Nv":
            table["gel"] = {"Nv": 1e-3 + step}
        elif name.endswith("deg"):
            hole["angle_deg"] += step
        else:
            hole["semi_axes"][int(name[-1])] += step
        moved = from_table(table, "moved")
        own = from_table(TABLE, "own")
        model = own.discretisation.model(
            own.cloud().at(own.plate.at([h.theta for h in moved.plate.holes]))
        )
        path = moved.path(model)
        return np.array([jaxgel.core_rotation(path)[-1], jaxgel.area_reduction(path)[-1]])

    for i, name in enumerate(found.inputs):
        difference = (swept(name, steps[name]) - swept(name, -steps[name])) / (2 * steps[name])
        np.testing.assert_allclose(found.slopes[:, i], difference, rtol=1e-4, atol=1e-7)


def test_samples_are_normal_and_reproduce_the_inputs(case):
    """Sobol samples have the means and deviations of the inputs.

    The same seed gives the same samples.
    """
    inputs = uncertain_inputs(case)
    study = uncertain_samples(case, inputs, 256)
    axes = np.array([point["holes[0].semi_axes"] for point in study.points])
    np.testing.assert_allclose(axes.mean(axis=0), [1.2, 0.8], atol=2e-4)
    np.testing.assert_allclose(axes.std(axis=0), 0.01, rtol=0.02)
    assert study.points == uncertain_samples(case, inputs, 256).points
    plate = study.at(study.points[0]).plate
    np.testing.assert_allclose(plate.holes[0].theta["semi_axes"], axes[0])


def test_deviations_of_samples_leave_out_what_did_not_end():
    """Rows that failed have no value."""
    rows = [
        {"status": "complete", "r": 1.0},
        {"status": "complete", "r": 3.0},
        {"status": "failed", "r": None},
    ]
    assert sampled_deviations(rows, {"r": "r"}) == {"r": (2.0, pytest.approx(2**0.5), 2)}


@pytest.mark.slow
def test_command_writes_table_figure_and_samples(tmp_path, capsys):
    """The deviations on the terminal are those of the files; samples are beside them."""
    file = tmp_path / "tilted.toml"
    file.write_text(
        "[plate]\nwidth = 4.0\nheight = 4.0\nspacing = 0.6\nnodes_per_hole = 8\n"
        "core = [1.6, 1.5]\n[[holes]]\nkind = 'ellipse'\ncentre = [0.15, -0.1]\n"
        "semi_axes = [1.2, 0.8]\nangle_deg = 20.0\n[sweep]\nmu = [-4.0, -3.0]\n[uncertainty]\n"
        "Nv = '5 %'\n"
    )
    arguments = [
        "uncertainty",
        str(file),
        "--quantities",
        "core_rotation",
        "--samples",
        "2",
        "--workers",
        "1",
        "--out",
        str(tmp_path / "out"),
    ]
    assert jaxgel.cli.main(arguments) == 0
    printed = capsys.readouterr().out
    rows = list(csv.DictReader((tmp_path / "out" / "uncertainty.csv").read_text().splitlines()))
    record = json.loads((tmp_path / "out" / "uncertainty.json").read_text())["quantities"][
        "core_rotation"
    ]
    assert [row["input"] for row in rows] == ["Nv"] and abs(
        float(rows[0]["contribution"])
    ) == pytest.approx(record["deviation"])
    assert (
        f"{record['value']:.5g} +- {record['deviation']:.2g} degree" in printed
        and "over 2 samples" in printed
    )
    assert (tmp_path / "out" / "contributions.png").stat().st_size > 5_000
    assert (
        jaxgel.cli.main([*arguments[:4], "--uncertain", "Nv:5", "--out", str(tmp_path / "out")])
        == 2
    )
    assert "uncertain: 'Nv:5' is not of the form NAME=DEVIATION" in capsys.readouterr().err


@pytest.mark.slow
def test_a_design_as_made_scatters_as_first_order_says(case, found):
    """Mean and deviation of an objective over samples of the design's inputs.

    Samples that are refused are counted.
    """
    start, bounds = {"semi_axes": np.array([1.2, 0.8])}, {"semi_axes": (0.5, 1.5)}
    problem = jaxgel.DesignProblem(
        plate=lambda v: case.plate.at(
            [{"centre": (0.15, -0.1), "semi_axes": v["semi_axes"], "angle": np.deg2rad(20.0)}]
        ),
        start=start,
        bounds=bounds,
        objective=jaxgel.value_at(jaxgel.area_reduction, -2.0),
        gel=case.gel,
        mu=[-4.0, -3.0, -2.0],
    )
    made = as_made(problem, case, case.uncertainty, 16)
    k = found.names.index("area_reduction")
    assert made["samples"] == 16 and made["invalid"] == 0 and made["reason"] == ""
    assert made["mean"] == pytest.approx(found.values[k], rel=1e-3)
    # of 16 normal samples the deviation itself scatters by 18 %
    assert made["deviation"] == pytest.approx(found.deviations[k], rel=0.3)
    assert made["worst"] == pytest.approx(found.values[k], abs=4 * found.deviations[k])
    none = as_made(problem, case, {"Nv": 1.0}, 2)
    assert none["invalid"] >= 1 and none["mean"] is None and "Nv" in none["reason"]


def test_a_run_refuses_an_input_that_does_not_exist(tmp_path, capsys):
    """Before it computes: the same line as that of the command that uses the section."""
    (tmp_path / "case.toml").write_text(
        'plate = { sample = "sample-1" }\nuncertainty = { Nw = 0.1 }\n'
    )
    assert (
        jaxgel.cli.main(["run", str(tmp_path / "case.toml"), "--out", str(tmp_path / "out")]) == 2
    )
    assert (
        "uncertainty.Nw.of: 'Nw' is unknown; did you mean 'Nv'" in capsys.readouterr().err
        and not (tmp_path / "out").exists()
    )
