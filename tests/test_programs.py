"""Facts about compiled programs of clouds that are no longer in use."""

import pathlib
import sys

import numpy as np
import pytest

import jaxgel
from jaxgel.geometry import Plate


def mappings():
    return len(pathlib.Path("/proc/self/maps").read_text().splitlines())


@pytest.mark.slow
@pytest.mark.skipif(
    sys.platform != "linux",
    reason="other systems do not tell how many memory mappings a process has",
)
def test_programs_are_let_go_where_a_process_runs_out_of_memory_mappings(monkeypatch):
    plate = Plate(4, 4, [], edges={"top": "free"}, spacing=1.0)
    gel = jaxgel.Gel(1e-3, 0.1)

    def swollen():
        return jaxgel.sweep(
            jaxgel.Problem(jaxgel.discretise(jaxgel.make_cloud(plate)), gel), [-4.0, -3.0]
        ).x

    first, before = swollen(), mappings()
    monkeypatch.setattr("jaxgel._programs.CROWDED", 0.0)
    jaxgel.make_cloud(plate)
    assert mappings() < before - 200
    monkeypatch.undo()
    np.testing.assert_array_equal(swollen(), first)
