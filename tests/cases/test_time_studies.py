"""Studies of swelling in time: objectives and constraints at times, times as objectives."""

import json
import re
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from studies import COARSE, changed, designed

import jaxgel
from jaxgel.cases import VERIFIED, load_case, study_from_table, study_runs
from jaxgel.cli import command_line as cli
from jaxgel.design import Design, Outcome

STUDY = (
    COARSE
    + """
[gel]
chi = 0.1
[sweep]
mu_start = -4.0
[time]
end = 0.5
first = 0.05
steps_per_decade = 4
[bath]
mu = -1.5
[[parameters]]
of = "radius"
lower = 0.8
upper = 1.3
[[objective]]
of = "surface_ratio"
target = 1.15
at_time = 0.4
[[objective]]
of = "surface_ratio"
goal = "minimise"
time_to = 1.12
[[constraints]]
of = "area_reduction"
above = -0.1
at_time = 0.2
[[constraints]]
of = "surface_ratio"
below = 0.5
time_to = 1.12
[search]
evaluations = 2
[verification]
spacing = 0.8
"""
)
NO_CONSTRAINTS = STUDY[STUDY.index("[[constraints]]") : STUDY.index("[search]")], ""
SMALL = changed(
    STUDY,
    NO_CONSTRAINTS,
    ("end = 0.5\nfirst = 0.05\nsteps_per_decade = 4", "times = [0.1, 0.3, 0.5]"),
)
"""The study without constraints, in three steps."""
TARGET = "target = 1.15\nat_time = 0.4\n"
GOAL = '[[objective]]\nof = "surface_ratio"\ngoal = "minimise"\ntime_to = 1.12\n'
AREA = "above = -0.1\nat_time = 0.2\n"
LIMIT = "below = 0.5\ntime_to = 1.12\n"


def study(*changes):
    """The study with some texts of its file replaced."""
    return study_from_table(tomllib.loads(changed(STUDY, *changes)), "small")


@pytest.fixture(scope="module")
def placed():
    """Problem of the study and a cloud of its start."""
    problem = study().problem
    return problem, problem.make_cloud(problem.plate(problem.start))


@pytest.mark.slow
def test_terms_are_the_quantity_at_a_time_and_the_time_at_which_it_reaches_a_value(placed):
    """As `at_time` and `time_to` give them, on the path of `swell` of the same plate."""
    problem, cloud = placed
    path = problem.path(problem.start, cloud)
    made = jaxgel.Problem(path.model, jaxgel.Gel(1e-3, 0.1), contact=False)
    times = jaxgel.TimeSteps(0.5, 0.05, 4)
    np.testing.assert_array_equal(path.x, jaxgel.swell(made, -1.5, times, start=-4.0).x)
    ratio = jaxgel.at_time(path, "surface_ratio", 0.4)
    reached = jaxgel.time_to(path, "surface_ratio", 1.12)
    assert 0 < reached < 0.5
    assert float(problem.objective(path)) == pytest.approx(float((ratio - 1.15) ** 2 + reached))
    assert problem.reported.keys() == {"time to surface_ratio = 1.12"}
    names = ["area_reduction >= -0.1 at t = 0.2", "time to surface_ratio = 1.12 <= 0.5"]
    assert [constraint.name for constraint in problem.constraints] == names
    rooms = [float(constraint.function(path)) for constraint in problem.constraints]
    area = jaxgel.at_time(path, "area_reduction", 0.2)
    assert rooms == pytest.approx([float(area) + 0.1, 0.5 - float(reached)])


@pytest.mark.slow
def test_the_gradient_of_terms_in_time_is_a_difference():
    """Central differences on a finer cloud, with steps that end before the next kink.

    Where a point enters a support the slope jumps: by 2e-4 of itself between -9e-5 and -5e-5.
    """
    problem = study(
        ("spacing = 0.8\nnodes_per_hole = 8", "spacing = 0.6666666666666666\nnodes_per_hole = 12")
    ).problem
    cloud = problem.make_cloud(problem.plate(problem.start))
    vector, step = jnp.asarray(problem.vector), 2.5e-5

    def objective(vector):
        return problem.objective(problem.path(problem.parameters(vector), cloud))

    slope = jax.grad(objective)(vector)
    difference = (objective(vector + step) - objective(vector - step)) / (2 * step)
    np.testing.assert_allclose(slope[0], difference, rtol=1e-6)


def test_a_verification_has_half_the_steps():
    """Of steps that grow and of a list of times."""
    assert study().problem.refined == jaxgel.TimeSteps(0.5, 0.025, 8)
    steps = "end = 0.5\nfirst = 0.05\nsteps_per_decade = 4"
    listed = study((steps, "times = [0.1, 0.5]")).problem
    assert listed.refined == pytest.approx([0.05, 0.1, 0.3, 0.5])


@pytest.mark.slow
def test_a_design_is_written_as_a_case_that_run_accepts_and_verified(tmp_path):
    """Here the start; the search before it is that of the slow test.

    And of tests/cases/test_field_studies.py without time.
    """
    made = study_from_table(tomllib.loads(SMALL + "[output]\nfigures = false\n"), "small")
    design = Design(made.problem.start, 1.0, {}, True, Outcome.EXHAUSTED, [{"value": 1.0}])
    verified = study_runs._verified(made, design, tmp_path)
    assert json.loads((tmp_path / VERIFIED).read_text()) == json.loads(json.dumps(verified))
    assert (
        verified["best"] == verified["start"]
        and verified["best"]["reported"]["time to surface_ratio = 1.12"] > 0
    )
    check_case(tmp_path, made, verified)


def check_case(folder, made, verified):
    """The best design is a case with its study's times and baths and the verified radius."""
    case = load_case(folder / "best.toml")
    assert case.time == made.case.time and case.baths() == made.case.baths()
    assert case.plate.holes[0].radius == pytest.approx(verified["parameters"]["radius"], rel=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize(("text", "interrupted"), [(SMALL, False), (STUDY, False), (STUDY, True)])
def test_the_command_leaves_a_valid_design_that_run_accepts(text, interrupted, tmp_path):
    """Of the study, at once or interrupted and resumed."""
    folder = designed(text, tmp_path, interrupted=interrupted, sweep=2)
    assert {file.name for file in folder.iterdir()} == {
        "design.json",
        "best.toml",
        VERIFIED,
        "design.png",
    }
    verified = json.loads((folder / VERIFIED).read_text())
    assert verified["best"]["valid"] and verified["best"]["value"] <= verified["start"]["value"]
    assert verified["best"]["reported"]["time to surface_ratio = 1.12"] > 0
    check_case(folder, study_from_table(tomllib.loads(text), "small"), verified)


@pytest.mark.slow
def test_a_design_that_does_not_reach_the_value_is_not_valid(tmp_path, capsys):
    """With the values that it has."""
    (tmp_path / "small.toml").write_text(STUDY.replace("time_to = 1.12", "time_to = 9.0"))
    assert cli.main(["design", str(tmp_path / "small.toml"), "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert (
        "start: the first design is not valid: surface_ratio does not reach 9 until t = 0.5, its"
        in line
    )


REFUSED = [
    ((TARGET, "target = 1.15\n"), "objective[0]: at_time is missing; give the time at which"),
    (
        (TARGET, TARGET + "time_to = 1.0\n"),
        "objective[0]: give one of at_time and time_to, not both",
    ),
    (
        (TARGET, "target = 1.15\nat = -1.5\n"),
        "objective[0].at: does not go with [time]; give at_time or time_to",
    ),
    ((TARGET, "curve = [1.15]\n"), "objective[0].curve: does not go with [time]"),
    ((TARGET, "line = { slope = 1.0, mu0 = 1.0 }\n"), "objective[0].line: does not go with [time]"),
    ((TARGET, TARGET + "from = 0.1\n"), "objective[0].from: does not go with [time]"),
    (
        (TARGET, "target = 1.15\nat_time = 0.6\n"),
        "objective[0].at_time: 0.6 is not in the run, 0 ... 0.5",
    ),
    (
        (TARGET, "target = 1.15\nat_time = -0.1\n"),
        "objective[0].at_time: -0.1 is not a finite number of at least 0",
    ),
    (
        (GOAL, '[[objective]]\nof = "fold_up"\ntarget = 1.0\n'),
        "objective[1].of: 'fold_up' is for equilibria",
    ),
    (
        ('of = "area_reduction"', 'of = "lowest_eigenvalue"'),
        "constraints[0].of: 'lowest_eigenvalue' is for equilibria",
    ),
    (
        (GOAL, '[[objective]]\nof = "free_edge"\noutline = [[0, 0], [1, 1]]\ntime_to = 1.0\n'),
        "objective[1].time_to: does not go with 'free_edge'; remove it",
    ),
    ((LIMIT, "below = 0.5\nat = -1.5\n"), "constraints[1].at: does not go with [time]"),
    ((LIMIT, "below = 0.5\nat_time = 3.0\n"), "constraints[1].at_time: 3 is not in the run"),
    (
        ('of = "area_reduction"', 'of = "hole_area"'),
        "constraints[0].at_time: does not go with 'hole_area'; remove it",
    ),
    (
        (TARGET, TARGET + "hole = 0\n"),
        "objective[0].hole: does not go with 'surface_ratio'; remove it",
    ),
    ((AREA, AREA + "hole = 1\n"), "constraints[0].hole: 1 is not the number of a hole, 0 to 0"),
    (("[verification]", "[verification]\nmu = [-1.0]"), "verification.mu: does not go with [time]"),
    (
        ("[time]\nend = 0.5\nfirst = 0.05\nsteps_per_decade = 4\n[bath]\nmu = -1.5\n", ""),
        "objective[0].at_time: goes with swelling in time",
    ),
]


def test_wrong_entries_are_refused_in_one_line(refused):
    refused(lambda change: study(change), REFUSED, literal=True)


def test_the_study_of_the_documentation_is_one():
    """The second TOML text of the page; its case is built in, and its times are the study's own."""
    page = (Path(__file__).parents[2] / "docs" / "howto" / "time.md").read_text(encoding="utf-8")
    text = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)[1]
    problem = study_from_table(tomllib.loads(text), "page").problem
    assert problem.time.values == jaxgel.TimeSteps(0.5, 1e-3, 5) and problem.mu == [-4.9678]
    assert problem.baths == {hole: jaxgel.Bath(-0.9678) for hole in range(4)}
