"""Every item of the paper on one coarse path of sample 1, with fixed times.

Its figure, rows and table are made.
"""

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxgel
from jaxgel.paper import curves, square
from jaxgel.paper import runs as paper
from jaxgel.paper.items import Number, Runs

ITEMS = [name for name in paper.items() if name not in ("table-1", "algorithm")]


class OnePath(Runs):
    """One path in place of every other."""

    def __init__(self, path):
        super().__init__()
        self.one = path

    def path(self, *_, **__):
        return self.one

    def stiff(self, _):
        return self.one


@pytest.fixture(scope="module")
def folder(coarse_path, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        off = {
            name: 1e-12 * 7.3**k * np.linspace(1, 2, len(square.MU))
            for k, name in enumerate(square.METHODS)
        }
        patch.setattr(
            square, "_stretches", lambda _, name: square.exact(square.MU) * (1 + off[name])
        )
        patch.setattr(
            square,
            "_timed",
            lambda side, name: dict(
                nodes=side**2, method=name, cpu_seconds=0.1 * side, reached_mu=0.0
            ),
        )
        patch.setattr(square, "make_cloud", lambda plate: round(1 / plate.spacing) + 1)
        patch.setattr(curves, "CENTRE", 0)
        patch.setattr(paper, "Runs", lambda _: OnePath(coarse_path))
        patch.setattr(Figure, "savefig", lambda *_, **__: None)
        out = tmp_path_factory.mktemp("report")
        failed = paper.run_paper(ITEMS, out, quiet=True, say=lambda _: None)
        assert failed == []
    return out


@pytest.mark.slow
@pytest.mark.parametrize("name", ITEMS)
def test_the_report_has_the_table_of_each_item(folder, name):
    record, report = (
        json.loads((folder / f"{name}.json").read_text()),
        (folder / "report.md").read_text(),
    )
    assert f"`jaxgel paper {name}`" in report and record["numbers"]
    assert all(f"| {' | '.join(line)} |" in report for line in record["numbers"])


@pytest.mark.slow
def test_the_rotation_of_sample_1_is_that_of_the_path(folder, coarse_path):
    with (folder / "fig-12.csv").open(newline="") as file:
        first = [row for row in csv.DictReader(file) if row["sample"] == "1"][: len(coarse_path)]
    np.testing.assert_allclose(
        [float(row["rotation_deg"]) for row in first], jaxgel.rotation_angle(coarse_path), rtol=1e-8
    )


def test_an_error_bar_stands_beside_the_value():
    """Of the rotation on three clouds in the table of Fig. 12, and in any line that has one."""
    assert Number("rotation", 28.416, reference=28.37, error=0.1234).cells()[2:4] == [
        "28.42 ± 0.12",
        "28.37",
    ]
    clouds = [SimpleNamespace(model=SimpleNamespace(n_nodes=n)) for n in (400, 900, 1600)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            curves, "rotation_angle", lambda path: np.array([28.0 + 100.0 / path.model.n_nodes])
        )
        patch.setattr(curves, "at", lambda path, mu: 0)
        np.testing.assert_allclose(
            curves._errors(clouds), 1.25 * 100.0 / np.array([400, 900, 1600]), rtol=1e-9
        )
