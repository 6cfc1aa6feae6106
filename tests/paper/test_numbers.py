"""Every number of the paper's report follows from the item's CSV file: found there, or computed from it once more, to the digits shown.

The items are small: fixed errors and times in place of the square's, and one coarse path of sample 1 in place of all others. With
``JAXGEL_REPORT`` set to the folder of a whole ``jaxgel paper`` the same is asked of that.
"""

import csv
import itertools
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxgel
from jaxgel.observables import CREASE_RATIO
from jaxgel.paper import CLOSING, FINITE_ELEMENTS, Runs, crossing
from jaxgel.paper import areas as paper_areas
from jaxgel.paper import curves as paper_curves
from jaxgel.paper import runs as paper
from jaxgel.paper import square as paper_square

NUMBER = re.compile(r"(?<![\w.^])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w^])")
NAMES = re.compile(  # numbers that name something
    r"[Ss]amples? \d(?:-\d|(?:, \d)*(?: and \d)?)|Figs?\. \d+|penalty(?: factor)? 1e\d|\b1e\d:|\(1, z\)|\(1, 1\)|Eq\. \(59\)|\d+ pi mm\^2"
)
ITEMS = ("fig-2", "fig-3", "fig-4", "fig-6", "fig-7", "fig-8", "fig-9", "fig-10", "fig-11", "fig-12", "fig-13", "fig-14", "algorithm")


class OnePath(Runs):
    """One path in place of every other."""

    def __init__(self, path):
        super().__init__()
        self.one = path

    def path(self, *_, **__):
        return self.one

    stiff = path


@pytest.fixture(scope="module")
def folder(coarse_path, tmp_path_factory):
    """A report made in seconds, or the one that is asked for."""
    if "JAXGEL_REPORT" in os.environ:
        return Path(os.environ["JAXGEL_REPORT"])
    with pytest.MonkeyPatch.context() as patch:
        exact = np.asarray(jaxgel.uniaxial_swelling(np.array(paper_square.MU), jaxgel.sample("square").gel))
        off = {name: 1e-12 * 7.3**k * np.linspace(1, 2, len(exact)) for k, name in enumerate(paper_square.METHODS)}
        patch.setattr(paper_square, "_stretches", lambda _, name: exact * (1 + off[name]))
        patch.setattr(paper_square, "_timed", _timed)
        patch.setattr(paper_square, "make_cloud", lambda plate: round(1 / plate.spacing) + 1)
        patch.setattr(paper_curves, "CENTRE", 0)
        patch.setattr(paper, "Runs", lambda _: OnePath(coarse_path))
        patch.setattr(Figure, "savefig", lambda *_, **__: None)
        out = tmp_path_factory.mktemp("report")
        failed = paper.run_paper([name for name in ITEMS if name != "algorithm"], out, quiet=True, say=lambda _: None)
        assert failed == []
    return out


def _timed(side, name):
    time = 0.1234 * side * (1 + len(name) % 7)
    numbers = {"seconds": time, "cpu_seconds": 1.1 * time, "newton_iterations": side + len(name), "reached_mu": -0.1 * (side == 7)}
    return {"nodes": side**2, "method": name, "runs": 3} | numbers


def read(folder, name):
    """Record and rows of an item; what looks like a number is one."""
    with (folder / f"{name}.csv").open(newline="") as file:
        rows = [{key: float(v) if NUMBER.fullmatch(v) or v == "nan" else v for key, v in row.items()} for row in csv.DictReader(file)]
    return json.loads((folder / f"{name}.json").read_text()), rows


def shows(text, value):
    """Whether the number ``text`` is ``value`` to the digits that it shows."""
    digits = text.lstrip("-").split("e")[0].partition(".")[2]
    kinds = f"{abs(value):.{len(digits)}{'e' if 'e' in text else 'f'}}", f"{abs(value):.2g}"
    return abs(float(text)) in map(float, kinds)


def unexplained(text, values):
    """Numbers in ``text`` that are none of ``values``."""
    return [number for number in NUMBER.findall(NAMES.sub("", text)) if not any(shows(number, v) for v in values if np.isfinite(v))]


def entries(rows):
    """All numbers of the rows, and as percentages."""
    numbers = [v for row in rows for v in row.values() if isinstance(v, float)]
    return [*numbers, *(100 * v for v in numbers)]


def column(rows, name, **where):
    """The values (k,) of a column in the rows that have the given entries."""
    return np.array([row[name] for row in rows if all(row[key] == v for key, v in where.items())])


# --- the same numbers once more, by item -------------------------------------------------------------------------------------


def of_stretches(rows, folder):
    errors = read(folder, "fig-3")[1]
    methods = {name: column(errors, name) for name in errors[0] if name != "mu"}
    mu = column(errors, "mu")
    values = [f(e[np.isfinite(e)]) for e in methods.values() if np.isfinite(e).any() for f in (np.max, np.median, np.min)]
    printed, other = methods[paper_square.PRINTED], methods[paper_square.OTHER]
    both = np.isfinite(printed) & np.isfinite(other)
    against = [v for name, e in methods.items() if name.startswith("ICVEFG") for v in e[np.isfinite(e)]]
    counts = [both.sum(), np.sum(printed[both] < other[both]), len(against), np.sum(np.array(against) >= 1e-4)]
    ends = [mu[np.isfinite(e)][-1] for e in methods.values() if np.isfinite(e).any()]
    return [*values, *counts, *ends, 1e-4, 1e-10]


def of_times(rows, folder):
    seconds = {name: column(rows, "cpu_seconds", method=name) for name in paper_square.TIMED}
    pairs = ((paper_square.OTHER, paper_square.PRINTED), (paper_square.OTHER, paper_square.ALIKE), (paper_square.PLAIN, paper_square.ALIKE))
    ratios = [f(seconds[a] / seconds[b]) for a, b in pairs for f in (np.min, np.max)]
    iterations = [column(rows, "newton_iterations", method=name).sum() for name in seconds]
    lost = np.sum(column(rows, "reached_mu", method=paper_square.OTHER) < 0)
    return [*ratios, *iterations, lost, len(paper_square.SIDES), len(paper_square.MU), paper_square.REPEATS, paper_square.LIMIT, 0.0]


def of_patterns(rows, folder):
    known = FINITE_ELEMENTS["sample-1"]
    mu, angle = column(rows, "mu", path=1), column(rows, "midline_rotation_deg", path=1)
    off = [abs(angle[mu == m][0] / r - 1) for m, r in zip(known["mu"], known["rotation"], strict=True) if m in mu]
    return [100 * max(off, default=0.0), 1.0, np.sqrt(2), np.sqrt(0.5)]


def of_rotation(rows, folder):
    values, printed = [*paper_curves.PRINTED_ANGLES.values(), paper_curves.NO_ROTATION], paper_curves.PRINTED_ANGLES
    ellipses = [list(group) for _, group in itertools.groupby(rows, lambda row: (row["sample"], row["contact"], row["nodes"]))]
    halves = [part for group in ellipses for part in _rising(group)]
    for group in halves:
        mu, angle, surface = (column(group, name) for name in ("mu", "rotation_deg", "surface_ratio"))
        values += [crossing(mu, angle, printed[int(group[0]["sample"])]), crossing(mu, surface, CREASE_RATIO), angle.max()]
    known = FINITE_ELEMENTS["sample-1"]
    for group in halves:
        pairs = [(row["rotation_deg"], r) for row in group for m, r in zip(known["mu"], known["rotation"], strict=True) if row["mu"] == m]
        values += [100 * max((abs(a / r - 1) for a, r in pairs), default=0.0), len(pairs)]
    return [*values, known["rotation"][1], -1.9678]  # the last: where the clouds are compared


def _rising(rows):
    """Rows cut where mu falls back: one part for each path."""
    cuts = [k for k in range(1, len(rows)) if rows[k]["mu"] <= rows[k - 1]["mu"]]
    return [rows[a:b] for a, b in zip([0, *cuts], [*cuts, len(rows)], strict=True)]


def of_lattice(rows, folder):
    contact = 0.5 * (0.2 if "JAXGEL_REPORT" in os.environ else 1.1)  # half the spacing
    return [float(jaxgel.free_swelling(-0.1688, jaxgel.sample("lattice").gel)), -0.2688, -0.1688, contact]


def of_areas(rows, folder):
    values = [100 * max(abs(row["area_reduction"] - row["kinematic"]) for row in rows), *paper_areas.PRINTED_AREAS.values()]
    values += [100 * v for v in paper_areas.PRINTED_AREAS.values()]
    for n, printed in paper_areas.PRINTED_AREAS.items():
        mu = crossing(column(rows, "mu", sample=n, contact="on"), column(rows, "area_reduction", sample=n, contact="on"), printed)
        values += [mu, float(jaxgel.free_swelling(mu, jaxgel.sample("sample-1").gel))] if np.isfinite(mu) else []
    return [*values, 3.0, *range(4)]  # families


DERIVED = {"fig-2": of_stretches, "fig-3": of_stretches, "fig-4": of_times, "fig-12": of_rotation, "fig-13": of_lattice, "fig-14": of_areas}
DERIVED["algorithm"] = lambda rows, folder: []


@pytest.mark.parametrize("name", ITEMS)
def test_every_number_of_the_report_follows_from_its_data(folder, name):
    if not (folder / f"{name}.json").exists():
        pytest.skip("only in a whole report")
    record, rows = read(folder, name)
    values = [*entries(rows), *DERIVED.get(name, of_patterns)(rows, folder), 1e-8 * (name == "algorithm"), float(len(rows))]
    known = [f * v for v in _leaves(FINITE_ELEMENTS) for f in (1, 100)]
    for what, _, ours, reference, _ in record["numbers"]:
        assert unexplained(ours, values) == []
        assert unexplained(what, [*values, *known]) == []
        assert unexplained(reference, [*values, *known]) == []
    for text in (record["verdict"], *(claim[2] for claim in record["claims"])):
        assert unexplained(text, values) == []


def _leaves(tree):
    if isinstance(tree, dict):
        return [v for name, branch in tree.items() if name != "spread" for v in _leaves(branch)]
    return [v for branch in tree for v in _leaves(branch)] if isinstance(tree, list) else [tree] if isinstance(tree, float | int) else []


def test_a_wrong_digit_is_found(folder):
    record, rows = read(folder, "fig-6")
    values = [*entries(rows), *of_patterns(rows, folder)]
    angle = record["numbers"][-1][2]
    assert unexplained(angle, values) == []
    wrong = f"{float(angle) + 0.01:.2f}"
    assert unexplained(wrong, values) == [wrong]


def test_the_report_holds_each_text_and_each_claim(folder):
    report = (folder / "report.md").read_text()
    for name in ITEMS:
        if (folder / f"{name}.json").exists():
            record, _ = read(folder, name)
            assert f"`jaxgel paper {name}`" in report and record["verdict"] in report
            assert all(f"| {' | '.join(line)} |" in report for line in record["numbers"])
            assert all(
                f"| {statement} | **{verdict}** | {evidence} | {name} |" in report for statement, verdict, evidence in record["claims"]
            )
    assert set(CLOSING) >= set(paper_areas.PRINTED_AREAS)
