"""A refined verification ends when the numbers of the design no longer move.

Its clouds are given by numbers here.
"""

import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from studies import STUDY

from jaxgel._validation import Inadmissible
from jaxgel.cases import study_from_table
from jaxgel.design import bound, verification, verify
from jaxgel.observables import min_gap

FIRST, FINEST = 1.0, 0.5


@pytest.fixture
def verified(monkeypatch):
    """Function: `verify` between two spacings of a design with given numbers ``of(h)``."""

    def run(of, constraints=(), empty=lambda h: False, **options):
        def on_cloud(problem, parameters, spacing, mu):
            if empty(spacing):
                raise Inadmissible("too coarse")
            value, margins = of(spacing)
            names = [c.name for c in constraints]
            found = dict(
                value=value,
                constraints=dict(zip(names, margins, strict=True)),
                valid=value is not None,
            )
            return found | dict(
                spacing=spacing,
                nodes=round(1000 / spacing**2),
                last={"rotation": value},
                reported={},
            ), None

        monkeypatch.setattr(verification, "_on_cloud", on_cloud)
        return verify(
            SimpleNamespace(constraints=constraints), {}, spacing=(FIRST, FINEST), **options
        )[0]

    return run


def test_it_ends_at_the_third_cloud_if_the_objective_has_settled(verified):
    found = verified(lambda h: (10.0 + 0.01 * h**2, ()))
    assert [cloud["spacing"] for cloud in found["clouds"]] == pytest.approx(
        [1.0, 2**-0.25, 2**-0.5]
    )
    assert (
        found["spacing"] == found["clouds"][-1]["spacing"]
        and found["clouds"][-1]["value"] == found["value"]
    )
    # of the trend: its numbers have no scatter
    np.testing.assert_allclose(found["errors"]["value"], 1.25 * 0.005, rtol=2e-3)
    assert found["errors"]["last"]["rotation"] == found["errors"]["value"]


def test_it_goes_on_to_the_finest_cloud_if_the_objective_moves(verified):
    found = verified(lambda h: (10.0 + 2.0 * h**2, ()))
    assert len(found["clouds"]) == 5 and found["spacing"] == FINEST
    assert found["errors"]["value"] > 0.01 * found["value"]


def test_a_small_misfit_is_compared_with_its_scale(verified):
    def misfit(h):
        return 1e-3 + 1e-3 * h**2, ()

    assert len(verified(misfit)["clouds"]) == 5
    assert len(verified(misfit, scale=1.0)["clouds"]) == 3


def test_it_goes_on_while_it_is_not_sure_that_a_constraint_is_met(verified):
    limit = (bound("gap >= 0", of=min_gap, above=0.0),)
    clear, touching = (
        (lambda margin: lambda h: (10.0, (margin + 0.1 * h**2,)))(0.5),
        lambda h: (10.0, (0.1 * h**2 - 0.04,)),
    )
    assert len(verified(clear, limit)["clouds"]) == 3
    assert len(verified(touching, limit)["clouds"]) == 5


def test_clouds_that_cannot_be_made_are_left_out_unless_it_is_the_finest(verified):
    found = verified(lambda h: (10.0, ()), empty=lambda h: h > 0.9)
    assert [cloud["spacing"] for cloud in found["clouds"]] == pytest.approx(
        [2**-0.25, 2**-0.5, 2**-0.75]
    )
    with pytest.raises(Inadmissible, match="too coarse"):
        verified(lambda h: (10.0, ()), empty=lambda h: True)


def test_numbers_that_a_design_does_not_have_get_no_error_bars(verified):
    found = verified(lambda h: (None if h < 0.55 else 10.0 + h**2, ()))
    assert len(found["clouds"]) == 5 and found["errors"]["value"] is None and not found["valid"]


@pytest.mark.slow
def test_error_bars_of_a_swollen_design_hold_its_values_on_a_finer_cloud():
    """Value, area and surface ratio of the small study within bars of a 2.4 times finer cloud."""
    study = study_from_table(tomllib.loads(STUDY), "small")
    parameters = study.problem.start
    found, path = study.verify(parameters, spacing=(1.2, 0.85), tolerance=1e-6)
    fine, _ = study.verify(parameters, spacing=0.55)
    assert [cloud["spacing"] for cloud in found["clouds"]] == pytest.approx(
        [1.2, 1.01, 0.85], abs=0.01
    ) and len(path) == 2
    assert abs(found["value"] - fine["value"]) < found["errors"]["value"] < 0.01
    for name in ("area_reduction", "surface_ratio"):
        assert abs(found["last"][name] - fine["last"][name]) < found["errors"]["last"][name]
