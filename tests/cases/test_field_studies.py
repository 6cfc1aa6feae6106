"""Studies of fields of the gel: gradients through the filter, files, refusals.

Files of a search; wrong entries are refused in one line.
"""

import dataclasses
import json
import re
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image
from studies import STUDY, changed, designed

from jaxgel.cases import VERIFIED, load_case, load_map, load_study, study_from_table
from jaxgel.cli import command_line as cli
from jaxgel.cli.taylor_test import check_gradient
from jaxgel.design import filtered, read_log

ENTRY = "pixels = [9, 9]\nfilter = 1.5\nlower = 5e-4\nupper = 5e-3\n"
CONSTRAINT = 'of = "hole_area"\nabove = 10.0', 'of = "Nv_mean"\nabove = 1e-3'
SMALL = (
    changed(STUDY, CONSTRAINT, ("evaluations = 4", 'evaluations = 3\nmethod = "lbfgs"'))
    + f'[[parameters]]\nof = "Nv_field"\n{ENTRY}'
)


def field(entry):
    """The small study with other lines of its field."""
    return changed(SMALL, (ENTRY, entry))


@pytest.mark.slow
@pytest.mark.parametrize(
    "entry",
    [
        ENTRY,
        ENTRY + "with_holes = true\n",
        "modes = [3, 4]\nfilter = 2.0\nlower = 5e-4\nupper = 5e-3\n",
        'pixels = [9, 9]\nlower = 0.05\nupper = 0.6\nstart = 0.2\nname = "chi"\n',
    ],
    ids=["pixels", "moving pixels", "filtered modes", "chi"],
)
def test_the_remainder_of_the_objective_falls_as_the_square_of_the_step(entry):
    """Along pixels and semi-axes together.

    Each of them is tested below and in tests/mechanics/test_local_gel.py.
    """
    text = field(entry)
    problem = study_from_table(
        tomllib.loads(text.replace("Nv_field", "chi_field") if '"chi"' in entry else text), "field"
    ).problem
    cloud = problem.make_cloud(problem.plate(problem.start))
    random = np.random.default_rng(11)
    start = np.clip(problem.vector + random.uniform(0.1, 0.2, problem.vector.shape), 0.05, 0.95)
    towards = random.normal(size=start.shape) / np.sqrt(len(start))
    # semi-axes, the last by name, along which the plate's own weights have kinks
    towards[-2:] *= 0.1

    def objective(vector):
        return problem.objective(problem.path(problem.parameters(vector), cloud))

    value, slope = jax.value_and_grad(objective)(jnp.asarray(start))
    # a coefficient does more than a pixel
    steps = (0.005 if "modes" in entry else 0.04) * 0.5 ** np.arange(4)
    remainders = [
        abs(float(objective(start + h * towards) - value - h * slope @ towards)) for h in steps
    ]
    rates = np.log2(np.divide(remainders[:-1], remainders[1:]))
    assert np.median(rates) > 1.95 and remainders[-1] > 1e-11  # above the states' 1e-12


@pytest.mark.slow
def test_a_field_at_its_symmetric_start_has_the_slope_of_differences():
    """States of a symmetric plate are found on a quarter of it.

    The slope by one pixel is that of the whole plate.
    """
    table = tomllib.loads(SMALL) | {
        "holes": [dict(kind="circle", centre=[0.0, 0.0], radius=2.0)],
        "constraints": [],
    }
    table["plate"] = dict(width=8.0, height=8.0)
    table["parameters"] = table["parameters"][1:]
    problem = study_from_table(table, "symmetric").problem
    cloud, step = problem.make_cloud(problem.plate({})), np.zeros((9, 9))
    step[1, 2] = 2e-6

    def objective(pixels):
        return problem.objective(problem.path({"Nv_field": pixels}, cloud))

    start = problem.start["Nv_field"]
    slope = jnp.sum(jax.grad(objective)(start) * step)
    # of 1e-7, of states to 1e-12
    np.testing.assert_allclose(
        slope, (objective(start + step) - objective(start - step)) / 2, rtol=1e-5
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of ``jaxgel design`` of the small study, interrupted in its third sweep, resumed."""
    return designed(SMALL, tmp_path_factory.mktemp("field"), interrupted=True)


@pytest.mark.slow
def test_the_folder_keeps_the_field_and_its_best_design_is_a_case(folder):
    assert {file.name for file in folder.iterdir()} == {
        "design.json",
        "best.toml",
        VERIFIED,
        "design.png",
        "Nv.png",
    }
    verified = json.loads((folder / VERIFIED).read_text())
    assert verified["best"]["valid"] and verified["best"]["value"] > verified["start"]["value"]
    assert list(verified["parameters"]) == ["semi_axes"] and verified["search"]["evaluations"] == 3
    assert -1e-7 < verified["best"]["constraints"]["Nv_mean >= 0.001"] < 5e-4

    log, study = read_log(folder), load_study(folder.parent / "small.toml")
    best = min(
        log["evaluations"],
        key=lambda entry: entry["values"][0] if min(entry["values"][1:]) > -1e-4 else np.inf,
    )
    raw = study.problem.parameters(np.array(best["vector"]))["Nv_field"]
    case = load_case(folder / "best.toml")
    assert case.plate.edges["top"] == "free" and case.sweep.mu == (-3.0, -1.8)
    np.testing.assert_allclose(
        case.plate.holes[0].semi_axes, verified["parameters"]["semi_axes"], rtol=1e-15
    )
    found = case.gel.Nv.values
    np.testing.assert_allclose(found, filtered(raw, (8.0, 8.0), 1.5), rtol=1e-12)
    assert found.min() >= 5e-4 and found.max() <= 5e-3 and np.ptp(found) > 1e-4
    grey = np.asarray(Image.open(folder / "Nv.png"))
    np.testing.assert_allclose(5e-4 + 4.5e-3 * grey / 255, found, atol=0.51 * 4.5e-3 / 255)


@pytest.mark.slow
def test_the_best_design_runs_and_the_gradients_of_its_field_are_true(folder, tmp_path):
    """By the pixels, and by the holes that move under them.

    On the plate of the start, which has no kinks of its own nearby.
    """
    assert (
        cli.main(
            [
                "run",
                str(folder / "best.toml"),
                "--out",
                str(tmp_path / "run"),
                "--quiet",
                "--no-plots",
            ]
        )
        == 0
    )
    found, start = load_case(folder / "best.toml"), load_study(folder.parent / "small.toml").case
    assert all(row.ok for row in check_gradient(dataclasses.replace(found, plate=start.plate)))


def test_a_start_may_be_a_picture_and_several_starts_fields(tmp_path):
    picture = np.random.default_rng(11).integers(0, 256, (9, 9)).astype(np.uint8)
    Image.fromarray(picture).save(tmp_path / "start.png")
    text = field(ENTRY + 'start = { file = "start.png", low = 1e-3, high = 2e-3 }\n').replace(
        "[search]", "[search]\nstarts = 2"
    )
    (tmp_path / "study.toml").write_text(text)
    study = load_study(tmp_path / "study.toml")
    np.testing.assert_allclose(
        study.problem.start["Nv_field"], 1e-3 + 1e-3 * picture / 255, rtol=1e-14
    )
    (tmp_path / "start.png").unlink()
    # the log needs no other file
    again = study_from_table(json.loads(json.dumps(study.table)), "again")
    np.testing.assert_array_equal(again.problem.start["Nv_field"], study.problem.start["Nv_field"])


def test_wrong_entries_are_refused(tmp_path, refused):
    Image.new("RGB", (9, 9)).save(tmp_path / "colour.png")
    Image.new("L", (3, 3)).save(tmp_path / "small.png")

    def load(entry):
        (tmp_path / "small.toml").write_text(field(entry + "\n"))
        load_study(tmp_path / "small.toml")

    refused(
        load,
        [
            (
                ENTRY + "start = [[1e-3, 2e-3]]",
                "start: [[0.001, 0.002]] is not a finite number, or 9 x 9 of them",
            ),
            (
                ENTRY + "start = [[1e-3, 2e-3], [1e-3]]",
                "start: [[0.001, 0.002], [0.001]] is not a finite number, or 9 x 9 of them",
            ),
            (
                ENTRY + "start = 6e-3",
                "start: 0.006 is not between lower = 0.0005 and upper = 0.005",
            ),
            (
                ENTRY + 'start = { file = "colour.png", low = 1e-3, high = 2e-3 }',
                "colour.png' is a picture of mode RGB, it must be black and",
            ),
            (
                ENTRY + 'start = { file = "small.png", low = 1e-3, high = 2e-3 }',
                "0.001]] is not a finite number, or 9 x 9 of them",
            ),
            (
                ENTRY + 'start = { file = "none.png", low = 1e-3, high = 2e-3 }',
                "none.png' cannot be read as a picture: ",
            ),
            (
                ENTRY + "filtre = 2.0",
                "parameters[1]: unknown entry 'filtre'; did you mean 'filter'?",
            ),
            (ENTRY + 'link = "turned"', "parameters[1]: unknown entry 'link'"),
            (ENTRY + "modes = [2, 2]", "parameters[1]: give one of pixels and modes"),
            (
                "lower = 5e-4\nupper = 5e-3\n",
                "parameters[1]: give one of pixels and modes (found none)",
            ),
            (
                ENTRY.replace("1.5", "-1.5"),
                "parameters[1].filter: -1.5 is not a finite number of at least 0",
            ),
            (ENTRY.replace("1.5", "true"), "parameters[1].filter: True is not a finite number"),
            (
                ENTRY.replace("lower = 5e-4", "lower = 6e-3"),
                "parameters[1].upper: 0.005 is not above lower = 0.006",
            ),
            (
                ENTRY.replace("lower = 5e-4", "lower = 0.0"),
                "parameters[1].lower: 0 is not accepted, it must be a finite number > 0",
            ),
            (
                ENTRY.replace("[9, 9]", "[9, 20]"),
                "parameters[1].pixels: a picture of 20 x 9 pixels does not cover a plate of 8 x 8",
            ),
            (
                ENTRY.replace("[9, 9]", "[9]"),
                "parameters[1].pixels: [9] is not a list of 2 whole numbers",
            ),
            (
                ENTRY.replace("[9, 9]", "[0, 9]"),
                "parameters[1].pixels[0]: 0 is not a whole number of at least 1",
            ),
            (
                ENTRY.replace("[9, 9]", "[40, 40]").replace("1.5", "0.5"),
                "parameters[1].filter: 0.5 leaves pixels of 0.2 mm, finer than",
            ),
            (
                "modes = [2, 99]\nlower = 5e-4\nupper = 5e-3\n",
                "parameters[1].modes: [2, 99] is more than the 40 x 40 pixels",
            ),
            (
                ENTRY + '[[parameters]]\nof = "Nv"\nlower = 5e-4\nupper = 5e-3\n',
                "parameters: Nv is varied twice; keep one of the two",
            ),
        ],
        literal=True,
    )


def test_a_map_refuses_a_field(tmp_path):
    (tmp_path / "map.toml").write_text(
        'case = "square"\n[[parameters]]\nof = "Nv_field"\npixels = [4, 4]\nlower = 1e-3\n'
        "upper = 2e-3\n"
    )
    with pytest.raises(
        ValueError,
        match=re.escape(
            "parameters[0].of: 'Nv_field' is not accepted in a map, which varies numbers"
        ),
    ):
        load_map(tmp_path / "map.toml")
