"""Random gels and mu on a tiny cloud end as a path that obeys mechanics, or as one line.

tests/random_cases.py draws everything at random, clouds too, for as many cases as one likes.
"""

import dataclasses

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from random_cases import faults, outcome, random_time_table

import jaxgel
from jaxgel.continuation import SweepFailed

GELS = st.builds(
    lambda power, chi: jaxgel.Gel(10**power, chi), st.floats(-5, -1), st.floats(1e-9, 1.2)
)


EASY = settings(
    deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
SWEEPS = given(
    gel=GELS,
    ends=st.tuples(st.floats(-8, -1), st.floats(-1, 0)).filter(lambda ends: ends[0] < ends[1]),
    chosen=st.booleans(),
    branch=st.sampled_from(["stable", "symmetric"]),
    contact=st.sampled_from(["on", "off", "stop"]),
)


@pytest.mark.slow
@settings(EASY, max_examples=8)
@SWEEPS
@example(gel=jaxgel.Gel(1e-5, 1e-9), ends=(-8.0, 0.0), chosen=True, branch="stable", contact="on")
@example(gel=jaxgel.Gel(1e-1, 1e-9), ends=(-8.0, 0.0), chosen=True, branch="stable", contact="on")
@example(gel=jaxgel.Gel(1e-5, 1.2), ends=(-8.0, 0.0), chosen=True, branch="stable", contact="on")
@example(gel=jaxgel.Gel(1e-1, 1.2), ends=(-8.0, 0.0), chosen=True, branch="stable", contact="on")
def test_random_sweeps_obey_mechanics_or_say_why_not(
    tiny_model, gel, ends, chosen, branch, contact
):
    obeys(tiny_model, gel, ends, chosen, branch, contact)


def obeys(tiny_model, gel, ends, chosen, branch, contact):
    """The sweep has no faults, and its reason is one line."""
    mu = jaxgel.Adaptive(*ends) if chosen else np.linspace(*ends, 3).tolist()
    try:
        path = jaxgel.sweep(
            jaxgel.Problem(tiny_model, gel, contact=contact == "on"), mu, branch=branch
        )
    except SweepFailed as failed:
        reason = str(failed)
    else:
        reason = path.stop_text
        check(path, ends[1])
    assert "\n" not in reason


def check(path, last):
    """The path has no faults and says where it ended: at its ``last`` mu, or why not."""
    assert faults(path) == []
    assert path.stop.ok == (path.mu[-1] == last)
    assert path.stop.ok or path.stop_text.startswith(f"stopped after mu = {path.mu[-1]:.6g}: ")


@pytest.mark.slow
@pytest.mark.parametrize("number", [3, 11, 13])
def test_random_plates_in_random_baths_obey_mechanics_or_say_why_not(number):
    """Forces, solvent and J of every state."""
    text, bad = outcome(random_time_table(np.random.default_rng(number)))
    assert bad == [] and "\n" not in text


@pytest.mark.slow
def test_the_faults_of_a_broken_path_are_found(path):
    """A path with its states exchanged, and one that is pulled by a hair."""
    assert faults(path) == []
    mixed = dataclasses.replace(path, x=path.x[::-1])
    assert len(faults(mixed)) >= len(path) - 1
    hair = np.array(path.x)
    hair[3, 150] += 1e-6
    (fault, *_) = faults(dataclasses.replace(path, x=hair))
    assert fault.startswith(f"mu = {path.mu[3]:.4g}: imbalance")
