"""Case files and studies of several tests, each of one small plate, and their runs.

Programs are compiled once.
"""

import json
import shutil

import pytest

from jaxgel import Observer
from jaxgel.cases import load_case
from jaxgel.cli import command_line as cli
from jaxgel.design import DesignProblem, Outcome, search
from jaxgel.io import Recorder

TINY = """
[plate]
width = 4.0
height = 4.0
edges = { top = "free" }
[[holes]]
kind = "circle"
centre = [0.1, -0.2]
radius = 1.1
[discretisation]
spacing = 0.6666666666666666
nodes_per_hole = 12
"""
"""Case of the plate of `conftest.tiny_plate`."""
TILTED = """
[plate]
width = 8.0
height = 8.0
edges = { top = "free" }
[[holes]]
kind = "ellipse"
centre = [0.3, -0.2]
semi_axes = [2.4, 1.6]
angle = 0.4
[discretisation]
spacing = 1.2
nodes_per_hole = 8
[sweep]
mu = [-3.0, -1.8]
"""
"""Case of a tilted ellipse."""
STUDY = (
    TILTED
    + """
[[parameters]]
of = "semi_axes"
lower = [2.1, 1.4]
upper = [2.7, 1.8]
[[objective]]
of = "area_reduction"
goal = "maximise"
at = -1.8
[[constraints]]
of = "hole_area"
above = 10.0
[search]
evaluations = 4
[verification]
spacing = 1.2
mu = [-3.0, -1.8]
"""
)
"""Study of the tilted ellipse."""


def changed(text, *changes):
    """A text with (old, new) parts replaced, each of which it must have."""
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return text


COARSE = changed(TINY, ("0.6666666666666666", "0.8"), ("nodes_per_hole = 12", "nodes_per_hole = 8"))
"""The same plate with 39 nodes, for gels that swell in time."""


def one_cloud(patch, without=()):
    """Give all sweeps and verifications of designs one cloud.

    ValueError for a first semi-axis in the list ``without``.
    """
    make, made = DesignProblem.make_cloud, []

    def once(self, plate, spacing=None):
        if without and float(plate.holes[0].semi_axes[0]) in without:
            raise ValueError("plate: no cloud")
        made.extend([] if made else [make(self, plate, spacing)])
        return made[0]

    patch.setattr(DesignProblem, "make_cloud", once)


def interrupt(patch, sweep):
    """Let Ctrl-C come in the sweep of a search with this number.

    The list of the vectors of all sweeps.
    """
    forward, calls = search.Search._forward, []

    def interrupted(self, vector):
        calls.append(vector)
        if len(calls) == sweep:
            raise KeyboardInterrupt
        return forward(self, vector)

    patch.setattr(search.Search, "_forward", interrupted)
    return calls


def designed(text, folder, *, interrupted, sweep=3):
    """Folder of ``jaxgel design`` of a study, at once or interrupted in ``sweep`` and resumed."""
    (folder / "small.toml").write_text(text)
    command = ["design", str(folder / "small.toml"), "--out", str(folder / "out"), "--quiet"]
    with pytest.MonkeyPatch.context() as patch:
        one_cloud(patch)
        if interrupted:
            interrupt(patch, sweep)
            assert cli.main(command) == 130
            assert (
                json.loads((folder / "out" / "design.json").read_text())["outcome"]
                == Outcome.INTERRUPTED
            )
            command = ["resume", str(folder / "out")]
        assert cli.main(command) == 0
    return folder / "out"


class Interrupted(Recorder):
    """A recorder that keeps the folder as it was after every step."""

    def __call__(self, step):
        super().__call__(step)
        shutil.copytree(self.folder, self.folder.with_name(f"after-{len(self.records)}"))


def killed(text, parent):
    """Folder of a case's run, folders ``after-k`` killed after k states, and its path."""
    (parent / "case.toml").write_text(text)
    case = load_case(parent / "case.toml")
    recorder = Interrupted(parent / "whole", case, case.problem(case.model()))
    path = case.path(recorder.model, observer=Observer(accepted=recorder))
    recorder.finish("complete", path.stop_text, path.stop)
    return parent / "whole", path
