"""The audit that ``jaxgel doctor`` makes, at one size on each side of the 16,384 rows beyond which a jaxlib went wrong."""

import tomllib
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jaxgel.cli.uncompiled import plain

from jaxgel.cli import command_line as cli
from jaxgel.cli import commands, doctor, versions


def test_compiled_kernels_agree_with_the_same_operations_one_by_one():
    """Three of the kernels; .ci/run has ``jaxgel doctor`` audit all of them."""
    found = list(doctor.audit((7, 16_385), ["matrix times row, summed", "Cauchy stress", "energy and residual"]))
    assert len(found) == 3
    assert [(f.name, f.difference) for f in found if not f.ok] == []


def test_every_kind_of_kernel_is_audited():
    assert len({**doctor.point_kernels(), **doctor.model_kernels()}) == 13


def test_a_wrong_program_is_found(monkeypatch):
    """As jaxlib 0.10.2 did: beyond 16,384 rows half of the sums are wrong, here by a billionth of a part more than is accepted."""

    def wrong(function, **_):
        def program(x):
            return [y * np.where(np.arange(len(y)) > 16_384, 1 + 2e-9, 1.0) for y in function(x)]

        return SimpleNamespace(lower=lambda x: SimpleNamespace(compile=lambda: program))

    monkeypatch.setattr(doctor.jax, "jit", wrong)
    monkeypatch.setattr(doctor, "model_kernels", dict)
    monkeypatch.setattr(doctor, "point_kernels", lambda: {"wrong": (lambda x: x, (np.linspace(1.0, 2.0, doctor.DISTINCT),))})
    assert [found.ok for found in doctor.audit((1000, 16_384))] == [True]
    assert [(found.ok, found.points) for found in doctor.audit((1000, 32_769, 7))] == [(False, 32_769)]


def test_what_is_not_compiled_agrees_with_what_is():
    """Every kind of loop and branch, operations that NumPy names and some that it does not, and nan without a warning."""

    def function(x):
        count = lax.while_loop(lambda s: s[0] < 5, lambda s: (s[0] + 1, 0.5 * s[1] + x), (0, x))[1]
        last, rows = lax.scan(lambda s, row: (s + row, s * row), x[0], x, reverse=True)
        chosen = lax.cond(last[0] > 0, jnp.sin, jnp.cos, x)
        scattered = jnp.zeros(9).at[jnp.array([1, 1, 20])].add(x[:, 0], mode="drop")
        padded = lax.pad(x, 1.0, ((1, 2, 1), (0, 0, 0)))
        order = jnp.cumsum(jnp.sort(x, axis=0), axis=1), jnp.argmax(x), jnp.argmin(x, axis=1), jnp.where(x > 0, x, -1), x[::-1, :2].T @ x
        parts = jnp.stack([x, 2 * x], axis=1), [lax.dynamic_slice(x, (row, -9), (2, 3)) for row in (-7, -2, 1, 8)]  # as far as it reaches
        bits, signs = jnp.arange(12).reshape(3, 4) & 6 | ~jnp.argmax(x), ~(x > 0) | (x < 1) & (x != 0)
        return count, rows, chosen, scattered, padded, order, parts, bits, signs, jnp.log(-x * x), x**-2, (x + 1j * x).conj()

    x = jnp.asarray(np.random.default_rng(1).normal(size=(3, 4)))
    found, expected = jax.tree.leaves(plain(function)(x)), jax.tree.leaves(jax.jit(function)(x))
    for a, b in zip(found, expected, strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_allclose(a, b, rtol=1e-14, atol=1e-15)  # a few roundings
    np.testing.assert_array_equal(plain(lambda x: lax.scan(lambda s, row: (s, row), 0.0, x)[1])(x[:0]), x[:0])


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
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    for name in ("jax", "jaxlib"):
        (requirement,) = [r for r in project["dependencies"] if r.startswith(f"{name}>")]
        assert {part.removeprefix("!=") for part in requirement.split(",") if part.startswith("!=")} == set(versions.REFUSED)


def test_only_known_flags_are_given_to_xla():
    """An unknown one ends the process: jaxlib 0.12 has no emitters to choose."""
    fusion = "--xla_cpu_use_fusion_emitters=false"
    assert fusion in versions.quick_flags("0.10.1")
    assert fusion not in versions.quick_flags("0.11.2") + versions.quick_flags("0.12.0.1")
    assert versions.in_one_part("0.10.1")
    assert not versions.in_one_part("0.12.0.1")


def test_flags_that_make_xla_compute_wrongly_are_warned_of():
    """At level 0 the audit finds the paper's stress wrong, and sweeps fail: the flag may come from a user's environment."""
    with pytest.warns(RuntimeWarning, match="optimization_level=0 makes XLA compute wrongly"):
        versions.warn_of_flags("--other=1 --xla_backend_optimization_level=0")
    versions.warn_of_flags("--xla_backend_optimization_level=1")
