"""``jaxgel doctor`` beyond the 16,384 rows of a wrong jaxlib, and refused releases."""

import contextlib
import re
import tomllib
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from jaxgel._kept import KEPT
from jaxgel.cli import command_line as cli
from jaxgel.cli import doctor, environment, starting
from jaxgel.materials import Gel, cauchy_stress


def test_the_known_stretch_is_that_of_a_stress_free_gel():
    """A free gel has no stress: Nv (stretch - 1 / stretch) / stretch + p = 0 in plane strain."""
    F = np.diag(2 * [doctor.SWOLLEN])
    np.testing.assert_allclose(
        np.diag(cauchy_stress(F, -1.0, Gel(Nv=1e-3, chi=0.2))), 0, atol=1e-13
    )


@pytest.mark.slow
def test_the_command_computes_what_is_known_and_finds_a_wrong_program(monkeypatch, capsys):
    """As jaxlib 0.10.2 did: beyond 16,384 rows the values are wrong, here by a thousandth."""
    assert cli.main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert "float64: on" in out and "kept programs: none" in out
    assert "JAX sees no accelerator" in out or "programs of jax.jit and jax.vmap run on" in out
    compiled = jax.jit

    def wrong(function):
        return lambda *args: (
            np.asarray(compiled(function)(*args))
            * np.where(np.arange(doctor.POINTS) >= 16_384, 1 + 1e-3, 1.0)
        )

    monkeypatch.setattr(doctor.jax, "jit", wrong)
    assert cli.main(["doctor"]) == 3
    assert (
        "computes wrongly: sums of three squares, free swelling; install another jaxlib"
        in capsys.readouterr().err
    )


def test_accelerators_are_named_and_what_they_compute_wrongly_is_an_error(monkeypatch, capsys):
    device = SimpleNamespace(platform="gpu", id=1, device_kind="of a test")
    monkeypatch.setattr(doctor.jax, "devices", lambda: [device])
    monkeypatch.setattr(doctor.jax, "default_device", lambda given: contextlib.nullcontext(given))
    assert doctor.check_accelerators() == 0
    out = capsys.readouterr().out
    assert "gpu 1 (of a test), free swelling: relative difference" in out
    assert "programs of jax.jit and jax.vmap run on gpu 1; float64: on" in out
    monkeypatch.setattr(doctor, "differences", lambda: {"free swelling": 1e-3})
    assert doctor.check_accelerators() == 3
    assert "float64: WRONG" in capsys.readouterr().out


@pytest.mark.slow
def test_the_command_compiles_the_programs_of_the_built_in_cases(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(doctor, "sample_names", lambda: ["sample-1"])
    KEPT.keep(tmp_path)
    assert cli.main(["doctor", "--warm"]) == 0
    count, kept = (
        int(re.search(r"kept programs: (\d+), ", capsys.readouterr().out).group(1)),
        KEPT.folder,
    )
    KEPT.keep(None)
    assert count == len(list(kept.iterdir())) > 30
    assert any("_over_states" in file.name for file in kept.iterdir())


@pytest.mark.parametrize("jaxlib", list(environment.REFUSED))
def test_a_jaxlib_known_to_be_bad_is_refused_in_one_line(jaxlib, monkeypatch, capsys):
    monkeypatch.setattr(environment, "version", lambda _: jaxlib)
    monkeypatch.setattr(starting, "list_samples", lambda _: pytest.fail("was run"))
    assert cli.main(["samples"]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"jaxgel: error: jaxlib: {jaxlib} ")
    assert error.count("\n") == 1


def test_the_refused_versions_are_those_of_the_project():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    for name in ("jax", "jaxlib"):
        (requirement,) = [r for r in project["dependencies"] if r.startswith(f"{name}>")]
        assert {
            part.removeprefix("!=") for part in requirement.split(",") if part.startswith("!=")
        } == set(environment.REFUSED)


def test_only_known_flags_are_given_to_xla():
    """An unknown one ends the process: jaxlib 0.12 has no emitters to choose."""
    fusion = "--xla_cpu_use_fusion_emitters=false"
    assert fusion in environment.quick_flags("0.10.1")
    assert fusion not in environment.quick_flags("0.11.2") + environment.quick_flags("0.12.0.1")
