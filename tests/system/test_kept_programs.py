"""Programs kept in a folder: their use by a second process, and unusable files."""

import functools
import os
import shutil
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgel
from jaxgel import _kept
from jaxgel._compiled import PROGRAMS, compiled
from jaxgel._described import NotDescribed, described
from jaxgel._kept import KEPT, PROGRAM, TRIED, WAITING, try_waiting
from jaxgel.geometry import outline_points

GEL = jaxgel.Gel(Nv=1e-3, chi=0.2)
PROCESS = """
import sys, jax
names = []
listen = jax.monitoring.register_event_duration_secs_listener
listen(lambda event, _, **of: names.append(str(of.get("fun_name"))))
import jaxgel
jaxgel.keep_programs(sys.argv[1])
gel = jaxgel.Gel(Nv=1e-3, chi=0.2)
found = jax.value_and_grad(lambda mu: jaxgel.free_swelling(mu, gel))(-1.0)
print(*(float(value).hex() for value in found), sum("free_swelling" in name for name in names))
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder with the kept program of `free_swelling` at one mu."""
    folder = tmp_path_factory.mktemp("made") / "programs"
    with keeping(folder):
        jaxgel.free_swelling(-1.0, GEL)
        try_waiting(folder)
    (file,) = folder.glob(f"*/*{PROGRAM}")
    assert file.name.startswith("free_swelling-")
    return folder


@pytest.fixture
def folder(made, tmp_path):
    """A copy of `made` in which programs are kept during a test."""
    shutil.copytree(made, tmp_path / "programs")
    with keeping(tmp_path / "programs"):
        yield tmp_path / "programs"


class keeping:  # noqa: N801
    """Context in which programs are kept in a folder, none of them loaded before."""

    def __init__(self, folder):
        self.folder = folder

    def __enter__(self):
        PROGRAMS.forget_kept()
        KEPT.keep(self.folder)

    def __exit__(self, *_):
        KEPT.keep(None)
        PROGRAMS.forget_kept()


def files(folder):
    return sorted(file.name for file in folder.glob("*/*"))


def loads(folder):
    """Whether the one kept program is loaded; what is computed does not depend on it."""
    (name,) = {file.name.split(".")[0] for file in folder.glob("*/*")}
    found = KEPT.load(name)
    assert jaxgel.free_swelling(-1.0, GEL) == plain()
    return found is not None


@functools.cache
def plain():
    root = KEPT.root
    KEPT.keep(None)
    value = float(jaxgel.free_swelling(-1.0, GEL))
    KEPT.keep(root)
    return value


@pytest.mark.thorough
def test_a_second_process_neither_traces_nor_lowers_and_has_the_same_bits(tmp_path):
    """The first one's programs are tried by a process that outlives it."""

    def process():
        done = subprocess.run(
            [sys.executable, "-c", PROCESS, str(tmp_path)],
            check=True,
            capture_output=True,
            text=True,
        )
        assert not done.stderr
        *values, count = done.stdout.split()
        return values, int(count)

    values, count = process()
    assert count > 0
    end = time.monotonic() + 120
    while len(list(tmp_path.glob(f"programs/*/free_swelling*{PROGRAM}"))) < 2:  # value and reverse
        assert time.monotonic() < end, files(tmp_path / "programs")
        time.sleep(0.1)
    assert process() == (values, 0)


def test_a_kept_program_is_loaded(folder):
    assert loads(folder)


def test_damaged_files_are_compiled_anew(folder):
    (file,) = folder.glob("*/*")
    content = file.read_bytes()
    for damaged in (
        b"",
        content[:20],
        content[:-1],
        content[:100] + bytes([content[100] ^ 1]) + content[101:],
    ):
        file.write_bytes(damaged)
        PROGRAMS.forget_kept()
        assert not loads(folder), len(damaged)
    file.write_bytes(content)
    assert loads(folder)


def test_files_that_others_can_write_or_own_are_not_read(folder, monkeypatch):
    (file,) = folder.glob("*/*")
    for mode in (0o620, 0o602):
        file.chmod(mode)
        assert not loads(folder)
    file.chmod(0o600)
    assert loads(folder)
    monkeypatch.setattr(os, "getuid", lambda: file.stat().st_uid + 1)
    assert not loads(folder)


def test_programs_of_other_surroundings_are_not_seen(folder, monkeypatch):
    known = _kept.surroundings()
    monkeypatch.setattr(_kept, "surroundings", lambda: f"{known} of another release")
    KEPT.keep(folder)
    assert not loads(folder)
    assert len(list(folder.iterdir())) == 2


def test_the_folder_is_the_users_alone(tmp_path):
    with keeping(tmp_path / "new" / "programs"):
        assert KEPT.folder.stat().st_mode & 0o777 == 0o700
        assert KEPT.folder.parent.stat().st_mode & 0o777 == 0o700
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o770)
    with keeping(tmp_path / "open"):
        assert jaxgel.free_swelling(-1.0, GEL) == plain()
        assert KEPT.root is None
    assert not list((tmp_path / "open").iterdir())


def test_a_program_that_fails_its_trial_is_neither_used_nor_written_again(folder):
    (file,) = folder.glob("*/*")
    name = file.stem
    file.unlink()
    file.with_suffix(WAITING).write_bytes(b"damaged")
    assert KEPT.load(name) is None and not KEPT.accepts(name)
    try_waiting(folder)
    assert files(folder) == [f"{name}{TRIED}"]
    PROGRAMS.forget_kept()
    assert jaxgel.free_swelling(-1.0, GEL) == plain()
    assert files(folder) == [f"{name}{TRIED}"]


def test_what_was_used_least_recently_is_removed(folder, monkeypatch):
    (file,) = folder.glob("*/*")
    other = file.with_name(f"other{PROGRAM}")
    shutil.copy(file, other)
    os.utime(file, (1, 1))
    monkeypatch.setattr(_kept, "MAX_BYTES", other.stat().st_size)
    try_waiting(folder)
    assert files(folder) == [other.name]


def test_nothing_is_kept_in_the_trace_of_a_users_program(tmp_path):
    mu = np.array([-1.0, -0.5])
    with keeping(tmp_path):
        jax.jit(jaxgel.free_swelling)(mu, GEL)
        jax.vmap(lambda mu: jaxgel.free_swelling(mu, GEL))(mu)
    assert not files(tmp_path)


def test_derivatives_by_kept_programs_are_those_without(tmp_path):
    """To round-off: the reverse evaluates the function anew, in other programs."""
    t, angle = np.linspace(0.0, 1.0, 5), jnp.asarray(0.3)

    def length(angle, semi_axes=(3.0, 2.0)):
        hole = jaxgel.Ellipse(centre=jnp.zeros(2), semi_axes=jnp.asarray(semi_axes), angle=angle)
        return jnp.sum(outline_points(hole, t)[1:3] ** 3)

    def derivatives():
        return [
            *(
                derivative(length)(angle)
                for derivative in (
                    jax.grad,
                    jax.jacfwd,
                    jax.jacrev,
                    lambda f: jax.grad(jax.grad(f)),
                )
            ),
            jax.jvp(length, (angle,), (2.0 * angle,))[1],
            *jax.grad(lambda axes: length(angle, axes))((3.0, 2.0)),
            jax.vmap(jax.grad(length))(angle[None])[0],
            jax.jit(jax.grad(length))(angle),
            *jax.vjp(lambda *args: jax.jit(length)(*args), angle)[1](angle),
        ]

    expected = derivatives()
    with keeping(tmp_path):
        np.testing.assert_allclose(derivatives(), expected, rtol=1e-12)
    assert any("reverse" in name for name in files(tmp_path)) and any(
        "tangent" in name for name in files(tmp_path)
    )


def test_users_functions_and_classes_are_not_kept(tmp_path):
    class Mine(jaxgel.Gel):
        pass

    for value in (plain, lambda: 0, Mine, object(), np.array([None])):
        with pytest.raises(NotDescribed):
            described(value)
    with keeping(tmp_path):
        assert float(compiled()(lambda x: 2 * x)(3.0)) == 6.0
    assert not files(tmp_path)


def test_values_are_described_by_their_content():
    same = [
        described(
            (1, "a", None, np.arange(3), jaxgel.free_swelling, jax.tree.structure({"b": (1, None)}))
        )
        for _ in range(2)
    ]
    assert same[0] == same[1]
    values = (
        1,
        1.0,
        True,
        "1",
        None,
        np.arange(3),
        np.arange(3.0),
        np.arange(1, 4),
        (1, 2),
        [1, 2],
        jax.tree.structure((1, 2)),
    )
    assert len({described(value) for value in values}) == len(values)


@pytest.mark.slow
def test_the_command_line_keeps_programs_with_its_cache_and_not_without():
    def root(**variables):
        code = (
            "from jaxgel.cli.environment import prepare_environment as p; p(); from jaxgel._kept "
            "import KEPT; print(KEPT.root)"
        )
        inherited = {
            name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"
        }
        return subprocess.run(
            [sys.executable, "-c", code], check=True, capture_output=True, env=inherited | variables
        ).stdout.decode()

    assert root(JAXGEL_CACHE="/own") == "/own/programs\n"
    assert root(JAXGEL_CACHE="off") == "None\n"
    assert root(JAX_COMPILATION_CACHE_DIR="/shared") == "None\n"


@pytest.mark.slow
def test_a_sweep_and_its_gradient_are_those_without_kept_programs(tmp_path):
    plate = jaxgel.sample("sample-1")
    cloud = jaxgel.make_cloud(plate, spacing=4.0)

    def rotation(axes):
        model = jaxgel.discretise(cloud.at(plate.at([{"semi_axes": axes}] * 4)))
        return jaxgel.rotation_angle(jaxgel.sweep(jaxgel.Problem(model, plate.gel), [-3.0]))[-1]

    results = []
    for _ in range(2):
        results += jax.value_and_grad(rotation)(jnp.array([5.0, 4.0]))
        KEPT.keep(tmp_path)
    KEPT.keep(None)
    PROGRAMS.forget_kept()
    np.testing.assert_allclose(results[2], results[0], rtol=1e-10)
    np.testing.assert_allclose(results[3], results[1], rtol=1e-8)
    assert any("_over_states" in name for name in files(tmp_path))


def test_nothing_is_kept_or_loaded_of_sources_that_were_edited_after_the_import(
    folder, monkeypatch
):
    before = files(folder)
    monkeypatch.setattr(KEPT, "_imported", 0.0)  # earlier than any source
    monkeypatch.setattr(KEPT, "_looked", -np.inf)
    assert jaxgel.free_swelling(-1.0, GEL) == plain()
    # of a program that is not kept yet
    assert jaxgel.free_swelling(np.array([-1.0, -0.5]), GEL).shape == (2,)
    assert KEPT.root is None and files(folder) == before
