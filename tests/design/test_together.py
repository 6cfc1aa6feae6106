"""Several searches at once, whose designs one compiled program evaluates."""

import dataclasses
import functools
import time
import tomllib

import jax
import numpy as np
import pytest
from studies import STUDY, changed

import jaxgel
from jaxgel.cases import OPTIMA, run_study, study_from_table
from jaxgel.continuation import devices_of
from jaxgel.design import Spread, Together, optimise, read_log
from jaxgel.design.search import Search

SEVERAL = changed(STUDY, ("evaluations = 4", "evaluations = 3\nstarts = 3"))


def study(*changes):
    return study_from_table(
        tomllib.loads(changed(SEVERAL, *changes) + "[output]\nfigures = false\n"), "small"
    )


@pytest.fixture
def doubling():
    """A `Together` that answers each design by its double; the batches that it was asked for."""
    made, batches = object.__new__(Together), []

    def answers(vectors):
        batches.append({key: vector.tolist() for key, vector in vectors.items()})
        return {key: (2 * vector, vector) for key, vector in vectors.items()}

    made._answers = answers
    return made, batches


def test_searches_wait_for_each_other_and_each_gets_its_own_answers(doubling):
    made, batches = doubling
    running = []

    def search(start, member):
        vector = np.array([float(start)])
        for _ in range(start):
            assert not running  # one search at a time
            running.append(start)
            time.sleep(0.005)
            running.clear()
            vector = member.values(vector)[0]
        return float(vector[0])

    searches = {start: functools.partial(search, start) for start in (1, 3, 2)}
    ended = list(made.run(searches))
    assert ended == [(1, 2.0), (2, 8.0), (3, 24.0)]
    assert batches[0] == {1: [1.0], 3: [3.0], 2: [2.0]} and batches[2:4] == [{3: [12.0]}, {}]


def test_parameters_are_arrays_of_jax_in_the_shapes_of_the_start():
    """A user's plate may set parts of them."""
    start = {"b": np.array([[1.0, 2.0]]), "a": 3.0}
    problem = dataclasses.replace(
        study().problem, start=start, bounds={"a": (0.0, 4.0), "b": (0.0, 10.0)}
    )
    found = problem.parameters(problem.vector)
    assert found["a"].shape == () and found["b"].at[0, 0].set(5.0).tolist() == [[5.0, 2.0]]
    assert jax.tree.map(float, {"a": found["a"], "b": found["b"][0, 1]}) == {"a": 3.0, "b": 2.0}


def test_an_error_of_one_search_ends_the_others(doubling):
    interrupted = []

    def other(member):
        try:
            while True:
                member.values(np.zeros(1))
        except KeyboardInterrupt:
            interrupted.append(True)

    def failing(member):
        member.values(np.zeros(1))
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        list(doubling[0].run({1: other, 2: failing, 3: other}))
    assert interrupted == [True, True]


def test_problems_that_no_program_evaluates_are_refused(tmp_path, refused):
    own = study().problem
    rows = [
        ({"sweep": dataclasses.replace(own.sweep, branch="symmetric")}, r"device: sweep\.branch"),
        ({"spread": Spread(lambda *given: given, np.zeros((2, 1)))}, "a problem with spread"),
        ({"reported": {"onset": None}}, "device: a problem with reported is for searches one by"),
    ]
    refused(
        lambda change: Together(dataclasses.replace(own, **change), None, devices_of("cpu")), rows
    )
    with pytest.raises(ValueError, match=r"^device: 'cpu' is for several searches at once; give"):
        run_study(study(("\nstarts = 3", "")), tmp_path, device="cpu")


@pytest.mark.slow
def test_the_program_has_the_values_and_gradients_of_the_host(tmp_path, monkeypatch):
    """Of all that the searches ask for; one starts where the shared cloud does not serve.

    An interruption loses nothing: the searches go on to the same numbers.
    """
    several = study(("lower = [2.1, 1.4]", "lower = [1.5, 1.4]"))
    starts = [(2.4, 1.6), (2.35, 1.62), (1.6, 1.5)]
    problems = [
        dataclasses.replace(several.problem, start={"semi_axes": np.array(start)})
        for start in starts
    ]
    cloud = several.problem.make_cloud(several.case.plate)
    together, by_host = Together(several.problem, cloud, devices_of("cpu")), []
    forward = Search._forward

    def counted(self, vector):
        if self.cloud is not cloud:
            by_host.append(self.name)
        return forward(self, vector)

    monkeypatch.setattr(Search, "_forward", counted)
    folders = [tmp_path / str(k) for k in range(3)]

    def searches(evaluations, resume):
        return {
            k: lambda member, k=k: optimise(
                problems[k],
                evaluations=evaluations,
                folder=folders[k],
                resume=resume,
                member=member,
            )
            for k in range(3)
        }

    first = dict(together.run(searches(2, False)))
    assert by_host == ["slsqp"] * 2
    designs = dict(together.run(searches(4, True)))
    assert by_host == ["slsqp"] * 4
    for k, folder in enumerate(folders):
        logged = read_log(folder)["evaluations"]
        assert len(designs[k].history) == len(logged) == 4
        assert [row["value"] for row in first[k].history] == [
            row["value"] for row in designs[k].history[:2]
        ]
        if k == 2:
            continue
        host = Search(problems[k], 4)
        host.cloud, host.unit = cloud, read_log(folder)["unit"]
        for entry in logged:
            assert entry["cloud"] == 0
            there = host.at(np.array(entry["vector"]))
            np.testing.assert_allclose(there.values, entry["values"], rtol=1e-9, atol=1e-11)
            for weights, row in entry["gradients"]:
                np.testing.assert_allclose(
                    host.gradients(there.entry, there.vector, weights), row, rtol=1e-7, atol=1e-9
                )


@pytest.mark.slow
def test_a_study_of_several_starts_has_its_table_whoever_evaluates_them(tmp_path):
    """Gels of one plate: all designs are on the same cloud. A symmetry that a start lacks, too."""
    gels = study(
        (
            'of = "semi_axes"\nlower = [2.1, 1.4]\nupper = [2.7, 1.8]',
            'of = "chi"\nlower = 0.0\nupper = 0.3',
        )
    )
    rows = []
    for name, device in (("host", None), ("device", "cpu")):
        design, _ = run_study(gels, tmp_path / name, device=device)
        lines = (tmp_path / name / OPTIMA).read_text().splitlines()
        rows.append([line.split(",") for line in lines])
        again = run_study(gels, tmp_path / name, device=device, resume=True)[0]
        assert again.value == design.value and design.outcome in jaxgel.design.Outcome
    heads, *pairs = zip(*rows, strict=True)
    assert heads[0] == heads[1] and len(pairs) == 3
    for one, other in pairs:
        for column, a, b in zip(heads[0], one, other, strict=True):
            if column in ("start", "outcome", "feasible", "evaluations", "reason"):
                assert a == b, column
            elif column != "seconds":
                np.testing.assert_allclose(float(a), float(b), rtol=1e-6, atol=1e-8, err_msg=column)
