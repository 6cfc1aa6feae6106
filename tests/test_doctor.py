"""The audit that ``jaxgel doctor`` makes, at one size on each side of the 16,384 rows beyond which a jaxlib went wrong."""

import tomllib
from pathlib import Path

import jax.numpy as jnp
import pytest

from jaxgel import cli, commands, doctor, versions


def test_compiled_kernels_agree_with_the_same_operations_one_by_one():
    """Three of the kernels; .ci/run has ``jaxgel doctor`` audit all of them."""
    found = list(doctor.audit((7, 16_385), ["matrix times row, summed", "Cauchy stress", "energy and residual"]))
    assert len(found) == 3
    assert [(f.name, f.difference) for f in found if not f.ok] == []


def test_every_kind_of_kernel_is_audited():
    assert len({**doctor.point_kernels(), **doctor.model_kernels()}) == 13


def test_a_wrong_program_is_found(monkeypatch):
    """As jaxlib 0.10.2 did: beyond 16,384 rows half of the sums are wrong, here by a billionth of a part more than is accepted."""

    def kernel(x):
        return x * jnp.where(jnp.arange(len(x)) > 16_384, 1 + 2e-9, 1.0)

    monkeypatch.setattr(doctor.jax, "vmap", lambda _: kernel)
    arguments = (jnp.linspace(1.0, 2.0, doctor.DISTINCT),)
    assert doctor._at_points("wrong", (1000, 16_384), None, arguments).ok
    found = doctor._at_points("wrong", (1000, 32_769, 7), None, arguments)
    assert (found.ok, found.points) == (False, 32_769)


def test_the_command_reports_every_kernel(monkeypatch, capsys):
    kinds = {True: doctor.Finding("sound", 1e-15, 7), False: doctor.Finding("broken", float("nan"), 16_385)}
    for ok, code in ((True, 0), (False, 3)):
        monkeypatch.setattr(doctor, "audit", lambda ok=ok: [kinds[ok]])
        assert cli.main(["doctor"]) == code
        printed = capsys.readouterr()
        assert "float64: on" in printed.out
        assert kinds[ok].name in printed.out
        assert ("computes wrongly: broken" in printed.err) == (not ok)


@pytest.mark.parametrize("jaxlib", list(versions.REFUSED))
def test_a_jaxlib_known_to_be_bad_is_refused_in_one_line(jaxlib, monkeypatch, capsys):
    monkeypatch.setattr(versions, "version", lambda _: jaxlib)
    monkeypatch.setattr(commands, "list_samples", lambda _: pytest.fail("was run"))
    assert cli.main(["samples"]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"jaxgel: error: jaxlib: {jaxlib} ")
    assert error.count("\n") == 1


def test_the_refused_versions_are_those_of_the_project():
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
    for name in ("jax", "jaxlib"):
        (requirement,) = [r for r in project["dependencies"] if r.startswith(f"{name}>")]
        assert {part.removeprefix("!=") for part in requirement.split(",") if part.startswith("!=")} == set(versions.REFUSED)
