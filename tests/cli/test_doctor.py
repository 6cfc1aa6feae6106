"""The audit that ``jaxgel doctor`` makes beyond the 16,384 rows after which a jaxlib went wrong, and the releases that are refused."""

import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxgel.cli import command_line as cli
from jaxgel.cli import doctor, environment, starting
from jaxgel.materials import osmotic


def test_compiled_kernels_agree_with_small_batches():
    found = list(doctor.audit())
    assert len(found) == 6
    assert [(f.name, f.difference) for f in found if not f.ok] == []


def test_the_known_digits_are_a_root_of_the_free_gel():
    """The stress of a free gel vanishes: Nv (stretch - 1 / stretch) / stretch + p = 0 in plane strain."""
    stretch, Nv = doctor.SWOLLEN, doctor.GEL.Nv
    F = np.diag([stretch, stretch])
    np.testing.assert_allclose(np.diag(doctor.cauchy_stress(F, -1.0, doctor.GEL)), 0, atol=1e-13)
    assert abs(float(osmotic(stretch**2, -1.0, doctor.GEL))) < Nv


def test_a_wrong_program_is_found(monkeypatch):
    """As jaxlib 0.10.2 did: beyond 16,384 rows the sums are wrong, here of one row by a thousandth of its sum."""
    compiled = jax.jit

    def wrong(function, **options):
        def program(*args):
            value = np.asarray(compiled(function, **options)(*args))
            return value * np.where(np.arange(len(value)) >= 16_384, 1 + 1e-3, 1.0)

        return program

    kernels = {"sum": doctor.kernels()["matrix times row of 3, squared, summed"]}
    monkeypatch.setattr(doctor, "kernels", lambda: kernels)
    monkeypatch.setattr(doctor.jax, "jit", wrong)
    assert [found.ok for found in doctor.audit()] == [False, True]
    monkeypatch.setattr(doctor, "POINTS", 16_384)
    assert [found.ok for found in doctor.audit()] == [True, True]


def test_the_command_reports_every_kernel(monkeypatch, capsys):
    kinds = {True: doctor.Finding("sound", 1e-15), False: doctor.Finding("broken", float("nan"))}
    for ok, code in ((True, 0), (False, 3)):
        monkeypatch.setattr(doctor, "audit", lambda ok=ok: [kinds[ok]])
        assert cli.main(["doctor"]) == code
        printed = capsys.readouterr()
        assert "float64: on" in printed.out
        assert kinds[ok].name in printed.out
        assert ("computes wrongly: broken" in printed.err) == (not ok)


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
        assert {part.removeprefix("!=") for part in requirement.split(",") if part.startswith("!=")} == set(environment.REFUSED)


def test_only_known_flags_are_given_to_xla():
    """An unknown one ends the process: jaxlib 0.12 has no emitters to choose."""
    fusion = "--xla_cpu_use_fusion_emitters=false"
    assert fusion in environment.quick_flags("0.10.1")
    assert fusion not in environment.quick_flags("0.11.2") + environment.quick_flags("0.12.0.1")
    assert environment.in_one_part("0.10.1")
    assert not environment.in_one_part("0.12.0.1")
